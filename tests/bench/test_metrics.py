"""Every metric on numbers small enough to work out by hand."""

import numpy as np
import pytest

from bench import metrics
from fmsync import calibration, oracle
from fmsync.problem import cycle_error


def turn(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def test_frobenius_errors_are_chords_and_not_squared():
    maps, truth = np.stack([turn(0.0), turn(np.pi / 3)]), np.stack([turn(np.pi), turn(0.0)])
    # |turn(a) - turn(b)| = 2 sqrt 2 sin(|a - b| / 2): 2 sqrt 2 and sqrt 2
    np.testing.assert_allclose(metrics.frobenius_errors(maps, truth), [np.sqrt(8), np.sqrt(2)])


def test_root_mean_square_by_hand():
    assert metrics.root_mean_square([1.0, 7.0]) == 5.0


def test_energy_score_by_hand():
    draws = np.zeros((3, 1, 2, 2))
    draws[:, 0, 0, 0] = [0.0, 1.0, 3.0]
    truth = np.zeros((1, 2, 2))
    truth[0, 0, 0] = 1.0
    # distances to the truth 1, 0, 2: mean 1; between draws 1, 3, 2: mean 2
    assert calibration.energy_score(draws, truth) == pytest.approx(1.0 - 2.0 / 2)


def test_energy_score_against_its_slow_twin():
    rng = np.random.default_rng(0)
    draws, truth = rng.standard_normal((7, 3, 2, 2)), rng.standard_normal((3, 2, 2))
    slow = 0.0
    for pair in range(3):
        near = np.mean([np.linalg.norm(x - truth[pair]) for x in draws[:, pair]])
        apart = [np.linalg.norm(draws[a, pair] - draws[b, pair]) for a in range(7) for b in range(7) if a != b]
        slow += (near - np.mean(apart) / 2) / 3
    assert calibration.energy_score(draws, truth) == pytest.approx(slow)


def test_energy_score_prefers_the_right_width():
    rng = np.random.default_rng(1)
    truth = rng.standard_normal((400, 2, 2))
    scores = [
        calibration.energy_score(width * rng.standard_normal((100, 400, 2, 2)), truth) for width in (0.3, 1.0, 3.0)
    ]
    assert scores[1] < min(scores[0], scores[2]) - 0.02


def test_coverage_by_hand():
    draws = np.zeros((8, 1, 2, 2))
    draws[1::2, 0, 0, 0] = [1.0, 2.0, 3.0, 4.0]  # even draws put the centre at 0, odd ones the radii at 1..4
    for distance, inside in ((2.4, [True, True]), (3.0, [False, True]), (4.0, [False, False])):
        truth = np.zeros((1, 2, 2))
        truth[0, 0, 0] = distance
        np.testing.assert_array_equal(calibration.covered(draws, truth, (0.5, 0.8))[:, 0], inside)


def test_coverage_of_exact_draws_is_what_was_promised():
    rng = np.random.default_rng(2)
    coverage = calibration.covered(
        rng.standard_normal((2000, 1000, 3, 3)), rng.standard_normal((1000, 3, 3)), metrics.LEVELS
    ).mean(axis=1)
    np.testing.assert_allclose(coverage, metrics.LEVELS, atol=0.045)  # three standard errors at one half


def test_calibration_error_by_hand():
    assert calibration.calibration_error([0.4, 1.0], (0.5, 0.8)) == pytest.approx(0.15)


def test_curve_and_area_by_hand():
    errors = [0.0, 0.1, 0.2, 0.0]
    np.testing.assert_allclose(metrics.cumulative_curve(errors, [0.0, 0.15, 0.3]), [0.5, 0.75, 1.0])
    # (1 + 0.5 + 0 + 1) / 4 of [0, 0.2]
    assert metrics.area_under_curve(errors, 0.2) == pytest.approx(0.625)


def test_area_is_the_integral_of_the_curve():
    errors = np.random.default_rng(3).exponential(0.05, 500)
    thresholds = (np.arange(2000) + 0.5) / 2000 * 0.25
    integral = metrics.cumulative_curve(errors, thresholds).mean()
    assert metrics.area_under_curve(errors, 0.25) == pytest.approx(integral, abs=1e-3)


def test_cycle_error_of_one_turned_edge():
    maps = np.stack([turn(0.0), turn(0.0), turn(np.pi / 3)])
    np.testing.assert_allclose(cycle_error(3, [[0, 1], [1, 2], [0, 2]], maps), [np.sqrt(2)])


def test_oracle_accuracy_by_hand():
    truth = np.stack([np.eye(2), np.eye(2)])
    draws = np.stack([np.eye(2), turn(np.pi)])[None]
    # the second map is 2 sqrt 2 away, the first is right by the gauge
    np.testing.assert_allclose(oracle.oracle_accuracy(draws, truth), [(1 + 1 / (1 + np.sqrt(8))) / 2])


def test_too_few_draws_are_refused():
    with pytest.raises(ValueError, match="energy score"):
        calibration.energy_score(np.zeros((1, 1, 2, 2)), np.zeros((1, 2, 2)))
    with pytest.raises(ValueError, match="four"):
        calibration.covered(np.zeros((3, 1, 2, 2)), np.zeros((1, 2, 2)), metrics.LEVELS)


def test_every_metric_has_a_unit_and_a_direction():
    assert {metric.direction for metric in metrics.METRICS.values()} == {"lower", "higher", "none"}
    assert all(metric.unit and name == metric.name for name, metric in metrics.METRICS.items())
