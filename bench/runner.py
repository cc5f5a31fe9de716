"""Run the cells of a suite side by side, on this machine or on a Dask cluster, and never twice."""

import contextlib
import json
import multiprocessing
import os
import subprocess
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky import ProcessPoolExecutor
from joblib.externals.loky.process_executor import BrokenProcessPool as LokyBroken

from bench import methods
from bench.cell import CONTENT, run_together
from bench.store import CorruptCellError, Store
from bench.suites import Cell
from fmsync.extras import require

OnRecord = Callable[[Cell, dict], None]
Batches = Sequence[tuple[Cell, ...]]


class RunError(RuntimeError):
    """The run had to stop; the message says why, what is kept and what to do."""


@dataclass(frozen=True)
class Run:
    """What came of a run.

    Attributes
    ----------
    records
        One for every cell, in the order of the cells, failures included.
    n_cached
        Cells that were there already.
    corrupt
        Messages about damaged cells, which were computed again.
    """

    records: tuple[dict, ...]
    n_cached: int
    corrupt: tuple[str, ...]


def run_cells(
    cells: Sequence[Cell],
    store: Store,
    *,
    n_jobs: int = 2,
    scheduler: str | None = None,
    on_record: OnRecord = lambda cell, record: None,
    on_start: Callable[[int, int], None] = lambda n_cached, n_left: None,
) -> Run:
    """Finish all cells that are not in the store; each is written there by the process that ran it.

    Parameters
    ----------
    cells, store
        What to run and where finished cells are kept.
    n_jobs
        Processes on this machine, one BLAS thread each.
    scheduler
        Address of a Dask scheduler to use instead; a worker that dies has its cells done by another one.
    on_record, on_start
        Told of every cell as it finishes, and first of how many were found and are left.

    Raises
    ------
    RunError
        Nothing can be written any more (a full disk), or the scheduler cannot be reached. Finished cells are kept.
    """
    if n_jobs < 1:
        raise ValueError(f"n_jobs: need at least one process, got {n_jobs}")
    done, corrupt, waiting = {}, [], {}
    for cell in cells:
        cell.module, cell.key  # noqa: B018  looked up once here, and not again in every worker
    try:
        store.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"{store.folder}: cannot be made ({error}); name another folder with --store") from error
    for cell in cells:
        try:
            record = store.read(cell.key)
        except CorruptCellError as error:
            corrupt.append(str(error))
            record = None
        if record is None:
            waiting[cell.key] = cell
        else:
            done[cell.key] = record
    n_cached = len(done)
    on_start(n_cached, len(waiting))
    commit = current_commit()
    with _pool(n_jobs, scheduler) if waiting else contextlib.nullcontext() as pool:
        while waiting:
            store.take_started()  # marks of an earlier run
            try:
                for finished in pool.run(_batches(waiting.values()), store.folder, commit):
                    for key, record in finished:
                        _keep(store, key, record)
                        on_record(waiting.pop(key), record)
                        done[key] = record
            except pool.crashes:
                suspects = [key for key in store.take_started() if key in waiting]
                for key in list(waiting):  # finished, but the news died with the pool
                    with contextlib.suppress(CorruptCellError):
                        if (record := store.read(key)) is not None:
                            on_record(waiting.pop(key), record)
                            done[key] = record
                for key in [key for key in suspects or list(waiting)[:1] if key in waiting]:
                    record = pool.alone(waiting[key], store.folder, commit)
                    _keep(store, key, record)
                    on_record(waiting.pop(key), record)
                    done[key] = record
    return Run(tuple({**done[cell.key], "label": cell.label} for cell in cells), n_cached, tuple(corrupt))


def _batches(cells: Iterable[Cell]) -> list[tuple[Cell, ...]]:
    """Cells that may run together, and differ in their seed alone; every other one by itself."""
    found: dict[str, list[Cell]] = {}
    for cell in cells:
        key = cell.key
        if cell.together and methods.get(cell.method).can_run_together(cell.options):
            key = json.dumps({**cell.content, "seed": None}, sort_keys=True)
        found.setdefault(key, []).append(cell)
    return [tuple(batch) for batch in found.values()]


