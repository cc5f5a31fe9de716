"""Errors and CPU seconds of the stages of the pipeline, beside pyFM on the same bases, descriptors and samples."""

from collections.abc import Callable

import numpy as np

import fmsync
from bench.own_shapes.evaluation import Evaluation, evaluation_vertices, some_pairs
from bench.studies import cpu_seconds
from fmsync.adapters import to_pyfm
from fmsync.functional_maps import nearest_rows
from fmsync.matching import SyncedShapes, network, synchronize
from fmsync.matching.latent import sizes, upsample
from fmsync.matching.pairwise import FINE, improve, match, zoomout
from fmsync.matching.samples import farthest_points
from fmsync.shape import Shape
from fmsync.threads import single_threaded_blas

_STEP = 5  # functions that pyFM adds at a time


def remeshed(loaded: dict[str, list[Shape]], n_landmarks: int = 0, **options) -> dict:
    """Errors on copies of shapes with triangulations of their own; landmarks are far from each other."""
    found = {}
    for name, shapes in loaded.items():
        marks = np.tile(farthest_points(shapes[0].vertices, 4), (len(shapes), 1))
        copies, vertices = decimated(shapes, np.column_stack([marks, evaluation_vertices(shapes)]))
        landmarks = vertices[:, :n_landmarks] if n_landmarks else None
        synced = fmsync.synchronize_shapes(copies, rng=0, n_draws=0, landmarks=landmarks, **options)
        found[name] = stages(synced, Evaluation(synced.shapes, vertices[:, 4:]), peers=True)
    return found


def decimated(shapes: list[Shape], vertices: np.ndarray, share: float = 0.2) -> tuple[list[Shape], np.ndarray]:
    """Copies of about ``share`` of the vertices, another number for each shape, and those nearest to ``vertices``."""
    import pyvista as pv

    copies, moved = [], []
    for k, (shape, own) in enumerate(zip(shapes, vertices)):
        mesh = pv.PolyData.from_regular_faces(shape.vertices, shape.faces)
        mesh = mesh.decimate(1 - share * (0.9 + 0.2 * (k % 5) / 4))
        points = np.asarray(mesh.points, dtype=float)
        copies.append(Shape(points, mesh.regular_faces, shape.name))
        moved.append(nearest_rows(shape.vertices[own] - points.mean(axis=0), points - points.mean(axis=0)))
    return copies, np.array(moved)


def stages(synced: SyncedShapes, evaluation: Evaluation, peers: bool = False) -> dict:
    """Mean geodesic errors and CPU seconds of every stage after the bases and descriptors, which all share."""
    shapes, edges, n, m = synced.shapes, synced.edges, synced.problem.n, synced.refined.shape[-1]
    pairs, rng, light = some_pairs(len(shapes)), np.random.default_rng(0), [s.light(FINE) for s in shapes]
    seconds: dict[str, float] = {}

    def synchronised(matches: list):
        estimate, signs, _, problem = network.robust_maps(len(shapes), edges, matches, n, rng)
        turn = network.basis_signs(signs, n)[:, None]
        return estimate.absolute * turn, problem, turn

    def relative(absolute: np.ndarray) -> Callable:
        return lambda i, j: absolute[i].T @ absolute[j]

    matches = [match(light[i], light[j]) for i, j in edges]
    robust, problem, turn = synchronised(matches)
    plain = fmsync.solve(problem, "mle", tolerance=1e-3).absolute * turn
    proposed = matches
    with cpu_seconds(seconds, "synchronised maps proposed to the pairs"):
        for _ in range(synchronize.ROUNDS):
            better = relative(synchronised(proposed)[0])
            tried = [improve(light[i], light[j], better(i, j)) for i, j in edges]
            proposed = [min(old, new, key=lambda x: x.cost) for old, new in zip(proposed, tried)]
        start = synchronised(proposed)[0]
    own = both_ways(edges, matches)

    def upsampled(i: int, j: int) -> np.ndarray:
        return zoomout(shapes[i], shapes[j], relative(robust)(i, j)[None], m, 5)[0][0]

    errors = {
        "pairwise (with its own ZoomOut)": evaluation.mean(pairs, lambda i, j: own[i, j]),
        "synchronised": evaluation.mean(pairs, relative(plain)),
        "robustly synchronised": evaluation.mean(pairs, relative(robust)),
        "robustly synchronised, upsampled": evaluation.mean(pairs, upsampled),
        "proposed to the pairs, synchronised": evaluation.mean(pairs, relative(start)),
    }
    maps = np.array([x.c_ij[:n, :n] for x in proposed])
    for size in sorted({min(size, m) for size in (FINE, 80, m)}):
        with cpu_seconds(seconds, f"upsampled together to {size}"):
            latent = upsample(shapes, edges, maps, sizes(n, size))
        missed = [evaluation.errors(i, j, latent[i], latent[j]) for i, j in pairs]
        errors[f"pipeline (upsampled together to {size})"] = float(np.mean(missed))
    if peers:
        pyfm_stages(synced, evaluation, matches, errors, seconds)
    return {"mean_geodesic_error": errors, "cpu_seconds": seconds}


