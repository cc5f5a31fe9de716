"""Examine a mesh as it came from a file: repair what has one right answer, with a warning, and refuse the rest."""

import warnings

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

_MAIN_SHARE = 0.9  # of the area: a component this large is the shape, the others are debris


def examined(vertices: np.ndarray, faces: np.ndarray | None, name: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Repaired vertices (V, 3) and faces (F, 3), or the same when nothing was wrong.

    Repaired, each with a ``UserWarning``: vertices at the same place (merged), faces that use a vertex twice and
    repeated faces (dropped), fins on edges with more than two faces (dropped), debris beside a component that holds
    90 % of the area (dropped), vertices that no face uses (dropped). What is dropped renumbers the vertices behind it.

    Raises
    ------
    ValueError
        Refused, naming the first offender: vertices that are not finite, faces out of range, three different corners
        on one line, several large components, an edge with more than two faces that is not a fin's.
    """
    finite = np.isfinite(vertices).all(axis=1)
    if not finite.all():
        raise ValueError(f"{name}: vertex {np.argmin(finite)} is not finite ({(~finite).sum()} such): mend the file")
    if faces is None:
        return vertices, None
    if len(faces) == 0:
        raise ValueError(f"{name}: there are no faces")
    outside = ((faces < 0) | (faces >= len(vertices))).any(axis=1)
    if outside.any():
        face = int(np.argmax(outside))
        raise ValueError(f"{name}: face {face} uses vertices {faces[face].tolist()}, there are 0..{len(vertices) - 1}")
    faces = _merge_duplicate_vertices(vertices, faces, name)
    faces = _drop_repeated(faces, name)
    _refuse_flat(vertices, faces, name)
    faces = _drop_fins(faces, name)
    faces = _main_component(vertices, faces, name)
    return _drop_unused(vertices, faces, name)


def _warn(message):
    warnings.warn(message, UserWarning, stacklevel=5)


def _merge_duplicate_vertices(vertices, faces, name):
    _, first, label = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    representative = first[label.ravel()]
    merged = int((representative != np.arange(len(vertices))).sum())
    if merged == 0:
        return faces
    _warn(f"{name}: {merged} vertices lie exactly on others and were merged with them")
    return representative[faces]


def _drop_repeated(faces, name):
    ordered = np.sort(faces, axis=1)
    proper = (ordered[:, 0] != ordered[:, 1]) & (ordered[:, 1] != ordered[:, 2])
    if not proper.all():
        _warn(
            f"{name}: {(~proper).sum()} faces use a vertex twice and were dropped, the first is face {proper.argmin()}"
        )
        faces, ordered = faces[proper], ordered[proper]
    if len(faces) == 0:
        raise ValueError(f"{name}: no face with three different corners is left")
    lowest = ordered[:, 0] * (faces.max() + 1) + ordered[:, 1]
    by_corners = np.lexsort((ordered[:, 2], lowest))
    listed = np.c_[lowest, ordered[:, 2]][by_corners]
    first = np.sort(by_corners[np.r_[True, (listed[1:] != listed[:-1]).any(axis=1)]])
    if len(first) < len(faces):
        _warn(f"{name}: {len(faces) - len(first)} faces repeat others and were dropped")
        faces = faces[first]
    return faces


def _double_areas(vertices, faces):
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1)


def _refuse_flat(vertices, faces, name):
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    longest2 = np.max([((b - a) ** 2).sum(1), ((c - b) ** 2).sum(1), ((a - c) ** 2).sum(1)], axis=0)
    flat = _double_areas(vertices, faces) <= 1e-10 * longest2
    if flat.any():
        raise ValueError(
            f"{name}: face {np.argmax(flat)} has no area, its three corners lie on one line ({flat.sum()} such): "
            "remesh it"
        )


def _edge_use(faces):
    """For every corner edge (F, 3): how many faces share it."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    codes = edges[:, 0] * (faces.max() + 1) + edges[:, 1]  # one number an edge: far quicker to sort than rows
    _, label, count = np.unique(codes, return_inverse=True, return_counts=True)
    return count[label].reshape(-1, 3)


def _drop_fins(faces, name):
    """A fin hangs on an edge that has two other faces, and has a free edge itself; peel until none is left."""
    before = len(faces)
    while True:
        use = _edge_use(faces)
        crowded = (use > 2).any(axis=1)
        fin = crowded & (use == 1).any(axis=1)
        if not fin.any():
            break
        faces = faces[~fin]
    if crowded.any():
        corner = faces[np.argmax(crowded)].tolist()
        raise ValueError(
            f"{name}: an edge of the face on vertices {corner} belongs to more than two faces: the surface is not a "
            "manifold there; split or remesh it"
        )
    if len(faces) < before:
        _warn(f"{name}: {before - len(faces)} faces stood as fins on edges with two other faces and were dropped")
    return faces


def _main_component(vertices, faces, name):
    n = len(vertices)
    links = coo_array((np.ones(2 * len(faces)), (np.repeat(faces[:, 0], 2), faces[:, 1:].ravel())), shape=(n, n))
    _, label = connected_components(links, directed=False)
    of_face = label[faces[:, 0]]
    area = np.bincount(of_face, _double_areas(vertices, faces))
    if (area > 0).sum() == 1:
        return faces
    share = area.max() / area.sum()
    count = int((area > 0).sum())
    if share < _MAIN_SHARE:
        raise ValueError(f"{name}: {count} components, the largest with {share:.0%} of the area: give one of them")
    _warn(f"{name}: {count} components; the largest, {share:.1%} of the area, was kept")
    return faces[of_face == area.argmax()]


def _drop_unused(vertices, faces, name):
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    if used.all():
        return vertices, faces
    _warn(f"{name}: {(~used).sum()} vertices are on no face and were dropped, the first is vertex {used.argmin()}")
    return vertices[used], (np.cumsum(used) - 1)[faces]
