"""The same cells on a local Dask cluster of two worker processes, one of which is killed."""

import os
import signal
import threading
import time
from collections import Counter
from pathlib import Path

import pytest

from bench import methods
from bench.runner import RunError, run_cells
from bench.store import Store
from bench.suites import Cell

distributed = pytest.importorskip("distributed")
TRICKS = str(Path(__file__).with_name("tricks.py"))
methods.load(TRICKS)
pytestmark = pytest.mark.filterwarnings("ignore")  # of a library that is told of a death


def cells(count, log, seconds):
    problem, options = {"n_nodes": 4, "n": 3, "sigma2": 0.1}, {"log": str(log), "seconds": seconds}
    generator = "bench.problems:rotations"
    return [Cell(generator, problem, k, "c", "trick-count", options, file=TRICKS) for k in range(count)]


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster


def test_a_cluster_gives_the_numbers_of_this_machine(cluster, tmp_path):
    todo = cells(6, tmp_path / "log", 0.0)
    there = run_cells(todo, Store(tmp_path / "dask"), scheduler=cluster.scheduler_address)
    here = run_cells(todo, Store(tmp_path / "loky"), n_jobs=1)
    timing = {"seconds", "cpu_seconds", "peak_memory"}

    def numbers(run):
        return [[row for row in record["metrics"] if row[0] not in timing] for record in run.records]

    assert [record["status"] for record in there.records] == ["ok"] * 6
    assert numbers(there) == numbers(here)


def test_a_worker_dies_and_every_cell_is_done(cluster, tmp_path):
    log, store = tmp_path / "log", Store(tmp_path / "store")
    todo = cells(40, log, 0.1)
    with distributed.Client(cluster.scheduler_address) as client:
        victim = next(iter(client.run(os.getpid).values()))

    killed = []

    def kill():
        while len(list(store.folder.glob("*/*.json"))) < 6:
            time.sleep(0.02)
        os.kill(victim, signal.SIGKILL)
        killed.append(len(list(store.folder.glob("*/*.json"))))

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    run = run_cells(todo, store, scheduler=cluster.scheduler_address)
    thread.join(timeout=10)
    assert killed
    assert killed[0] < 40
    assert [record["status"] for record in run.records] == ["ok"] * 40
    assert len(Counter(log.read_text().split())) == 40


def test_an_unreachable_scheduler_is_named(tmp_path):
    with pytest.raises(RunError, match="tcp://127.0.0.1:1 cannot be reached"):
        run_cells(cells(1, tmp_path / "log", 0.0), Store(tmp_path), scheduler="tcp://127.0.0.1:1")
