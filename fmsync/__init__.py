"""Probabilistic synchronization of functional maps: estimators, posterior samplers and bounds.

One way through: make or load a :class:`SyncProblem`, :func:`solve` or :func:`sample` it, compare the answer with the
bounds. Submodules are imported when first used, so that ``import fmsync`` stays quick.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the names below, for type checkers alone
    from fmsync import bounds as bounds
    from fmsync import calibration as calibration
    from fmsync import diagnostics as diagnostics
    from fmsync import energy as energy
    from fmsync import estimators as estimators
    from fmsync import functional_maps as functional_maps
    from fmsync import langevin as langevin
    from fmsync import matching as matching
    from fmsync import oracle as oracle
    from fmsync import problem as problem
    from fmsync import samplers as samplers
    from fmsync import shape as shape
    from fmsync import so as so
    from fmsync import uncertainty as uncertainty
    from fmsync import viz as viz
    from fmsync.bounds import expected_rms_error as expected_rms_error
    from fmsync.bounds import relative_error_bound as relative_error_bound
    from fmsync.estimators import Estimate as Estimate
    from fmsync.estimators import methods as methods
    from fmsync.estimators.certificate import certify as certify
    from fmsync.estimators.rectangular import RectangularEstimate as RectangularEstimate
    from fmsync.estimators.rectangular import RectangularSyncProblem as RectangularSyncProblem
    from fmsync.estimators.rectangular import solve_rectangular as solve_rectangular
    from fmsync.estimators.solve import solve as solve
    from fmsync.functional_maps import functional_map as functional_map
    from fmsync.functional_maps import functional_map_from_descriptors as functional_map_from_descriptors
    from fmsync.functional_maps import point_map as point_map
    from fmsync.matching import synchronize_shapes as synchronize_shapes
    from fmsync.problem import LangevinPrior as LangevinPrior
    from fmsync.problem import SyncProblem as SyncProblem
    from fmsync.problem import load_problem as load_problem
    from fmsync.problem import save_problem as save_problem
    from fmsync.samplers import Posterior as Posterior
    from fmsync.samplers.sample import sample as sample
    from fmsync.shape import Basis as Basis
    from fmsync.shape import Shape as Shape
    from fmsync.shape import laplace_beltrami as laplace_beltrami

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


def __getattr__(name: str) -> object:
    if name in _MODULES:
        return importlib.import_module(f"fmsync.{name}")
    if name in _HOME:
        value = getattr(importlib.import_module(f"fmsync.{_HOME[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'fmsync' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME, *_MODULES})
