"""The project's estimator and sampler as others write them; importing this package registers both by name."""

from bench.peers import geomstats_rlfm, pymanopt_mle  # noqa: F401
