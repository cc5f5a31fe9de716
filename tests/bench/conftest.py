"""Small planted problems."""

import pytest

import data_gen
from bench.problems import Planted

collect_ignore = ["tricks.py"]  # looked through for doctests it would register its methods a second time


@pytest.fixture(scope="session")
def planted():
    """Factory of Planted problems: Haar rotations under the paper's noise."""

    def make(n_nodes=5, n=4, sigma2=0.05, rng=0, **noise):
        truth = data_gen.planted(n_nodes, n, rng=[rng, 1])
        return Planted(data_gen.perturb(truth, sigma2, rng=[rng, 2][1] + 10 * rng, **noise), truth.absolute)

    return make
