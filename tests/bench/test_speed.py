"""The study of speed: its rows on small problems, and that it leaves the library as it was."""

import sys

import numpy as np

from bench import speed


def test_rows_are_complete_and_nobody_is_watched_afterwards(monkeypatch):
    monkeypatch.setattr(speed, "RUNS", 2)
    p, before = speed.problem(60), sys.getprofile()
    row = speed.solves(p)
    assert sys.getprofile() is before
    assert row["n_edges"] == 600
    assert 0 < row["limit"] < 10 * row["seconds"]
    assert 0 < row["memory"] < 3
    sums = speed.neighbour_sums(p, np.dtype(float))
    assert all(np.isfinite(value) and value > 0 for value in sums.values())


def test_pairs_are_ratios_of_the_second_to_the_first():
    pair = speed.paired(lambda: sum(range(10**5)), lambda: sum(range(10**6)), runs=3)
    assert pair["ratio_low"] <= pair["ratio"] <= pair["ratio_high"]
    assert pair["ratio"] > 3


def test_the_large_problem_is_described_by_one_solve():
    row = speed.large(60)
    assert row["n_nodes"] == 60
    assert row["maps"] == row["n_edges"] * 400 * 8 / 1e9
    assert row["maps"] < row["peak"] < 10
    assert row["seconds"] > 0
