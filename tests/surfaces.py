"""Small meshes with known properties, shared by the tests of shapes and functional maps."""

import numpy as np


def icosphere(level):
    """Unit sphere of 10 * 4^level + 2 vertices: an icosahedron subdivided and pushed out."""
    g = (1 + 5**0.5) / 2
    vertices = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g), (0, -1, -g), (0, 1, -g)]
    vertices += [(g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6)]
    faces += [(7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10)]
    faces += [(8, 6, 7), (9, 8, 1)]
    for _ in range(level):
        middle = {}
        finer = []
        for face in faces:
            a, b, c = face
            ab, bc, ca = (_midpoint(vertices, middle, *edge) for edge in ((a, b), (b, c), (c, a)))
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = finer
    vertices = np.array(vertices, dtype=float)
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), np.array(faces)


def _midpoint(vertices, middle, a, b):
    key = (min(a, b), max(a, b))
    if key not in middle:
        middle[key] = len(vertices)
        vertices.append(tuple((np.array(vertices[a]) + np.array(vertices[b])) / 2))
    return middle[key]


def potato(level=3):
    """A sphere deformed so that nothing is symmetric: simple eigenvalues, distinct vertices."""
    vertices, faces = icosphere(level)
    x, y, z = vertices.T
    radius = 1 + 0.25 * np.sin(2 * x + 1) * np.cos(3 * y + 0.5) + 0.2 * z**3 + 0.15 * y**2 * x + 0.1 * np.sin(4 * z + x)
    return vertices * radius[:, None] * [1.5, 1.0, 0.7], faces


def relabelled(vertices, faces, rng):
    """The same mesh with its vertices renumbered; new vertex v is old vertex old[v]."""
    old = np.random.default_rng(rng).permutation(len(vertices))
    return vertices[old], np.argsort(old)[faces], old


def rotation(rng):
    """A random rotation of space."""
    q, r = np.linalg.qr(np.random.default_rng(rng).standard_normal((3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.linalg.det(q)
