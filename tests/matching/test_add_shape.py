"""One shape more: the others stay, the new one comes where the full run puts it, for a few matches."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import fmsync
from fmsync import langevin, so
from fmsync.matching import add, add_shape
from fmsync.matching.confidence import samples_to_vertices
from fmsync.matching.conformal import default_calibration
from fmsync.samplers import Posterior
from tests.matching.conftest import OPTIONS


@pytest.fixture(scope="module")
def few(cats):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fmsync.synchronize_shapes(cats[:3], n_draws=200, **OPTIONS)


@pytest.fixture(scope="module")
def more(few, cats):
    return add_shape(few, cats[3])


def test_the_others_stay_as_they_are(more, few):
    np.testing.assert_array_equal(more.refined[:3], few.refined)
    np.testing.assert_array_equal(more.posterior.absolute[:, :, :3], few.posterior.absolute)
    np.testing.assert_array_equal(more.posterior.kappa, few.posterior.kappa)
    np.testing.assert_array_equal(more.edges, [*few.edges, (0, 3), (1, 3), (2, 3)])
    assert more.names == ["cat0", "cat1", "cat2", "cat3"]
    assert len(more.matches) == len(more.estimate.edge_weights) == more.problem.n_edges == 6


def test_it_agrees_with_the_full_run_within_its_regions(more, synced):
    calibration = default_calibration()
    for i, j in ((0, 3), (3, 1)):
        vertices = synced.shapes[j].shape.vertices
        images = [s.point_map(i, j) for s in (more, synced)]
        apart = np.linalg.norm(vertices[images[0]] - vertices[images[1]], axis=1)
        region = samples_to_vertices(more.shapes[i], calibration.radius(more.confidence(i, j)))
        assert (apart <= region).mean() > 0.7
        errors = [np.linalg.norm(vertices[image] - vertices, axis=1).mean() for image in images]
        assert errors[0] < errors[1] + 0.01
    rotations = [so.project(s.draws(1, 3, 200).mean(axis=0)) for s in (more, synced)]
    assert np.linalg.norm(rotations[0] - rotations[1]) < 1  # two unrelated ones are √24 apart


def test_it_costs_a_match_for_each_neighbour(few, cats, monkeypatch):
    seen = []
    found = {s.shape.name: m for s, m in zip(few.shapes, add_shape(few, cats[3]).matches[3:])}
    monkeypatch.setattr(add, "match", lambda a, b: seen.append((a, b)) or found[a.shape.name])
    near = add_shape(few, cats[3], neighbours=2)
    assert len(seen) == 2
    assert len(near.edges) == 5
    monkeypatch.undo()
    again = add_shape(near, replace(cats[3], name="cat1"), neighbours=1)
    assert again.names[-1] == "cat1 (shape 4)"
    assert again.point_map(0, 4).shape == (1000,)


def test_draws_follow_the_conditional_density():
    """Where the maps of all others say the same, it is Langevin with the sum of the concentrations."""
    n, kappa, count = 5, 3.0, 4000
    rng = np.random.default_rng(0)
    fixed, new = so.random_uniform(n, (1, count, 2), rng), so.random_uniform(n, 1, rng)[0]
    maps = np.array([so.random_uniform(n, 1, rng)[0], new])
    fixed[:, :, 0] = fixed[:, :, 1] @ maps[1] @ maps[0].T  # C_0 M_0 = C_1 M_1
    problem = fmsync.SyncProblem(2, [[0, 1]], [np.eye(n)])
    ones = np.ones((1, count))
    posterior = Posterior(problem, "heat-bath", fixed, 0 * ones, kappa * ones, False, {})
    found = add._with_draws(posterior, np.array([[0, 2], [1, 2]]), maps, rng)
    cosine = np.einsum("ctab,ctab->t", found.absolute[:, :, 2], fixed[:, :, 1] @ maps[1]) / n
    error = cosine.std() / np.sqrt(count)
    assert abs(cosine.mean() - langevin.mean_cosine(n, 2 * kappa)) < 5 * error
    np.testing.assert_allclose(found.energy[0], 4 * n * (1 - cosine), atol=1e-9)
    both = fmsync.energy.energy(found.problem, found.absolute[0, 0])
    assert both == pytest.approx(found.energy[0, 0] + fmsync.energy.energy(problem, fixed[0, 0]))


def test_wrong_maps_of_the_new_shape_are_named(few, cats, monkeypatch):
    """Of three maps one is of something else."""
    true = add_shape(few, cats[3]).matches[3:]
    wrong = replace(true[1], c_ij=np.linalg.qr(np.random.default_rng(0).standard_normal(true[1].c_ij.shape))[0])
    found = dict(zip(few.names, (true[0], replace(wrong, distortion=-1.0), true[2])))  # too good to be replaced
    monkeypatch.setattr(add, "match", lambda a, b: found[a.shape.name])
    more = add_shape(few, cats[3])
    assert more.estimate.edge_weights[4] < 0.1
    assert more.estimate.edge_weights[[3, 5]].min() > 0.9
    assert 4 not in more.used


def test_what_does_not_fit_is_refused(few, cats, monkeypatch):
    monkeypatch.setattr(add, "sample_shape", lambda *_: pytest.fail("long work began"))
    with pytest.raises(ValueError, match="cat3: mirrored or inside out"):
        add_shape(few, replace(cats[3], vertices=cats[3].vertices * [1, -1, 1]))
    with pytest.raises(ValueError, match=r"landmarks\[3\] \(of cat3\): 2 vertices, cat0 has 0"):
        add_shape(few, cats[3], landmarks=[1, 2])
    with pytest.raises(ValueError, match="neighbours: an integer >= 1, got 0"):
        add_shape(few, cats[3], neighbours=0)
