"""From an implicit body to an even triangulation with any number of vertices, mirror symmetric vertex by vertex.

Half of the skin (y >= 0) is contoured finely and covered by a centroidal Voronoi tessellation whose sites lie in the
mirror plane or off it; the dual triangles are mirrored and glued along the plane (Valette and Chassery 2004).
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from fmsync.extras import require
from fmsync.shape import edges_of_faces, vertex_areas

Arrays = tuple[np.ndarray, np.ndarray, np.ndarray]
Skin = Callable[[np.ndarray], np.ndarray]  # (..., 3) -> (...,): zero on the surface, negative inside

_MIN_VERTICES, _MAX_VERTICES = 1000, 30_000


def check_resolution(n_vertices: int) -> None:
    """Refuse numbers of vertices for which no mesh is made."""
    if not _MIN_VERTICES <= n_vertices <= _MAX_VERTICES:
        raise ValueError(f"n_vertices = {n_vertices}: ask for {_MIN_VERTICES} to {_MAX_VERTICES} vertices")


def mirrored_mesh(skin: Skin, samples: Arrays, n_vertices: int, n_steps: int, rng: np.random.Generator) -> Arrays:
    """Triangulate a body whose skin is known where y >= 0 by points (P, 3), triangles between them, normals (P, 3).

    Returns vertices (V, 3), faces (F, 3) and the vertex opposite to each vertex (V,). Those in the mirror plane come
    first, then the left ones, then their mirror images in the same order. With too few vertices for its thin parts the
    mesh is no sphere (:func:`is_sphere`).
    """
    points, triangles, normals = samples
    areas = vertex_areas(points, triangles)  # (P,)
    edge = np.sqrt(2 * areas.sum() / n_vertices * 2 / np.sqrt(3))  # of an equilateral triangle of the mean area
    codes, count = np.unique(edges_of_faces(triangles) @ [len(points), 1], return_counts=True)
    first, second = np.divmod(codes[count == 1], len(points))  # ends of the edges on the rim
    n_plane = round(np.linalg.norm(points[first] - points[second], axis=1).sum() / edge)
    n_plane += (n_vertices - n_plane) % 2
    n_left = (n_vertices - n_plane) // 2

    features = with_normals(points, normals, edge)
    labels, sites = voronoi(features, areas, points[:, 1] == 0, (n_plane, n_left), n_steps, rng)
    half = dual_triangles(labels[triangles])[:, ::-1]  # contouring makes them face inwards
    sites = onto_skin(skin, sites)

    mirror = np.r_[np.arange(n_plane), n_plane + n_left + np.arange(n_left), n_plane + np.arange(n_left)]
    faces = np.vstack([half, mirror[half][:, ::-1]])
    vertices = np.vstack([sites, sites[n_plane:] * [1, -1, 1]])
    return vertices, faces, mirror


def half_skin(skin: Skin, low: np.ndarray, high: np.ndarray, step: float, level: float = 0.0) -> Any:
    """Contour y >= 0 in a box, from the values of ``skin`` on a grid (nz, ny, nx, 3) of points: a pyvista surface."""
    counts = np.ceil((high - low) / step).astype(int) + 1
    grid = require("pyvista", "shapes").ImageData(dimensions=counts, spacing=(step,) * 3, origin=low)
    values = skin(np.asarray(grid.points).reshape(*counts[::-1], 3))
    return grid.contour([level], scalars=values.ravel(), method="flying_edges")


def refined(surface: Any, n_samples: int) -> tuple[np.ndarray, np.ndarray]:
    """At least ``n_samples`` points on a surface and triangles between them; the rim lies exactly in y = 0."""
    while surface.n_points < n_samples:
        surface = surface.subdivide(1, "linear")
    points = np.array(surface.points, dtype=float)
    points[np.abs(points[:, 1]) < 1e-7, 1] = 0.0
    return points, surface.regular_faces.astype(np.int64)


def skin_gradient(skin: Skin, points: np.ndarray) -> np.ndarray:
    """Gradient of the implicit function by central differences (P, 3); in the mirror plane it has no y."""
    delta = 1e-5
    slopes = [(skin(points + delta * axis) - skin(points - delta * axis)) / (2 * delta) for axis in np.eye(3)]
    gradient = np.stack(slopes, axis=-1)
    gradient[points[:, 1] == 0, 1] = 0
    return gradient


def onto_skin(skin: Skin, points: np.ndarray) -> np.ndarray:
    """Two Newton steps along the gradient; points in the mirror plane stay there."""
    for _ in range(2):
        gradient = skin_gradient(skin, points)
        points = points - (skin(points) / (gradient**2).sum(-1))[:, None] * gradient
    return points


def voronoi(
    features: np.ndarray,
    areas: np.ndarray,
    in_plane: np.ndarray,
    counts: tuple[int, int],
    n_steps: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Lloyd's algorithm: labels (P,) and sites (S, 3), as many as ``counts`` says in the mirror plane, then off it.

    ``features`` (P, 6) of :func:`with_normals` keep cells from reaching through an ear or a tail to the far side.
    """
    plane, left, n_plane = np.flatnonzero(in_plane), np.flatnonzero(~in_plane), counts[0]
    drawn = rng.choice(left, counts[1], replace=False, p=areas[left] / areas[left].sum())
    sites = features[np.r_[_farthest(features[:, :3], plane, n_plane) if n_plane else plane, drawn]]
    for _ in range(n_steps):
        labels = cKDTree(sites).query(features)[1]
        if n_plane:  # samples in the plane belong to sites in it: the rim of the half is then a chain of those sites
            labels[plane] = cKDTree(sites[:n_plane]).query(features[plane])[1]
        weight = np.bincount(labels, areas, minlength=len(sites))
        sums = coo_array((areas, (labels, np.arange(len(labels)))), shape=(len(sites), len(labels))) @ features
        sites = sums / weight[:, None]
        sites[:n_plane, [1, 4]] = 0
    return labels, sites[:, :3]


