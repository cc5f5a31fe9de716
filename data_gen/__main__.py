"""Commands about shape collections: ``python -m data_gen --help``."""

import argparse
import json
import sys

from data_gen.collections import load_collection
from data_gen.fingerprints import known_collections, same_triangulation, verify
from data_gen.isometry import edge_distortion
from data_gen.report import collection_report
from fmsync.extras import MissingExtra


def main(arguments: list[str] | None = None) -> int:
    """Run one command; the exit code is 1 when a collection is refused or does not verify."""
    parser = argparse.ArgumentParser(
        prog="python -m data_gen",
        description="Look at a collection of shapes: 'cats', a folder, or a folder inside FMSYNC_DATA.",
        epilog="example: python -m data_gen isometry cats",
    )
    commands = parser.add_subparsers(dest="command", required=True)
    for name, what in (
        ("list", "names, vertex and face counts"),
        ("isometry", "mean |log edge-length ratio| over all pairs, shapes scaled to unit area"),
        ("report", "isometry, spectra, cycle errors and determinants at n = 20, as JSON"),
        ("verify", "compare counts and fingerprints with the table that comes with the project"),
    ):
        command = commands.add_parser(name, help=what, description=what)
        command.add_argument("collection", nargs="?" if name != "verify" else None, default=None)
    options = parser.parse_args(arguments)
    try:
        return {"list": _list, "isometry": _isometry, "report": _report, "verify": _verify}[options.command](
            options.collection
        )
    except (ValueError, MissingExtra) as error:
        print(error, file=sys.stderr)
        return 1


def _list(collection):
    shapes = load_collection(collection)
    for shape in shapes:
        faces = "a point cloud" if shape.faces is None else f"{len(shape.faces)} faces"
        note = same_triangulation(shapes[0], shape)
        agreement = {"identical": "", "reoriented": f", triangles of {shapes[0].name} reoriented", None: ""}[note]
        print(f"{shape.name}: {shape.n_vertices} vertices, {faces}{agreement}")
    return 0


def _isometry(collection):
    shapes = load_collection(collection)
    values = edge_distortion(shapes)
    print(f"{len(shapes)} shapes, {len(values)} pairs: mean {values.mean():.3f}, range {values.min():.3f}", end="")
    print(f"–{values.max():.3f}")
    return 0


def _report(collection):
    print(json.dumps(collection_report(load_collection(collection))))
    return 0


def _verify(collection):
    table = known_collections()
    name = collection.rstrip("/").rpartition("/")[2]
    if name not in table:
        raise ValueError(f"{name}: no fingerprints known; known are {', '.join(table)}")
    verdicts = verify(load_collection(collection), table[name])
    for shape, verdict in verdicts.items():
        print(f"{shape}: {verdict}")
    return 0 if set(verdicts.values()) == {"ok"} else 1


if __name__ == "__main__":
    sys.exit(main())
