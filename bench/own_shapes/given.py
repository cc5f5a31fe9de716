"""What synchronisation makes of maps that another matcher gives: pyFM's fit and ZoomOut, some of them spoiled."""

from collections.abc import Iterable

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree
from sklearn.metrics import roc_auc_score

from bench.own_shapes.confidence import observe
from bench.own_shapes.stages import Evaluation, decimated, evaluation_vertices, species
from data_gen import Creature
from fmsync import adapters, diagnostics
from fmsync.functional_maps import point_map
from fmsync.matching.conformal import default_calibration
from fmsync.shape import Basis, Shape

SPECIES, _SHAPES = range(4), 6
_N_BASIS, _STEP, _N_REFINED = 20, 5, 120  # ZoomOut goes from the first to the last
_WRONG = 0.2  # share of pairs
_SOFT, _NEIGHBOURS = 10.0, 20  # times the temperature at which a soft map says as much as its point map; entries a row


def table(loaded: dict[str, list[Shape]], numbers: Iterable[int] = SPECIES) -> dict:
    """Mean errors before and after, AUC of the inlier weights and coverage, by collection and by kind of given map."""
    found = {}
    for name, shapes in loaded.items():
        copies, vertices = decimated(shapes[:_SHAPES], evaluation_vertices(shapes)[:_SHAPES])
        found[name] = starts(copies, vertices)
    for number in numbers:
        shapes = species(number, count=_SHAPES)
        found[f"species {number}"] = starts(shapes, evaluation_vertices(shapes))
    return found


def starts(shapes: list[Shape], vertices: np.ndarray) -> dict[str, dict]:
    """One collection: every kind of given map, before and after synchronisation."""
    rng = np.random.default_rng(0)
    meshes = [adapters.to_pyfm(shape).process() for shape in shapes]
    bases = [adapters.from_pyfm(mesh)[1] for mesh in meshes]
    pairs = [(i, j) for i in range(len(shapes)) for j in range(i)]
    fits, refined = zip(*(_pyfm(meshes[i], meshes[j]) for i, j in pairs))
    points = [_points(c, bases[i], bases[j]) for (i, j), c in zip(pairs, refined)]
    spoiled = np.zeros(len(pairs), dtype=bool)
    spoiled[rng.choice(len(pairs), max(1, round(_WRONG * len(pairs))), replace=False)] = True
    shuffled = [rng.permutation(p) for p in points]
    given = {
        "fit": (fits, None),
        "ZoomOut": (refined, None),
        "ZoomOut, shuffled": ([q if s else p for s, p, q in zip(spoiled, points, shuffled)], spoiled),
        "soft, too hot": ([_soft(c, bases[i], bases[j]) for (i, j), c in zip(pairs, refined)], None),
    }
    if isinstance(shapes[0], Creature):
        turns = [shapes[i].located[shapes[i].opposite] if s else slice(None) for s, (i, _) in zip(spoiled, pairs)]
        given["ZoomOut, mirrored"] = ([image[turn] for image, turn in zip(points, turns)], spoiled)
    found = {}
    for name, (maps, wrong) in given.items():
        named = dict(zip(pairs, maps))
        options = {"maps": named, "n_basis": _N_BASIS, "n_refined": _N_REFINED, "n_draws": 40}
        options |= {} if np.ndim(maps[0]) == 1 or sp.issparse(maps[0]) else {"bases": bases}
        with diagnostics.short_run():  # scores do not depend on draws
            seen = observe(shapes, levels=(), vertices=vertices, **options)
        before = [_error(seen.evaluation, bases, pair, c) for pair, c in named.items()]
        y = seen.synced.refined
        after = [float(seen.evaluation.errors(i, j, y[i], y[j]).mean()) for i, j in pairs]
        found[name] = {"before": float(np.mean(before)), "after": float(np.mean(after))}
        found[name]["coverage of 90 %"] = seen.covered(default_calibration())["0.9"]
        if wrong is not None:
            found[name]["AUC of the inlier weights"] = float(roc_auc_score(~wrong, seen.synced.estimate.edge_weights))
    return found


def _pyfm(mesh_i, mesh_j) -> tuple[np.ndarray, np.ndarray]:
    """C_ij by pyFM with its defaults: the fit to WKS, and ZoomOut from it."""
    from pyFM.functional import FunctionalMapping

    model = FunctionalMapping(mesh_j, mesh_i)  # pyFM maps from its first mesh: our C_ij has j first
    model.preprocess(descr_type="WKS")
    model.fit()
    start = model.FM_12[:_N_BASIS, :_N_BASIS]
    return model.FM_12, model.zoomout_refine(start, nit=(_N_REFINED - _N_BASIS) // _STEP, step=_STEP)


def _points(c_ij: np.ndarray, basis_i: Basis, basis_j: Basis) -> np.ndarray:
    return point_map(c_ij, basis_i.truncated(len(c_ij)), basis_j.truncated(c_ij.shape[1]))


def _soft(c_ij: np.ndarray, basis_i: Basis, basis_j: Basis) -> sp.csr_array:
    """A soft map (V_i, V_j) that is ten times too hot: its weights fall off with the distance between embeddings."""
    at_i, at_j = basis_i.eigenfunctions[:, : len(c_ij)] @ c_ij, basis_j.eigenfunctions[:, : c_ij.shape[1]]
    distance, image = cKDTree(at_j).query(at_i, _NEIGHBOURS)
    temperature = _SOFT * np.median(distance[:, 0] ** 2)
    weight = np.exp(-(distance**2 - distance[:, :1] ** 2) / temperature)
    weight /= weight.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(len(at_i)), _NEIGHBOURS)
    return sp.csr_array((weight.ravel(), (rows, image.ravel())), shape=(len(at_i), len(at_j)))


def _error(evaluation: Evaluation, bases: list, pair: tuple[int, int], given) -> float:
    """Mean geodesic error of a given map; of a soft one where it is largest."""
    i, j = pair
    if sp.issparse(given):
        given = np.asarray(given.argmax(axis=1)).ravel()
    images = given if given.ndim == 1 else _points(given, bases[i], bases[j])
    at = np.arange(evaluation.vertices.shape[1])
    return float(evaluation.distances[j][at, images[evaluation.vertices[i]]].mean())
