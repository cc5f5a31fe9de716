"""From posterior draws of a functional map to where a vertex may go."""

import numpy as np

from fmsync import checks
from fmsync.checks import checked
from fmsync.functional_maps import nearest_rows_unchecked as nearest_rows
from fmsync.shape import Basis


@checked(relative_draws=checks.array, vertex=">= 0")
def vertex_images(relative_draws: np.ndarray, basis_i: Basis, basis_j: Basis, vertex: int) -> np.ndarray:
    r"""Images (K,) on shape j of one vertex of shape i under every draw of C_ij.

    The vertex x goes to :math:`\arg\min_y\lVert(\Phi_i C_{ij})_x-(\Phi_j)_y\rVert`, as in :func:`fmsync.point_map`.

    ``relative_draws`` (K, n_i, n_j) are draws of C_ij, e.g. ``post.relative([[i, j]]).reshape(-1, n, n)``.
    """
    relative_draws = np.asarray(relative_draws, dtype=float)
    if relative_draws.ndim != 3 or relative_draws.shape[1:] != (basis_i.n, basis_j.n):
        raise ValueError(f"relative_draws: expected (K, {basis_i.n}, {basis_j.n}), got {relative_draws.shape}")
    checks.indices("vertex", [vertex], basis_i.n_vertices)
    return nearest_rows(basis_i.eigenfunctions[vertex] @ relative_draws, basis_j.eigenfunctions)


@checked(images="K < V")
def image_density(images: np.ndarray, n_vertices: int) -> np.ndarray:
    """How often each vertex was hit, (n_vertices,) counts that sum to the number of draws."""
    return np.bincount(checks.indices("images", images, n_vertices), minlength=n_vertices)
