"""``fmsync sync``, from mesh files to correspondences with a confidence on every vertex, and ``fmsync transfer``."""

import argparse
import itertools
import json
import os
import re
import shutil
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import fmsync
from fmsync.matching import ConformalCalibration, SyncedShapes
from fmsync.matching.conformal import default_calibration
from fmsync.matching.map_files import read_maps
from fmsync.matching.outliers import OutlierWarning
from fmsync.matching.output import edge_table, transferred_tables, write_all
from fmsync.matching.report import quality_flags
from fmsync.mesh_io import mesh_files, read_shape
from fmsync.shape import Shape

_WORK = ".fmsync"  # inside OUT while a run is not complete: finished pairs, and the output as it is written
_LONGEST_NAME = 80  # characters of a shape's name in file names; two of them stand in one


def run_transfer(options: argparse.Namespace) -> int:
    """Carry the columns of a table to every other shape of a collection."""
    with _working_folder(options.output) as work:
        tables = transferred_tables(options.synced, options.values, options.on)
        for name, table in tables.items():
            table.to_csv(work / "output" / f"{name}.csv", index=False, float_format="%.5g")
    print(f"{options.output}: a table for each of {len(tables)} shapes")
    return 0


def run(options: argparse.Namespace) -> int:
    """Do what the command line says; whatever is wrong with it raises a ValueError before long work."""
    _check(options)
    own = options.calibration
    calibration = default_calibration() if own is None else ConformalCalibration.load(own)
    calibration.scale(options.level)
    files = mesh_files(options.meshes)
    stems = [file.stem for file in files]
    names = file_names(stems)
    progress = sys.stderr.isatty()  # on a terminal, and nowhere else
    with _working_folder(options.output) as work:
        caught: list[str] = []
        with warnings.catch_warnings(action="always"):
            warnings.showwarning = partial(_hear, caught)
            shapes = [replace(read_shape(file, manifold=False), name=name) for file, name in zip(files, names)]
            maps = options.maps and read_maps(options.maps, stems, [shape.n_vertices for shape in shapes])
            landmarks = options.landmarks and _landmarks(options.landmarks, shapes)
            print(f"fmsync: {len(shapes)} shapes, in this order: {', '.join(names)}", file=sys.stderr)
            counts = {f"n_{name}": getattr(options, name) for name in ("basis", "refined", "samples", "draws")}
            stage = {"jobs": options.jobs, "checkpoint": work / "pairs", "progress": progress, "rng": options.seed}
            chosen = {name: getattr(options, name) for name in ("graph", "drop_outliers", "fast")}
            given = {"maps": maps, "landmarks": landmarks, **chosen, **counts, **stage}
            try:
                synced = fmsync.matching.synchronize_shapes(shapes, **given)
            except ValueError as error:  # arguments are options here
                told = re.sub(r"\bn_(basis|refined|samples|draws)\b", r"--\1", str(error))
                raise ValueError(told) from error
        write_all(synced, work / "output", options.level, calibration, options.jobs, progress)
    said = list(dict.fromkeys([*quality_flags(synced), *caught]))
    for line in said:
        print(f"fmsync: warning: {line}", file=sys.stderr)
    if options.json:
        print(json.dumps(_summary(synced, options.output, dict(zip(names, files)), said), indent=1))
    else:
        print(f"{options.output}/report.html: open it in a browser; README.txt beside it says what the other files are")
    return 0


def file_names(names: Sequence[str]) -> list[str]:
    """Names that can stand in file names: letters, digits and ``_.+-``, at most 80, none of them twice.

    >>> file_names(["cat 0", "..", "cat/0"])
    ['cat_0', 'shape', 'cat_0_2']
    """
    found: list[str] = []
    for name in names:
        safe = re.sub(r"[^\w.+-]", "_", name.encode("utf-8", "replace").decode()).lstrip(".")[:_LONGEST_NAME] or "shape"
        tried = itertools.chain([safe], (f"{safe}_{number}" for number in itertools.count(2)))
        found.append(next(name for name in tried if name.lower() not in map(str.lower, found)))
    return found


