"""Whether a table can be trusted: cells run again, equal, near or not."""

import numpy as np
import pandas as pd
import pytest

from bench import results
from bench.__main__ import main
from bench.cell import run_cell, run_together
from bench.suites import Cell
from bench.verify import agrees, verify

PROBLEM = {"n_nodes": 5, "n": 4, "sigma2": 0.1}


def cell(method, seed, problem=PROBLEM, **options):
    return Cell("bench.problems:rotations", problem, seed, method, method, options)


@pytest.fixture(scope="module")
def frame():
    cells = [cell("mle", seed) for seed in range(3)]
    cells += [cell("heat-bath", seed, n_chains=1, n_draws=100, warmup=20) for seed in range(3)]
    return results.to_frame("s", [run_cell(c) for c in cells])


def with_errors(frame, label, change):
    """The table with another edge_error in all rows of a method."""
    chosen = (frame.label == label) & (frame.metric == "edge_error")
    return frame.assign(value=frame.value.where(~chosen, change(frame.value)))


def verdicts(found, metric="edge_error"):
    return {one.cell.partition(" ")[0]: one.verdict for one in found if one.metric == metric}


def test_the_same_machine_gives_the_same_numbers(frame):
    found = list(verify(frame, 6, rng=0))
    assert len({one.cell for one in found}) == 6
    assert {one.verdict for one in found} == {"equal"}
    compared = {one.metric for one in found}
    assert {"edge_error", "cycle_error", "energy_score", "coverage_90", "accuracy_at_draws"} <= compared
    assert not compared & {"seconds", "cpu_seconds", "peak_memory", "ess_per_second"}


def test_cells_of_a_batch_are_run_again_alone():
    batch = [cell("rlfm", seed, n_chains=1, n_draws=60, warmup=20) for seed in range(3)]
    found = list(verify(results.to_frame("s", run_together(batch)), 3, rng=0))
    assert {one.verdict for one in found} == {"equal"}


def test_draws_may_differ_more_than_estimates(frame):
    moved = with_errors(with_errors(frame, "mle", lambda v: v * 1.01), "heat-bath", lambda v: v * 1.01)
    found = list(verify(moved, 6, rng=0))
    assert verdicts(found) == {"mle": "differs", "heat-bath": "agrees"}
    assert [agrees(one) for one in found if one.metric == "edge_error" and one.cell.startswith("mle")] == [False] * 3
    rounded = with_errors(frame, "mle", lambda v: v * (1 + 1e-5))
    assert verdicts(verify(rounded, 6, rng=0))["mle"] == "agrees"
    far = with_errors(frame, "heat-bath", lambda v: v + np.where(frame.seed == 0, 10.0, 10.001))
    assert verdicts(verify(far, 6, rng=0))["heat-bath"] == "differs"


def test_a_metric_that_a_seed_does_not_have_is_left_out(frame):
    without = frame[~((frame.metric == "cycle_error") & (frame.seed == 1) & (frame.label == "mle"))]
    found = list(verify(without, 6, rng=0))
    assert {one.verdict for one in found} == {"equal"}
    told = {one.cell for one in found if one.metric == "cycle_error"}
    assert len({one.cell for one in found}) - len(told) == 1


def test_a_cell_that_fails_now_is_told(frame):
    def failing(again):
        return {**run_cell(again), "status": "timeout"}

    (found,) = verify(frame, 1, rng=0, run=failing)
    assert found.verdict == "timeout"
    assert not agrees(found)


def test_cells_without_their_data_are_left_out(frame, monkeypatch):
    monkeypatch.delenv("FMSYNC_DATA", raising=False)
    elsewhere = frame.assign(problem='{"collection": "not-here"}', label="mle on shapes")
    assert {one.cell.split()[0] for one in verify(pd.concat([frame, elsewhere]), 9, rng=0)} == {
        "mle",
        "heat-bath",
    }


def test_more_cells_than_there_are(frame):
    with pytest.raises(ValueError, match="7 of a table of 6"):
        list(verify(frame, 7, rng=0))


def test_command(frame, tmp_path, capsys):
    results.write(frame, tmp_path / "mine.parquet")
    assert main(["verify", "--cells", "3", "--results", str(tmp_path)]) == 0
    assert "all agree" in capsys.readouterr().out
    results.write(with_errors(frame, "mle", lambda v: v + 1), tmp_path / "mine.parquet")
    assert main(["verify", "mine", "--cells", "6", "--results", str(tmp_path)]) == 1
    assert "differs: edge_error" in capsys.readouterr().out
    assert main(["verify", "--results", str(tmp_path / "nowhere")]) == 2
    assert "--results" in capsys.readouterr().err
