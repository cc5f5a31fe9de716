"""Probabilistic synchronization of functional maps: point answers, posterior draws and their limits.

One way through: make or load a :class:`SyncProblem`, :func:`solve` or :func:`sample` it, compare the answer with the
bounds. Submodules are imported when first used, so that ``import fmsync`` stays quick.
"""

import importlib

__version__ = "0.1.0"

_HOME = {  # public name -> the room it lives in
    "Basis": "shape",
    "Estimate": "estimators",
    "LangevinPrior": "problem",
    "Posterior": "samplers",
    "RectangularEstimate": "rectangular",
    "RectangularSyncProblem": "rectangular",
    "Shape": "shape",
    "SyncProblem": "problem",
    "certify": "certificate",
    "expected_rms_error": "bounds",
    "functional_map_from_descriptors": "functional_map",
    "laplace_beltrami": "shape",
    "load_problem": "problem_io",
    "methods": "estimators",
    "point_map": "functional_map",
    "relative_error_bound": "bounds",
    "sample": "samplers",
    "save_problem": "problem_io",
    "solve": "estimators",
    "solve_rectangular": "rectangular",
    "synchronize_shapes": "pipeline",
}
_ROOMS = {
    "bounds",
    "calibration",
    "certificate",
    "diagnostics",
    "estimators",
    "langevin",
    "oracle",
    "pipeline",
    "problem",
    "rectangular",
    "samplers",
    "shape",
    "so",
    "uncertainty",
    "viz",
}

# "from fmsync import *" must work without the extra that synchronize_shapes needs
__all__ = sorted({*_HOME, "functional_map"} - {"synchronize_shapes"})


def __getattr__(name: str):
    if name in _ROOMS:
        return importlib.import_module(f"fmsync.{name}")
    if name in _HOME:
        value = getattr(importlib.import_module(f"fmsync.{_HOME[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'fmsync' has no attribute {name!r}")


def __dir__():
    return sorted({*globals(), *_HOME, *_ROOMS})


# The room and the function share a name. Loading the room here, once, leaves the function under it for good.
from fmsync.functional_map import functional_map  # noqa: E402, F401
