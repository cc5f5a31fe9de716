"""Execute the runs of a suite side by side, on this machine or on a Dask cluster, and never twice."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from dataclasses import dataclass

from bench.cache import ResultCache
from bench.execute import end_workers, isolated, record_of
from bench.provenance import current_commit
from bench.suites import Run
from fmsync.extras import require


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
