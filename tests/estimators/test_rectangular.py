"""Maps between bases of unequal sizes: derivatives on Stiefel products, recovery, and the square case as a check."""

import warnings

import networkx as nx
import numpy as np
import pytest

import data_gen
import fmsync
from fmsync.estimators.rectangular import Frames

SIZES = (4, 6, 5, 6, 3, 5)


def planted(sizes=SIZES, m=6, noise=0.0, seed=0, graph=None):
    """(problem, frames) with C_ij = C_iᵀ C_j + noise."""
    rng = np.random.default_rng(seed)
    frames = [np.linalg.qr(rng.standard_normal((m, size)))[0] for size in sizes]
    edges = np.array((nx.complete_graph(len(sizes)) if graph is None else graph).edges)
    maps = [frames[i].T @ frames[j] for i, j in edges]
    maps = [observed + noise * rng.standard_normal(observed.shape) for observed in maps]
    weights = rng.uniform(0.5, 2, len(edges))
    return fmsync.RectangularSyncProblem(len(sizes), edges, maps, weights), frames


def energy(problem, frames):
    """The stated energy, edge by edge."""
    return sum(
        weight * np.sum((frames[i].T @ frames[j] - observed) ** 2)
        for (i, j), weight, observed in zip(problem.edges, problem.weights, problem.maps)
    )


def largest_error(estimate, frames):
    return max(
        np.abs(found - frames[i].T @ frames[j]).max()
        for found, (i, j) in zip(estimate.relative(), estimate.problem.edges)
    )


def random_tangent(model, point, rng):
    """The projection the Hessian ends with, of an ambient Gaussian with zero columns where there is padding."""
    ambient = rng.standard_normal(point.absolute.shape) * ~model._absent[:, None, :]
    inner = np.swapaxes(point.absolute, 1, 2) @ ambient
    return ambient - point.absolute @ (inner + np.swapaxes(inner, 1, 2)) / 2


@pytest.mark.parametrize("m", [6, 8])
def test_gradient_and_hessian_have_the_right_slopes(m):
    problem, _ = planted(noise=0.3)
    model = Frames(problem, m)
    rng = np.random.default_rng(1)
    frames = [np.linalg.qr(rng.standard_normal((m, size)))[0] for size in SIZES]
    start = np.zeros((len(SIZES), m, 6))
    for node, frame in enumerate(frames):
        start[node, :, : frame.shape[1]] = frame
    point = model.evaluate(start)
    np.testing.assert_allclose(point.cost, energy(problem, frames))
    v, w = random_tangent(model, point, rng), random_tangent(model, point, rng)
    hv = model.hessian(point, v)
    np.testing.assert_allclose(np.vdot(hv, w), np.vdot(v, model.hessian(point, w)), rtol=1e-10)

    def rest(t):  # the polar retraction is of second order, so the remainder of Taylor's expansion is cubic
        moved = model.evaluate(model.retract(point, t * v)).cost
        return abs(moved - point.cost - t * np.vdot(point.gradient, v) - t**2 / 2 * np.vdot(hv, v))

    slope = np.log10(rest(1e-2) / rest(1e-3))
    assert abs(slope - 3) < 0.1


def test_consistent_maps_are_recovered():
    problem, frames = planted()
    estimate = fmsync.solve_rectangular(problem)
    assert estimate.converged
    assert estimate.cost < 1e-12
    assert largest_error(estimate, frames) < 1e-6
    unseen = estimate.relative([[5, 0], [2, 2]])
    np.testing.assert_allclose(unseen[0], frames[5].T @ frames[0], atol=1e-6)
    np.testing.assert_allclose(unseen[1], np.eye(5), atol=1e-12)


def test_a_universe_larger_than_every_shape_is_recovered():
    problem, _ = planted(sizes=(4, 5, 4, 5, 3, 4, 5), m=7)
    assert fmsync.solve_rectangular(problem, 7).cost < 1e-10
    assert fmsync.solve_rectangular(problem).cost > 0.1  # five dimensions cannot hold them


def test_missing_edges_and_noise():
    """Synchronised maps are nearer to the truth than the observed ones."""
    graph = data_gen.random_graph(12, 0.6, rng=0)
    problem, frames = planted(sizes=(6, 7, 8) * 4, m=8, noise=0.1, graph=graph)
    estimate = fmsync.solve_rectangular(problem)
    np.testing.assert_allclose(estimate.cost, energy(problem, estimate.absolute), rtol=1e-10)
    raw, synchronised = (
        sum(np.sum((a - frames[i].T @ frames[j]) ** 2) for a, (i, j) in zip(maps, problem.edges))
        for maps in (problem.maps, estimate.relative())
    )
    assert synchronised < 0.6 * raw
    assert energy(problem, estimate.absolute) < energy(problem, frames)


@pytest.mark.parametrize(
    ("seed", "sizes", "m"), [(15, (4, 4, 5, 2, 3, 2), 5), (51, (5, 5, 3, 3), 5), (54, (2, 3, 4, 4), 4)]
)
def test_no_saddle_at_the_start_holds_a_path(seed, sizes, m):
    problem, _ = planted(sizes, m, seed=seed, graph=nx.path_graph(len(sizes)))
    assert fmsync.solve_rectangular(problem, m).cost < 1e-8


def test_equal_sizes_are_the_problem_on_orthogonal_matrices():
    square = data_gen.perturb(data_gen.planted(7, 4, rng=0), 0.1, rng=1)
    problem = fmsync.RectangularSyncProblem(7, square.edges, list(square.maps))
    estimate, expected = fmsync.solve_rectangular(problem), fmsync.solve(square, "mle", group="O")
    np.testing.assert_allclose(estimate.cost, expected.cost, rtol=1e-9)
    np.testing.assert_allclose(np.stack(estimate.relative()), expected.relative(), atol=1e-5)


