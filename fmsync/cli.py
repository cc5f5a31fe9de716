"""The command line: ``fmsync sync``, ``transfer``, ``solve``, ``sample`` and ``info``."""

import argparse
import importlib
import os
import sys
import tomllib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import fmsync
from fmsync.extras import MissingExtra

_TYPES = {"Path": Path, "int": int, "float": float}
_RUNS = {"sync": ("sync_cli", "run"), "transfer": ("sync_cli", "run_transfer"), "info": ("info_cli", "run")}
_RUNS |= {"solve": ("problem_cli", "run_solve"), "sample": ("problem_cli", "run_sample")}


def add_commands(
    parser: argparse.ArgumentParser, file: Path, runs: Mapping[str, Callable[..., int]], **defaults: object
) -> None:
    """Add the commands that a TOML file tells, with their texts and options, and what runs each."""
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, told in tomllib.loads(file.read_text(encoding="utf-8")).items():
        options, stopped = told.pop("options", {}), told.pop("stopped", "")
        texts = {"description": told["help"], "formatter_class": argparse.RawDescriptionHelpFormatter} | told
        command = commands.add_parser(name, **texts)
        command.set_defaults(run=runs[name], stopped=stopped, **defaults)
        for names, option in options.items():
            kind = {"type": _TYPES[option["type"]]} if "type" in option else {}
            command.add_argument(*names.split(), **option | kind)


def main(arguments: list[str] | None = None) -> int:
    """Run a command; what can be expected to fail ends with one line on stderr and a status.

    2: bad input, or an extra that is missing; 1: it failed on the way, for instance on a full disk; 130: Ctrl-C.
    """
    parser = argparse.ArgumentParser(prog="fmsync", description=fmsync.__doc__.partition("\n")[0])
    parser.add_argument("--version", action="version", version=f"fmsync {fmsync.__version__}")
    runs = {name: partial(_run, *place) for name, place in _RUNS.items()}
    add_commands(parser, Path(__file__).with_name("help.toml"), runs, jobs=os.cpu_count())
    parsed = parser.parse_args(arguments)
    try:
        status = parsed.run(parsed)
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


def _run(module: str, function: str, options: argparse.Namespace) -> int:
    """Import what a command needs when it runs, so that the others, and ``--help``, start quickly."""
    return getattr(importlib.import_module(f"fmsync.{module}"), function)(options)


def _ended(why: object, status: int) -> int:
    print(f"fmsync: {' '.join(str(why).split())}".encode("utf-8", "replace").decode(), file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
