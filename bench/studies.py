"""What the stand-alone studies share: CPU seconds, and files of results that are added to."""

import argparse
import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import joblib
import pandas as pd

from bench.provenance import machine
from fmsync.files import replacing


@contextmanager
def cpu_seconds(seconds: dict[str, float], name: str) -> Iterator[None]:
    """Put the CPU seconds of a block under ``name``."""
    began = time.process_time()
    yield
    seconds[name] = time.process_time() - began


def add_part(path: Path, part: str, found: Mapping, command: str) -> None:
    """Put ``found`` under ``part`` of a file of results, with how and where it was made; complete or not at all."""
    table = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    table[part] = {"command": command, "machine": machine(), **found}
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as file:
        file.write(f"{json.dumps(table, indent=1, ensure_ascii=False)}\n".encode())


def command_line(text: str, problems: int, jobs: int) -> argparse.ArgumentParser:
    """What the studies of coverage are asked: how many problems, by which means, and where the results are."""
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=problems, help="at most, of each case or of the first setting")
    parser.add_argument("--jobs", type=int, default=jobs)
    parser.add_argument("--results", type=Path, default=Path("results"))
    return parser


def coverage(rows: pd.DataFrame, columns: Mapping[float, str]) -> dict[str, float]:
    """Shares covered by the balls of each probability, with standard errors clustered by problem, one a row."""
    found = {}
    for q, name in columns.items():
        found |= {f"{q:g}": rows[name].mean(), f"se {q:g}": rows[name].std(ddof=1) / len(rows) ** 0.5}
    return found


def kept_results(work: Callable[[Any], object], tasks: Iterable[object], folder: Path, jobs: int = 2) -> list:
    """``work(task)`` of all tasks, from ``folder`` what was made there before by the same code of ``work``."""
    kept = joblib.Memory(folder, verbose=0).cache(work)
    return joblib.Parallel(jobs)(joblib.delayed(kept)(task) for task in tasks)


def fill(
    path: Path,
    fields: Sequence[str],
    todo: Sequence[tuple],
    work: Callable[..., Mapping[str, object]],
    jobs: int,
    enough: Callable[[], bool] = lambda: False,
) -> None:
    """Add to a CSV file, as they come, lines ``work(*task)`` of the tasks whose first fields it does not hold yet.

    A run that was stopped continues. It ends when all are done, or when ``enough()``.
    """
    done = pd.read_csv(path) if path.exists() else pd.DataFrame(columns=fields)
    known = set(done[list(fields[: len(todo[0])])].itertuples(index=False, name=None))
    left = [task for task in todo if task not in known]
    with joblib.Parallel(jobs) as parallel:
        for first in range(0, len(left), 4 * jobs):
            if enough():
                return
            lines = parallel(joblib.delayed(work)(*task) for task in left[first : first + 4 * jobs])
            new = pd.DataFrame(lines, columns=fields)
            new.to_csv(path, mode="a", header=not path.exists(), index=False, float_format="%.5g")
