"""Posterior draws: one file for each sampler, registered by name when imported here, called through :func:`sample`."""

from fmsync.samplers import heat_bath, hmc, rlfm, tempered
from fmsync.samplers.base import Sampler, Target, methods, sampler
from fmsync.samplers.posterior import Posterior
from fmsync.samplers.sample import sample

__all__ = ["Posterior", "Sampler", "Target", "heat_bath", "hmc", "methods", "rlfm", "sample", "sampler", "tempered"]
