"""The command line: ``fmsync bench run SUITE``, ``fmsync bench report``, ``fmsync bench compare A B``.

A room brings its commands in a module with ``add_parser(commands)``, which ends in ``set_defaults(run=function)``; the
function takes the parsed arguments and gives an exit status.
"""

import argparse
import importlib
import importlib.util
import sys

import fmsync

_ROOMS = ("fmsync.sync_cli", "fmsync.bench.commands")


def main(arguments: list[str] | None = None) -> int:
    """Run a command; bad input ends with one line and status 2.

    Examples
    --------
    >>> from fmsync.cli import main
    >>> main(["bench", "compare", "missing.parquet", "missing.parquet"])
    2
    """
    parser = argparse.ArgumentParser(prog="fmsync", description=fmsync.__doc__.partition("\n")[0])
    parser.add_argument("--version", action="version", version=f"fmsync {fmsync.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for room in _ROOMS:
        if importlib.util.find_spec(room) is not None:
            importlib.import_module(room).add_parser(commands)
    parsed = parser.parse_args(arguments)
    try:
        return parsed.run(parsed)
    except ValueError as error:
        print(f"fmsync: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
