"""The runner: nothing twice, nothing lost, whoever dies."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from bench import methods, runner
from bench.runner import RunError, run_cells
from bench.store import Store
from bench.suites import Cell

TRICKS = str(Path(__file__).with_name("tricks.py"))
methods.load(TRICKS)


def cells(method, count, **options):
    problem = {"n_nodes": 4, "n": 3, "sigma2": 0.1}
    return [
        Cell("bench.problems:rotations", problem, seed, method, method, options, file=TRICKS) for seed in range(count)
    ]


def calls(log):
    return Counter(log.read_text().split()) if log.exists() else Counter()


def test_every_cell_once_and_never_again(tmp_path):
    log, store = tmp_path / "log", Store(tmp_path / "store")
    todo = cells("trick-count", 6, log=str(log))
    seen = []
    run = run_cells(todo, store, on_record=lambda cell, record: seen.append(cell.seed))
    assert sorted(seen) == list(range(6))
    assert [record["seed"] for record in run.records] == list(range(6))
    again = run_cells(todo, store)
    assert again.n_cached == 6
    assert [record["metrics"] for record in again.records] == [record["metrics"] for record in run.records]
    assert set(calls(log).values()) == {1}
    assert len(calls(log)) == 6


def test_jobs_do_not_change_the_numbers(tmp_path):
    todo = cells("spectral", 4)
    edge = [
        [
            dict((row[0], row[2]) for row in record["metrics"])["edge_error"]
            for record in run_cells(todo, Store(tmp_path / str(jobs)), n_jobs=jobs).records
        ]
        for jobs in (1, 2)
    ]
    assert edge[0] == edge[1]


def test_chains_of_all_seeds_are_one_batch_where_that_is_allowed(tmp_path):
    one = {"n_chains": 1, "n_draws": 40, "warmup": 20}
    chains, several = cells("rlfm", 3, **one), cells("rlfm", 2, **{**one, "n_chains": 2})
    todo = [replace(c, together=True) for c in [*chains, *several, *cells("mle", 2)]]
    assert [len(batch) for batch in runner._batches(todo)] == [3, 1, 1, 1, 1]
    assert [len(batch) for batch in runner._batches(chains)] == [1, 1, 1]
    together = run_cells(todo, Store(tmp_path / "together"))
    assert [dict((m, v) for m, _, v in r["metrics"]).get("at_once") for r in together.records] == [3] * 3 + [None] * 4
    assert run_cells(todo, Store(tmp_path / "together")).n_cached == len(todo)
    alone = run_cells(chains, Store(tmp_path / "alone"))
    for a, b in zip(together.records, alone.records):
        error = [dict((m, v) for m, _, v in record["metrics"])["edge_error"] for record in (a, b)]
        assert error[0] == error[1]


def test_a_batch_whose_process_dies_is_tried_cell_by_cell(tmp_path, monkeypatch):
    """Marks of all its cells are found, and each gets a process of its own."""
    store = Store(tmp_path / "store")
    todo = [replace(c, together=True) for c in cells("rlfm", 2, n_chains=1, n_draws=40, warmup=20)]

    class Dying(runner._Local):
        def run(self, batches, folder, commit):
            for cell in batches[0]:
                store.mark_started(cell.key)
            raise runner.BrokenProcessPool

    monkeypatch.setattr(runner, "_Local", Dying)
    run = run_cells(todo, store, n_jobs=1)
    assert [record["status"] for record in run.records] == ["ok", "ok"]
    assert all("at_once" not in {name for name, _, _ in record["metrics"]} for record in run.records)


def test_a_damaged_cell_is_reported_and_computed_again(tmp_path):
    log, store = tmp_path / "log", Store(tmp_path / "store")
    todo = cells("trick-count", 3, log=str(log))
    run_cells(todo, store)
    store.path(todo[1].key).write_text("{")
    run = run_cells(todo, store)
    assert len(run.corrupt) == 1
    assert todo[1].key in run.corrupt[0]
    assert run.n_cached == 2
    assert sorted(calls(log).values()) == [1, 1, 2]


def test_failures_are_kept_apart_and_tried_again(tmp_path):
    flag, store = tmp_path / "flag", Store(tmp_path / "store")
    todo = cells("trick-raise", 2, once=str(flag)) + cells("mle", 1)
    run = run_cells(todo, store)
    assert [record["status"] for record in run.records] == ["error", "error", "ok"]
    assert "the trick failed" in store.failure(todo[0].key)["traceback"]
    flag.touch()
    run = run_cells(todo, store)
    assert run.n_cached == 1
    assert [record["status"] for record in run.records] == ["ok"] * 3
    assert store.failure(todo[0].key) is None


def test_a_cell_that_takes_its_process_along_does_not_stop_the_others(tmp_path):
    log = tmp_path / "log"
    todo = (
        cells("trick-count", 5, log=str(log)) + cells("trick-die", 1) + cells("trick-die", 1, once=str(tmp_path / "x"))
    )
    run = run_cells(todo, Store(tmp_path / "store"))
    assert [record["status"] for record in run.records] == ["ok"] * 5 + ["crashed", "ok"]
    assert "died" in run.records[5]["traceback"]
    assert len(calls(log)) == 5


def test_a_full_disk_stops_clearly_and_loses_nothing(tmp_path, monkeypatch):
    store = Store(tmp_path / "store")
    todo = cells("identity", 4)
    run_cells(todo[:2], store)
    write, record = Store.write, {"status": "ok", "wall": 0.0, "metrics": []}

    class OnePool:  # runs here, so that the disk can be made full
        crashes = ()

        def __enter__(self):
            return self

        def __exit__(self, *error):
            return None

        def run(self, batches, folder, commit):
            for (cell,) in batches:
                yield [(cell.key, dict(record))]

    def full(self, key, record):
        if key == todo[3].key:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(self, key, record)

    monkeypatch.setattr(Store, "write", full)
    monkeypatch.setattr(runner, "_pool", lambda n_jobs, scheduler: OnePool())
    with pytest.raises(RunError, match="No space left.*make room and run again"):
        run_cells(todo, store)
    assert [store.read(cell.key) is not None for cell in todo] == [True, True, True, False]


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match="--store"):
        run_cells(cells("identity", 1), Store(tmp_path / "file" / "store"))


def test_n_jobs_are_positive(tmp_path):
    with pytest.raises(ValueError, match="n_jobs"):
        run_cells([], Store(tmp_path), n_jobs=0)


SUITE = """description = "to be killed"
seeds = 60
[method.slow]
use = "trick-count"
log = {log}
seconds = 0.05
[[grid]]
generator = "bench.problems:rotations"
problem = {{ n_nodes = 4, n = 3, sigma2 = 0.1 }}
methods = ["slow"]
"""


@pytest.mark.parametrize("after", [5, pytest.param(25, marks=pytest.mark.slow)])
def test_sigkill_loses_and_repeats_no_finished_cell(tmp_path, after):
    log, folder = tmp_path / "log", tmp_path / "store"
    suite = tmp_path / "killed.toml"
    suite.write_text(SUITE.format(log=json.dumps(str(log))))
    command = [sys.executable, "-m", "bench", "run", str(suite), "--with", TRICKS, "--store", str(folder)]
    command += ["--jobs", "2", "--results", str(tmp_path / "results"), "--only", "^slow "]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    deadline = time.monotonic() + 100
    while len(list(folder.glob("*/*.json"))) < after and time.monotonic() < deadline:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGKILL)  # runner and workers at once
    process.wait()
    finished = {path.stem for path in folder.glob("*/*.json")}
    started = calls(log)
    assert after <= len(finished) < 60
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"({len(finished)} of them before)" in done.stdout
    times = calls(log)
    assert len(times) == 60
    assert len([name for name, count in times.items() if count > 1]) <= len(started) - len(finished)
    assert max(times.values()) <= 2
