"""Hashes of the source and of the data that a result depends on: a result is stale when one of them has changed."""

import ast
import hashlib
import importlib
from collections.abc import Mapping
from functools import cache, lru_cache
from pathlib import Path

import data_gen
import fmsync

_MEASURED_BY = ("bench.measure", "bench.metrics", "bench.planted")
_DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


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
    tree = ast.parse(file.read_bytes())
    for node in ast.walk(tree):
        if isinstance(node, _DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            del node.body[0]
    return f"{file.name} {hashlib.sha256(ast.dump(tree).encode()).hexdigest()}"


def data_hash(generator: str, problem: Mapping[str, object]) -> str:
    """SHA-256 over names and bytes of the ``data_files(problem)`` of its generator's module; empty without any."""
    files_of = getattr(importlib.import_module(generator.partition(":")[0]), "data_files", None)
    files = files_of(problem) if files_of else []
    told = [f"{file.name}\n{_hash_of_data(file, file.stat().st_mtime_ns, file.stat().st_size)}\n" for file in files]
    return hashlib.sha256("".join(told).encode()).hexdigest() if told else ""


@lru_cache(maxsize=1024)
def _hash_of_data(file: Path, mtime_ns: int, size: int) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()
