"""The command line: ``fmsync sync MESH_OR_FOLDER... -o OUT``."""

import argparse
import sys

import fmsync
from fmsync import sync_cli
from fmsync.extras import MissingExtra


def main(arguments: list[str] | None = None) -> int:
    """Run a command; bad input, or an extra that is missing, ends with one line and status 2.

    Examples
    --------
    >>> from fmsync.cli import main
    >>> main(["sync", "no_such_folder", "-o", "matched"])
    2
    """
    parser = argparse.ArgumentParser(prog="fmsync", description=fmsync.__doc__.partition("\n")[0])
    parser.add_argument("--version", action="version", version=f"fmsync {fmsync.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    sync_cli.add_parser(commands)
    parsed = parser.parse_args(arguments)
    try:
        return parsed.run(parsed)
    except (ValueError, MissingExtra) as error:
        print(f"fmsync: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
