"""The public names: type checkers read them here, and ``__init__.py`` imports each when it is first used."""

from fmsync import adapters as adapters
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

__version__: str
