"""The shortest peer: eigenvectors by SciPy, rounded block by block. No degrees, no sparse products."""

import numpy as np
import scipy.linalg

from bench.methods import Answer, Rng, SyncProblem, method
from fmsync import so


@method("scipy-eigh")
def scipy_eigh(problem: SyncProblem, *, rng: Rng) -> Answer:
    """Leading n eigenvectors of the dense connection matrix, each (n, n) block projected to SO(n)."""
    size, n = problem.n_nodes * problem.n, problem.n
    _, vectors = scipy.linalg.eigh(problem.connection, subset_by_index=[size - n, size - 1])
    blocks = vectors.reshape(problem.n_nodes, n, n)
    if np.linalg.det(blocks).sum() < 0:  # else half of the problems come out mirrored
        blocks = blocks * np.where(np.arange(n) == 0, -1.0, 1.0)
    return Answer.from_absolute(so.project(so.transpose(blocks)))
