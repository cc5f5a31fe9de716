"""Noise protocols: what the maps become, what stays recorded."""

import numpy as np
import pytest

import data_gen
from fmsync import so


@pytest.fixture(scope="module")
def truth():
    return data_gen.planted(6, 20, rng=0)


def test_zero_noise_is_the_truth(truth):
    np.testing.assert_array_equal(data_gen.perturb(truth, 0.0).maps, truth.maps)


@pytest.mark.parametrize(("sigma2", "distance"), [(0.1, 4.2), (0.2, 4.87), (0.4, 5.3), (1.0, 5.7)])
def test_distance_of_the_corrupted_map(truth, sigma2, distance):
    """Two random rotations of SO(20) are √40 = 6.32 apart: the noise axis of the paper is nearly saturated."""
    maps = np.concatenate([data_gen.perturb(truth, sigma2, rng=seed).maps - truth.maps for seed in range(8)])
    assert np.linalg.norm(maps, axis=(1, 2)).mean() == pytest.approx(distance, abs=0.06)
    np.testing.assert_allclose(np.linalg.det(data_gen.perturb(truth, sigma2, rng=1).maps), 1)


def test_two_way_observes_each_pair_twice_with_noise_of_its_own(truth):
    p = data_gen.perturb(truth, 0.1, rng=1, two_way=True)
    there, back = p.maps[: len(truth.edges)], p.maps[len(truth.edges) :]
    np.testing.assert_array_equal(p.edges[: len(truth.edges)], p.edges[len(truth.edges) :, ::-1])
    assert np.linalg.norm(there - so.transpose(back), axis=(1, 2)).min() > 1
    clean = data_gen.perturb(truth, 0.0, two_way=True)
    np.testing.assert_array_equal(clean.maps[len(truth.edges) :], so.transpose(clean.maps[: len(truth.edges)]))


def test_around_the_measured_maps(truth):
    with pytest.raises(ValueError, match="around"):
        data_gen.perturb(truth, 0.1, around="median")


def test_seeds_and_records(truth):
    a, b = data_gen.perturb(truth, 0.3, rng=5), data_gen.perturb(truth, 0.3, rng=5)
    np.testing.assert_array_equal(a.maps, b.maps)
    assert np.abs(a.maps - data_gen.perturb(truth, 0.3, rng=6).maps).max() > 0.1
    assert a.provenance["seed"] == 5
    assert a.provenance["sigma2"] == 0.3


@pytest.mark.parametrize("sigma2", [-0.1, float("nan"), float("inf")])
def test_bad_noise(truth, sigma2):
    with pytest.raises(ValueError, match="sigma2"):
        data_gen.perturb(truth, sigma2)
