"""Point estimates: one file for each estimator, registered by name when imported here, called through :func:`solve`."""

from fmsync.estimators import map, mle, mle_geodesic, mle_unconstrained, robust, spanning_tree, spectral, staircase
from fmsync.estimators.base import Callback, Estimate, Trace, estimator, methods
from fmsync.estimators.restarts import mean_of_starts
from fmsync.estimators.solve import solve
from fmsync.estimators.starts import starting_point

__all__ = [
    "Callback",
    "Estimate",
    "Trace",
    "estimator",
    "map",
    "mean_of_starts",
    "methods",
    "mle",
    "mle_geodesic",
    "mle_unconstrained",
    "robust",
    "solve",
    "spanning_tree",
    "spectral",
    "staircase",
    "starting_point",
]
