"""Damaged files for every reader: ``python -m tests.fuzz --mutants 100000``.

Each reader gets mutants of good files: cut short, bits flipped, bytes and lines repeated or taken out, numbers replaced
by what is none. It must answer or raise a ValueError, within two seconds and a gigabyte. Whatever does not is written
to ``tests/broken``, where ``tests/test_broken.py`` reads it ever after. Exit status 1 if there was any.
"""

import argparse
import contextlib
import io
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import numpy as np
import scipy.io
import scipy.sparse

import fmsync
from bench import results
from data_gen.cache import arithmetic, cached, checksum
from fmsync.matching import ConformalCalibration, given_maps, map_files
from fmsync.mesh_io import read_shape

BROKEN = Path(__file__).with_name("broken")
SECONDS, MEGABYTES = 2, 1024
NUMBERS = [b"nan", b"inf", b"-1", b"1e400", b"3e8", b"1,5", b"0x1", b"null", b"999999999999", b"", b"2147483648", b"-0"]
SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]])
CORNERS = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])


def read_tri(path: Path) -> object:
    """The triangles of a good ``.vert``."""
    path.with_suffix(".vert").write_text("".join(f"{x} {y} {z}\n" for x, y, z in SQUARE))
    return read_shape(path.with_suffix(".vert"))


def read_cache(path: Path) -> None:
    """A damaged entry of the cache is built again, whatever it holds."""
    with tempfile.TemporaryDirectory() as home, mock.patch.dict(os.environ, XDG_CACHE_HOME=home):
        entry = Path(home) / "fmsync" / arithmetic() / "mutant.npz"
        entry.parent.mkdir(parents=True)
        entry.write_bytes(path.read_bytes())
        found = cached("mutant", lambda: {"x": np.arange(40.0)})
    if (found["x"] != np.arange(40)).any():
        raise RuntimeError("damaged numbers came out of the cache")


def read_map(path: Path) -> object:
    """A map between shapes of eight vertices, read and checked."""
    return given_maps._checked(map_files._read(path, 64), (8, 8), (8, 8), 2)


def good_files() -> dict[str, tuple[Callable[[Path], object], list[bytes]]]:
    """Suffix, reader and good files of each."""
    points = "".join(f"{x:g} {y:g} {z:g}\n" for x, y, z in SQUARE)
    faces = "".join(f"3 {a} {b} {c}\n" for a, b, c in CORNERS)
    header = "element vertex 5\nproperty float x\nproperty float y\nproperty float z\nelement face 6\n"
    header += "property list uchar int vertex_indices\nend_header\n"
    records = np.empty(6, [("n", "u1"), ("corners", "<i4", 3)])
    records["n"], records["corners"] = 3, CORNERS
    facets = np.zeros(6, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets["corners"] = SQUARE[CORNERS]
    loops = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in SQUARE[t])
        + "endloop\nendfacet\n"
        for t in CORNERS
    )
    with tempfile.TemporaryDirectory() as folder:
        problem, calibration = Path(folder) / "p.npz", Path(folder) / "c.json"
        maps = np.stack([np.eye(3)] * 3)
        fmsync.save_problem(fmsync.SyncProblem(3, [[0, 1], [1, 2], [0, 2]], maps), problem)
        ConformalCalibration("x", 1.0, (0.5, 0.9), (1.0, 2.0)).save(calibration)
        packed, written = problem.read_bytes(), calibration.read_bytes()
        entry, table = Path(folder) / "e.npz", Path(folder) / "t.parquet"
        numbers = {"x": np.arange(40.0)}
        np.savez(entry, checksum=np.array(checksum(numbers)), **numbers)
        run = {"generator": "g", "problem": {"n": 3}, "seed": 0, "label": "a", "method": "a", "options": {}}
        run |= {"status": "ok", "metrics": [["error", None, 0.5]], "commit": "c", "machine": "m", "versions": "v"}
        results.write(results.to_frame("s", [run, run | {"seed": 1}]), table)
        kept, tabled = entry.read_bytes(), table.read_bytes()
    functional, numbers, text = np.random.default_rng(0).standard_normal((5, 5)), np.arange(8), io.BytesIO()
    arrays, matrices = [io.BytesIO(), io.BytesIO()], [io.BytesIO(), io.BytesIO(), io.BytesIO()]
    np.save(arrays[0], functional)
    np.save(arrays[1], numbers)
    np.savetxt(text, functional, delimiter=",")
    scipy.io.savemat(matrices[0], {"C": functional})
    scipy.io.savemat(matrices[1], {"p2p": numbers}, do_compression=True)
    scipy.io.savemat(matrices[2], {"C": scipy.sparse.csc_matrix(0.5 * np.eye(8))})
    return {
        ".npy": (read_map, [file.getvalue() for file in arrays]),
        ".csv": (read_map, [text.getvalue()]),
        ".mat": (read_map, [file.getvalue() for file in matrices]),
        ".off": (read_shape, [f"OFF\n5 6 0\n{points}{faces}".encode(), f"COFF 5 6 0\n# c\n{points}{faces}".encode()]),
        ".obj": (
            read_shape,
            [
                (
                    "".join(f"v {line}\n" for line in points.splitlines())
                    + "f 1 3 2\nf -5 4/1/1 3\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n"
                ).encode()
            ],
        ),
        ".ply": (
            read_shape,
            [
                f"ply\nformat ascii 1.0\n{header}{points}{faces}".encode(),
                f"ply\nformat binary_little_endian 1.0\n{header}".encode()
                + SQUARE.astype("<f4").tobytes()
                + records.tobytes(),
            ],
        ),
        ".stl": (
            read_shape,
            [
                f"solid a\n{loops}endsolid a\n".encode(),
                b"solid".ljust(80) + (6).to_bytes(4, "little") + facets.tobytes(),
            ],
        ),
        ".npz": (fmsync.load_problem, [packed]),
        ".json": (ConformalCalibration.load, [written]),
        ".tri": (read_tri, ["".join(f"{a + 1} {b + 1} {c + 1}\n" for a, b, c in CORNERS).encode()]),
        ".cache": (read_cache, [kept]),
        ".parquet": (results.read, [tabled]),
    }


