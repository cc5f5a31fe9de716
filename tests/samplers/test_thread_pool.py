"""Parts of one piece of work: the same draws however many threads there are, and Ctrl-C."""

import gc
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
import pytest
from joblib import Parallel, delayed

import data_gen
import fmsync
from fmsync import so
from fmsync.samplers.thread_pool import ThreadPool
from tests.samplers.helpers import noisy


@pytest.mark.parametrize(
    ("n_nodes", "n_chains", "options"),
    [
        (24, 4, {"kappa": 5.0}),
        (24, 4, {"likelihood": "projected-gaussian"}),
        (400, 1, {"kappa": 5.0}),
        (400, 1, {"kappa": "auto"}),
    ],
)
def test_draws_do_not_depend_on_the_number_of_threads(monkeypatch, n_nodes, n_chains, options):
    """Chains side by side in the first two, nodes of one colour in the others."""
    n = 20 if n_nodes < 100 else 8
    graph = data_gen.random_graph(n_nodes, 0.5 if n_nodes < 100 else 0.02, rng=0)
    p = data_gen.perturb(data_gen.planted(n_nodes, n, graph, rng=0), 0.1, 1)
    start, shares = so.random_uniform(n, (n_chains, n_nodes), rng=2), []
    plain = ThreadPool.parallel_for

    def counted(pool, work, count):
        shares.append((pool.size, count))
        plain(pool, work, count)

    monkeypatch.setattr(ThreadPool, "parallel_for", counted)
    draws = []
    for threads in (1, 3):
        monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", threads)
        draws.append(
            fmsync.sample(p, "heat-bath", init=start, n_chains=n_chains, n_draws=4, warmup=0, rng=3, **options)
        )
    np.testing.assert_array_equal(draws[0].absolute, draws[1].absolute)
    np.testing.assert_array_equal(draws[0].energy, draws[1].energy)
    np.testing.assert_array_equal(draws[0].kappa, draws[1].kappa)
    shared = [count for size, count in shares if size == 3]
    assert max(shared) == n_chains if n_chains > 1 else max(shared) > 12


def test_ctrl_c_in_a_shared_step_waits_for_the_other_thread(monkeypatch):
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 2)
    finished = []

    def work(first, last):
        if first == 0:  # in the thread of the caller, the one that Ctrl-C interrupts
            raise KeyboardInterrupt
        time.sleep(0.2)
        finished.append(last)

    with pytest.raises(KeyboardInterrupt):
        ThreadPool().parallel_for(work, 10)
    assert finished == [10]


def test_ctrl_c_while_the_caller_waits_waits_for_the_other_thread(monkeypatch):
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 2)
    finished = []

    def work(first, last):
        if first:
            signal.raise_signal(signal.SIGINT)  # the thread of the caller hears it, in its wait
            time.sleep(0.2)
            finished.append(last)

    gc.disable()  # what is raised in a callback of the collector, such as hypothesis has, is lost
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore Ctrl-C
    try:
        with pytest.raises(KeyboardInterrupt):
            ThreadPool().parallel_for(work, 10)
    finally:
        signal.signal(signal.SIGINT, handler)
        gc.enable()
    assert finished == [10]


def test_an_error_in_another_thread_is_the_callers(monkeypatch):
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 2)

    def work(first, last):
        if first:
            raise ZeroDivisionError("here")

    others, pool = set(threading.enumerate()), ThreadPool()
    with pytest.raises(ZeroDivisionError, match="here"):
        pool.parallel_for(work, 10)
    (own,) = set(threading.enumerate()) - others
    del pool
    gc.collect()  # the error knows where it was raised
    own.join(timeout=10)
    assert not own.is_alive()  # threads end with the pool


def test_ctrl_c_in_a_shared_step_returns_the_draws_so_far(monkeypatch):
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 2)
    p = data_gen.perturb(data_gen.planted(24, 20, rng=0), 0.1, 1)
    options = {"kappa": 5.0, "n_chains": 4, "n_draws": 60, "warmup": 0, "rng": 3, "init": "random"}
    whole, calls, plain = fmsync.sample(p, "heat-bath", **options), [], ThreadPool.parallel_for

    def interrupted(pool, work, count):
        calls.append(count)
        plain(pool, work, count)
        if len(calls) == 4:
            raise KeyboardInterrupt

    monkeypatch.setattr(ThreadPool, "parallel_for", interrupted)
    post = fmsync.sample(p, "heat-bath", **options)
    assert post.interrupted
    np.testing.assert_array_equal(post.absolute, whole.absolute[:, :30])  # ten steps are shared out at once


RUN = {"kappa": 5.0, "n_chains": 4, "n_draws": 3, "warmup": 0}


def test_two_runs_at_once_do_not_meet():
    p = noisy(24, 20)
    with ThreadPoolExecutor(2) as callers:
        together = list(callers.map(lambda k: _absolute(p, k, RUN), range(2)))
    for k in range(2):
        np.testing.assert_array_equal(together[k], _absolute(p, k, RUN))


@pytest.mark.slow  # the workers import everything anew
def test_joblib_workers_make_the_same_draws():
    p = noisy(24, 20)
    for k, apart in enumerate(Parallel(n_jobs=2)(delayed(_absolute)(p, k, RUN) for k in range(2))):
        np.testing.assert_array_equal(apart, _absolute(p, k, RUN))


def _absolute(problem, seed, run):
    return fmsync.sample(problem, "heat-bath", rng=seed, **run).absolute
