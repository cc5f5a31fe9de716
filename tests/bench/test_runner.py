"""The runner: nothing twice, nothing lost, whoever dies."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import pytest

from bench import runner
from bench.cache import ResultCache
from bench.runner import record_of, run_suite
from tests.bench.helpers import TRICKS, calls, runs, untimed


def test_every_run_once_and_never_again(tmp_path):
    log, cache = tmp_path / "log", ResultCache(tmp_path / "cache")
    todo = runs("trick-count", 6, log=str(log))
    seen = []
    outcome = run_suite(todo, cache, on_record=lambda run, record: seen.append(run.seed))
    assert sorted(seen) == list(range(6))
    assert [record["seed"] for record in outcome.records] == list(range(6))
    again = run_suite(todo, cache)
    assert again.n_cached == 6
    assert [record["metrics"] for record in again.records] == [record["metrics"] for record in outcome.records]
    assert set(calls(log).values()) == {1}
    assert len(calls(log)) == 6


def test_jobs_do_not_change_the_numbers(tmp_path):
    one, two = (
        run_suite(runs("spectral", 4), ResultCache(tmp_path / str(jobs)), n_jobs=jobs).records for jobs in (1, 2)
    )
    assert list(map(untimed, one)) == list(map(untimed, two))


def test_two_names_of_one_run_are_one_run(tmp_path):
    log = tmp_path / "log"
    (run,) = runs("trick-count", 1, log=str(log))
    outcome = run_suite([run, replace(run, label="other")], ResultCache(tmp_path / "cache"))
    assert [record["label"] for record in outcome.records] == ["trick-count", "other"]
    assert sum(calls(log).values()) == 1


def test_a_damaged_record_is_reported_and_its_run_repeated(tmp_path):
    log, cache = tmp_path / "log", ResultCache(tmp_path / "cache")
    todo = runs("trick-count", 3, log=str(log))
    run_suite(todo, cache)
    cache.path(todo[1].key).write_text("{")
    outcome = run_suite(todo, cache)
    assert len(outcome.corrupt) == 1
    assert todo[1].key in outcome.corrupt[0]
    assert outcome.n_cached == 2
    assert sorted(calls(log).values()) == [1, 1, 2]


def test_failures_are_kept_apart_and_tried_again(tmp_path):
    flag, cache = tmp_path / "flag", ResultCache(tmp_path / "cache")
    todo = runs("trick-raise", 2, once=str(flag)) + runs("mle", 1)
    outcome = run_suite(todo, cache)
    assert [record["status"] for record in outcome.records] == ["error", "error", "ok"]
    assert "the trick failed" in cache.read(todo[0].key, "failed")["traceback"]
    flag.touch()
    outcome = run_suite(todo, cache)
    assert outcome.n_cached == 1
    assert [record["status"] for record in outcome.records] == ["ok"] * 3
    assert cache.read(todo[0].key, "failed") is None


def test_a_run_that_takes_its_process_along_does_not_stop_the_others(tmp_path):
    log, cache = tmp_path / "log", ResultCache(tmp_path / "cache")
    todo = [
        *runs("trick-count", 5, log=str(log)),
        *runs("trick-die", 1),
        *runs("trick-die", 1, once=str(tmp_path / "x")),
    ]
    outcome = run_suite(todo, cache)
    assert [record["status"] for record in outcome.records] == ["ok"] * 5 + ["crashed"] * 2
    assert "died" in outcome.records[5]["traceback"]
    assert len(calls(log)) == 5
    again = run_suite(todo, cache)
    assert [record["status"] for record in again.records] == ["ok"] * 5 + ["crashed", "ok"]
    assert set(calls(log).values()) == {1}


def test_a_slow_run_does_not_stop_the_others(tmp_path):
    slow = [replace(run, seconds=0.5) for run in runs("trick-sleep", 2)]
    outcome = run_suite([*slow, *runs("identity", 2)], ResultCache(tmp_path / "cache"))
    assert [record["status"] for record in outcome.records] == ["timeout"] * 2 + ["ok"] * 2


def test_source_that_was_edited_meanwhile_gives_no_result(tmp_path, monkeypatch):
    monkeypatch.setattr("bench.suites.code_hash", lambda *modules: "as it was")
    (todo,) = runs("identity", 1)
    cache = ResultCache(tmp_path / "cache")
    (record,) = run_suite([todo], cache).records
    assert record["status"] == "error"
    assert "edited" in record["traceback"]
    assert cache.read(todo.key) is None


def test_a_full_disk_stops_clearly_and_loses_nothing(tmp_path, monkeypatch):
    cache, todo = ResultCache(tmp_path / "cache"), runs("identity", 4)
    write = ResultCache.write

    def full(self, key, record):
        if key == todo[3].key:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(self, key, record)

    monkeypatch.setattr(ResultCache, "write", full)
    monkeypatch.setattr(runner, "isolated", lambda run, commit: record_of(run, commit, status="ok", wall=0.0))
    with pytest.raises(ValueError, match="No space left.*make room and run again"):
        run_suite(todo, cache, n_jobs=1)
    kept = [cache.read(run.key) for run in todo]
    assert kept[3] is None
    monkeypatch.setattr(ResultCache, "write", write)
    outcome = run_suite(todo, cache)
    assert outcome.n_cached == sum(record is not None for record in kept)
    assert [record["status"] for record in outcome.records] == ["ok"] * 4


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="--cache"):
        run_suite(runs("identity", 1), ResultCache(tmp_path / "file" / "cache"))


def test_n_jobs_are_positive(tmp_path):
    with pytest.raises(ValueError, match="n_jobs"):
        run_suite([], ResultCache(tmp_path), n_jobs=0)


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
def test_sigkill_loses_and_repeats_no_finished_run(tmp_path, after):
    log, folder = tmp_path / "log", tmp_path / "cache"
    suite = tmp_path / "killed.toml"
    suite.write_text(SUITE.format(log=json.dumps(str(log))))
    command = [sys.executable, "-m", "bench", "run", str(suite), "--with", TRICKS, "--cache", str(folder)]
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
