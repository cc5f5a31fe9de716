"""What is read off the draws, kept in memory, on disk, or taken in as they come."""

import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import so
from fmsync.samplers.streaming import PointMapCounts, RelativeMoments
from fmsync.shape import Basis


@pytest.fixture(scope="module")
def problem():
    return data_gen.perturb(data_gen.planted(4, 3, rng=0), 0.1, 1)


@pytest.fixture(scope="module")
def post(problem):
    return fmsync.sample(problem, "heat-bath", kappa=6.0, n_chains=3, n_draws=40, warmup=20, rng=5)


OPTIONS = {"kappa": 6.0, "n_chains": 3, "n_draws": 40, "warmup": 20, "rng": 5}


def test_mean_balls_and_spread_against_their_definitions(post):
    pairs = np.array([[0, 2], [3, 1]])
    draws = post.relative(pairs).reshape(-1, 2, 3, 3)
    mean = draws.mean(axis=0)
    np.testing.assert_allclose(post.relative_mean(pairs, projected=False), mean, atol=1e-12)
    np.testing.assert_allclose(post.relative_mean(pairs), so.project(mean), atol=1e-12)
    np.testing.assert_allclose(post.spread(pairs), np.sqrt(((draws - mean) ** 2).sum((2, 3)).mean(axis=0)), atol=1e-10)
    others = (draws.sum(axis=0) - draws) / (len(draws) - 1)  # the mean of all draws but one
    distance = np.linalg.norm(draws - others, axis=(2, 3))
    for level in (0.5, 0.9):
        centre, radius = post.credible_balls(level, pairs)
        np.testing.assert_allclose(centre, mean, atol=1e-12)
        np.testing.assert_allclose(radius, np.quantile(distance, level, axis=0))
    with pytest.raises(ValueError, match="level"):
        post.credible_balls(1.0)


def test_draws_on_disk_are_those_in_memory(problem, post, tmp_path):
    path = tmp_path / "draws.npy"
    stored = fmsync.sample(problem, "heat-bath", store=path, **OPTIONS)
    assert isinstance(stored.absolute, np.memmap)
    np.testing.assert_array_equal(stored.absolute, post.absolute)
    np.testing.assert_array_equal(np.load(path), post.absolute)
    np.testing.assert_array_equal(stored.relative_mean(), post.relative_mean())
    assert [f.name for f in tmp_path.iterdir()] == ["draws.npy"]


def test_an_interrupted_file_holds_the_draws_so_far(problem, post, tmp_path):
    def interrupt(draw, state, energy):
        assert not (tmp_path / "draws.npy").exists()
        if draw == 7:
            raise KeyboardInterrupt

    stored = fmsync.sample(problem, "heat-bath", store=tmp_path / "draws.npy", callback=interrupt, **OPTIONS)
    assert stored.interrupted
    np.testing.assert_array_equal(np.load(tmp_path / "draws.npy"), post.absolute[:, :7])
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_nothing_half_written_stays(problem, tmp_path, error):
    def fail(draw, state, energy):
        raise error

    with pytest.raises(error):
        fmsync.sample(problem, "heat-bath", store=tmp_path / "draws.npy", callback=fail, **OPTIONS)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("name", "message"), [("draws.txt", "ends in .npy"), ("no/draws.npy", "does not exist")])
def test_bad_paths_are_named(problem, tmp_path, name, message):
    with pytest.raises(ValueError, match=message):
        fmsync.sample(problem, "heat-bath", store=tmp_path / name, **OPTIONS)


def test_running_moments_without_keeping_draws(problem, post):
    pairs = np.array([[0, 1], [2, 3]])
    moments = RelativeMoments(pairs, covariance=True)
    light = fmsync.sample(problem, "heat-bath", store=None, callback=moments, **OPTIONS)
    np.testing.assert_array_equal(light.energy, post.energy)
    assert (light.n_chains, light.n_draws, light.interrupted) == (3, 40, False)
    draws = post.relative(pairs).reshape(-1, 2, 9)
    np.testing.assert_allclose(moments.mean.reshape(2, 9), draws.mean(axis=0), atol=1e-12)
    for e in range(2):
        np.testing.assert_allclose(moments.covariance[e], np.cov(draws[:, e].T), atol=1e-12)
    with pytest.raises(ValueError, match="not kept"):
        light.relative_mean()
    with pytest.raises(ValueError, match="not kept"):
        light.summary()
    with pytest.raises(ValueError, match="covariance"):
        RelativeMoments(pairs).covariance  # noqa: B018


def test_point_map_counts_against_the_point_maps_of_the_draws(problem, post):
    rng = np.random.default_rng(0)
    first, second = (Basis(np.arange(3.0), rng.standard_normal((v, 3)), np.full(v, 1 / v)) for v in (12, 15))
    vertices = np.array([0, 5, 11])
    counts = PointMapCounts((0, 2), first, second, vertices)
    fmsync.sample(problem, "heat-bath", store=None, callback=counts, **OPTIONS)
    expected = np.zeros((3, 15), dtype=int)
    for relative in post.relative([[0, 2]]).reshape(-1, 3, 3):
        expected[np.arange(3), fmsync.point_map(relative, first, second)[vertices]] += 1
    np.testing.assert_array_equal(counts.counts, expected)
