"""Every metric on numbers small enough to work out by hand."""

from types import SimpleNamespace

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


def test_curve_and_area_by_hand(monkeypatch):
    monkeypatch.setattr(metrics, "point_map", lambda c, first, second, scored: scored)
    planted = SimpleNamespace(scored=np.arange(4), bases=[None] * 2, distances=[None, np.diag([0.0, 0.125, 0.2, 0.0])])
    found = {(name, at): value for name, at, value in metrics._measure_points(planted, [(0, 1)], [None])}
    assert found["point_error", None] == pytest.approx(0.08125)
    assert found["point_area", None] == pytest.approx(0.675)  # (1 + 0.5 + 0.2 + 1) / 4 of [0, 0.25]
    assert [found["point_curve", at] for at in (0.0, 0.15, 0.25)] == [0.5, 0.75, 1.0]


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
