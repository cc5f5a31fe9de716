"""Every metric on numbers small enough to work out by hand."""

import numpy as np
import pytest

from bench import metrics
from fmsync import oracle
from fmsync.problem import cycle_error


def turn(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def test_frobenius_errors_are_chords_and_not_squared():
    maps, truth = np.stack([turn(0.0), turn(np.pi / 3)]), np.stack([turn(np.pi), turn(0.0)])
    # |turn(a) - turn(b)| = 2 sqrt 2 sin(|a - b| / 2): 2 sqrt 2 and sqrt 2
    np.testing.assert_allclose(metrics.frobenius_errors(maps, truth), [np.sqrt(8), np.sqrt(2)])


def test_root_mean_square_by_hand():
    assert metrics.root_mean_square([1.0, 7.0]) == 5.0


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


def test_every_metric_has_a_unit_and_a_direction():
    assert {metric.direction for metric in metrics.METRICS.values()} == {"lower", "higher", "none"}
    assert all(metric.unit and name == metric.name for name, metric in metrics.METRICS.items())
