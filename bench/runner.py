"""Execute the runs of a suite side by side, on this machine or on a Dask cluster, and never twice.

Each run has its limits, in a worker process; how it went is recorded.
"""

import contextlib
import importlib
import json
import os
import pickle
import re
import resource
import signal
import subprocess
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

from bench import methods
from bench.cache import HASHES, ResultCache
from bench.metrics import measure, method_rng
from bench.problems import Planted
from bench.provenance import current_commit, machine, versions
from bench.suites import Run, generator_function
from data_gen.cache import arithmetic
from fmsync.extras import require
from fmsync.memory import give_back
from fmsync.problem import SyncProblem
from fmsync.threads import single_threaded_blas

_ROUNDING = 1e-13  # maps and bases of shapes differ by up to 4e-13 between two kinds of arithmetic
_SERVE = [sys.executable, "-c", "from bench.runner import serve; serve()"]
_ENVIRONMENT = {"TQDM_DISABLE": "1", "NUMBA_NUM_THREADS": "1"}  # other runs want the other cores
_WORKERS: set[subprocess.Popen] = set()  # all of this process ...
_IDLE: list[subprocess.Popen] = []  # ... and those without a run


@dataclass(frozen=True)
class Outcome:
    """What came of a suite."""

    records: tuple[dict, ...]  # one for every run, in their order, failures included
    n_cached: int  # runs that were finished before
    corrupt: tuple[str, ...]  # messages about damaged records, whose runs were repeated


def run_suite(
    runs: Sequence[Run],
    cache: ResultCache,
    *,
    n_jobs: int = 2,
    scheduler: str | None = None,
    on_record: Callable[[Run, dict], None] = lambda run, record: None,
    on_start: Callable[[int, int], None] = lambda n_cached, n_left: None,
) -> Outcome:
    """Execute all runs that are not in the cache; each is written there as it ends.

    ``n_jobs`` at a time on this machine, each with one BLAS thread, or on the Dask cluster whose ``scheduler`` has this
    address: runs of a worker that dies are given to another one. ``on_record`` is told of every run as it ends,
    ``on_start`` first of how many were found and are left. A ValueError on a full disk or without the scheduler.
    """
    if n_jobs < 1:
        raise ValueError(f"n_jobs: need at least one process, got {n_jobs}")
    try:
        cache.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"{cache.folder}: cannot be made ({error}); name another folder with --cache") from error
    done, corrupt, waiting = {}, {}, {}
    for run in runs:
        try:
            done[run.key] = cache.read(run.key)
        except ValueError as error:
            corrupt[run.key] = str(error)
        if done.get(run.key) is None:
            waiting[run.key] = run
    n_cached = len(done.keys() - waiting.keys())
    on_start(n_cached, len(waiting))
    commit = current_commit()
    with _executor(n_jobs, scheduler) if waiting else contextlib.nullcontext() as executor:
        futures = {executor.submit(isolated, run, commit): run for run in waiting.values()}
        try:
            for future in as_completed(futures):
                run = futures[future]
                done[run.key] = _record(future, run, commit)
                try:
                    cache.write(run.key, done[run.key])
                except OSError as error:
                    message = f"{cache.folder}: cannot write ({error}); finished runs are kept, make room and run again"
                    raise ValueError(message) from error
                on_record(run, done[run.key])
        except BaseException:
            for future in futures:
                future.cancel()
            end_workers()
            raise
    return Outcome(tuple({**done[run.key], "label": run.label} for run in runs), n_cached, tuple(corrupt.values()))


def _record(future, run: Run, commit: str) -> dict:
    try:
        record = future.result()
    except Exception as error:  # of a cluster that lost several workers on this run
        return record_of(run, commit, status="crashed", traceback=f"{type(error).__name__}: {error}", wall=0.0)
    if record["code"] != run.code:
        why = "the source was edited after this command, or the Dask worker, had started; start it again"
        return record_of(run, commit, status="error", traceback=why, wall=record["wall"])
    return record


@contextlib.contextmanager
def _executor(n_jobs: int, scheduler: str | None) -> Iterator[Executor]:
    """Threads, each of which has a worker process, or the threads of Dask's workers, which do the same."""
    if scheduler is None:
        with ThreadPoolExecutor(n_jobs) as executor:
            yield executor
        return
    distributed = require("distributed", "bench")
    try:
        client = distributed.Client(scheduler, timeout=5)
    except (OSError, TimeoutError, ValueError) as error:
        why = f"cannot be reached ({error or type(error).__name__}); start 'dask scheduler' and 'dask worker'"
        raise ValueError(f"scheduler: {scheduler} {why}, and give its tcp:// address") from error
    with client, client.get_executor(pure=False) as executor:
        yield executor


def isolated(run: Run, commit: str = "unknown", replica: int = 0) -> dict:
    """The record of :func:`execute` in a worker process, which lives until a run ends it or this process ends.

    A run ends its worker at its time limit, which gives a record of status "timeout", or when it crashes ("crashed").
    """
    began = time.perf_counter()
    try:
        worker = _IDLE.pop()
    except IndexError:
        path = os.pathsep.join(filter(None, sys.path))
        environment = {**os.environ, "PYTHONPATH": path, **_ENVIRONMENT}
        worker = subprocess.Popen(_SERVE, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)
        _WORKERS.add(worker)
    try:
        pickle.dump((run, commit, replica, dict(HASHES)), worker.stdin)
        worker.stdin.flush()
        record = pickle.load(worker.stdout)
    except (EOFError, OSError, pickle.UnpicklingError):
        _WORKERS.discard(worker)
        late = worker.wait() == -signal.SIGALRM
        reason = f"more than {run.seconds:g} s" if late else f"its process died with exit code {worker.returncode}"
        status = "timeout" if late else "crashed"
        return record_of(run, commit, status=status, traceback=reason, wall=time.perf_counter() - began)
    _IDLE.append(worker)
    return record


