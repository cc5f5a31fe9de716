"""Maps of pairs in a folder: ``A_to_B.npy`` and the like, A and B names of meshes."""

import io
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

_SUFFIXES = (".npy", ".npz", ".csv", ".txt", ".mat")
_PER_ENTRY, _HEADER = 32, 2**20  # bytes in a file, at most: for each entry of a full matrix, and besides

_MAT_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}


def read_maps(folder: str | Path, names: Sequence[str], sizes: Sequence[int]) -> dict[tuple[int, int], dict[str, Any]]:
    """Maps ``{(i, j): {name of the file: array}}`` of meshes with these names and numbers of vertices.

    Files are named as ``fmsync sync --help`` says; one that is not, or cannot be read, is a ValueError that names it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ValueError(f"{folder}: there is no such folder")
    pairs: dict[str, list[tuple[int, int]]] = {}
    for i, a in enumerate(names):
        for j, b in enumerate(names):
            pairs.setdefault(f"{a}_to_{b}", []).extend([(i, j)] * (i != j))
    found: dict[tuple[int, int], dict[str, Any]] = {}
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or not (path.suffix in _SUFFIXES or "_to_" in path.name):
            continue
        meant = pairs.get(path.stem) or pairs.get(path.stem.rpartition(".")[0]) or []
        if len(meant) != 1 or path.suffix not in _SUFFIXES:
            why = "could be of several pairs" if meant[1:] else "is not A_to_B of two meshes"
            known = f"meshes are {', '.join(names)}; suffixes {', '.join(_SUFFIXES)}"
            raise ValueError(f"{path}: its name {why}; rename it ({known})")
        found.setdefault(meant[0], {})[path.name] = _read(path, sizes[meant[0][0]] * sizes[meant[0][1]])
    if not found:
        raise ValueError(f"{folder}: no maps in it; they are called A_to_B{', '.join(_SUFFIXES)}")
    return found


def _read(path: Path, entries: int) -> Any:
    """The one array in a file; nothing larger than so many entries is taken in."""
    most = _PER_ENTRY * entries + _HEADER
    try:
        announced = path.stat().st_size
        if path.suffix == ".npz":
            with zipfile.ZipFile(path) as packed:
                announced = sum(part.file_size for part in packed.infolist())
        if announced > most:
            raise ValueError(f"{announced} bytes are too many for a map of these meshes")
        if path.suffix == ".npy":
            return np.load(path, mmap_mode="r", allow_pickle=False)  # refuses more than the file holds
        if path.suffix in (".csv", ".txt"):
            text = path.read_text(encoding="utf-8-sig")
            return np.loadtxt(io.StringIO(text.replace(",", " ").replace(";", " ")))
        array = sp.load_npz(path) if path.suffix == ".npz" else _read_mat(path.read_bytes(), most)
        if hasattr(array, "check_format"):
            array.check_format(full_check=True)  # indices that lead outside would crash the process
        return array
    except Exception as error:  # readers of others raise whatever a damaged file makes them
        raise ValueError(f"{path}: cannot be read as a map ({error}); write it again or take it away") from error


def _read_mat(data: bytes, most: int) -> Any:
    """The real matrix C or p2p of a MATLAB 5 file (format: MAT-File Level 5), which SciPy's reader lets crash."""
    if data[126:128] not in (b"IM", b"MI"):
        raise ValueError("not a MATLAB file of version 5 to 7; save it with -v7")
    order, found = "<" if data[126:128] == b"IM" else ">", []
    for kind, body in _elements(data[128:], order):
        if kind == 15:  # compressed
            kind, body = next(_elements(zlib.decompressobj().decompress(body, most), order))
        (_, flags), (_, sizes), (_, name), *parts = _elements(body, order) if kind == 14 else [(0, b"")] * 3
        if name in (b"C", b"p2p"):
            shape = tuple(np.frombuffer(sizes, f"{order}i4").tolist())
            values = [np.frombuffer(part, order + _MAT_TYPES[kind]).astype(float) for kind, part in parts]
            if np.frombuffer(flags, f"{order}u4")[0] & 0xFF == 5:
                rows, starts = (indices.astype(int) for indices in values[:2])
                found.append(sp.csc_array((values[2], rows, starts), shape=shape))
            else:
                found.append(values[0].reshape(shape, order="F"))
    if len(found) != 1:
        raise ValueError("it must hold one variable called C or p2p")
    return found[0]


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Types and contents of the elements of a MATLAB 5 file, small ones in the second half of their tag."""
    at = 0
    while at + 8 <= len(data):
        kind, size = np.frombuffer(data, f"{order}u4", 2, at).tolist()
        small = kind >> 16
        start, size = (at + 4, small) if small else (at + 8, size)
        yield kind & 0xFFFF, data[start : start + size]
        at = at + 8 if small else start + size + (-size % 8 if kind != 15 else 0)
