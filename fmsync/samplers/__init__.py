"""Posterior draws: one file for each sampler, registered by name when imported here, called through :func:`sample`."""

from fmsync.samplers import heat_bath, hmc, rlfm, tempered
from fmsync.samplers.base import Sampler, concentration, methods, sampler, with_anchor
from fmsync.samplers.posterior import Posterior
from fmsync.samplers.sample import sample

__all__ = [
    "Posterior",
    "Sampler",
    "concentration",
    "heat_bath",
    "hmc",
    "methods",
    "rlfm",
    "sample",
    "sampler",
    "tempered",
    "with_anchor",
]
