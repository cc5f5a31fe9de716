"""Read one shape from a file: OFF, OBJ, PLY, STL, or TOSCA's pair of ``.vert`` and ``.tri``.

Text formats are read here, so that vertices keep their order (the ground truth of a collection) and a damaged file is
refused with its line of trouble; PLY and STL go through PyVista. What was read is then examined by ``mesh_repair``.
"""

from pathlib import Path

import numpy as np
import pyvista as pv

from data_gen.mesh_repair import examined
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


def _numbers(tokens, kind, what):
    try:
        return np.array(tokens, dtype=kind)
    except (ValueError, OverflowError):
        raise ValueError(f"{what}: {_first_bad(tokens, kind)!r} is not a number") from None


def _first_bad(tokens, kind):
    for token in tokens:
        try:
            kind(token)
        except ValueError:
            return token
    return tokens[0]


def _read_off(path):
    tokens = _text(path).split()
    if tokens[:1] != ["OFF"]:
        raise ValueError(f"an OFF file begins with OFF, this one with {' '.join(tokens[:1])[:20]!r}")
    counts = _numbers(tokens[1:4], int, "line of counts")
    if len(counts) < 3 or counts.min() < 0:
        raise ValueError("the line of counts must hold the numbers of vertices, faces and edges")
    n_vertices, n_faces = int(counts[0]), int(counts[1])
    end = 4 + 3 * n_vertices
    if len(tokens) < end:
        raise ValueError(f"{n_vertices} vertices announced, the file ends after {(len(tokens) - 4) // 3}")
    vertices = _numbers(tokens[4:end], float, "vertices").reshape(-1, 3)
    return vertices, _off_faces(tokens[end:], n_faces)


def _off_faces(tokens, n_faces):
    if len(tokens) < 4 * n_faces:
        raise ValueError(f"{n_faces} faces announced, the file ends after {len(tokens) // 4}")
    if len(tokens) > 4 * n_faces:
        raise ValueError(
            f"{n_faces} faces announced, {len(tokens) / 4:g} found: a wrong count, faces with colours, or not triangles"
        )
    rows = _numbers(tokens, int, "faces").reshape(-1, 4)
    if (rows[:, 0] != 3).any():
        face = int(np.argmax(rows[:, 0] != 3))
        raise ValueError(f"face {face} has {rows[face, 0]} corners: triangulate the mesh first")
    return rows[:, 1:]


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
    vertices = _numbers(points, float, "vertices").reshape(-1, 3)
    faces = _numbers(corners, int, "faces").reshape(-1, 3)
    return vertices, np.where(faces < 0, faces + len(vertices), faces - 1)  # OBJ counts from one, or back from the end


def _read_vert_tri(path):
    triangles = path.with_suffix(".tri")
    if not triangles.is_file():
        raise ValueError(f"there is no {triangles.name} beside it")
    tables = []
    for file, kind in ((path, float), (triangles, int)):
        tokens = _text(file).split()
        if len(tokens) == 0 or len(tokens) % 3:
            raise ValueError(f"{file.name} holds {len(tokens)} numbers, not three in every line")
        tables.append(_numbers(tokens, kind, file.name).reshape(-1, 3))
    vertices, faces = tables
    return vertices, faces - 1  # TOSCA counts from one


def _read_vtk(path):
    try:
        with pv.VtkErrorCatcher(raise_errors=True):
            mesh = pv.read(path)
    except Exception as error:  # VTK reports a damaged file in many ways
        raise ValueError(f"VTK cannot read it: {error}") from error
    if not isinstance(mesh, pv.PolyData) or mesh.n_points == 0:
        raise ValueError("VTK finds no points in it")
    if mesh.n_cells == 0 or mesh.n_faces_strict == 0:
        return np.asarray(mesh.points, dtype=float), None
    if not mesh.is_all_triangles:
        raise ValueError("not all faces are triangles: triangulate the mesh first")
    return np.asarray(mesh.points, dtype=float), mesh.regular_faces.astype(np.int64)
