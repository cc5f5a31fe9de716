"""Noise protocols: from a ground truth to the problem that an estimator is given."""

import platform
from collections.abc import Callable

import numpy as np
import scipy

import fmsync
from data_gen.langevin import langevin_noise
from data_gen.truth import GroundTruth
from fmsync import SyncProblem, checks, so

_VERSIONS = {m.__name__: m.__version__ for m in (fmsync, np, scipy)} | {"python": platform.python_version()}


@checks.checked(around=("consistent", "measured"), outlier_kind=("haar", "flip"))
def perturb(
    truth: GroundTruth,
    sigma2: float | None = None,
    rng: int | np.random.Generator = 0,
    *,
    noise: str = "projected-gaussian",
    kappa: float | None = None,
    two_way: bool = False,
    repeats: int = 1,
    around: str = "consistent",
    outliers: float = 0.0,
    outlier_kind: str = "haar",
) -> SyncProblem:
    r"""Observe every map of the truth through noise; the paper's by default. Seed or generator are recorded.

    * ``noise``: ``"projected-gaussian"``, :math:`\mathrm{proj}_{SO(n)}(C_{ij} + \sigma G)`, the paper's;
      ``"tangent-gaussian"``, :math:`C_{ij}\exp(\sigma\,\mathrm{skew}\,G)`, the same to first order; ``"langevin"``,
      :math:`C_{ij}Z` with density :math:`\propto\exp(\kappa\operatorname{tr}Z)`, exact draws. G is standard normal.
    * ``sigma2``, ``kappa``: noise variance per entry, >= 0, of the two Gaussian families (at n = 20 the paper's noise
      makes maps nearly random from 1 on); in its place the concentration of the Langevin family.
    * ``two_way``, ``repeats``: observe (j, i) as well, and every (directed) pair so often, each with its own noise.
    * ``around``: ``"consistent"``, noise around C_i^T C_j; ``"measured"``, around the maps measured on the shapes, so
      that their model error is part of the problem.
    * ``outliers``, ``outlier_kind``: share in [0, 1) of the observations that is replaced, exactly ``round(outliers *
      E)`` of them and listed in ``provenance["outlier_edges"]``; ``"haar"``: by uniformly random rotations; ``"flip"``:
      by the left–right mirrored map :math:`C_i^\top F C_j`, noisy like the rest (needs ``truth.flip``).

    >>> import data_gen
    >>> truth = data_gen.planted(4, 5)
    >>> data_gen.perturb(truth, sigma2=0.1, rng=0, two_way=True).n_edges
    12
    >>> data_gen.perturb(truth, noise="langevin", kappa=20.0, outliers=0.3).provenance["outlier_edges"]
    [2, 3]
    """
    disturb = _family(noise, sigma2, kappa)
    if not 0 <= outliers < 1:
        raise ValueError(f"outliers: must lie in [0, 1), got {outliers}")
    if outlier_kind == "flip" and outliers > 0 and truth.flip is None:
        raise ValueError("outlier_kind: this truth has no mirror map; give ground_truth the flip of its first shape")
    generator = np.random.default_rng(rng)
    seed = int(rng) if isinstance(rng, int | np.integer) else generator.bit_generator.state
    record: dict[str, object] = {"noise": noise, "sigma2": sigma2, "kappa": kappa, "around": around, "rng": seed}
    record |= {"two_way": two_way, "repeats": repeats, "outliers": outliers, "versions": dict(_VERSIONS)}
    record["outlier_kind"] = outlier_kind if outliers > 0 else None
    edges, maps = truth.edges, truth.maps if around == "consistent" else truth.measured_maps
    if two_way:
        edges, maps = np.concatenate([edges, edges[:, ::-1]]), np.concatenate([maps, so.transpose(maps)])
    edges, maps = np.tile(edges, (repeats, 1)), np.tile(maps, (repeats, 1, 1))
    replaced = np.sort(generator.permutation(len(edges))[: round(outliers * len(edges))])
    if record["outlier_kind"] == "flip" and len(replaced):
        i, j = edges[replaced].T
        maps[replaced] = so.project(so.transpose(truth.absolute[i]) @ truth.flip @ truth.absolute[j])
    maps = disturb(maps, generator)
    if record["outlier_kind"] == "haar":
        maps[replaced] = so.random_uniform(truth.n, len(replaced), generator)
    record["outlier_edges"] = replaced.tolist()
    return SyncProblem(truth.n_nodes, edges, maps, provenance={**truth.provenance, **record})


def _family(noise: str, sigma2: float | None, kappa: float | None) -> Callable:
    """The function (maps, generator) -> noisy maps."""
    checks.one_of("noise", noise, ("projected-gaussian", "tangent-gaussian", "langevin"))
    wanted, unwanted = ("kappa", "sigma2") if noise == "langevin" else ("sigma2", "kappa")
    level, other = (kappa, sigma2) if noise == "langevin" else (sigma2, kappa)
    if level is None or other is not None:
        raise ValueError(f"{wanted}: {noise} noise takes {wanted} and no {unwanted}")
    checks.not_negative(wanted, level)
    if noise == "langevin":
        return lambda maps, rng: maps @ langevin_noise(maps.shape[-1], level, len(maps), rng)
    if level == 0:
        return lambda maps, rng: maps.copy()
    sigma = np.sqrt(level)
    if noise == "tangent-gaussian":
        return lambda maps, rng: maps @ so.exp(sigma * so.skew(rng.standard_normal(maps.shape)))
    return lambda maps, rng: so.project(maps + sigma * rng.standard_normal(maps.shape))
