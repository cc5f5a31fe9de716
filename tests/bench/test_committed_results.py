"""The tables in results/ can be remade: ten random cells, run again here, agree."""

import json
from pathlib import Path

import numpy as np
import pytest

from fmsync.bench import cell as cells
from fmsync.bench import methods, results
from fmsync.bench.suites import Cell, load_suite, suite_names

FOLDER = Path(__file__).parents[2] / "results"
SUITES = [name for name in suite_names() if (FOLDER / f"{name}.parquet").is_file()]


def again(row):
    problem, options = json.loads(row.problem), json.loads(row.options)
    return Cell(row.generator, problem, int(row.seed), row.label, row.method, options, seconds=300.0, memory=8000.0)


@pytest.mark.slow
@pytest.mark.parametrize("k", range(10))
def test_ten_random_cells_agree(k):
    """To a thousandth where the method and its randomness are unchanged; a sampler that draws other numbers now is
    one more draw, within three standard deviations of the seeds and two per cent.
    """
    rng = np.random.default_rng([k, 2026])
    frame = results.read(FOLDER / f"{SUITES[rng.integers(len(SUITES))]}.parquet")
    errors = frame[(frame.metric == "edge_error") & (frame.status == "ok")]
    row = errors.iloc[rng.integers(len(errors))]
    peers = errors[(errors.problem == row.problem) & (errors.label == row.label)].value
    draws = methods.get(row.method).kind == "sampler"
    tolerance = 0.02 * row.value + 3 * (peers.std() if len(peers) > 1 else 0.0) if draws else 1e-3 * row.value
    record = cells.run_cell(again(row))
    assert record["status"] == "ok", record.get("traceback")
    (found,) = (value for name, at, value in record["metrics"] if name == "edge_error")
    assert found == pytest.approx(row.value, abs=tolerance)


@pytest.mark.parametrize("name", SUITES)
def test_tables_hold_cells_of_their_suites(name):
    """What is committed belongs to the suite as it is written now, and says where it was made."""
    frame = results.read(FOLDER / f"{name}.parquet")
    known = {(cell.label, json.dumps(dict(cell.problem), sort_keys=True)) for cell in load_suite(name).cells}
    rows = frame.drop_duplicates(["label", "problem"])
    assert {(row.label, row.problem) for row in rows.itertuples()} <= known
    assert not frame.commit.isin(["", "unknown"]).any()
    assert not frame.commit.str.endswith("+").any()  # made from a clean checkout
    assert frame.versions[frame.status == "ok"].str.contains("numpy").all()
    scalars = frame[frame.metric.notna()]
    assert scalars.unit.notna().all()