def with_normals(points: np.ndarray, normals: np.ndarray, edge: float) -> np.ndarray:
    """Points (P, 6) in space and in the direction of the surface there, the latter as much as half an edge length."""
    lengths = np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return np.hstack([points, 0.5 * edge * normals / lengths])


def _farthest(points: np.ndarray, candidates: np.ndarray, count: int) -> np.ndarray:
    """Farthest point sampling of ``count`` of the candidates."""
    chosen = [candidates[0]]
    distance = np.linalg.norm(points[candidates] - points[chosen[0]], axis=1)
    for _ in range(count - 1):
        chosen.append(candidates[np.argmax(distance)])
        distance = np.minimum(distance, np.linalg.norm(points[candidates] - points[chosen[-1]], axis=1))
    return np.array(chosen)


def dual_triangles(corners: np.ndarray) -> np.ndarray:
    """One triangle for every place where three cells meet; a ragged border that is met to and fro cancels out."""
    distinct = (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2]) & (corners[:, 2] != corners[:, 0])
    corners = corners[distinct]
    start = np.argmin(corners, axis=1)
    corners = np.take_along_axis(corners, (start[:, None] + np.arange(3)) % 3, axis=1)
    upward = corners[:, 1] < corners[:, 2]
    faces, index = np.unique(np.sort(corners, axis=1), axis=0, return_inverse=True)
    turns = np.bincount(index, np.where(upward, 1, -1))  # net orientation of each triple
    faces = np.where((turns > 0)[:, None], faces, faces[:, [0, 2, 1]])
    return faces[turns != 0]


def is_sphere(faces: np.ndarray, n_vertices: int) -> bool:
    """Whether faces (F, 3) close up, facing one way, to a surface of genus zero that uses every vertex."""
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    codes, opposite = directed @ [n_vertices, 1], directed @ [1, n_vertices]
    once = len(np.unique(codes)) == len(codes)
    paired = np.array_equal(np.sort(codes), np.sort(opposite))
    return once and paired and n_vertices - len(codes) // 2 + len(faces) == 2 and len(np.unique(faces)) == n_vertices


def self_intersections(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Pairs of triangles (K, 2) of a mesh (V, 3), (F, 3) that cut each other.

    Pairs that share an edge are not tested; of pairs that share a vertex the edge opposite to it is.

    >>> flat, upright = [[0, 0, 0], [2, 0, 0], [0, 2, 0]], [[0.5, 0.5, -1], [0.5, 0.5, 1], [0.6, 0.5, 1]]
    >>> self_intersections(np.array(flat + upright, dtype=float), np.array([[0, 1, 2], [3, 4, 5]]))
    array([[0, 1]])
    """
    corners = vertices[faces]  # (F, 3, 3)
    centres = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centres[:, None], axis=2).max()
    pairs = cKDTree(centres).query_pairs(2 * reach, output_type="ndarray")
    low, high = corners.min(axis=1), corners.max(axis=1)
    overlap = ((low[pairs[:, 0]] <= high[pairs[:, 1]]) & (low[pairs[:, 1]] <= high[pairs[:, 0]])).all(axis=1)
    pairs = pairs[overlap]
    shared = (faces[pairs[:, 0]][:, :, None] == faces[pairs[:, 1]][:, None, :]).sum(axis=(1, 2))
    pairs = pairs[shared < 2]
    cut = np.zeros(len(pairs), dtype=bool)
    for first, second in ((0, 1), (1, 0)):
        for k in range(3):
            ends = faces[pairs[:, first]][:, [k, (k + 1) % 3]]
            other = faces[pairs[:, second]]
            apart = (ends[:, :, None] != other[:, None, :]).all(axis=(1, 2))
            cut |= apart & _segment_cuts_triangle(*vertices[ends].swapaxes(0, 1), vertices[other])
    return pairs[cut]


def _segment_cuts_triangle(start, end, triangle):
    """Möller and Trumbore (1997): does the segment pass through the inside of the triangle? (K,) booleans."""
    direction = end - start
    edge1, edge2 = triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0]
    normal = np.cross(direction, edge2)
    determinant = (edge1 * normal).sum(1)
    parallel = determinant == 0
    scale = 1 / np.where(parallel, 1, determinant)
    offset = start - triangle[:, 0]
    u = scale * (offset * normal).sum(1)
    across = np.cross(offset, edge1)
    v = scale * (direction * across).sum(1)
    t = scale * (edge2 * across).sum(1)
    return ~parallel & (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1)
