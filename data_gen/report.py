"""What a collection is like as a source of problems: isometry, spectra, and what the sign trap does to its maps."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from data_gen.fingerprints import same_triangulation
from data_gen.truth import fix_signs, measure_maps
from fmsync import laplace_beltrami, so
from fmsync.problem import cycle_error
from fmsync.shape import Shape, edges_of_faces


def collection_report(shapes: Sequence[Shape], n_basis: int = 20) -> dict[str, object]:
    """Measure N >= 3 shapes that share their triangulation; plain JSON values, nothing of the meshes.

    Returns ``edge_distortion`` (N (N-1)/2,), ``eigenvalues`` (N, n); ``cycle_error``, the mean over 3-cycles of the
    maps of all ordered pairs ``raw``, projected to SO(n) edge by edge (``projected``), and projected after one flip a
    shape (``signs fixed``); ``negative``, the share of negative determinants ``before`` and ``after``; ``determinants``
    (N (N-1),) after sign fixing.

    >>> from data_gen import load_collection
    >>> report = collection_report(load_collection("cats", count=3, n_vertices=1000), n_basis=8)
    >>> report["cycle_error"]["signs fixed"] < report["cycle_error"]["raw"] + 1
    True
    """
    bases = [laplace_beltrami(shape.vertices, shape.faces, n_basis) for shape in shapes]
    n_nodes = len(shapes)
    pairs = np.array([(i, j) for i in range(n_nodes) for j in range(n_nodes) if i != j])
    raw = measure_maps(bases, pairs)
    fixed = measure_maps(fix_signs(bases), pairs)
    maps = {"raw": raw, "projected": so.project(raw), "signs fixed": so.project(fixed)}
    before, after = np.linalg.det(raw), np.linalg.det(fixed)
    return {
        "shapes": [shape.name for shape in shapes],
        "n_vertices": shapes[0].n_vertices,
        "edge_distortion": edge_distortion(shapes).round(5).tolist(),
        "eigenvalues": np.stack([basis.eigenvalues for basis in bases]).round(4).tolist(),
        "cycle_error": {name: round(float(cycle_error(n_nodes, pairs, c).mean()), 4) for name, c in maps.items()},
        "negative": {when: round(float((c < 0).mean()), 4) for when, c in (("before", before), ("after", after))},
        "determinants": after.round(4).tolist(),
    }


def edge_distortion(shapes: Sequence[Shape]) -> np.ndarray:
    r"""Mean \|log edge-length ratio\| of every pair of shapes, each scaled to unit area: 0 for isometric ones.

    (N (N - 1) / 2,) in the order of ``itertools.combinations``, dimensionless. A ValueError where shapes differ in
    their triangles, whatever the orientation of these.

    >>> tent = Shape(vertices=[[0, 0, 0], [1, 0, 0], [0, 1, 0]], faces=[[0, 1, 2]], name="tent")
    >>> edge_distortion([tent, tent])
    array([0.])
    """
    for shape in shapes[1:]:
        if same_triangulation(shapes[0], shape) is None:
            raise ValueError(f"{shape.name} and {shapes[0].name} differ in their triangles: edges cannot be compared")
    ends = np.unique(edges_of_faces(shapes[0].faces), axis=0)
    scaled = [shape.normalised().vertices for shape in shapes]
    logs = [np.log(np.linalg.norm(v[ends[:, 0]] - v[ends[:, 1]], axis=1)) for v in scaled]
    return np.array([np.abs(a - b).mean() for a, b in combinations(logs, 2)])
