"""Run a cell, or some as one batch, within its limits and say honestly how it went."""

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
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache, lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numba
import numpy as np

from bench import methods
from bench.measure import measure, method_rng
from bench.planted import Planted
from bench.suites import Cell, generator_function
from data_gen.cache import arithmetic
from fmsync.problem import SyncProblem
from fmsync.threads import single_threaded_blas

CONTENT = ("generator", "problem", "seed", "method", "options", "code", "data")  # what determines a record
_SPENT = ("seconds", "cpu_seconds", "peak_memory")
_GRACE = 30.0  # seconds that a call which ignores its limit still gets before its process is ended
_STATUS, _SIZES = Path("/proc/self/status"), Path("/proc/self/statm")
_SOFT, _HARD = resource.getrlimit(resource.RLIMIT_AS)  # what the process was given
_ROUNDING = 1e-13  # maps and bases of shapes differ by up to 4e-13 between two kinds of arithmetic
_VERSIONS = ("fmsync", "numpy", "scipy", "numba", "pymanopt", "geomstats", "pyfmaps")


class CellTimeoutError(BaseException):
    """Thrown into a cell at its limit; not an ``Exception``, so that no method swallows it."""


def run_cell(cell: Cell, commit: str = "unknown", *, replica: int = 0) -> dict:
    """Make the problem, run the method, measure the answer.

    Parameters
    ----------
    cell
        The method, the problem and the limits.
    commit
        Is written into the record.
    replica
        0 for the run that belongs into a table. Replica k >= 1 is one more run on the same problem, which shows how
        much the answer varies: a sampler draws other random numbers; any other method keeps its random numbers and
        gets observed maps, and bases of shapes, whose entries are moved by about 1e-13, as if they had been computed
        in another arithmetic.

    Returns
    -------
    dict
        Plain JSON values: ``status`` "ok", "timeout", "memory" or "error" (with ``traceback``), ``metrics`` as rows
        (name, at, value), seconds, CPU seconds, peak memory in MB above the process's own, machine, versions,
        arithmetic, commit.
    """
    return _run((cell,), commit, replica)[0]


def run_together(cells: Sequence[Cell], commit: str = "unknown") -> list[dict]:
    """Records of cells that differ in their seed alone, run as one batch; where that fails, of each run by itself.

    Seconds and memory of a cell are then its share of the batch's, and the metric ``at_once`` says of how many. The
    batch may take as long as all its cells, and as much memory as one.
    """
    records = _run(cells, commit)
    if len(cells) > 1 and any(record["status"] != "ok" for record in records):
        return [run_cell(cell, commit) for cell in cells]
    return records


def _run(cells: Sequence[Cell], commit: str, replica: int = 0) -> list[dict]:
    first, count = cells[0], len(cells)
    outcome: dict = {"status": "ok"}
    answered: list[list] = [[] for _ in cells]
    began = time.perf_counter()
    try:
        if first.file is not None:
            _load(first.file)
        else:
            importlib.import_module(first.module)
        method = methods.get(first.method)
        with warnings.catch_warnings(record=True) as caught, _one_thread():
            warnings.simplefilter("always")
            problems = [_problem(c.generator, _frozen(c.problem), c.seed, c.content["data"]) for c in cells]
            rngs = [method_rng(cell.seed) for cell in cells]
            if replica:
                problems[0], rngs[0] = _replicated(problems[0], first.seed, method.kind, replica)
            _warm(method, first.options)
            before = _reset_peak()
            began, cpu = time.perf_counter(), time.process_time()
            with _limited(first.seconds * count, first.memory):
                if count == 1:
                    answers = [method.run(problems[0], rngs[0], first.options)]
                else:
                    answers = method.run_together(problems, rngs, first.options)
            if replica and method.kind == "sampler":
                answers = [replace(answers[0], numbers=dict)]  # effective draws a second: slow, and not compared
            spent = (time.perf_counter() - began, time.process_time() - cpu, max(0.0, _peak() - before))
            rows = [[name, None, value / count] for name, value in zip(_SPENT, spent)]
            rows += [["at_once", None, float(count)]] if count > 1 else []
            answered = [rows + measure(problem, answer) for problem, answer in zip(problems, answers)]
        outcome["warnings"] = sorted({str(warning.message) for warning in caught})
    except CellTimeoutError:
        outcome |= {"status": "timeout", "traceback": f"more than {first.seconds:g} s"}
    except MemoryError:
        outcome |= {"status": "memory", "traceback": f"more than {first.memory:g} MB\n{traceback.format_exc()}"}
    except Exception:
        outcome |= {"status": "error", "traceback": traceback.format_exc()}
    return [
        {
            **{name: cell.content[name] for name in CONTENT},
            "label": cell.label,
            "commit": commit,
            "machine": machine(),
            "versions": versions(),
            "arithmetic": arithmetic(),
            **outcome,
            "metrics": metrics,
            "wall": (time.perf_counter() - began) / count,
        }
        for cell, metrics in zip(cells, answered)
    ]


def _replicated(planted: Planted, seed: int, kind: str, replica: int) -> tuple[Planted, np.random.Generator]:
    """Problem and generator of a replica; the generator of replica 0 is not drawn from."""
    other = method_rng(seed).spawn(replica)[-1]
    if kind == "sampler":
        return planted, other
    maps = _rounded_otherwise(planted.problem.maps, other)
    bases = [replace(b, eigenfunctions=_rounded_otherwise(b.eigenfunctions, other)) for b in planted.bases]
    return replace(planted, problem=replace(planted.problem, maps=maps), bases=tuple(bases)), method_rng(seed)


def _rounded_otherwise(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return values + _ROUNDING * rng.standard_normal(values.shape)


@cache
def _load(file: str) -> None:
    methods.load(file)


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
    try:
        size = int(_SIZES.read_text().split()[0]) * resource.getpagesize()
    except OSError:
        yield
        return
    wanted = int(size + megabytes * 2**20)
    soft = min((wanted, _SOFT, _HARD), key=lambda limit: np.inf if limit == resource.RLIM_INFINITY else limit)
    resource.setrlimit(resource.RLIMIT_AS, (soft, _HARD))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (_SOFT, _HARD))


def _reset_peak() -> float:
    """Forget the peak of this process so far, and give its present size in MB."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return _peak()


def _peak() -> float:
    with contextlib.suppress(OSError):
        if match := re.search(r"VmHWM:\s+(\d+) kB", _STATUS.read_text()):
            return int(match[1]) / 1024
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