def _check(options: argparse.Namespace) -> None:
    for name, least in (("basis", 2), ("refined", options.basis), ("samples", options.basis), ("draws", 1)):
        if getattr(options, name) < least:
            raise ValueError(f"--{name}: at least {least}, got {getattr(options, name)}")
    if options.jobs < 1:
        raise ValueError(f"--jobs: at least one process, got {options.jobs}")
    if options.seed < 0:
        raise ValueError(f"--seed: a whole number >= 0, got {options.seed}")
    if not 0 < options.level < 1:
        raise ValueError(f"--level: a probability strictly between 0 and 1, got {options.level}")
    if not re.fullmatch("complete|k[1-9][0-9]*", options.graph):
        raise ValueError(f"--graph: 'complete', or k and a number of neighbours such as 'k4', not {options.graph!r}")
    if options.maps is not None and options.graph != "complete":
        raise ValueError("--graph: the maps say which pairs there are; leave it out beside --maps")
    if options.landmarks is not None and not options.landmarks.is_file():
        raise ValueError(f"--landmarks: {options.landmarks}: there is no such file")


@contextmanager
def _working_folder(output: Path) -> Iterator[Path]:
    """``OUT/.fmsync``, from whose folder ``output`` all is moved to OUT in the end.

    If nothing worth keeping is in it afterwards, it goes, and OUT as well if it was not there.
    """
    if output.exists() and not output.is_dir():
        raise ValueError(f"{output}: it is a file; name a folder that is new or empty")
    if output.is_dir() and {path.name for path in output.iterdir()} - {_WORK}:
        raise ValueError(f"{output}: it is not empty; name a folder that is new or empty")
    new = not output.exists()
    work = output / _WORK
    shutil.rmtree(work / "output", ignore_errors=True)
    (work / "output").mkdir(parents=True)
    try:
        yield work
        for part in (work / "output").iterdir():
            os.replace(part, output / part.name)
        shutil.rmtree(work)
    finally:
        if work.is_dir() and not any((work / "pairs").glob("*.npz")):
            shutil.rmtree(work, ignore_errors=True)
            if new:
                output.rmdir()


def _summary(synced: SyncedShapes, output: Path, files: Mapping[str, Path], said: Sequence[str]) -> dict[str, object]:
    assert synced.posterior is not None, "the command asks for draws"
    return {
        "output": str(output),
        "shapes": [
            {"name": s.shape.name, "file": os.fspath(files[s.shape.name]), "vertices": s.shape.n_vertices}
            for s in synced.shapes
        ],
        "outliers": list(synced.outliers),
        "left_out": [name for name in synced.outliers if name not in synced.names],
        "pairs": json.loads(edge_table(synced).to_json(orient="records")),
        "draws": int(synced.posterior.energy.size),
        "kappa": float(synced.posterior.kappa.mean()),
        "warnings": list(said),
    }


def _hear(caught: list[str], message: Warning | str, category: type[Warning], *_: object) -> None:
    """Keep warnings that are not said in plain words already; say at once what is known before long work."""
    if category is OutlierWarning:
        print(f"fmsync: warning: {message}", file=sys.stderr)
    elif category in (UserWarning, RuntimeWarning):
        caught.append(str(message))  # a ConvergenceWarning is one of the flags, the rest is for programmers


def _landmarks(path: Path, shapes: Sequence[Shape]) -> list[list[int]]:
    """Vertices of every shape, from lines 'NAME: 1 2 3' in any order or lines of numbers in the order of the shapes."""
    lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
    if len(lines) != len(shapes):
        raise ValueError(f"{path}: {len(lines)} lines for {len(shapes)} meshes")
    if any(":" in line for line in lines):
        named = {name.strip(): numbers for name, _, numbers in (line.rpartition(":") for line in lines)}
        if missing := [shape.name for shape in shapes if shape.name not in named]:
            raise ValueError(f"{path}: no line 'NAME: ...' for {', '.join(missing)}; it has {', '.join(named)}")
        lines = [named[shape.name] for shape in shapes]
    words = [line.replace(",", " ").split() for line in lines]
    for shape, row in zip(shapes, words):
        if not row or not all(re.fullmatch("[0-9]{1,12}", word) for word in row):
            raise ValueError(f"{path}: the line of {shape.name} must hold vertex numbers, counted from zero")
    return [[int(word) for word in row] for row in words]