def end_workers() -> None:
    """End the workers of this process at once, whatever they do."""
    for worker in list(_WORKERS):
        worker.kill()
        worker.wait()
    _WORKERS.clear(), _IDLE.clear()


def serve() -> None:
    """What a worker does: execute what comes in, until nothing can come any more because its parent has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which ends its workers
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # end the process, whatever it computes
    records = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what methods print must not come between the records
    with contextlib.suppress(EOFError):
        while True:
            run, commit, replica, known = pickle.load(sys.stdin.buffer)
            HASHES.update(known)
            pickle.dump(execute(run, commit, replica), records)
            records.flush()


def execute(run: Run, commit: str = "unknown", replica: int = 0) -> dict:
    """Make the problem, run the method within its limits (see :func:`process_limits`), measure the answer.

    Replica 0 belongs into a table. Replica k >= 1 shows how much the answer varies: a sampler draws other random
    numbers; any other method keeps them and gets observed maps, and bases, whose entries are moved by about 1e-13, as
    if computed in another arithmetic. Returns plain JSON values, see :func:`record_of`: ``status`` "ok", "memory" or
    "error" (with ``traceback``), ``metrics`` as rows (name, at, value), among them seconds, CPU seconds and MiB.
    """
    outcome: dict = {"status": "ok"}
    began = time.perf_counter()
    try:
        importlib.import_module(run.module) if run.file is None else methods.load(run.file)
        method = methods.get(run.method)
        with warnings.catch_warnings(record=True) as caught, single_threaded_blas():
            warnings.simplefilter("always")
            planted = _problem(run.generator, tuple(run.problem.items()), run.seed, run.content["data"])
            planted, rng = _replicated(planted, run.seed, method.kind, replica)
            _warm(run.method, json.dumps(run.options))
            before = peak_memory(forget=True)
            began, cpu = time.perf_counter(), time.process_time()
            with process_limits(run):
                answer = method.run(planted, rng, run.options)
            spent = (time.perf_counter() - began, time.process_time() - cpu, max(0.0, peak_memory() - before))
            if replica and method.kind == "sampler":
                answer = replace(answer, numbers=dict)  # effective draws a second: slow, and not compared
            rows = [[name, None, value] for name, value in zip(("seconds", "cpu_seconds", "peak_memory"), spent)]
            outcome["metrics"] = rows + measure(planted, answer)
        outcome["warnings"] = sorted({str(warning.message) for warning in caught})
    except MemoryError:
        outcome = {"status": "memory", "traceback": f"more than {run.memory:g} MB\n{traceback.format_exc()}"}
    except Exception:
        outcome = {"status": "error", "traceback": traceback.format_exc()}
    return record_of(run, commit, wall=time.perf_counter() - began, **outcome)


def record_of(run: Run, commit: str, **outcome: object) -> dict:
    """A record: what the run is, where it was made, and its outcome."""
    what = {**run.content, "code": run.code, "label": run.label}  # the code as this process has it
    where = {"commit": commit, "machine": machine(), "versions": versions(), "arithmetic": arithmetic()}
    return {**what, **where, "metrics": [], **outcome}


@contextlib.contextmanager
def process_limits(run: Run) -> Iterator[None]:
    """End this process after the seconds of a run; let no allocation take more than its MiB."""
    before = soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    with contextlib.suppress(OSError):  # systems without /proc do not say how large a process is
        size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        soft = min([int(size + run.memory * 2**20), *(one for one in before if one != resource.RLIM_INFINITY)])
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
    signal.setitimer(signal.ITIMER_REAL, run.seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        resource.setrlimit(resource.RLIMIT_AS, before)


@lru_cache(maxsize=2)
def _problem(generator: str, problem: tuple, seed: int, data: str) -> Planted:
    """Kept, since all methods meet it; ``data``, which the generator reads by itself, tells changed files apart."""
    return generator_function(generator)(seed=seed, **dict(problem))


def _replicated(planted: Planted, seed: int, kind: str, replica: int) -> tuple[Planted, np.random.Generator]:
    """Problem and generator of a replica; the generator of replica 0 is not drawn from."""
    if replica == 0:
        return planted, method_rng(seed)
    other = method_rng(seed).spawn(replica)[-1]
    if kind == "sampler":
        return planted, other
    exact = planted.problem.maps, *(basis.eigenfunctions for basis in planted.bases)
    maps, *moved = (a + _ROUNDING * other.standard_normal(a.shape) for a in exact)
    bases = tuple(replace(basis, eigenfunctions=a) for basis, a in zip(planted.bases, moved))
    return replace(planted, problem=replace(planted.problem, maps=maps), bases=bases), method_rng(seed)


@cache
def _warm(name: str, options: str) -> None:
    """Compile and import what a method needs, with options as JSON, on a toy: its first run is not to pay for it."""
    method = methods.get(name)
    eye = np.broadcast_to(np.eye(4), (3, 4, 4))
    toy = Planted(SyncProblem(3, [[0, 1], [1, 2], [0, 2]], eye), eye)
    quick = {"n_draws": 20, "warmup": 10, "thin": 1} if method.kind == "sampler" else {}
    with contextlib.suppress(Exception):  # what is wrong will show on the real problem
        method.run(toy, np.random.default_rng(0), {**json.loads(options), **quick})


def peak_memory(*, forget: bool = False) -> float:
    """Largest size of this process in MiB, where the system allows it after forgetting what was before."""
    with contextlib.suppress(OSError):
        if forget:
            give_back()  # what compiling left free would take in what comes
            Path("/proc/self/clear_refs").write_text("5")
        if match := re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text()):
            return int(match[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 1024)
