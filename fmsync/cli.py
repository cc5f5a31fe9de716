"""The command line: ``fmsync sync``, ``solve``, ``sample`` and ``info``."""

import argparse
import os
import sys
import tomllib
from pathlib import Path

import fmsync
from fmsync import info_cli, problem_cli, sync_cli
from fmsync.extras import MissingExtra


def main(arguments: list[str] | None = None) -> int:
    """Run a command; what can be expected to fail ends with one line on stderr and a status.

    2: bad input, or an extra that is missing; 1: it failed on the way, for instance on a full disk; 130: Ctrl-C.
    """
    parser = argparse.ArgumentParser(prog="fmsync", description=fmsync.__doc__.partition("\n")[0])
    parser.add_argument("--version", action="version", version=f"fmsync {fmsync.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    texts = tomllib.loads(Path(__file__).with_name("help.toml").read_text(encoding="utf-8"))

    def add(name: str) -> argparse.ArgumentParser:
        return commands.add_parser(name, formatter_class=argparse.RawDescriptionHelpFormatter, **texts[name])

    sync_cli.add_parsers(add)
    problem_cli.add_parsers(add)
    info_cli.add_parser(add)
    parsed = parser.parse_args(arguments)
    try:
        status: int = parsed.run(parsed)
        sys.stdout.flush()
        return status
    except (ValueError, MissingExtra) as error:
        return _ended(error, 2)
    except KeyboardInterrupt:
        return _ended(parsed.stopped, 130)
    except BrokenPipeError:  # nobody reads what we print; Python would complain once more when it closes stdout
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (OSError, MemoryError, RuntimeError) as error:
        return _ended(str(error) or type(error).__name__, 1)


def _ended(why: object, status: int) -> int:
    print(f"fmsync: {' '.join(str(why).split())}".encode("utf-8", "replace").decode(), file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
