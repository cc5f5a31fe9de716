"""Probabilistic synchronization of functional maps: estimators, posterior samplers and bounds.

One way through: make or load a :class:`SyncProblem`, :func:`solve` or :func:`sample` it, compare the answer with the
bounds. Submodules are imported when first used, so that ``import fmsync`` stays quick.
"""

import importlib

__version__ = "0.1.0"

_HOME = {  # public name -> its module
    "Basis": "shape",
    "Estimate": "estimators",
    "LangevinPrior": "problem",
    "Posterior": "samplers",
    "RectangularEstimate": "estimators.rectangular",
    "RectangularSyncProblem": "estimators.rectangular",
    "Shape": "shape",
    "SyncProblem": "problem",
    "certify": "estimators.certificate",
    "expected_rms_error": "bounds",
    "functional_map": "functional_maps",
    "functional_map_from_descriptors": "functional_maps",
    "laplace_beltrami": "shape",
    "load_problem": "problem",
    "methods": "estimators",
    "point_map": "functional_maps",
    "relative_error_bound": "bounds",
    "sample": "samplers",
    "save_problem": "problem",
    "solve": "estimators",
    "solve_rectangular": "estimators.rectangular",
    "synchronize_shapes": "matching",
}
_MODULES = {
    "bounds",
    "calibration",
    "diagnostics",
    "energy",
    "estimators",
    "functional_maps",
    "langevin",
    "oracle",
    "matching",
    "problem",
    "samplers",
    "shape",
    "so",
    "uncertainty",
    "viz",
}

# "from fmsync import *" must work without the extra that synchronize_shapes needs
__all__ = sorted({*_HOME, "functional_map"} - {"synchronize_shapes"})


def __getattr__(name: str):
    if name in _MODULES:
        return importlib.import_module(f"fmsync.{name}")
    if name in _HOME:
        value = getattr(importlib.import_module(f"fmsync.{_HOME[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'fmsync' has no attribute {name!r}")


def __dir__():
    return sorted({*globals(), *_HOME, *_MODULES})
