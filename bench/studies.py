"""What the stand-alone studies share: CPU seconds, and a JSON file to which each adds its part."""

import json
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

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
