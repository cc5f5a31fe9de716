"""Noise protocols: from a ground truth to the problem that an estimator is given."""

import numpy as np

import fmsync
from data_gen.truth import GroundTruth
from fmsync import SyncProblem, so


def perturb(
    truth: GroundTruth,
    sigma2: float,
    rng: int | np.random.Generator = 0,
    *,
    two_way: bool = False,
    around: str = "consistent",
) -> SyncProblem:
    r"""Observe every map of the truth through the paper's noise :math:`\mathrm{proj}_{SO(n)}(C_{ij} + \sigma G)`.

    Parameters
    ----------
    truth
        What to observe.
    sigma2
        Noise variance per entry, >= 0; at n = 20 the maps are nearly random rotations from 1 on.
    rng
        Seed or generator.
    two_way
        Observe (j, i) as well, with noise of its own: two observations per pair.
    around
        ``"consistent"``: noise around C_i^T C_j; ``"measured"``: around the maps measured on the shapes, so that their
        model error is part of the problem.

    Returns
    -------
    SyncProblem
        With a provenance record.

    Examples
    --------
    >>> import data_gen
    >>> data_gen.perturb(data_gen.planted(4, 5), sigma2=0.1, rng=0, two_way=True).n_edges
    12
    """
    if not (np.isfinite(sigma2) and sigma2 >= 0):
        raise ValueError(f"sigma2: must be finite and >= 0, got {sigma2}")
    if around not in ("consistent", "measured"):
        raise ValueError(f"around: 'consistent' or 'measured', not {around!r}")
    edges, maps = truth.edges, truth.maps if around == "consistent" else truth.measured_maps
    if two_way:
        edges, maps = np.concatenate([edges, edges[:, ::-1]]), np.concatenate([maps, so.transpose(maps)])
    generator = np.random.default_rng(rng)
    provenance = {
        **truth.provenance,
        "noise": "projected-gaussian",
        "sigma2": float(sigma2),
        "around": around,
        "two_way": bool(two_way),
        "seed": int(rng) if isinstance(rng, int | np.integer) else None,
        "versions": {"fmsync": fmsync.__version__, "numpy": np.__version__},
    }
    if sigma2 > 0:
        maps = so.project(maps + np.sqrt(sigma2) * generator.standard_normal(maps.shape))
    return SyncProblem(truth.n_nodes, edges, maps, provenance=provenance)
