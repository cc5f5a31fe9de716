"""What is read off the draws."""

import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import calibration, so


@pytest.fixture(scope="module")
def problem():
    return data_gen.perturb(data_gen.planted(4, 3, rng=0), 0.1, 1)


@pytest.fixture(scope="module")
def post(problem):
    return fmsync.sample(problem, "heat-bath", kappa=6.0, n_chains=3, n_draws=40, warmup=20, rng=5)


def test_mean_and_balls_against_their_definitions(post):
    pairs = np.array([[0, 2], [3, 1]])
    draws = post.relative(pairs).reshape(-1, 2, 3, 3)
    mean = draws.mean(axis=0)
    np.testing.assert_allclose(post.relative_mean(pairs, projected=False), mean, atol=1e-12)
    np.testing.assert_allclose(post.relative_mean(pairs), so.project(mean), atol=1e-12)
    others = (draws.sum(axis=0) - draws) / (len(draws) - 1)  # the mean of all draws but one
    distance = np.linalg.norm(draws - others, axis=(2, 3))
    for level in (0.5, 0.9):
        centre, radius = post.credible_balls(level, pairs)
        np.testing.assert_allclose(centre, mean, atol=1e-12)
        np.testing.assert_allclose(radius, np.sort(distance, axis=0)[int(np.floor(level * len(draws)))])
    with pytest.raises(ValueError, match="level"):
        post.credible_balls(1.0)


@pytest.mark.parametrize("level", np.arange(1, 20) / 20)
def test_a_ball_covers_exactly_the_truths_whose_level_it_reaches(problem, level):
    post = fmsync.sample(problem, "heat-bath", kappa=6.0, n_chains=1, n_draws=20, warmup=20, rng=5)
    draws = post.relative(problem.edges[:1])[0, :, 0]
    centre, radius = post.credible_balls(level, problem.edges[:1])
    truths = draws.mean(axis=0) + np.linspace(0, 4, 400)[:, None, None] * np.eye(3) / np.sqrt(3)
    covered = np.linalg.norm(truths - centre, axis=(1, 2)) <= radius
    levels = np.array([calibration.ball_level(draws, truth) for truth in truths])
    np.testing.assert_array_equal(covered, levels <= level)
    assert 0 < covered.sum() < 400
