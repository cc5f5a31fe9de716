"""Does a triangle mesh pass through itself? An exhaustive test of all pairs of triangles that come near each other."""

import numpy as np
from scipy.spatial import cKDTree


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
            hit = _segment_cuts_triangle(vertices[ends[:, 0]], vertices[ends[:, 1]], vertices[other])
            cut |= hit & apart
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