def pyfm_stages(synced: SyncedShapes, evaluation: Evaluation, matches: list, errors: dict, seconds: dict) -> None:
    """Add pyFM's fit, ZoomOut of it, and Consistent ZoomOut of it and of our maps before and after synchronisation."""
    from pyFM.FMN import FMN
    from pyFM.functional import FunctionalMapping
    from pyFM.refine.zoomout import zoomout_refine

    n, m, edges, pairs = synced.problem.n, synced.refined.shape[-1], synced.edges, some_pairs(len(synced.shapes))
    fine, samples = min(FINE, m), np.array([s.samples for s in synced.shapes])
    meshes = [to_pyfm(s.shape, s.basis) for s in synced.shapes]

    def fit(i: int, j: int) -> np.ndarray:
        model = FunctionalMapping(meshes[j], meshes[i])  # pyFM maps from its first mesh: our C_ij has j first
        model.add_descriptors(synced.shapes[j].descriptors, synced.shapes[i].descriptors)
        model.fit(K=(n, n))  # its own default weights
        return model.FM_12

    def refine(i: int, j: int) -> np.ndarray:
        options = {"nit": (fine - n) // _STEP, "step": _STEP, "subsample": (samples[j], samples[i])}
        return zoomout_refine(fitted[i, j], meshes[j].eigenvectors, meshes[i].eigenvectors, **options)

    def consistent(start: dict, size: int) -> dict:
        network = FMN(meshes)
        network.set_maps({(j, i): c[:n, :n].copy() for (i, j), c in start.items()})
        network.set_subsample(samples)
        network.M = n
        while size > network.M:
            network.zoomout_iteration(int(0.9 * network.M), network.M, network.M + _STEP, weight_type="icsm")
        return {(i, j): np.array(c) for (j, i), c in network.maps.items()}

    with single_threaded_blas():
        fitted = {(i, j): fit(i, j) for i, j in [*edges.tolist(), *edges[:, ::-1].tolist()]}
        errors["pyFM pairwise"] = evaluation.mean(pairs, lambda i, j: fitted[i, j])
        errors["pyFM pairwise + ZoomOut"] = evaluation.mean(pairs, refine)
        own, after = both_ways(edges, matches), both_ways(edges, synced.matches)
        starts = [("its own fit", fitted, fine), ("our pairwise maps", own, fine), ("our pairwise maps", own, m)]
        for name, start, size in [*starts, ("our pairs after proposals", after, fine)]:
            key = f"pyFM Consistent ZoomOut to {size} from {name}"
            with cpu_seconds(seconds, key):
                maps = consistent(start, size)
            errors[key] = evaluation.mean(pairs, lambda i, j, maps=maps: maps[i, j])


def both_ways(edges: np.ndarray, matches: list) -> dict[tuple[int, int], np.ndarray]:
    """Maps of the pairs by (i, j), and their transposes by (j, i)."""
    one_way = {tuple(e): m.c_ij for e, m in zip(edges.tolist(), matches)}
    return one_way | {(j, i): c.T for (i, j), c in one_way.items()}
