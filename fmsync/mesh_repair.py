"""Examine a mesh as it came from a file: repair what has one right answer, and say so; refuse the rest."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fmsync.shape import edges_of_faces, triangle_areas

_MAIN_SHARE = 0.9  # of the area: a component this large is the shape, the others are debris


def repaired(
    vertices: np.ndarray, faces: np.ndarray, manifold: bool = True
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Vertices (V, 3), faces (F, 3), and a line for everything that was repaired.

    Repaired: vertices at the same place (merged), faces that use a vertex twice and repeated faces (dropped), fins on
    edges with more than two faces (dropped), debris beside a component that holds 90 % of the area (dropped), vertices
    that no face uses (dropped, which renumbers those behind them).

    Refused by a ValueError that names the first offender: faces out of range, several large components; of a
    ``manifold`` also three corners on one line, and an edge with more than two faces that is not a fin's.
    """
    said: list[str] = []
    if (outside := ((faces < 0) | (faces >= len(vertices))).any(axis=1)).any():
        face = int(np.argmax(outside))
        raise ValueError(f"face {face} uses vertices {faces[face].tolist()} of 0..{len(vertices) - 1}: mend the file")
    _, first, label = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    representative = first[label.ravel()]
    if (merged := representative != np.arange(len(vertices))).any():
        said.append(f"{merged.sum()} vertices lie exactly on others and were merged with them")
        faces = representative[faces]
    ordered = np.sort(faces, axis=1)
    proper = (ordered[:, 0] != ordered[:, 1]) & (ordered[:, 1] != ordered[:, 2])
    faces = _kept(faces, proper, "use a vertex twice", said)
    if len(faces) == 0:
        raise ValueError("no face with three different corners is left: mend the file")
    once = np.isin(np.arange(len(faces)), np.unique(ordered[proper], axis=0, return_index=True)[1])
    faces = _kept(faces, once, "repeat others", said)
    if manifold:
        faces = _manifold(vertices, faces, said)
    links = np.ones(2 * len(faces)), (np.repeat(faces[:, 0], 2), faces[:, 1:].ravel())
    graph = coo_array(links, shape=(len(vertices), len(vertices)))
    of_face = connected_components(graph, directed=False)[1][faces[:, 0]]
    count, area = len(np.unique(of_face)), np.bincount(of_face, triangle_areas(vertices, faces))
    if count > 1:
        share = area.max() / area.sum()
        if not share >= _MAIN_SHARE:
            raise ValueError(f"{count} components, the largest with {share:.0%} of the area: give one of them")
        said.append(f"{count} components; the largest, {share:.1%} of the area, was kept")
        faces = faces[of_face == area.argmax()]
    used = np.bincount(faces.ravel(), minlength=len(vertices)) > 0
    if (idle := ~used & ~merged).any():
        said.append(f"{idle.sum()} vertices are on no face and were dropped, the first is vertex {idle.argmax()}")
    return vertices[used], (np.cumsum(used) - 1)[faces], said


def _kept(faces: np.ndarray, keep: np.ndarray, what: str, said: list[str]) -> np.ndarray:
    if keep.all():
        return faces
    said.append(f"{(~keep).sum()} faces {what} and were dropped")
    return faces[keep]


def _manifold(vertices: np.ndarray, faces: np.ndarray, said: list[str]) -> np.ndarray:
    """Refuse flat faces and crowded edges; fins, which hang on such an edge by a free one of their own, are peeled."""
    corners = vertices[faces]
    longest2 = ((corners - corners[:, [1, 2, 0]]) ** 2).sum(axis=2).max(axis=1)
    if (flat := 2 * triangle_areas(vertices, faces) <= 1e-10 * longest2).any():
        where = f"face {flat.argmax()} has no area, its corners lie on one line"
        raise ValueError(f"{where} ({flat.sum()} such): remesh it")
    standing = np.ones(len(faces), dtype=bool)
    while True:
        # one number an edge: far quicker to sort than rows
        codes = edges_of_faces(faces[standing]) @ [len(vertices), 1]
        _, label, count = np.unique(codes, return_inverse=True, return_counts=True)
        use = count[label].reshape(-1, 3)  # how many faces share each edge of a face
        crowded = (use > 2).any(axis=1)
        fin = crowded & (use == 1).any(axis=1)
        if not fin.any():
            break
        standing[standing] = ~fin
    if crowded.any():
        edge = f"an edge of the face on vertices {faces[standing][np.argmax(crowded)].tolist()}"
        raise ValueError(f"{edge} belongs to more than two faces: not a manifold there; split or remesh it")
    return _kept(faces, standing, "stood as fins on edges with two other faces", said)


def filled(vertices: np.ndarray, faces: np.ndarray, longest: float) -> np.ndarray:
    """Faces (F', 3) of a mesh, the given ones first, and patches for the holes whose rim is not longer.

    Corners of a rim are cut off one by one, always by the shortest edge that is not in the mesh; where there is none,
    the hole stays open.

    >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]])
    >>> tent = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    >>> filled(corners, tent, longest=5)[4:].tolist(), len(filled(corners, tent, longest=3))
    ([[2, 1, 0], [0, 3, 2]], 4)
    """
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    sides = edges_of_faces(faces) @ [len(vertices), 1]
    codes, label, count = np.unique(sides, return_inverse=True, return_counts=True)
    following: dict[int, list[int]] = {}
    for after, before in ends[count[label] == 1].tolist():  # against the direction of the faces beside it
        following.setdefault(before, []).append(after)
    known, patches = set(codes.tolist()), []
    for loop in _loops(following):
        points = vertices[loop]
        if np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).sum() <= longest:
            patches += _patch(vertices, loop, known)
    return np.vstack([faces, np.array(patches, dtype=faces.dtype).reshape(-1, 3)])


def _loops(following: dict[int, list[int]]) -> list[list[int]]:
    """Closed walks along a rim, of which none visits a vertex twice."""
    loops = []
    for start in following:
        path = [start]
        while following.get(path[-1]):
            if (corner := following[path[-1]].pop()) in path:  # a rim that touches itself is several loops
                loops.append(path[path.index(corner) :])
                del path[path.index(corner) + 1 :]
            else:
                path.append(corner)
    return loops


def _patch(vertices: np.ndarray, loop: list[int], known: set[int]) -> list[list[int]]:
    """Triangles in a loop; their new edges join the ``known`` ones. None if some edge would be there twice."""
    triangles, new = [], set()
    while len(loop) > 3:
        before, after = np.roll(loop, 1), np.roll(loop, -1)
        codes = np.sort(np.stack([before, after], axis=1), axis=1) @ [len(vertices), 1]
        length = np.linalg.norm(vertices[before] - vertices[after], axis=1)
        length[[code in known or code in new for code in codes.tolist()]] = np.inf
        k = int(length.argmin())
        if length[k] == np.inf:
            return []
        triangles.append([int(before[k]), loop[k], int(after[k])])
        new.add(int(codes[k]))
        loop = loop[:k] + loop[k + 1 :]
    known |= new
    return [*triangles, loop]
