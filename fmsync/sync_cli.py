"""``fmsync sync``: from mesh files to consistent correspondences with a confidence on every vertex."""

import argparse
import os
import shutil
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fmsync.shape import Shape


def add_parser(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add ``sync`` to a parser."""
    parser = commands.add_parser(
        "sync",
        help="consistent correspondences of your own shapes, with a confidence on every vertex",
        description=__doc__,
        epilog="example:\n  fmsync sync scans/ -o matched\n  fmsync sync a.off b.ply c.obj -o matched --jobs 2",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("meshes", nargs="+", metavar="MESH", help="files (off, obj, ply, stl) or folders")
    parser.add_argument(
        "-o", "--output", required=True, type=Path, metavar="OUT", help="folder that does not exist yet"
    )
    parser.add_argument("--graph", default="complete", help="complete, or k4 for four neighbours by spectrum")
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="FILE",
        help="of the regions, from ConformalCalibration.save (default: one fitted on synthetic cats)",
    )
    parser.add_argument("--basis", type=int, default=20, help="functions of the maps that are sampled (%(default)s)")
    parser.add_argument("--refined", type=int, default=120, help="functions of maps that carry points (%(default)s)")
    parser.add_argument("--samples", type=int, default=1000, help="samples of each shape (%(default)s)")
    parser.add_argument("--draws", type=int, default=1000, help="posterior draws (%(default)s)")
    parser.add_argument("--level", type=float, default=0.9, help="probability of the regions (%(default)s)")
    parser.add_argument(
        "--landmarks", type=Path, help="text file: a line per mesh, the same vertices in the same order"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes (default: cores)")
    parser.add_argument("--seed", type=int, default=0, help="of the draws (%(default)s)")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Do what the command line says; whatever is wrong with it raises a ValueError before long work."""
    from fmsync.matching import ConformalCalibration, synchronize_shapes
    from fmsync.matching.conformal import default_calibration
    from fmsync.matching.output import write_all
    from fmsync.matching.quality import quality_flags
    from fmsync.mesh_io import mesh_files, read_shape

    output = options.output
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise ValueError(f"{output}: it is not empty; name a folder that does not exist yet")
    if options.draws < 1:
        raise ValueError(f"--draws: the confidence needs at least one draw, got {options.draws}")
    if not 0 < options.level < 1:
        raise ValueError(f"--level: a probability strictly between 0 and 1, got {options.level}")
    chosen = options.calibration
    calibration = default_calibration() if chosen is None else ConformalCalibration.load(chosen)
    calibration.scale(options.level)
    progress = sys.stderr.isatty()  # on a terminal, and nowhere else
    # Everything is written beside the folder and moved there when complete; finished pairs outlive an interruption.
    partial = output.with_name(output.name + ".partial")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        shapes = [read_shape(file, manifold=False) for file in mesh_files(options.meshes)]
        landmarks = None if options.landmarks is None else _landmarks(options.landmarks, shapes)
        try:
            synced = synchronize_shapes(
                shapes,
                n_basis=options.basis,
                n_refined=options.refined,
                n_samples=options.samples,
                graph=options.graph,
                n_draws=options.draws,
                landmarks=landmarks,
                jobs=options.jobs,
                checkpoint=partial / "pairs",
                progress=progress,
                rng=options.seed,
            )
        except ValueError:  # the input is refused: nothing of it is worth keeping
            shutil.rmtree(partial, ignore_errors=True)
            raise
    folder = partial / "output"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    write_all(synced, folder, options.level, calibration, progress=progress)
    if output.is_dir():
        output.rmdir()
    os.replace(folder, output)
    shutil.rmtree(partial)
    # of other categories: a ConvergenceWarning is one of the flags, the rest is for programmers
    said = [str(w.message) for w in caught if w.category in (UserWarning, RuntimeWarning)]
    for line in dict.fromkeys([*quality_flags(synced), *said]):
        print(f"fmsync: warning: {line}", file=sys.stderr)
    print(f"{output}/report.html: open it in a browser; README.txt beside it says what the other files are")
    return 0


def _landmarks(path: Path, shapes: "Sequence[Shape]") -> list[list[int]]:
    if not path.is_file():
        raise ValueError(f"{path}: there is no such file")
    lines = [line.split() for line in path.read_text().splitlines() if line.strip()]
    if len(lines) != len(shapes):
        raise ValueError(f"{path}: {len(lines)} lines for {len(shapes)} meshes")
    if not all(word.isdigit() for line in lines for word in line):
        raise ValueError(f"{path}: every line must hold vertex numbers, counted from zero")
    points = [[int(word) for word in line] for line in lines]
    for shape, marks in zip(shapes, points):
        if len(marks) != len(points[0]):
            raise ValueError(f"{path}: {shape.name} has {len(marks)} landmarks, {shapes[0].name} has {len(points[0])}")
        if max(marks) >= shape.n_vertices:
            raise ValueError(f"{path}: vertex {max(marks)} is outside {shape.name}, which has {shape.n_vertices}")
    return points
