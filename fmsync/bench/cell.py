"""Run one cell within its limits and say honestly how it went."""

import contextlib
import ctypes
import importlib
import multiprocessing
import os
import platform
import queue
import re
import resource
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Iterator
from functools import cache, lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numba
import numpy as np

from fmsync._threads import single_threaded_blas
from fmsync.bench import methods
from fmsync.bench.measure import measure, method_rng
from fmsync.bench.planted import Planted
from fmsync.bench.suites import Cell, generator_function
from fmsync.problem import SyncProblem

CONTENT = ("generator", "problem", "seed", "method", "options", "code", "data")  # what determines a record
_GRACE = 30.0  # seconds that a call which ignores its limit still gets before its process is ended
_STATUS = Path("/proc/self/status")
_SOFT, _HARD = resource.getrlimit(resource.RLIMIT_AS)  # what the process was given
_VERSIONS = ("fmsync", "numpy", "scipy", "numba", "pymanopt", "geomstats", "pyfmaps")


class CellTimeoutError(BaseException):
    """Thrown into a cell at its limit; not an ``Exception``, so that no method swallows it."""


def run_cell(cell: Cell, commit: str = "unknown") -> dict:
    """Make the problem, run the method, measure the answer.

    Returns
    -------
    dict
        Plain JSON values: ``status`` "ok", "timeout", "memory" or "error" (with ``traceback``), ``metrics`` as rows
        (name, at, value), seconds, CPU seconds, peak memory in MB above the process's own, machine, versions, commit.
    """
    record: dict = {
        **{name: cell.content[name] for name in CONTENT},
        "label": cell.label,
        "commit": commit,
        "machine": machine(),
        "versions": versions(),
        "status": "ok",
        "metrics": [],
    }
    began = time.perf_counter()
    try:
        if cell.file is not None:
            methods.load(cell.file)
        else:
            importlib.import_module(cell.module)
        method = methods.get(cell.method)
        with warnings.catch_warnings(record=True) as caught, _one_thread():
            warnings.simplefilter("always")
            problem = _problem(cell.generator, _frozen(cell.problem), cell.seed, cell.content["data"])
            _warm(method, cell.options)
            before = _reset_peak()
            began, cpu = time.perf_counter(), time.process_time()
            with _limited(cell.seconds, cell.memory):
                answer = method.run(problem, method_rng(cell.seed), cell.options)
            spent = (time.perf_counter() - began, time.process_time() - cpu, max(0.0, _peak() - before))
            measured = measure(problem, answer)
        rows = [("seconds", spent[0]), ("cpu_seconds", spent[1]), ("peak_memory", spent[2])]
        record["metrics"] = [[name, None, float(value)] for name, value in rows] + measured
        record["warnings"] = sorted({str(warning.message) for warning in caught})
    except CellTimeoutError:
        record |= {"status": "timeout", "traceback": f"more than {cell.seconds:g} s"}
    except MemoryError:
        record |= {"status": "memory", "traceback": f"more than {cell.memory:g} MB\n{traceback.format_exc()}"}
    except Exception:
        record |= {"status": "error", "traceback": traceback.format_exc()}
    record["wall"] = time.perf_counter() - began
    return record


@lru_cache(maxsize=2)
def _problem(generator: str, problem: tuple, seed: int, data: str) -> Planted:
    """Kept, since all methods meet it; ``data``, which the generator reads by itself, tells changed files apart."""
    return generator_function(generator)(seed=seed, **dict(problem))


def _frozen(problem) -> tuple:
    return tuple(problem.items())


_WARMED: set[str] = set()


def _warm(method: methods.Method, options) -> None:
    """Compile and import what the method needs on a toy, so that its first cell does not pay for it."""
    name = f"{method.name} {options}"
    if name in _WARMED:
        return
    _WARMED.add(name)
    eye = np.broadcast_to(np.eye(4), (3, 4, 4))
    toy = Planted(SyncProblem(3, [[0, 1], [1, 2], [0, 2]], eye), eye)
    quick = {"n_draws": 20, "warmup": 10, "thin": 1} if method.kind == "sampler" else {}
    with contextlib.suppress(Exception):  # what is wrong will show on the real problem
        method.run(toy, np.random.default_rng(0), {**options, **quick})


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """One thread for BLAS, and one for samplers that share their work out: other cells want the other cores."""
    many, numba.config.NUMBA_NUM_THREADS = numba.config.NUMBA_NUM_THREADS, 1
    try:
        with single_threaded_blas():
            yield
    finally:
        numba.config.NUMBA_NUM_THREADS = many


@contextlib.contextmanager
def _limited(seconds: float, memory: float) -> Iterator[None]:
    """Throw into this thread after some seconds; let no allocation take more than some MB."""
    with _watcher().watching(seconds), _address_space(memory):
        yield


class _Watcher:
    """A thread beside another one, whose limits it keeps cell after cell: to start one for every cell takes longer."""

    def __init__(self):
        self._watched, self._limits = threading.get_ident(), queue.SimpleQueue()
        threading.Thread(target=self._watch, daemon=True).start()

    @contextlib.contextmanager
    def watching(self, seconds: float) -> Iterator[None]:
        finished, lock = threading.Event(), threading.Lock()
        self._limits.put((seconds, finished, lock))
        try:
            yield
        finally:
            with lock:
                finished.set()

    def _watch(self) -> None:
        while True:
            seconds, finished, lock = self._limits.get()
            if finished.wait(seconds):
                continue
            with lock:
                if finished.is_set():
                    continue
                throw = ctypes.pythonapi.PyThreadState_SetAsyncExc
                throw(ctypes.c_ulong(self._watched), ctypes.py_object(CellTimeoutError))
            if not finished.wait(_GRACE) and multiprocessing.parent_process() is not None:
                os._exit(1)  # a compiled call that never comes back: the runner notes a crash


_WATCHERS = threading.local()


def _watcher() -> _Watcher:
    if not hasattr(_WATCHERS, "own"):
        _WATCHERS.own = _Watcher()
    return _WATCHERS.own


@contextlib.contextmanager
def _address_space(megabytes: float) -> Iterator[None]:
    """Let the process grow by this much and no more, where the system can say how large it is."""
    size = _status("VmSize")
    if size is None:
        yield
        return
    wanted = int((size + megabytes) * 2**20)
    soft = min((wanted, _SOFT, _HARD), key=lambda limit: np.inf if limit == resource.RLIM_INFINITY else limit)
    resource.setrlimit(resource.RLIMIT_AS, (soft, _HARD))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (_SOFT, _HARD))


def _status(name: str) -> float | None:
    """A size of this process in MB, or None where the system does not tell."""
    try:
        match = re.search(rf"{name}:\s+(\d+) kB", _STATUS.read_text())
    except OSError:
        return None
    return int(match[1]) / 1024 if match else None


def _reset_peak() -> float:
    """Forget the peak of this process so far, and give its present size in MB."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return _peak()


def _peak() -> float:
    peak = _status("VmHWM")
    if peak is not None:
        return peak
    unit = 2**20 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


@cache
def machine() -> str:
    """Processor, cores and system."""
    names = re.findall(r"model name\s*:\s*(.+)", Path("/proc/cpuinfo").read_text()) if _STATUS.exists() else []
    return f"{names[0] if names else platform.processor()}, {os.cpu_count()} cores, {platform.system()}"


@cache
def versions() -> str:
    """Python and the libraries that results depend on."""
    found = [f"python {platform.python_version()}"]
    for name in _VERSIONS:
        with contextlib.suppress(PackageNotFoundError):
            found.append(f"{name} {version(name)}")
    return ", ".join(found)
