import numpy as np
import pytest

from fmsync import oracle, so


def slow_oracle(draws, truth):
    """The paper's recipe entry by entry, on gauged draws."""
    best = np.empty(truth.shape)
    for index in np.ndindex(truth.shape):
        entries = draws[(slice(None), *index)]
        best[index] = entries[np.argmin(np.abs(entries - truth[index]))]
    return np.mean([1 / (1 + np.linalg.norm(c - b)) for c, b in zip(truth, best)])


def test_against_the_recipe_and_free_of_gauge():
    rng = np.random.default_rng(0)
    truth, draws = so.random_uniform(4, 3, rng), so.random_uniform(4, (15, 3), rng)
    gauged = so.transpose(draws[:, :1]) @ draws
    curve = oracle.oracle_accuracy(draws, truth)
    assert curve.shape == (15,)
    assert (np.diff(curve) >= 0).all()
    for k in (1, 4, 15):
        assert curve[k - 1] == pytest.approx(slow_oracle(gauged[:k], truth[0].T @ truth), abs=1e-12)
    np.testing.assert_array_equal(oracle.oracle_accuracy(draws, truth, [4, 1]), curve[[3, 0]])
    turned = so.random_uniform(4, (15, 1), rng) @ draws
    np.testing.assert_allclose(oracle.oracle_accuracy(turned, so.random_uniform(4, 1, rng) @ truth), curve)


def test_the_truth_among_the_draws_scores_one():
    truth = so.random_uniform(4, 3, rng=1)
    draws = np.concatenate([so.random_uniform(4, (3, 3), rng=2), truth[None]])
    curve = oracle.oracle_accuracy(draws, truth)
    assert curve[2] < 0.9
    assert curve[3] == pytest.approx(1)


def test_baseline_starts_at_the_estimate_and_is_uniform_after():
    first = so.random_uniform(5, 3, rng=0)
    draws = oracle.haar_baseline(first, 2001, rng=1)
    np.testing.assert_allclose(draws[0], first[0].T @ first, atol=1e-12)
    np.testing.assert_allclose(draws[:, 0], np.broadcast_to(np.eye(5), (2001, 5, 5)), atol=1e-12)
    traces = np.trace(draws[1:, 1], axis1=1, axis2=2)  # mean 0, variance 1 under Haar
    assert abs(traces.mean()) < 4 / np.sqrt(2000)
    assert abs(traces.var() - 1) < 4 * np.sqrt(2 / 2000)


def test_bad_input_is_named():
    truth = so.random_uniform(4, 3, rng=0)
    with pytest.raises(ValueError, match=r"draws: expected \(K, 3, 4, 4\)"):
        oracle.oracle_accuracy(truth, truth)
    with pytest.raises(ValueError, match="K >= 1"):
        oracle.oracle_accuracy(truth[None][:0], truth)
    with pytest.raises(ValueError, match=r"counts\[1\] = 3"):
        oracle.oracle_accuracy(np.stack([truth] * 2), truth, [1, 3])
    with pytest.raises(ValueError, match="n_samples"):
        oracle.haar_baseline(truth, 0)
