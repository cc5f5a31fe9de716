"""Which modules a function may use, and a hash of their code: a cell is stale when one of them has changed.

Comments, docstrings and layout do not count: they change no result.

Imports are followed through the syntax tree, in the packages that are ours alone. A string that is the name of a method
counts as a use of that method, since methods call each other by name. Too much may be followed, which only costs time;
libraries of others are not, their versions are recorded with every result.
"""

import ast
import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from bench import methods
from fmsync.estimators.base import ESTIMATORS
from fmsync.samplers.base import SAMPLERS

_DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
_OURS = ("fmsync", "data_gen")  # beside the package of a generator or of a method
_LAZY = "fmsync"  # the root package imports its rooms when asked: following it would find everything


def used_modules(start: Iterable[str]) -> list[str]:
    """Names of the modules reachable from some modules, those included, sorted.

    Examples
    --------
    >>> from bench.code import used_modules
    >>> found = used_modules(["fmsync.estimators.spectral"])
    >>> "fmsync.so" in found, "fmsync.shape" in found
    (True, False)
    """
    methods.names()  # registers all of them
    waiting, found = list(start), set()
    roots = _roots(waiting)
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting.extend(_imports(name, roots))
    return sorted(found)


def fingerprint(start: Iterable[str]) -> str:
    """SHA-256 over names and syntax trees of the modules reachable from some modules."""
    digest = hashlib.sha256()
    for name in used_modules(start):
        digest.update(f"{name}\n".encode())
        digest.update(_code(name))
    return digest.hexdigest()


def _roots(start: Iterable[str]) -> frozenset[str]:
    return frozenset({*_OURS, *(name.split(".")[0] for name in start)})


@cache
def _imports(name: str, roots: frozenset[str]) -> frozenset[str]:
    path = _file(name)
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    found: set[str] = set()
    for node in ast.walk(_tree(name)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                found |= _module(alias.name, roots)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = importlib.util.resolve_name("." * node.level + base, package)
            for alias in node.names:
                found |= _name_in(base, alias.name, roots)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == _LAZY:
            found |= _name_in(_LAZY, node.attr, roots)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found |= _method(node.value)
    return frozenset(found - {name, _LAZY})


def _module(name: str, roots: frozenset[str]) -> set[str]:
    return {name} if name.split(".")[0] in roots and name != _LAZY else set()


def _name_in(base: str, name: str, roots: frozenset[str]) -> set[str]:
    """``from base import name``: a submodule, or whatever the package got the name from."""
    if base.split(".")[0] not in roots:
        return set()
    if importlib.util.find_spec(f"{base}.{name}") if _is_package(base) else False:
        return {f"{base}.{name}"}
    home = getattr(getattr(importlib.import_module(base), name, None), "__module__", base)
    return _module(base, roots) | _module(home if home.split(".")[0] in roots else base, roots)


def _is_package(name: str) -> bool:
    return _file(name).name == "__init__.py"


def _method(name: str) -> set[str]:
    entry = ESTIMATORS.get(name) or SAMPLERS.get(name)
    return set() if entry is None else {entry.__module__}


def method_modules(name: str) -> set[str]:
    """Module of a method of the benchmark, and those that run it."""
    entry = methods.get(name)
    runner = {"estimator": {"fmsync.estimators.solve"}, "sampler": {"fmsync.samplers.sample"}}
    return {entry.module} | runner.get(entry.kind, set())


@cache
def _file(name: str) -> Path:
    loaded = getattr(sys.modules.get(name), "__file__", None)
    return Path(loaded or importlib.util.find_spec(name).origin)


@cache
def _code(name: str) -> bytes:
    """What is hashed of a module; most methods share most modules."""
    return ast.dump(_tree(name)).encode()


@cache
def _tree(name: str) -> ast.Module:
    """Syntax tree of a module without its docstrings."""
    tree = ast.parse(_file(name).read_bytes())
    for node in ast.walk(tree):
        if isinstance(node, _DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            del node.body[0]
    return tree
