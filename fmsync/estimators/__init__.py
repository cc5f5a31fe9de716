"""Point estimates: one file for each estimator, registered by name when imported here, called through :func:`solve`."""

from fmsync.estimators import map, mle, mle_geodesic, mle_unconstrained, robust, spanning_tree, spectral, staircase  # noqa: F401
from fmsync.estimators.base import Callback, Estimate, Trace, estimator, methods
from fmsync.estimators.solve import mean_of_starts, solve
from fmsync.estimators.starts import starting_point

__all__ = ["Callback", "Estimate", "Trace", "estimator", "mean_of_starts", "methods", "solve", "starting_point"]
