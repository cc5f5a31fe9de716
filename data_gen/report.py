"""What a collection is like as a source of problems: isometry, spectra, and what the sign trap does to its maps."""

from collections.abc import Sequence

import numpy as np

from data_gen.isometry import edge_distortion
from data_gen.truth import fix_signs, measure_maps
from fmsync import laplace_beltrami, so
from fmsync.problem import cycle_error
from fmsync.shape import Basis, Shape


def collection_report(
    shapes: Sequence[Shape], n_basis: int = 20, bases: Sequence[Basis] | None = None
) -> dict[str, object]:
    """Measure a collection whose shapes share their triangulation; plain JSON values, nothing of the meshes.

    Parameters
    ----------
    shapes
        N >= 3 shapes.
    n_basis
        Number n of eigenfunctions.
    bases
        Bases computed before, at least n_basis functions each, signs as the solver gave them.

    Returns
    -------
    dict
        ``edge_distortion`` (N (N-1)/2,), ``eigenvalues`` (N, n); ``cycle_error``, the mean over 3-cycles of the
        maps of all ordered pairs ``raw``, projected to SO(n) edge by edge (``projected``), and projected after one
        flip a shape (``signs fixed``); ``negative`` the share of negative determinants ``before`` and ``after``;
        ``determinants`` (N (N-1),) after sign fixing.

    Examples
    --------
    >>> from data_gen import load_collection
    >>> report = collection_report(load_collection("cats", count=3, n_vertices=1000), n_basis=8)
    >>> report["cycle_error"]["signs fixed"] < report["cycle_error"]["raw"] + 1
    True
    """
    if bases is None:
        bases = [laplace_beltrami(shape.vertices, shape.faces, n_basis) for shape in shapes]
    bases = [basis.truncated(n_basis) for basis in bases]
    n_nodes = len(shapes)
    pairs = np.array([(i, j) for i in range(n_nodes) for j in range(n_nodes) if i != j])
    raw = measure_maps(bases, pairs)
    fixed = measure_maps(fix_signs(bases), pairs)
    maps = {"raw": raw, "projected": so.project(raw), "signs fixed": so.project(fixed)}
    determinants = np.linalg.det(fixed)
    return {
        "shapes": [shape.name for shape in shapes],
        "n_vertices": shapes[0].n_vertices,
        "edge_distortion": edge_distortion(list(shapes)).round(5).tolist(),
        "eigenvalues": np.stack([basis.eigenvalues for basis in bases]).round(4).tolist(),
        "cycle_error": {name: round(float(cycle_error(n_nodes, pairs, c).mean()), 4) for name, c in maps.items()},
        "negative": {
            "before": round(float((np.linalg.det(raw) < 0).mean()), 4),
            "after": round(float((determinants < 0).mean()), 4),
        },
        "determinants": determinants.round(4).tolist(),
    }
