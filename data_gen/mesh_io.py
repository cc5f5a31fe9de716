"""Read one shape from a file: OFF, OBJ, PLY, STL, or TOSCA's pair of ``.vert`` and ``.tri``.

Text formats are read here, so that vertices keep their order (the ground truth of a collection) and a damaged file is
refused with its line of trouble; PLY and STL go through PyVista, from the extra ``shapes``. What was read is then
examined by ``mesh_repair``.
"""

import warnings
from itertools import chain
from pathlib import Path

import numpy as np

from data_gen.mesh_repair import examined
from fmsync.extras import require
from fmsync.shape import Shape

SUFFIXES = (".off", ".obj", ".ply", ".stl", ".vert")


def read_shape(path: str | Path) -> Shape:
    """The shape in a file, named after the file.

    Parameters
    ----------
    path
        ``.off``, ``.obj``, ``.ply``, ``.stl`` (whose corners are merged: STL has no common vertex order) or ``.vert``
        with a ``.tri`` of the same name beside it. A PLY without faces is a point cloud.

    Raises
    ------
    ValueError
        The file cannot be read as a triangle mesh, or the mesh cannot be repaired; says which file and why.
    ImportError
        A PLY or STL file, without the extra ``shapes``.

    Warns
    -----
    UserWarning
        The mesh was repaired; says what was done.
    """
    path = Path(path)
    readers = {".off": _read_off, ".obj": _read_obj, ".vert": _read_vert_tri, ".ply": _read_vtk, ".stl": _read_vtk}
    if path.suffix.lower() not in readers:
        raise ValueError(f"{path}: unknown format {path.suffix!r}; known are {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise ValueError(f"{path}: there is no such file")
    if path.stat().st_size == 0:
        raise ValueError(f"{path}: the file is empty")
    try:
        vertices, faces = readers[path.suffix.lower()](path)
        vertices, faces = examined(vertices, faces, str(path))
        return Shape(vertices, faces, path.stem)
    except ValueError as error:
        reason = str(error)
        raise ValueError(reason if reason.startswith(str(path)) else f"{path}: {reason}") from error


def _text(path):
    text = path.read_text(encoding="utf-8", errors="replace")
    if "#" in text:
        text = "\n".join(line.partition("#")[0] for line in text.splitlines())
    return text


def _numbers(text, what):
    """All numbers of a text, float64; the first word that is none is named."""
    words = text.split()
    try:
        return np.array(words, dtype=np.float64)
    except ValueError:
        raise ValueError(f"{what}: {next(word for word in words if not _is_number(word))!r} is not a number") from None


def _is_number(word):
    try:
        float(word)
    except ValueError:
        return False
    return True


def _whole(numbers, what):
    whole = np.where(np.isfinite(numbers), numbers, 0).astype(np.int64)
    if (whole != numbers).any():
        raise ValueError(f"{what}: {numbers[np.argmax(whole != numbers)]} is not the number of a vertex")
    return whole


def _read_off(path):
    head, _, body = _text(path).lstrip().partition("OFF")
    if head or not body:
        raise ValueError(f"an OFF file begins with OFF, this one with {(head or body).split()[:1]}")
    numbers = _numbers(body, "OFF")
    if len(numbers) < 3 or (numbers[:3] < 0).any() or (numbers[:3] % 1 != 0).any():
        raise ValueError("the line of counts must hold the numbers of vertices, faces and edges")
    n_vertices, n_faces = int(numbers[0]), int(numbers[1])
    points, rows = np.split(numbers[3:], [3 * n_vertices])
    if len(points) < 3 * n_vertices:
        raise ValueError(f"{n_vertices} vertices announced, the file ends after {len(points) // 3}")
    if len(rows) < 4 * n_faces:
        raise ValueError(f"{n_faces} faces announced, the file ends after {len(rows) // 4}")
    if len(rows) > 4 * n_faces:
        raise ValueError(
            f"{n_faces} faces announced, {len(rows) / 4:g} found: a wrong count, faces with colours, or not triangles"
        )
    rows = _whole(rows, "faces").reshape(-1, 4)
    if (rows[:, 0] != 3).any():
        face = int(np.argmax(rows[:, 0] != 3))
        raise ValueError(f"face {face} has {rows[face, 0]} corners: triangulate the mesh first")
    return points.reshape(-1, 3), rows[:, 1:]


def _read_obj(path):
    points, corners = [], []
    for line in _text(path).splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            if len(words) < 4:
                raise ValueError(f"vertex {len(points)} has {len(words) - 1} coordinates instead of 3")
            points.append(words[1:4])
        elif words[:1] == ["f"]:
            if len(words) != 4:
                raise ValueError(f"face {len(corners)} has {len(words) - 1} corners: triangulate the mesh first")
            corners.append([word.partition("/")[0] for word in words[1:]])
    vertices = _numbers(" ".join(chain.from_iterable(points)), "vertices").reshape(-1, 3)
    faces = _whole(_numbers(" ".join(chain.from_iterable(corners)), "faces"), "faces").reshape(-1, 3)
    return vertices, np.where(faces < 0, faces + len(vertices), faces - 1)  # OBJ counts from one, or back from the end


def _read_vert_tri(path):
    triangles = path.with_suffix(".tri")
    if not triangles.is_file():
        raise ValueError(f"there is no {triangles.name} beside it")
    tables = []
    for file in (path, triangles):
        numbers = _numbers(_text(file), file.name)
        if len(numbers) == 0 or len(numbers) % 3:
            raise ValueError(f"{file.name} holds {len(numbers)} numbers, not three in every line")
        tables.append(numbers.reshape(-1, 3))
    vertices, faces = tables
    return vertices, _whole(faces, triangles.name) - 1  # TOSCA counts from one


def _read_vtk(path):
    pv = require("pyvista", "shapes")
    try:
        with warnings.catch_warnings(), pv.VtkErrorCatcher(raise_errors=True):
            warnings.simplefilter("error", UserWarning)
            mesh = pv.read(path)
    except Exception as error:  # VTK reports a damaged file in many ways
        raise ValueError(f"VTK cannot read it: {error}") from error
    if not isinstance(mesh, pv.PolyData) or mesh.n_points == 0:
        raise ValueError("VTK finds no points in it")
    if mesh.n_faces == 0:
        return np.asarray(mesh.points, dtype=float), None
    if not mesh.is_all_triangles:
        raise ValueError("not all faces are triangles: triangulate the mesh first")
    return np.asarray(mesh.points, dtype=float), mesh.regular_faces.astype(np.int64)
