import io
import sys

import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import so


@pytest.fixture(scope="module")
def problem():
    return data_gen.perturb(data_gen.planted(4, 3, rng=0), 0.1, 1)


@pytest.fixture(scope="module")
def post(problem):
    return fmsync.sample(problem, n_chains=3, n_draws=40, warmup=20, thin=2, rng=5)


def test_shapes_and_settings(problem, post):
    assert post.absolute.shape == (3, 40, 4, 3, 3)
    assert post.energy.shape == post.kappa.shape == (3, 40)
    assert (post.kappa == 2.0).all()
    assert (post.n_chains, post.n_draws, post.interrupted) == (3, 40, False)
    assert post.settings["warmup"] == 20
    np.testing.assert_allclose(post.energy, fmsync.energy.energy(problem, post.absolute))


def test_same_seed_same_draws(problem, post):
    again = fmsync.sample(problem, n_chains=3, n_draws=40, warmup=20, thin=2, rng=5)
    np.testing.assert_array_equal(again.absolute, post.absolute)
    other = fmsync.sample(problem, n_chains=3, n_draws=40, warmup=20, thin=2, rng=6)
    assert np.abs(other.absolute - post.absolute).max() > 0.1


def test_warmup_and_thinning_only_skip(problem):
    every = fmsync.sample(problem, n_chains=2, n_draws=30, warmup=0, rng=1)
    some = fmsync.sample(problem, n_chains=2, n_draws=5, warmup=10, thin=4, rng=1)
    np.testing.assert_array_equal(some.absolute, every.absolute[:, 13:30:4])


def test_relative_means_against_their_definition(post):
    pairs = np.array([[0, 2], [3, 1], [2, 2]])
    draws = post.relative(pairs).reshape(-1, 3, 3, 3)
    np.testing.assert_allclose(post.relative_mean(pairs), so.project(draws.mean(axis=0)), atol=1e-12)
    assert post.relative_mean().shape == (6, 3, 3)


def test_dispersed_starts(problem):
    states = []
    fmsync.sample(
        problem, step=1e-12, init="dispersed", n_chains=4, n_draws=1, warmup=0,
        callback=lambda draw, state, energy: states.append((state.copy(), energy.copy())),
    )  # fmt: skip
    (state, energy), best = states[0], fmsync.solve(problem, "mle").cost
    np.testing.assert_allclose(energy[::2], best, rtol=1e-3)
    assert (energy[1::2] > 1.5 * best).all()
    assert np.abs(state[1] - state[3]).max() > 0.1


def test_given_starts_are_used(problem):
    starts = so.random_uniform(3, (2, 4), rng=0)
    post = fmsync.sample(problem, step=1e-14, init=starts, n_chains=2, n_draws=1, warmup=0)
    np.testing.assert_allclose(post.absolute[:, 0], starts, atol=1e-5)
    estimate = fmsync.solve(problem, "mle")
    post = fmsync.sample(problem, step=1e-14, init=estimate, n_chains=2, n_draws=1, warmup=0)
    np.testing.assert_allclose(post.absolute[1, 0], estimate.absolute, atol=1e-5)


@pytest.mark.parametrize("when", [1, 7])
def test_ctrl_c_returns_the_draws_so_far(problem, when):
    whole = fmsync.sample(problem, n_chains=2, n_draws=10, warmup=5, rng=2)

    def interrupt(draw, state, energy):
        if draw == when:
            raise KeyboardInterrupt

    post = fmsync.sample(problem, n_chains=2, n_draws=10, warmup=5, rng=2, callback=interrupt)
    assert post.interrupted
    np.testing.assert_array_equal(post.absolute, whole.absolute[:, :when])
    assert post.energy.shape == post.kappa.shape == (2, when)


@pytest.mark.parametrize("terminal", [True, False])
def test_a_progress_bar_on_a_terminal_only(problem, monkeypatch, terminal):
    screen = io.StringIO()
    screen.isatty = lambda: terminal
    monkeypatch.setattr(sys, "stderr", screen)
    fmsync.sample(problem, n_chains=1, n_draws=10, warmup=10, thin=2)
    assert ("30" in screen.getvalue() and "step" in screen.getvalue()) == terminal
    assert bool(screen.getvalue()) == terminal


def test_ctrl_c_before_the_first_draw_goes_through(problem):
    def interrupt(draw, state, energy):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fmsync.sample(problem, n_draws=10, warmup=0, callback=interrupt)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_draws": 0}, "n_draws"),
        ({"n_chains": 0}, "n_chains"),
        ({"n_chains": 1.5}, "n_chains"),
        ({"warmup": -1}, "warmup"),
        ({"thin": 0}, "thin"),
        ({"init": "best"}, "'best'"),
        ({"init": np.stack([np.eye(3)] * 3)}, r"init: expected \(4, 3, 3\)"),
        ({"init": np.stack([np.stack([np.eye(3)] * 4)] * 3), "n_chains": 2}, "3 starts for 2 chains"),
        ({"method": "rlmf"}, "did you mean rlfm"),
        ({"stepp": 1.0}, "stepp: 'rlfm' has no such option; it takes retraction"),
        ({"likelihood": "projected-gaussian"}, "likelihood: 'rlfm' takes 'langevin' alone"),
        ({"energy": "free"}, "energy: 'euclidean' or 'geodesic', not 'free'"),
    ],
)
def test_bad_input_is_named(problem, options, message):
    with pytest.raises(ValueError, match=message):
        fmsync.sample(problem, **options)


def test_a_start_off_the_group_names_the_node(problem):
    start = np.stack([np.eye(3)] * 4)
    start[2, 0, 0] = -1
    with pytest.raises(ValueError, match="init: node 2 is not a rotation"):
        fmsync.sample(problem, init=start)
    with pytest.raises(ValueError, match="init: node 2 is not a rotation"):
        fmsync.sample(problem, init=np.stack([np.stack([np.eye(3)] * 4), start]), n_chains=2)
