"""From an implicit body to an even triangulation with any number of vertices, mirror symmetric vertex by vertex.

Half of the skin (y >= 0) is contoured finely, covered by a centroidal Voronoi tessellation whose sites either lie in
the mirror plane or off it, and the dual triangles are mirrored and glued along the plane (approximated centroidal
Voronoi diagrams: Valette and Chassery 2004).
"""

from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from data_gen.cat_body import skin
from fmsync.extras import require
from fmsync.shape import edges_of_faces

Skin = Callable[[np.ndarray], np.ndarray]  # (..., 3) -> (...,): zero on the surface, negative inside

_LOW, _HIGH = np.array([-1.0, 0.0, -0.05]), np.array([0.58, 0.22, 0.78])
_LLOYD_STEPS = 60
_MIN_VERTICES, _MAX_VERTICES = 1000, 30_000


def check_resolution(n_vertices: int) -> None:
    """Refuse numbers of vertices for which no mesh is made."""
    if not _MIN_VERTICES <= n_vertices <= _MAX_VERTICES:
        raise ValueError(f"n_vertices = {n_vertices}: ask for {_MIN_VERTICES} to {_MAX_VERTICES} vertices")


def rest_mesh(n_vertices: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangulate the cat at rest, see :func:`mirrored_mesh`."""
    surface = half_skin(lambda grid: skin(grid.reshape(-1, 3)), _LOW, _HIGH, 0.008)
    points, triangles = refined(surface, 7 * n_vertices)
    points = _onto_skin(skin, points)
    vertices, faces, mirror = mirrored_mesh(
        skin, points, triangles, _gradient(skin, points), n_vertices, _LLOYD_STEPS, np.random.default_rng(0)
    )
    if not is_sphere(faces, n_vertices):
        raise ValueError(f"n_vertices = {n_vertices} does not give a closed cat: ask for 1000 vertices or more")
    return vertices, faces, mirror


def mirrored_mesh(skin: Skin, points, triangles, normals, n_vertices: int, n_steps: int, rng):
    """Triangulate a body, the half y >= 0 of whose skin is known by fine samples (P, 3) and triangles between them.

    Returns ``vertices`` (V, 3), ``faces`` (F, 3) and ``mirror`` (V,): the vertex opposite to each vertex. Vertices in
    the mirror plane come first, then the left ones, then their mirror images in the same order. With too few vertices
    for its thin parts the mesh is no sphere (:func:`is_sphere`).
    """
    areas = vertex_areas(points, triangles)  # (P,)
    edge = np.sqrt(2 * areas.sum() / n_vertices * 2 / np.sqrt(3))  # of an equilateral triangle of the mean area
    n_plane = round(_boundary_length(points, triangles) / edge)
    n_plane += (n_vertices - n_plane) % 2
    n_left = (n_vertices - n_plane) // 2

    labels, sites = voronoi(points, areas, normals, points[:, 1] == 0, n_plane, n_left, edge, n_steps, rng)
    half = dual_triangles(labels[triangles])[:, ::-1]  # contouring makes them face inwards
    sites = _onto_skin(skin, sites)

    mirror = np.r_[np.arange(n_plane), n_plane + n_left + np.arange(n_left), n_plane + np.arange(n_left)]
    faces = np.vstack([half, mirror[half][:, ::-1]])
    vertices = np.vstack([sites, sites[n_plane:] * [1, -1, 1]])
    return vertices, faces, mirror


def half_skin(skin: Skin, low: np.ndarray, high: np.ndarray, step: float, level: float = 0.0):
    """Contour y >= 0 in a box, from the values of ``skin`` on a grid (nz, ny, nx, 3) of points: a pyvista surface."""
    counts = np.ceil((high - low) / step).astype(int) + 1
    grid = require("pyvista", "shapes").ImageData(dimensions=counts, spacing=(step,) * 3, origin=low)
    values = skin(np.asarray(grid.points).reshape(*counts[::-1], 3))
    return grid.contour([level], scalars=values.ravel(), method="flying_edges")


def refined(surface, n_samples: int) -> tuple[np.ndarray, np.ndarray]:
    """At least ``n_samples`` points on a surface and triangles between them; the rim lies exactly in y = 0."""
    while surface.n_points < n_samples:
        surface = surface.subdivide(1, "linear")
    points = np.array(surface.points, dtype=float)
    points[np.abs(points[:, 1]) < 1e-7, 1] = 0.0
    return points, surface.regular_faces.astype(np.int64)


def _gradient(skin, points):
    """Gradient of the implicit function by central differences (P, 3); in the mirror plane it has no y."""
    delta = 1e-5
    slopes = [(skin(points + delta * axis) - skin(points - delta * axis)) / (2 * delta) for axis in np.eye(3)]
    gradient = np.stack(slopes, axis=-1)
    gradient[points[:, 1] == 0, 1] = 0
    return gradient


def _onto_skin(skin, points):
    """Two Newton steps along the gradient; points in the mirror plane stay there."""
    for _ in range(2):
        gradient = _gradient(skin, points)
        points = points - (skin(points) / (gradient**2).sum(-1))[:, None] * gradient
    return points


def vertex_areas(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """A third of the triangles around each point (P,)."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return np.bincount(triangles.ravel(), np.repeat(area / 3, 3), minlength=len(points))


def _boundary_length(points, triangles):
    codes, count = np.unique(edges_of_faces(triangles) @ [len(points), 1], return_counts=True)
    first, second = np.divmod(codes[count == 1], len(points))
    return np.linalg.norm(points[first] - points[second], axis=1).sum()


def voronoi(points, areas, normals, in_plane, n_plane, n_left, edge, n_steps, rng):
    """Lloyd's algorithm; sites [0, n_plane) stay in the mirror plane. Returns labels (P,) and sites (S, 3).

    Distances count the direction of the surface too, so that no cell reaches through an ear or a tail to the far side.
    """
    features = with_normals(points, normals, edge)
    plane, left = np.flatnonzero(in_plane), np.flatnonzero(~in_plane)
    drawn = rng.choice(left, n_left, replace=False, p=areas[left] / areas[left].sum())
    sites = features[np.r_[_farthest(points, plane, n_plane) if n_plane else plane, drawn]]
    for _ in range(n_steps):
        labels = cKDTree(sites).query(features)[1]
        if n_plane:  # samples in the plane belong to sites in it: the rim of the half is then a chain of those sites
            labels[plane] = cKDTree(sites[:n_plane]).query(features[plane])[1]
        weight = np.bincount(labels, areas, minlength=len(sites))
        sums = coo_array((areas, (labels, np.arange(len(points)))), shape=(len(sites), len(points))) @ features
        sites = sums / weight[:, None]
        sites[:n_plane, [1, 4]] = 0
    return labels, sites[:, :3]


def with_normals(points: np.ndarray, normals: np.ndarray, edge: float) -> np.ndarray:
    """Points (P, 6) in space and in the direction of the surface there, the latter as much as half an edge length."""
    lengths = np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return np.hstack([points, 0.5 * edge * normals / lengths])


def _farthest(points, candidates, count):
    """Farthest point sampling of ``count`` of the candidates."""
    chosen = [candidates[0]]
    distance = np.linalg.norm(points[candidates] - points[chosen[0]], axis=1)
    for _ in range(count - 1):
        chosen.append(candidates[np.argmax(distance)])
        distance = np.minimum(distance, np.linalg.norm(points[candidates] - points[chosen[-1]], axis=1))
    return np.array(chosen)


def dual_triangles(corners):
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
    codes = directed[:, 0] * n_vertices + directed[:, 1]
    opposite = directed[:, 1] * n_vertices + directed[:, 0]
    once = len(np.unique(codes)) == len(codes)
    paired = np.array_equal(np.sort(codes), np.sort(opposite))
    return once and paired and n_vertices - len(codes) // 2 + len(faces) == 2 and len(np.unique(faces)) == n_vertices
