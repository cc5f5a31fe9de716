"""How far a collection is from isometric: edge lengths compared between poses."""

from itertools import combinations

import numpy as np

from data_gen.fingerprints import same_triangulation
from fmsync.shape import Shape


def edges(faces: np.ndarray) -> np.ndarray:
    """Undirected edges (E, 2) of faces (F, 3), each once, smaller vertex first."""
    return np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)


def edge_distortion(shapes: list[Shape]) -> np.ndarray:
    """Mean \\|log edge-length ratio\\| of every pair of shapes, each scaled to unit area.

    Parameters
    ----------
    shapes
        N shapes with the same triangles, whatever their orientation.

    Returns
    -------
    numpy.ndarray
        (N (N - 1) / 2,) in the order of ``itertools.combinations``; 0 for isometric shapes, dimensionless.

    Raises
    ------
    ValueError
        The shapes differ in their triangles.

    Examples
    --------
    >>> tent = Shape(vertices=[[0, 0, 0], [1, 0, 0], [0, 1, 0]], faces=[[0, 1, 2]], name="tent")
    >>> edge_distortion([tent, tent])
    array([0.])
    """
    for shape in shapes[1:]:
        if same_triangulation(shapes[0], shape) is None:
            raise ValueError(f"{shape.name} and {shapes[0].name} differ in their triangles: edges cannot be compared")
    ends = edges(shapes[0].faces)
    scaled = [shape.normalised().vertices for shape in shapes]
    logs = [np.log(np.linalg.norm(v[ends[:, 0]] - v[ends[:, 1]], axis=1)) for v in scaled]
    return np.array([np.abs(a - b).mean() for a, b in combinations(logs, 2)])
