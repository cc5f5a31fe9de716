"""Commands about shape collections: ``python -m data_gen --help``."""

import argparse
import json
import sys

from data_gen.collections import load_collection
from data_gen.fingerprints import known_collections, verify
from data_gen.report import collection_report
from fmsync.extras import MissingExtra


def main(arguments: list[str] | None = None) -> int:
    """Run one command; the exit code is 1 when a collection is refused or does not verify."""
    parser = argparse.ArgumentParser(prog="python -m data_gen", description="Look at a collection of shapes.")
    told = "report isometry, spectra, cycle errors and determinants at n = 20 as JSON, or verify counts and "
    told += "fingerprints against the table that comes with the project"
    parser.add_argument("command", choices=("report", "verify"), help=told)
    parser.add_argument("collection", help="'cats', a folder, or a folder inside FMSYNC_DATA")
    options = parser.parse_args(arguments)
    try:
        if options.command == "report":
            print(json.dumps(collection_report(load_collection(options.collection))))
            return 0
        table, name = known_collections(), options.collection.rstrip("/").rpartition("/")[2]
        if name not in table:
            raise ValueError(f"{name}: no fingerprints known; known are {', '.join(table)}")
        verdicts = verify(load_collection(options.collection), table[name])
        for shape, verdict in verdicts.items():
            print(f"{shape}: {verdict}")
        return 0 if set(verdicts.values()) == {"ok"} else 1
    except (ValueError, MissingExtra) as error:
        print(error, file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
