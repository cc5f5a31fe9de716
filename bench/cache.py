"""The result cache: a small file for each run, named by what went into it; failures are kept apart.

What goes in are hashes of the source and of the data too: a result is stale when one of them has changed.
"""

import ast
import hashlib
import importlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import data_gen
import fmsync
from fmsync.files import replacing

_MEASURED_BY = ("bench.metrics", "bench.problems")
HASHES: dict[tuple[str, int, int], str] = {}  # of files by path, time and size: workers get those of their parent
_DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def key_of(content: Mapping[str, object]) -> str:
    """SHA-256 of plain JSON values; the order of the keys does not matter."""
    return hashlib.sha256(_dump(content)).hexdigest()


@dataclass(frozen=True)
class ResultCache:
    """A folder of records."""

    folder: Path

    def path(self, key: str, suffix: str = "json") -> Path:
        """File of a finished run; that of a failure has the suffix ``"failed"``."""
        return self.folder / key[:2] / f"{key}.{suffix}"

    def write(self, key: str, record: Mapping[str, object]) -> None:
        """Keep a record: a failure is never read as a result, so that the next run tries again."""
        path = self.path(key, "json" if record["status"] == "ok" else "failed")
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as file:  # not synced: after a power cut the checksum fails
            file.write(_dump({"sha256": key_of(record), "record": record}))
        if record["status"] == "ok":
            self.path(key, "failed").unlink(missing_ok=True)

    def read(self, key: str, suffix: str = "json") -> dict | None:
        """Record of a finished run, or of its last failure ("failed"); None if there is none, ValueError if damaged."""
        path = self.path(key, suffix)
        try:
            wrapped = json.loads(path.read_bytes())
            if wrapped["sha256"] != key_of(wrapped["record"]):
                raise ValueError("checksum")
        except FileNotFoundError:
            return None
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path}: damaged record; the run will be repeated") from error
        return wrapped["record"]


def _dump(value: object) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=True).encode()


@cache
def code_hash(generator_module: str, method_module: str) -> str:
    """SHA-256 over the source of fmsync and data_gen, of what measures answers, and of two modules of a run.

    Of the two modules, those files of ``bench`` count too that they import something from. Comments, docstrings and
    layout do not count. The source is read once in a process, which has imported it.
    """
    files = {file for package in (fmsync, data_gen) for file in Path(package.__file__).parent.rglob("*.py")}
    names = {generator_module, method_module, *_MEASURED_BY}
    for module in map(importlib.import_module, (generator_module, method_module)):
        taken = {getattr(value, "__module__", None) or "" for value in vars(module).values()}
        names |= {name for name in taken if name.startswith("bench.")}
    files |= {Path(importlib.import_module(name).__file__) for name in names}
    return hashlib.sha256("\n".join(sorted(map(_hash_of_code, files))).encode()).hexdigest()


@cache
def _hash_of_code(file: Path) -> str:
    key = str(file), file.stat().st_mtime_ns, file.stat().st_size
    if key in HASHES:
        return HASHES[key]
    tree = ast.parse(file.read_bytes())
    for node in ast.walk(tree):
        if isinstance(node, _DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            del node.body[0]
    HASHES[key] = f"{file.name} {hashlib.sha256(ast.dump(tree).encode()).hexdigest()}"
    return HASHES[key]


def data_hash(generator: str, problem: Mapping[str, object]) -> str:
    """SHA-256 over names and bytes of the ``data_files(problem)`` of its generator's module; empty without any."""
    files_of = getattr(importlib.import_module(generator.partition(":")[0]), "data_files", None)
    files = files_of(problem) if files_of else []
    told = [f"{file.name}\n{_hash_of_data(file, file.stat().st_mtime_ns, file.stat().st_size)}\n" for file in files]
    return hashlib.sha256("".join(told).encode()).hexdigest() if told else ""


@lru_cache(maxsize=1024)
def _hash_of_data(file: Path, mtime_ns: int, size: int) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()
