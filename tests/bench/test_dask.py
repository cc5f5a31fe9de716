"""The same runs on a local Dask cluster of two worker processes, one of which is killed."""

import os
import signal
import threading
import time

import pytest

from bench.cache import ResultCache
from bench.runner import run_suite
from tests.bench.helpers import calls, runs, untimed

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.filterwarnings("ignore")  # of a library that is told of a death


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster


def test_a_cluster_gives_the_numbers_of_this_machine(cluster, tmp_path):
    todo = runs("trick-count", 6, log=str(tmp_path / "log"))
    there = run_suite(todo, ResultCache(tmp_path / "dask"), scheduler=cluster.scheduler_address)
    here = run_suite(todo, ResultCache(tmp_path / "local"), n_jobs=1)
    assert [record["status"] for record in there.records] == ["ok"] * 6
    assert list(map(untimed, there.records)) == list(map(untimed, here.records))


def test_a_run_that_takes_its_process_along_leaves_the_worker_alive(cluster, tmp_path):
    todo = [*runs("trick-die", 1), *runs("trick-count", 3, log=str(tmp_path / "log"))]
    outcome = run_suite(todo, ResultCache(tmp_path / "cache"), scheduler=cluster.scheduler_address)
    assert [record["status"] for record in outcome.records] == ["crashed", "ok", "ok", "ok"]


def test_a_worker_dies_and_every_run_is_done(cluster, tmp_path):
    log, cache = tmp_path / "log", ResultCache(tmp_path / "cache")
    todo = runs("trick-count", 40, log=str(log), seconds=0.1)
    with distributed.Client(cluster.scheduler_address) as client:
        victim = next(iter(client.run(os.getpid).values()))

    killed = []

    def kill():
        while len(list(cache.folder.glob("*/*.json"))) < 6:
            time.sleep(0.02)
        os.kill(victim, signal.SIGKILL)
        killed.append(len(list(cache.folder.glob("*/*.json"))))

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    outcome = run_suite(todo, cache, scheduler=cluster.scheduler_address)
    thread.join(timeout=10)
    assert killed
    assert killed[0] < 40
    assert [record["status"] for record in outcome.records] == ["ok"] * 40
    assert len(calls(log)) == 40


def test_an_unreachable_scheduler_is_named(tmp_path):
    todo = runs("trick-count", 1, log=str(tmp_path / "log"))
    with pytest.raises(ValueError, match="tcp://127.0.0.1:1 cannot be reached"):
        run_suite(todo, ResultCache(tmp_path), scheduler="tcp://127.0.0.1:1")
