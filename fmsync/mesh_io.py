"""The one reader of meshes and point clouds: OFF, OBJ, PLY, STL, and TOSCA's pairs of ``.vert`` and ``.tri``.

Everything is parsed here, with NumPy, because a file is not to be trusted: what it announces is compared with its size
before memory is taken, every number must be one, and a refusal names the line. Vertices keep their order, which is the
ground truth of a collection; :mod:`fmsync.mesh_repair` then examines the mesh.
"""

import contextlib
import itertools
import math
import re
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from fmsync import checks
from fmsync.mesh_repair import repaired
from fmsync.shape import Shape

SUFFIXES = (".off", ".obj", ".ply", ".stl", ".vert")
Rows = list[tuple[int, list[str]]]  # number of a line, its words
Mesh = tuple[np.ndarray, np.ndarray | None]
Properties = list[tuple[str, str, str]]  # name, type, and the type of the count of a list

_WORDS = {float: re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?"), int: re.compile(r"[-+]?\d{1,18}")}
_AGAIN = "mend it or export the mesh again"
_PLY_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"}
_PLY_TYPES |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
_PLY_TYPES |= {"float32": "f4", "double": "f8", "float64": "f8"}


@checks.checked()
def mesh_files(paths: Iterable[str | Path]) -> list[Path]:
    """Files that are named, or lie in folders that are named, each once; a folder's in natural order (2 before 10).

    A ValueError when a file is missing, a folder holds no meshes, or two files have one name, which names the shape.
    """
    files: list[Path] = []
    for path in map(Path, paths):
        inside = [path]
        if path.is_dir():
            found = (f for f in path.iterdir() if f.suffix.lower() in SUFFIXES and not f.is_dir())
            inside = sorted((f for f in found if not f.name.startswith("._")), key=_natural)  # ._: written by macOS
            if not inside:
                raise ValueError(f"{path}: no meshes in it; known are {', '.join(SUFFIXES)}")
        files += [_existing(file) for file in inside]
    files = list(dict.fromkeys(files))
    stems = [file.stem for file in files]
    for stem in stems:
        if stems.count(stem) > 1:
            raise ValueError(f"several files are called {stem}: rename them, shapes are told apart by these names")
    return files


@checks.checked()
def read_shape(path: str | Path, manifold: bool = True) -> Shape:
    """The shape in a file, named after it; a point cloud if the file announces no faces.

    Reads ``.off``, ``.obj``, ``.ply``, ``.stl``, and ``.vert`` with a ``.tri`` of the same name beside it. Polygons are
    cut into fans of triangles; all but points and faces is skipped. It warns of what ``fmsync.mesh_repair.repaired``
    mends; ``manifold`` refuses faces without area and edges in more than two faces. A ValueError says which file,
    where, and what to do when the file cannot be read or the mesh cannot be repaired.
    """
    path = _existing(Path(path))
    readers = {".off": _read_off, ".obj": _read_obj, ".ply": _read_ply, ".stl": _read_stl, ".vert": _read_vert_tri}
    try:
        if path.suffix.lower() not in readers:
            raise ValueError(f"unknown format {path.suffix!r}; convert it to one of {', '.join(SUFFIXES)}")
        if path.stat().st_size == 0:
            raise ValueError(f"the file is empty: {_AGAIN}")
        vertices, faces = readers[path.suffix.lower()](path)
        finite = np.isfinite(vertices).all(axis=1)
        if not finite.all():
            raise ValueError(f"vertex {finite.argmin()} is not finite ({(~finite).sum()} such): {_AGAIN}")
        if faces is not None:
            vertices, faces, said = repaired(vertices, faces, manifold)
            for line in said:
                warnings.warn(f"{path}: {line}", UserWarning, stacklevel=3)
        return Shape(vertices, faces, path.stem)
    except (ValueError, OSError) as error:
        raise ValueError(f"{path}: {error}") from error


def _existing(path: Path) -> Path:
    if not path.is_file():
        raise ValueError(f"{path}: {'a link to a file that is gone' if path.is_symlink() else 'there is no such file'}")
    return path


def _natural(path: Path) -> list[tuple[int, str]]:
    return [(int(part) if k % 2 else 0, part) for k, part in enumerate(re.split(r"(\d+)", path.name))]


def _rows(data: bytes, first: int = 1) -> Rows:
    """Lines that hold anything but a comment; the first of all lines has the number ``first``."""
    text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig", errors="replace")
    found = ((k, line.partition("#")[0].split()) for k, line in enumerate(text.splitlines(), first))
    return [(k, words) for k, words in found if words]


def _converted(words: list[str], kind: type, rows: Rows, sizes: int | list[int]) -> np.ndarray:
    """Words of the rows, ``sizes`` from each, as one array; the first that does not fit is named with its line."""
    with contextlib.suppress(ValueError, OverflowError):
        values: np.ndarray = np.array(words, dtype=kind)
        if np.isfinite(values).all() and "_" not in "".join(words):  # Python reads 1_0 as ten
            return values
    what = "a number" if kind is float else "the number of a vertex"
    for k, word in enumerate(words):
        if not (_WORDS[kind].fullmatch(word) and math.isfinite(float(word))):
            row = np.searchsorted(np.cumsum(np.broadcast_to(sizes, len(rows))), k, side="right")
            raise ValueError(f"line {rows[row][0]}: {word!r} is not {what}: {_AGAIN}")
    raise ValueError(f"some word is not {what}: {_AGAIN}")


def _points(rows: Rows, columns: Sequence[int] = (0, 1, 2)) -> np.ndarray:
    """(R, 3) coordinates in three columns of the rows."""
    last = max(columns)
    for line, words in rows:
        if len(words) <= last:
            raise ValueError(f"line {line}: {' '.join(words)!r} does not hold three coordinates: {_AGAIN}")
    return _converted([words[k] for _, words in rows for k in columns], float, rows, 3).reshape(-1, 3)


def _fans(corners: np.ndarray, sizes: np.ndarray | list[int]) -> np.ndarray:
    """Triangles (F, 3) of polygons whose corners follow each other; ``sizes`` says how many each polygon has."""
    sizes = np.asarray(sizes, dtype=np.int64)
    if sizes.min() < 3:
        raise ValueError(f"face {sizes.argmin()} has {sizes.min()} corners, three are the least: remove it")
    apex = np.repeat(np.cumsum(sizes) - sizes, sizes - 2)
    step = np.arange(len(apex)) - np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
    return corners[np.column_stack([apex, apex + step + 1, apex + step + 2])].astype(np.int64)


def _polygons(rows: Rows, at: int = 0) -> np.ndarray:
    """Triangles of rows that hold a number of corners, at this place, and as many vertices behind it."""
    corners: list[str] = []
    sizes = []
    for line, words in rows:
        size = int(words[at]) if len(words) > at and words[at].isdecimal() else len(words)
        if at + size >= len(words):
            raise ValueError(f"line {line}: {' '.join(words)!r} is not a number of corners and the corners: {_AGAIN}")
        sizes.append(size)
        corners += words[at + 1 : at + 1 + size]
    return _fans(_converted(corners, int, rows, sizes), sizes)


def _read_off(path: Path) -> Mesh:
    rows = everything = _rows(path.read_bytes())
    head = rows[0][1] if rows else [""]
    found = re.fullmatch(r"(?:ST)?C?N?OFF(\d*)", head[0])
    if found is None or "BINARY" in head:
        raise ValueError(f"a text mesh in space begins with OFF, this one with {' '.join(head[:2])!r}: {_AGAIN}")
    counts = ([found[1]] if found[1] else []) + head[1:]  # some write the counts beside the keyword
    counts, rows = (counts, rows[1:]) if counts else (rows[1][1] if len(rows) > 1 else [], rows[2:])
    n_vertices, n_faces = map(int, counts[:2]) if "".join(counts[:2]).isdecimal() and len(counts) > 1 else (-1, -1)
    size = 4 + 3 * n_vertices + 4 * n_faces
    if len(rows) != n_vertices + n_faces and size == sum(len(row) for _, row in everything):  # not a line for each
        words = [(line, word) for line, row in everything for word in row]
        ends = [*range(4, size - 4 * n_faces, 3), *range(4 + 3 * n_vertices, size + 1, 4)]
        rows, counts = [(words[a][0], [w for _, w in words[a:b]]) for a, b in itertools.pairwise(ends)], counts[:3]
    if n_vertices < 0 or not "".join(counts).isdecimal():
        raise ValueError(f"the line of counts must hold the numbers of vertices, faces and edges, not {counts}")
    for what, announced, there in (("vertices", n_vertices, len(rows)), ("faces", n_faces, len(rows) - n_vertices)):
        if there < announced:
            raise ValueError(f"{announced} {what} announced, the file ends after {there}: {_AGAIN}")
    if there > n_faces:
        raise ValueError(f"{n_faces} faces announced, {there} found: {_AGAIN}")
    return _points(rows[:n_vertices]), _polygons(rows[n_vertices:]) if n_faces else None


def _read_obj(path: Path) -> Mesh:
    points: Rows = []
    faces: Rows = []
    words_of_faces: list[str] = []
    before: list[int] = []  # vertices before each face: a negative number counts back from there
    for line, words in _rows(re.sub(rb"\\\r?\n", b" ", path.read_bytes())):
        if words[0] == "v":
            points.append((line, words))
        elif words[0] == "f":
            faces.append((line, words))
            words_of_faces += [word.partition("/")[0] for word in words[1:]]
            before.append(len(points))
    vertices, sizes = _points(points, (1, 2, 3)), [len(words) - 1 for _, words in faces]
    if not faces:
        return vertices, None
    corners = _converted(words_of_faces, int, faces, sizes)
    return vertices, _fans(np.where(corners < 0, corners + np.repeat(before, sizes), corners - 1), sizes)


def _read_vert_tri(path: Path) -> Mesh:
    triangles = path.with_suffix(".tri")
    if not triangles.is_file():
        raise ValueError(f"there is no {triangles.name} beside it")
    faces = [(line, ["3", *words]) for line, words in _rows(triangles.read_bytes())]
    return _points(_rows(path.read_bytes())), _polygons(faces) - 1 if faces else np.empty((0, 3), int)  # from one


def _read_stl(path: Path) -> Mesh:
    """Binary if the size says so: many binary files begin with the word that marks the others."""
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little")
    if len(data) == 84 + 50 * count:
        facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        vertices = np.frombuffer(data, facet, count, 84)["corners"].reshape(-1, 3).astype(np.float64)
        return vertices, np.arange(len(vertices)).reshape(-1, 3)
    rows = [(line, [words[0].lower(), *words[1:]]) for line, words in _rows(data)]
    if not rows or rows[0][1][0] != "solid":
        raise ValueError(f"{count} triangles announced are {84 + 50 * count} bytes, not {len(data)}: {_AGAIN}")
    told = [(line, words) for line, words in rows if words[0] in ("facet", "vertex", "endfacet")]
    due = ("facet", "vertex", "vertex", "vertex", "endfacet") * (len(told) // 5) + ("endsolid",)
    for (line, words), expected in zip([*told, rows[-1]], due):
        if words[0] != expected:
            raise ValueError(f"line {line}: {words[0]!r} where {expected!r} is due: {_AGAIN}")
    vertices = _points([row for row in told if row[1][0] == "vertex"], (1, 2, 3))
    return vertices, np.arange(len(vertices)).reshape(-1, 3)


def _read_ply(path: Path) -> Mesh:
    data = path.read_bytes().removeprefix(b"\xef\xbb\xbf")
    head = re.match(rb"ply[ \t]*(\r\n|\n|\r)(?s:(.*?))\1end_header[ \t]*\1", data)
    if head is None:
        raise ValueError(f"there is no header from 'ply' to 'end_header': {_AGAIN}")
    order, elements = _ply_header(head[2].decode("ascii", "replace").splitlines())
    at, vertices, faces = head.end(), np.empty((0, 3)), None
    rows = [] if order else _rows(data[at:], len(head[0].splitlines()) + 1)
    for name, count, properties in elements:
        if not count or not properties:
            continue
        names = [name for name, _, _ in properties]
        if order:
            values, at = _ply_binary(data, at, f"{count} of {name}", count, properties, order)
            if name == "vertex":
                vertices = np.column_stack([values[axis][0] for axis in "xyz"]).astype(np.float64)
            elif name == "face":
                faces = _fans(*values["vertex_indices"])
            continue
        if count > len(rows):
            raise ValueError(f"{count} of {name} announced, the file ends after {len(rows)}: {_AGAIN}")
        block, rows = rows[:count], rows[count:]
        if name == "vertex":
            vertices = _points(block, [names.index(axis) for axis in "xyz"])
        elif name == "face":
            faces = _polygons(block, names.index("vertex_indices"))
    if rows or (order and data[at:].strip()):
        raise ValueError(f"it holds more than its header announces: {_AGAIN}")
    return vertices, faces


def _ply_header(lines: list[str]) -> tuple[str, list[tuple[str, int, Properties]]]:
    """Order of the bytes ("" for text); name, number and properties of every element."""
    orders = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
    order: str | None = None
    elements: list[tuple[str, int, Properties]] = []
    for line in lines:
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", kind, _] if kind in orders:
                order = orders[kind]
            case ["element", name, count] if count.isdecimal():
                elements.append((name, int(count), []))
            case ["property", of, name] if elements and of in _PLY_TYPES:
                elements[-1][2].append((name, _PLY_TYPES[of], ""))
            case ["property", "list", n, of, name] if elements and {n, of} <= set(_PLY_TYPES):
                name = "vertex_indices" if name == "vertex_index" else name
                elements[-1][2].append((name, _PLY_TYPES[of], _PLY_TYPES[n]))
            case _:
                raise ValueError(f"its header holds {line!r}, which is not understood: {_AGAIN}")
    if order is None:
        raise ValueError(f"its header names no format: {_AGAIN}")
    for element, number, properties in elements:
        first = next((k for k, (_, _, counted) in enumerate(properties) if counted), len(properties))
        corners = [name for name, of, _ in properties[first : first + 1] if of[0] != "f"]
        if number and element == "vertex" and not {*"xyz"} <= {name for name, _, _ in properties[:first]}:
            raise ValueError(f"its vertices do not begin with x, y and z: {_AGAIN}")
        if number and (element == "tristrips" or (element == "face" and corners != ["vertex_indices"])):
            raise ValueError(f"its {element} is no list of the vertices of each face: export one")
    return order, elements


def _ply_binary(
    data: bytes, at: int, what: str, count: int, properties: Properties, order: str
) -> tuple[dict[str, tuple[np.ndarray, list[int]]], int]:
    """Values of every property and how many each row has of a list, and where the element ends."""
    short = f"{what} announced, the file is too short for them: {_AGAIN}"
    if not any(counted for _, _, counted in properties):
        record = np.dtype([(name, order + of) for name, of, _ in properties])
        if count * record.itemsize > len(data) - at:
            raise ValueError(short)
        table = np.frombuffer(data, record, count, at)
        return {name: (table[name], []) for name, _, _ in properties}, at + table.nbytes
    parts: dict[str, list[np.ndarray]] = {name: [] for name, _, _ in properties}
    kinds = [(name, np.dtype(order + of), int(n[1:] or 0), n[:1] == "i") for name, of, n in properties]
    for _ in range(count):
        for name, of, width, signed in kinds:
            counted = data[at : at + width]
            size = int.from_bytes(counted, "little" if order == "<" else "big", signed=signed) if width else 1
            at += width
            if not 0 <= size * of.itemsize <= len(data) - at:
                raise ValueError(short)
            parts[name].append(np.frombuffer(data, of, size, at) if size else np.empty(0, of))
            at += size * of.itemsize
    return {name: (np.concatenate(part), [len(values) for values in part]) for name, part in parts.items()}, at
