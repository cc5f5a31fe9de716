"""Methods that misbehave, for the tests of the runner."""

import hashlib
import os
import time
from pathlib import Path

import numba
import numpy as np
import threadpoolctl

from bench.methods import Answer, method


def right(problem):
    return Answer.from_absolute(np.stack([np.eye(problem.n)] * problem.n_nodes))


@method("trick-count")
def count(problem, *, rng, log: str, seconds: float = 0.0):
    """Note down every call on a problem that is not the warm-up toy."""
    if problem.n_nodes > 3:
        began = time.perf_counter()
        while time.perf_counter() - began < seconds:
            sum(range(100))
        with open(log, "a") as file:
            file.write(hashlib.sha256(problem.maps.tobytes()).hexdigest() + "\n")
    return right(problem)


@method("trick-sleep")
def sleep(problem, *, rng, seconds: float = 60.0):
    """Never come back by itself, in Python."""
    began = time.perf_counter()
    while problem.n_nodes > 3 and time.perf_counter() - began < seconds:
        try:
            sum(range(1000))
        except Exception:  # a method that swallows everything must not swallow its limit
            continue
    return right(problem)


@method("trick-hog")
def hog(problem, *, rng):
    """Take eight gigabytes."""
    if problem.n_nodes > 3:
        np.ones(2**30)
    return right(problem)


@method("trick-raise")
def fail(problem, *, rng, once: str | None = None):
    """Raise; with ``once``, only until that file exists."""
    if problem.n_nodes > 3 and (once is None or not Path(once).exists()):
        raise RuntimeError("the trick failed")
    return right(problem)


@method("trick-die")
def die(problem, *, rng, once: str | None = None):
    """Take the process along; with ``once``, only the first time."""
    if problem.n_nodes > 3 and (once is None or not Path(once).exists()):
        if once is not None:
            Path(once).touch()
        os._exit(9)
    return right(problem)


@method("trick-threads")
def threads(problem, *, rng):
    """Refuse to have more than one thread of BLAS or of our own."""
    blas = [pool["num_threads"] for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"]
    assert {*blas, numba.config.NUMBA_NUM_THREADS} == {1}
    return right(problem)


@method("trick-print")
def talk(problem, *, rng):
    """Print, from Python and below it."""
    print("a word")
    os.system("echo another word")
    return right(problem)
