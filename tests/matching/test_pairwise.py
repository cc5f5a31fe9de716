"""The map of one pair: candidates beyond signs."""

import numpy as np
import pytest

from fmsync.matching.pairwise import match
from fmsync.matching.samples import sample_shape
from fmsync.shape import Basis


@pytest.mark.parametrize("plane", [3, 5])
def test_eigenfunctions_that_a_pose_has_mixed_are_turned_back(cats, plane):
    """No signs do that: the map is as good as that of eigenfunctions that were not mixed."""
    first, second = (sample_shape(cat, 50, 300) for cat in cats[:2])
    mixed, eigenvalues = second.basis.eigenfunctions.copy(), second.basis.eigenvalues.copy()
    pair = [plane, plane + 1]
    mixed[:, pair] = mixed[:, pair] @ np.array([[1, -1], [1, 1]]) / np.sqrt(2)
    eigenvalues[pair] = eigenvalues[pair].mean()
    turned = sample_shape(cats[1], 50, 300, basis=Basis(eigenvalues, mixed, second.basis.mass))
    assert match(first, turned).distortion < 1.1 * match(first, second).distortion
