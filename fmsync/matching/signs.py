"""Signs of eigenfunctions without any truth: which shapes to flip so that most maps have determinant +1."""

import numpy as np


def rotation_signs(n_nodes: int, edges: np.ndarray, maps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signs s with det C_ij = s_i s_j on as many edges (E, 2) as greedy ascent from the leading eigenvector finds.

    (N,) of ±1, the first +1: flip one eigenfunction of every shape with -1. And indices of edges that disagree.

    >>> maps = np.array([np.diag([1.0, -1.0]), np.diag([1.0, -1.0]), np.eye(2)])
    >>> rotation_signs(3, np.array([[0, 1], [1, 2], [0, 2]]), maps)
    (array([ 1., -1.,  1.]), array([], dtype=int64))
    """
    first, second = np.asarray(edges).T
    parity = np.sign(np.linalg.det(maps))
    votes = np.zeros((n_nodes, n_nodes))
    np.add.at(votes, (first, second), parity)
    votes = votes + votes.T
    signs = np.where(np.linalg.eigh(votes)[1][:, -1] < 0, -1.0, 1.0)
    for _ in range(n_nodes**2):  # each flip satisfies more edges, so that this ends long before
        gain = signs * (votes @ signs)
        if gain.min() >= 0:
            break
        signs[gain.argmin()] *= -1
    signs *= signs[0]
    return signs, np.flatnonzero(parity != signs[first] * signs[second])
