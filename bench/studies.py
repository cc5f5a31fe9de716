"""What the stand-alone studies share: CPU seconds, timing in pairs, and a JSON file to which each adds its part."""

import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from bench.provenance import machine
from fmsync.files import replacing
from fmsync.threads import single_threaded_blas


@contextmanager
def cpu_seconds(seconds: dict[str, float], name: str) -> Iterator[None]:
    """Put the CPU seconds of a block under ``name``."""
    began = time.process_time()
    yield
    seconds[name] = time.process_time() - began


def compare(ours: Callable, peer: Callable, runs: int = 5, work: Callable | None = None) -> tuple[float, ...]:
    """Median CPU seconds of both, run in turn on one BLAS thread after one warm-up each, and the median ratio.

    ``work`` says of the result of a call how much it is worth, such as its effective draws: seconds are then of a unit.
    """

    def seconds(function: Callable) -> float:
        began = time.process_time()
        result = function()
        spent = time.process_time() - began
        return spent / work(result) if work else spent

    with single_threaded_blas():
        ours(), peer()
        pairs = np.array([(seconds(ours), seconds(peer)) for _ in range(runs)])
    return (*np.median(pairs, axis=0), float(np.median(pairs[:, 1] / np.maximum(pairs[:, 0], 1e-9))))


def add_part(path: Path, part: str, found: Mapping, command: str) -> None:
    """Put ``found`` under ``part`` of a file of results, with how and where it was made; complete or not at all."""
    table = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    table[part] = {"command": command, "machine": machine(), **found}
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as file:
        file.write(f"{json.dumps(table, indent=1, ensure_ascii=False)}\n".encode())
