"""The tables in results/ can be remade: ten random runs, repeated here, agree."""

import json
from pathlib import Path

import pandas as pd
import pytest

from bench import results
from bench.suites import load_suite, suite_names
from bench.verify import verify

FOLDER = Path(__file__).parents[2] / "results"
TABLES = sorted(path.stem for path in FOLDER.glob("*.parquet"))


@pytest.mark.slow
def test_ten_random_runs_agree():
    frame = pd.concat([results.read(FOLDER / f"{name}.parquet") for name in TABLES], ignore_index=True)
    assert [found for found in verify(frame, 10, rng=2026) if not found.agrees] == []


def test_every_table_is_of_a_suite():
    assert {name.partition("@")[0] for name in TABLES} <= set(suite_names())


@pytest.mark.parametrize("name", TABLES)
def test_tables_hold_runs_of_their_suites(name):
    """What is committed belongs to the suite as it is written now, and says where it was made."""
    frame = results.read(FOLDER / f"{name}.parquet")
    suite, _, collection = name.partition("@")
    moved = {"collection": collection} if collection else {}
    known = {(c.label, json.dumps({**c.problem, **moved}, sort_keys=True)) for c in load_suite(suite).runs}
    rows = frame.drop_duplicates(["label", "problem"])
    assert {(row.label, row.problem) for row in rows.itertuples()} <= known
    assert not frame.commit.isin(["", "unknown"]).any()
    assert not frame.commit.str.endswith("+").any()  # made from a clean checkout
    assert frame.versions[frame.status == "ok"].str.contains("numpy").all()
    scalars = frame[frame.metric.notna()]
    assert scalars.unit.notna().all()