def test_gauge_frames_and_trace():
    problem, _ = planted(noise=0.1)
    estimate = fmsync.solve_rectangular(problem, 7)
    np.testing.assert_allclose(estimate.absolute[0], np.eye(7, 4), atol=1e-12)
    for frame, size in zip(estimate.absolute, SIZES):
        assert frame.shape == (7, size)
        np.testing.assert_allclose(frame.T @ frame, np.eye(size), atol=1e-12)
    assert estimate.trace.cost[-1] == estimate.cost
    assert (np.diff(estimate.trace.cost) <= 1e-12).all()
    again = fmsync.solve_rectangular(problem, 7)
    np.testing.assert_array_equal(again.absolute[3], estimate.absolute[3])


def test_stopping_early_is_said_aloud():
    problem, _ = planted(noise=0.3)
    with pytest.warns(RuntimeWarning, match="solve_rectangular stopped before its tolerance"):
        assert not fmsync.solve_rectangular(problem, init="random", max_iterations=1).converged
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert fmsync.solve_rectangular(problem, init="random").converged


def test_bad_input_is_named():
    build = fmsync.RectangularSyncProblem
    with pytest.raises(ValueError, match=r"edge 1 \(1, 2\) gives node 1 4 basis functions, edge 0 gave it 3"):
        build(3, [[0, 1], [1, 2]], [np.eye(5, 3), np.eye(4, 2)])
    with pytest.raises(ValueError, match=r"maps: edge 0 \(0, 1\) holds NaN"):
        build(2, [[0, 1]], [np.full((2, 3), np.nan)])
    with pytest.raises(ValueError, match=r"maps: edge 0 \(0, 1\) has shape \(3,\)"):
        build(2, [[0, 1]], [np.ones(3)])
    with pytest.raises(ValueError, match="maps: 1 maps for 2 edges"):
        build(3, [[0, 1], [1, 2]], [np.eye(3)])
    with pytest.raises(ValueError, match=r"weights: edge 1 \(1, 2\) has weight 0"):
        build(3, [[0, 1], [1, 2]], [np.eye(3)] * 2, [1.0, 0.0])
    with pytest.raises(ValueError, match="falls into 2 components"):
        build(4, [[0, 1], [2, 3]], [np.eye(3)] * 2)
    problem = build(2, [[0, 1]], [np.eye(5, 3)])
    with pytest.raises(ValueError, match="universe: 4 is smaller than the 5 basis functions of node 0"):
        fmsync.solve_rectangular(problem, 4)
    with pytest.raises(ValueError, match="init: 'spectral' or 'random', not 'cold'"):
        fmsync.solve_rectangular(problem, init="cold")


def turned_beyond(frames, middle, part):
    """Other frames with the same maps to ``middle``: what lies outside of its span is turned in one shape."""
    span, _, _ = np.linalg.svd(frames[middle])
    inside, outside = np.split(span, [frames[middle].shape[1]], axis=1)
    turn = inside @ inside.T + outside @ -np.eye(outside.shape[1]) @ outside.T
    return [turn @ frame if k == part else frame for k, frame in enumerate(frames)]


@pytest.mark.parametrize("sizes", [(4, 3, 5), (4, 4, 4)])  # the part outside can be rotated, or only reflected
def test_maps_through_a_smaller_shape_are_said_to_be_undetermined(sizes):
    problem, frames = planted(sizes, 5, graph=nx.path_graph(3), seed=3)
    others = turned_beyond(frames, 1, 2)
    assert energy(problem, others) < 1e-20
    assert np.linalg.norm(frames[0].T @ frames[2] - others[0].T @ others[2]) > 0.1  # two truths, the same data
    estimate = fmsync.solve_rectangular(problem, 5, init="random")  # the spectral start of a path is a saddle
    assert estimate.cost < 1e-10
    assert estimate.identifiable([[0, 1], [2, 0], [1, 1]]).tolist() == [True, False, True]
    with pytest.warns(UserWarning, match=r"do not determine pairs \[0, 2\]; observe them"):
        estimate.relative(np.array([[1, 2], [0, 2]]))


@pytest.mark.parametrize(
    ("sizes", "m", "graph"),
    [
        ((4, 5, 3), 5, nx.path_graph(3)),  # through a shape that sees everything
        ((4,) * 6, 6, nx.wheel_graph(6)),  # two neighbours see everything together
        ((4,) * 5, 6, nx.cycle_graph(5)),  # by the whole cycle, no product of maps tells
        ((3,) * 4, 3, nx.path_graph(4)),  # square maps
    ],
)
def test_maps_that_are_determined_are_returned_without_a_word(sizes, m, graph):
    problem, frames = planted(sizes, m, graph=graph)
    estimate = fmsync.solve_rectangular(problem, m)
    assert estimate.cost < 1e-10
    pairs = np.stack(np.triu_indices(len(sizes), 1), axis=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = estimate.relative(pairs)
    assert all(np.abs(x - frames[i].T @ frames[j]).max() < 1e-4 for x, (i, j) in zip(found, pairs))


def test_a_ring_of_small_shapes_in_a_large_universe_is_undetermined():
    problem, _ = planted((2,) * 4, 5, graph=nx.cycle_graph(4))
    estimate = fmsync.solve_rectangular(problem, 5)
    assert estimate.identifiable([[0, 2], [1, 3], [0, 3]]).tolist() == [False, False, True]
    with pytest.raises(ValueError, match=r"edges"):
        estimate.identifiable([[0, 4]])