def mutant(good: list[bytes], seed: int) -> bytes:
    """A good file with one to four wounds."""
    rng = np.random.default_rng(seed)
    data = bytearray(good[rng.integers(len(good))])
    for _ in range(rng.integers(1, 5)):
        a, b = sorted(int(k) for k in rng.integers(0, len(data) + 1, size=2))
        b = min(b, a + int(rng.integers(1, 40)))
        match int(rng.integers(6)):
            case 0:
                del data[a:]
            case 1:
                del data[a:b]
            case 2:
                data[a:a] = data[a:b] * int(rng.integers(1, 4))
            case 3 if a < len(data):
                data[a] ^= 1 << int(rng.integers(8))
            case 4:
                data[a:b] = rng.bytes(b - a)
            case _:
                words = bytes(data).split(b" ")
                words[int(rng.integers(len(words)))] = NUMBERS[rng.integers(len(NUMBERS))]
                data = bytearray(b" ".join(words))
    return bytes(data)


def attack(suffix: str, first: int, count: int, news) -> None:
    """What a process does: read mutants, and tell of each before it is read and of what was wrong."""
    reader, good = good_files()[suffix]
    resource.setrlimit(resource.RLIMIT_AS, (resource.getrlimit(resource.RLIMIT_AS)[1],) * 2)
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + MEGABYTES * 2**20,) * 2)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"mutant{suffix}"
        for seed in range(first, first + count):
            path.write_bytes(mutant(good, seed))
            news.send((seed, ""))
            signal.setitimer(signal.ITIMER_REAL, SECONDS)  # ends the process, whatever it is in
            try:
                with contextlib.suppress(ValueError):
                    reader(path)
            except BaseException as error:
                news.send((seed, f"{type(error).__name__}: {error}"))
            signal.setitimer(signal.ITIMER_REAL, 0)
    news.send((first + count, ""))


def fuzz(suffix: str, count: int) -> dict[int, str]:
    """Seeds of mutants that did harm, and which; a process that died is replaced by one that goes on behind."""
    found, at = {}, 0
    while at < count:
        here, there = multiprocessing.get_context("fork").Pipe()
        process = multiprocessing.get_context("fork").Process(target=attack, args=(suffix, at, count - at, there))
        process.start()
        there.close()
        with contextlib.suppress(EOFError):
            while True:
                at, said = here.recv()
                if said:
                    found[at] = said
        process.join()
        if at < count:
            found[at] = f"the process died with status {process.exitcode}"
            at += 1
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mutants", type=int, default=2000, help="of each reader (default: %(default)s)")
    parser.add_argument("--only", help="one reader, by its suffix")
    options, harm = parser.parse_args(), 0
    count = options.mutants
    for suffix, (_, good) in good_files().items():
        if options.only not in (None, suffix):
            continue
        began = time.perf_counter()
        found = fuzz(suffix, count)
        print(f"{suffix}: {count} mutants, {len(found)} did harm, {time.perf_counter() - began:.0f} s", flush=True)
        for said, seed in {said[:40]: seed for seed, said in found.items()}.items():  # one of each kind
            BROKEN.mkdir(exist_ok=True)
            (BROKEN / f"{seed}{suffix}").write_bytes(mutant(good, seed))
            print(f"  {BROKEN.name}/{seed}{suffix}: {said}")
        harm += len(found)
    return int(harm > 0)


if __name__ == "__main__":
    sys.exit(main())
