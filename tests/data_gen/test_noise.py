"""Noise protocols: what the maps become, what stays recorded."""

import json
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import data_gen
import fmsync
from data_gen.cats import left_right_flip
from data_gen.langevin import langevin_noise
from fmsync import langevin, so


@pytest.fixture(scope="module")
def truth():
    return data_gen.planted(6, 20, rng=0)


FAMILIES = {
    "projected-gaussian": {"sigma2": 0.0},
    "tangent-gaussian": {"sigma2": 0.0},
}


@settings(max_examples=25, deadline=None)
@given(
    family=st.sampled_from(sorted(FAMILIES)),
    two_way=st.booleans(),
    repeats=st.integers(1, 3),
    around=st.sampled_from(["consistent", "measured"]),
    method=st.sampled_from(["spectral", "mle"]),
    n_nodes=st.integers(3, 8),
    n=st.integers(2, 7),
    density=st.floats(0.7, 1.0),
    seed=st.integers(0, 1000),
)
def test_no_noise_is_solved_exactly(family, two_way, repeats, around, method, n_nodes, n, density, seed):
    truth = data_gen.planted(n_nodes, n, data_gen.random_graph(n_nodes, density, seed), rng=seed)
    options = {"two_way": two_way, "repeats": repeats, "around": around}
    p = data_gen.perturb(truth, rng=seed, noise=family, **FAMILIES[family], **options)
    assert p.n_edges == len(truth.edges) * repeats * (1 + two_way)
    estimate = fmsync.solve(p, method, rng=seed)
    np.testing.assert_allclose(estimate.relative(truth.edges), truth.maps, atol=1e-6)


def test_concentrated_langevin_noise_is_solved_nearly_exactly(truth):
    p = data_gen.perturb(truth, noise="langevin", kappa=1e10)
    np.testing.assert_allclose(fmsync.solve(p).relative(), truth.maps, atol=1e-4)


@pytest.mark.parametrize(("sigma2", "distance"), [(0.1, 4.2), (0.2, 4.87), (0.4, 5.3), (1.0, 5.7)])
def test_distance_of_the_corrupted_map(truth, sigma2, distance):
    """Two random rotations of SO(20) are √40 = 6.32 apart: the noise axis of the paper is nearly saturated."""
    maps = np.concatenate([data_gen.perturb(truth, sigma2, rng=seed).maps - truth.maps for seed in range(8)])
    assert np.linalg.norm(maps, axis=(1, 2)).mean() == pytest.approx(distance, abs=0.06)
    np.testing.assert_allclose(np.linalg.det(data_gen.perturb(truth, sigma2, rng=1).maps), 1)


def test_tangent_noise_agrees_with_projection_to_first_order(truth):
    for sigma2, gap in ((1e-4, 0.02), (1e-6, 0.002)):
        a = data_gen.perturb(truth, sigma2, rng=3).maps - truth.maps
        b = data_gen.perturb(truth, sigma2, rng=3, noise="tangent-gaussian").maps - truth.maps
        ratio = np.linalg.norm(a, axis=(1, 2)).mean() / np.linalg.norm(b, axis=(1, 2)).mean()
        assert ratio == pytest.approx(1, abs=gap + 0.02)
        assert np.linalg.norm(b, axis=(1, 2)).mean() == pytest.approx(np.sqrt(190 * sigma2), rel=0.05)


class TestLangevin:
    @pytest.mark.parametrize(("kappa", "trace"), [(3, 3.0), (10, 10.1674), (30, 16.8173)])
    def test_mean_trace_at_n_20(self, kappa, trace):
        draws = np.trace(langevin_noise(20, kappa, 1500, rng=1), axis1=1, axis2=2)
        assert abs(draws.mean() - trace) < 4 * draws.std() / np.sqrt(len(draws))

    @pytest.mark.parametrize(("n", "kappa"), [(2, 3.0), (3, 0.7), (3, 5.0), (5, 40.0), (8, 2.5), (13, 6.5)])
    def test_mean_and_variance_of_the_trace(self, n, kappa):
        """log c_n(κ) generates the cumulants of the trace."""
        draws = np.trace(langevin_noise(n, kappa, 3000, rng=2), axis1=1, axis2=2)
        step = 1e-3 * max(kappa, 1)
        mean = n * langevin.mean_cosine(n, kappa)
        slope = (langevin.mean_cosine(n, kappa + step) - langevin.mean_cosine(n, kappa - step)) / (2 * step)
        assert abs(draws.mean() - mean) < 4 * draws.std() / np.sqrt(len(draws))
        spread = np.sqrt((((draws - draws.mean()) ** 2 - draws.var()) ** 2).mean() / len(draws))
        assert abs(draws.var() - n * slope) < 4 * spread

    def test_no_concentration_is_haar_and_much_is_the_identity(self):
        draws = np.trace(langevin_noise(6, 0.0, 4000, rng=3), axis1=1, axis2=2)
        assert abs(draws.mean()) < 4 / np.sqrt(4000)
        assert abs((draws**2).mean() - 1) < 4 * np.sqrt(2 / 4000)
        assert np.abs(langevin_noise(5, 1e8, 10, rng=1) - np.eye(5)).max() < 1e-3

    def test_are_rotations_with_planes_of_no_preference(self):
        z = langevin_noise(5, 4.0, 4000, rng=4)
        np.testing.assert_allclose(so.transpose(z) @ z, np.broadcast_to(np.eye(5), z.shape), atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(z), 1)
        off = z[:, 0, 1]
        assert abs(off.mean()) < 4 * off.std() / np.sqrt(4000)


