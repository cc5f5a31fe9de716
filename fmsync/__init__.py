"""Probabilistic synchronization of functional maps: estimators, posterior samplers and bounds.

One way through: make or load a :class:`SyncProblem`, :func:`solve` or :func:`sample` it, compare the answer with the
bounds. Submodules are imported when first used, so that ``import fmsync`` stays quick.
"""

import ast
import importlib
from pathlib import Path

__version__ = "0.1.0"

_STUB = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
_HOME = {alias.name: node.module for node in _STUB.body if isinstance(node, ast.ImportFrom) for alias in node.names}

# "from fmsync import *" must work without the extra that synchronize_shapes needs
__all__ = sorted({name for name, home in _HOME.items() if home != "fmsync"} - {"synchronize_shapes"})


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'fmsync' has no attribute {name!r}")
    if _HOME[name] == "fmsync":
        return importlib.import_module(f"fmsync.{name}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