def work(cells: Sequence[Cell], folder: Path, commit: str) -> list[tuple[str, dict]]:
    """What a worker does: run cells, as one batch if there are several, and keep them where the folder can be seen."""
    parent = multiprocessing.parent_process()
    if parent is not None and parent.pid not in (None, os.getppid()):
        os._exit(1)  # nobody waits for this any more
    store = Store(folder)
    visible = folder.is_dir()
    if visible:
        with contextlib.suppress(OSError):
            for cell in cells:
                store.mark_started(cell.key)
    records = run_together(cells, commit)
    for cell, record in zip(cells, records):
        if visible:
            with contextlib.suppress(OSError):  # the runner tries again, and knows whom to tell
                _write(store, cell.key, record)
                record["kept"] = True
                store.unmark(cell.key)
    return [(cell.key, record) for cell, record in zip(cells, records)]


def current_commit() -> str:
    """Commit of the checkout that holds this package, with "+" behind it when files differ; else "unknown"."""
    here = Path(__file__).parent
    try:
        found = subprocess.run(["git", "rev-parse", "--short=12", "HEAD"], cwd=here, capture_output=True, text=True)
        changed = subprocess.run(
            ["git", "status", "--porcelain", "-uno", "--", ".."], cwd=here, capture_output=True, text=True
        )
    except OSError:
        return "unknown"
    if found.returncode:
        return "unknown"
    return found.stdout.strip() + ("+" if changed.stdout.strip() else "")


def _write(store: Store, key: str, record: dict) -> None:
    (store.write if record["status"] == "ok" else store.write_failure)(key, record)


def _keep(store: Store, key: str, record: dict) -> None:
    if not record.pop("kept", False):
        try:
            _write(store, key, record)
        except OSError as error:
            message = f"{store.folder}: cannot write ({error}); the finished cells are kept, make room and run again"
            raise RunError(message) from error


class _Local:
    """Processes of joblib's loky backend."""

    crashes = (BrokenProcessPool, LokyBroken)

    def __init__(self, n_jobs: int):
        self._n_jobs = n_jobs

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return None

    def run(self, batches: Batches, folder: Path, commit: str) -> Iterator[list[tuple[str, dict]]]:
        with parallel_config(backend="loky", n_jobs=self._n_jobs, inner_max_num_threads=1):
            yield from Parallel(return_as="generator_unordered")(delayed(work)(b, folder, commit) for b in batches)

    def alone(self, cell: Cell, folder: Path, commit: str) -> dict:
        """A cell during which a process died gets one more try in a process of its own."""
        with ProcessPoolExecutor(max_workers=1) as executor:
            try:
                return executor.submit(work, (cell,), folder, commit).result()[0][1]
            except self.crashes as error:
                return crashed(cell, commit, error)


class _Dask:
    """Workers of a Dask cluster that is already there."""

    def __init__(self, scheduler: str):
        distributed = require("distributed", "bench")
        self.crashes = (distributed.KilledWorker,)
        try:
            self._client = distributed.Client(scheduler, timeout=5)
        except (OSError, TimeoutError, ValueError) as error:
            raise RunError(
                f"scheduler: {scheduler} cannot be reached ({error or type(error).__name__}); "
                "start one with 'dask scheduler' and workers with 'dask worker', and give its tcp:// address"
            ) from error

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self._client.close()

    def run(self, batches: Batches, folder: Path, commit: str) -> Iterator[list[tuple[str, dict]]]:
        with parallel_config(backend="dask"):
            yield from Parallel(return_as="generator_unordered")(delayed(work)(b, folder, commit) for b in batches)

    def alone(self, cell: Cell, folder: Path, commit: str) -> dict:
        try:
            return self._client.submit(work, (cell,), folder, commit, pure=False).result()[0][1]
        except self.crashes as error:
            return crashed(cell, commit, error)


def crashed(cell: Cell, commit: str, error: BaseException) -> dict:
    """Record of a cell that took its process with it."""
    content = {name: cell.content[name] for name in CONTENT}
    return {
        **content,
        "label": cell.label,
        "commit": commit,
        "machine": "",
        "versions": "",
        "status": "crashed",
        "metrics": [],
        "wall": float("nan"),
        "traceback": f"the process died twice: {type(error).__name__}: {error}",
    }


def _pool(n_jobs: int, scheduler: str | None):
    return _Local(n_jobs) if scheduler is None else _Dask(scheduler)