class TestOutliers:
    def test_share_and_record(self, truth):
        p = data_gen.perturb(truth, 0.01, rng=1, outliers=0.3)
        replaced = p.provenance["outlier_edges"]
        assert len(replaced) == round(0.3 * p.n_edges)
        off = np.linalg.norm(p.maps - truth.maps, axis=(1, 2))
        assert set(np.flatnonzero(off > 4)) == set(replaced)

    def test_flips_are_consistent_among_themselves(self, truth):
        p = data_gen.perturb(truth, 0.0, rng=1, outliers=0.4, outlier_kind="flip")
        for e in p.provenance["outlier_edges"]:
            i, j = p.edges[e]
            np.testing.assert_allclose(truth.absolute[i] @ p.maps[e] @ truth.absolute[j].T, truth.flip, atol=1e-10)

    def test_flips_of_shapes_mirror_the_body(self):
        shapes = data_gen.load_collection("cats", count=3, n_vertices=1000, symmetric=True)
        truth = data_gen.ground_truth(shapes, nx.complete_graph(3), 12, flip=left_right_flip(1000))
        np.testing.assert_allclose(truth.flip @ truth.flip, np.eye(12), atol=0.05)  # a pose is not symmetric
        assert np.linalg.norm(truth.flip - np.eye(12)) > 2


class TestRecords:
    def test_two_way_observes_each_pair_twice_with_noise_of_its_own(self, truth):
        p = data_gen.perturb(truth, 0.1, rng=1, two_way=True)
        there, back = p.maps[: len(truth.edges)], p.maps[len(truth.edges) :]
        np.testing.assert_array_equal(p.edges[: len(truth.edges)], p.edges[len(truth.edges) :, ::-1])
        assert np.linalg.norm(there - so.transpose(back), axis=(1, 2)).min() > 1

    def test_repeats_are_a_multigraph_with_noise_of_its_own(self, truth):
        p = data_gen.perturb(truth, 0.1, rng=1, repeats=3)
        first, second, third = p.maps.reshape(3, len(truth.edges), 20, 20)
        assert min(np.abs(first - second).max(), np.abs(second - third).max()) > 0.1

    def test_same_seed_same_problem(self, truth):
        a, b = data_gen.perturb(truth, 0.3, rng=5), data_gen.perturb(truth, 0.3, rng=5)
        np.testing.assert_array_equal(a.maps, b.maps)
        assert np.abs(a.maps - data_gen.perturb(truth, 0.3, rng=6).maps).max() > 0.1

    def test_the_record_remakes_the_problem(self, truth):
        generator = np.random.default_rng(9)
        generator.standard_normal(17)
        p = data_gen.perturb(truth, 0.3, rng=generator, outliers=0.2)
        record = json.loads(json.dumps(dict(p.provenance)))
        again = np.random.default_rng()
        again.bit_generator.state = record["rng"]
        same = data_gen.perturb(truth, record["sigma2"], again, outliers=record["outliers"])
        np.testing.assert_array_equal(same.maps, p.maps)
        assert record["noise"] == "projected-gaussian"
        assert record["versions"]["numpy"] == np.__version__


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"sigma2": -0.1}, "sigma2"),
        ({"sigma2": float("nan")}, "sigma2"),
        ({}, "takes sigma2"),
        ({"sigma2": 0.1, "kappa": 3.0}, "no kappa"),
        ({"sigma2": 0.1, "noise": "langevin"}, "takes kappa"),
        ({"kappa": -1.0, "noise": "langevin"}, "kappa"),
        ({"sigma2": 0.1, "noise": "cauchy"}, "'cauchy'"),
        ({"sigma2": 0.1, "around": "median"}, "around"),
        ({"sigma2": 0.1, "repeats": 0}, "repeats"),
        ({"sigma2": 0.1, "outliers": 1.0}, "outliers"),
        ({"sigma2": 0.1, "outliers": 0.1, "outlier_kind": "swap"}, "outlier_kind"),
    ],
)
def test_bad_noise(truth, options, words):
    with pytest.raises(ValueError, match=words):
        data_gen.perturb(truth, **options)


def test_flips_need_a_mirror_map(truth):
    with pytest.raises(ValueError, match="mirror map"):
        data_gen.perturb(replace(truth, flip=None), 0.1, outliers=0.2, outlier_kind="flip")
