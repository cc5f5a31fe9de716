"""What to doubt in an answer, in words for somebody who has never heard of a Markov chain."""

from fmsync.matching.confidence import has_continuous_symmetry
from fmsync.matching.network import doubts_of_draws, unchecked_maps
from fmsync.matching.synchronize import SyncedShapes


def quality_flags(synced: SyncedShapes) -> list[str]:
    """Sentences about what went wrong or is thin, each with what to do; none if nothing is.

    Watches energy, concentration and modes of the chains, edges that contradict the rest, outliers, and symmetries.
    """
    said = []
    for what, among in (("left out", False), ("doubtful, as are their maps: leave them out", True)):
        if outliers := [name for name in synced.outliers if (name in synced.names) == among]:
            said.append(f"Unlike the rest and {what}: {', '.join(outliers)}.")
    if synced.posterior is not None:
        said += doubts_of_draws(synced.posterior, bool(synced.map_names))
    if pairs := [synced.edge_names[e] for e in synced.violating]:
        said.append(f"{len(pairs)} pairs contradict the left and right of the others: doubt {', '.join(pairs)}.")
    if turned := [name for name, m in zip(synced.map_names, synced.matches) if m.orientation < 0]:
        said.append(f"{len(turned)} given maps turn left into right; if many, so may the answer: {', '.join(turned)}.")
    if turning := [s.shape.name for s in synced.shapes if has_continuous_symmetry(s)]:
        text = f"{', '.join(turning)}: nearly equal eigenvalues, as on a surface of revolution. It does not tell "
        text += "how far a vertex is turned about the axis; regions there are as wide as its circle. Give landmarks."
        said.append(text)
    if any(s.orientation is None and s.n_landmarks < 2 for s in synced.shapes):
        text = "Point clouds do not tell left from right: the answer for a symmetric body may be its mirror image. "
        said.append(text + "Give meshes or landmarks.")
    maps = synced.names, synced.edge_names, bool(synced.map_names)
    return said + unchecked_maps(synced.problem, synced.estimate, *maps)
