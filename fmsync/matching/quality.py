"""What to doubt in an answer, in words for somebody who has never heard of a Markov chain."""

import numpy as np

from fmsync import diagnostics
from fmsync.matching.confidence import has_continuous_symmetry
from fmsync.matching.synchronize import SyncedShapes

_RHAT, _ESS = 1.01, 400


def quality_flags(synced: SyncedShapes) -> list[str]:
    """Sentences about what went wrong or is thin, each with what to do; none if nothing is.

    Watches the energy and the concentration of the chains, edges that contradict the rest, and symmetries.
    """
    said = []
    if synced.posterior is not None:
        varying = [x for x in (synced.posterior.energy, synced.posterior.kappa) if np.ptp(x) > 0]
        apart = max((diagnostics.rhat(x) for x in varying), default=np.nan)
        effective = min((diagnostics.ess(x) for x in varying), default=np.nan)
        if not np.isfinite(apart):
            said.append("There are too few posterior draws to tell whether the chains agree: ask for 1000 or more.")
        elif apart > _RHAT:
            said.append(
                f"The chains of posterior draws do not agree (R-hat {apart:.3f}; it should be below {_RHAT}): "
                "do not rely on the regions; ask for more draws."
            )
        if np.isfinite(effective) and effective < _ESS:
            said.append(
                f"The posterior draws are worth only {effective:.0f} independent ones (ESS; {_ESS} are wanted): "
                "the regions are rough; ask for more draws."
            )
    pairs = [synced.edge_names[e] for e in synced.violating]
    if pairs:
        said.append(
            f"{len(pairs)} pairs contradict the left and right of the others, and are doubtful: {', '.join(pairs)}."
        )
    turned = [name for name, m in zip(synced.map_names, synced.matches) if m.orientation < 0]
    if turned:
        said.append(
            f"{len(turned)} given maps turn left into right; if these are many, so may the answer: {', '.join(turned)}."
        )
    turning = [s.shape.name for s in synced.shapes if has_continuous_symmetry(s)]
    if turning:
        said.append(
            f"{', '.join(turning)}: nearly equal eigenvalues, as on a surface of revolution. The shape does not tell "
            "how far a vertex is turned about the axis; regions there are as wide as its circle. Give landmarks."
        )
    if any(s.orientation is None and s.n_landmarks < 2 for s in synced.shapes):
        said.append(
            "Point clouds do not tell left from right: the answer for a symmetric body may be its mirror image. Give "
            "meshes or landmarks."
        )
    if len(synced.used) < len(synced.shapes):
        said.append(
            "The graph has no cycle, so pairs cannot be checked against each other and the noise level is a guess: "
            "use a graph with more pairs."
        )
    return said
