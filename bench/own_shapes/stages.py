"""Errors, where the vertex order is known, and CPU seconds of the stages of the pipeline; pyFM on the same input."""

from collections.abc import Callable, Sequence

import numpy as np

import fmsync
from bench.problems import geodesics_from
from bench.studies import cpu_seconds
from data_gen import Creature, load_collection
from fmsync.adapters import from_pyvista, to_pyfm, to_pyvista
from fmsync.functional_maps import nearest_rows
from fmsync.matching import SyncedShapes, network, synchronize
from fmsync.matching.confidence import samples_to_vertices
from fmsync.matching.latent import directions, upsample
from fmsync.matching.pairwise import FINE, match, zoomout
from fmsync.matching.samples import SampledShape, descriptors
from fmsync.shape import Shape
from fmsync.threads import single_threaded_blas

_STEP = 5  # functions that pyFM adds at a time


class Evaluation:
    """Geodesic distances from the true images of some vertices, by the heat method on the full meshes.

    ``vertices`` (N, P) are the evaluation vertices of every shape: the same point of the surface in every column. They
    belong at those of the other shapes, or at ``images`` (N, P).
    """

    def __init__(self, shapes: Sequence[SampledShape], vertices: np.ndarray, images: np.ndarray | None = None):
        self.shapes, self.vertices = shapes, vertices
        true = vertices if images is None else images
        self.distances = [geodesics_from(s.shape, own) for s, own in zip(shapes, true)]

    def images(self, i: int, j: int, first: np.ndarray, second: np.ndarray | None = None) -> np.ndarray:
        """(P,) vertices of j to which the evaluation vertices of i are sent.

        Vertices are matched by the directions of functions that both shapes share, to which ``first`` (M, m_i) and
        ``second`` (M, m_j) map their coefficients; without ``second`` by the functions of j, to which ``first`` =
        C_ij^T maps.
        """
        at_i = self.shapes[i].basis.eigenfunctions[self.vertices[i], : first.shape[1]] @ first.T
        at_j = self.shapes[j].basis.eigenfunctions[:, : len(first) if second is None else second.shape[1]]
        if second is None:
            return nearest_rows(at_i, at_j)
        return nearest_rows(directions(at_i), directions(at_j @ second.T))

    def errors(self, i: int, j: int, first: np.ndarray, second: np.ndarray | None = None) -> np.ndarray:
        """(P,) distance on shape j from the :meth:`images` of the evaluation vertices of i to where they belong."""
        images = self.images(i, j, first, second)
        return self.distances[j][np.arange(len(images)), images]

    def change(self, i: int, j: int, images: np.ndarray) -> float:
        """Mean absolute change of the distances between the evaluation vertices of i at their ``images`` (P,) on j.

        Only if the vertices belong at those of the other shapes: then distances are from the vertices.
        """
        there = geodesics_from(self.shapes[j].shape, images)[:, images]
        return float(np.abs(there - self.distances[i][:, self.vertices[i]]).mean())

    def mean(self, pairs: Sequence[tuple[int, int]], maps: Callable) -> float:
        """Mean error over pairs of the maps C_ij that ``maps(i, j)`` gives."""
        return float(np.mean([self.errors(i, j, maps(i, j).T) for i, j in pairs]))

    def at(self, i: int, values: np.ndarray) -> np.ndarray:
        """Values at the samples of shape i carried to the evaluation vertices."""
        return samples_to_vertices(self.shapes[i], values)[self.vertices[i]]


def species(number: int, count: int = 4) -> list[Creature]:
    """Poses of a random species, each with a triangulation of its own."""
    return load_collection("creatures", species=number, count=count, n_vertices=1500, remeshed=True)


def evaluation_vertices(shapes: list[Shape], count: int = 80) -> np.ndarray:
    """(N, P) vertices at which errors are measured, of shapes of one order or of creatures."""
    located = [s.located if isinstance(s, Creature) else np.arange(s.n_vertices) for s in shapes]
    chosen = np.random.default_rng(0).choice(len(located[0]), min(count, len(located[0])), replace=False)
    return np.array([own[chosen] for own in located])


def some_pairs(count: int, most: int = 22) -> list[tuple[int, int]]:
    """Ordered pairs of ``count`` shapes, evenly from all."""
    ordered = [(i, j) for i in range(count) for j in range(count) if i != j]
    return [ordered[k] for k in np.linspace(0, len(ordered) - 1, min(most, len(ordered))).astype(int)]


def decimated(shapes: list[Shape], vertices: np.ndarray, share: float = 0.2) -> tuple[list[Shape], np.ndarray]:
    """Copies of about ``share`` of the vertices, another number for each shape, and those nearest to ``vertices``."""
    copies, moved = [], []
    for k, (shape, own) in enumerate(zip(shapes, vertices)):
        mesh = to_pyvista(shape).decimate(1 - share * (0.9 + 0.2 * (k % 5) / 4))
        copies.append(from_pyvista(mesh, shape.name))
        points = copies[k].vertices
        moved.append(nearest_rows(shape.vertices[own] - points.mean(axis=0), points - points.mean(axis=0)))
    return copies, np.array(moved)


def stages(synced: SyncedShapes, evaluation: Evaluation, peers: bool = False) -> dict:
    """Mean geodesic errors and CPU seconds of every stage after the bases and descriptors, which all share."""
    shapes, edges, n, m = synced.shapes, synced.edges, synced.problem.n, synced.refined.shape[-1]
    pairs, rng, light = some_pairs(len(shapes)), np.random.default_rng(0), [s.light(FINE) for s in shapes]
    seconds: dict[str, float] = {}

    def synchronised(matches: list):
        estimate, signs, problem = network.robust_maps(len(shapes), edges, matches, n, rng)
        turn = network.basis_signs(signs, n)[:, None]
        return estimate.absolute * turn, problem, turn

    def relative(absolute: np.ndarray) -> Callable:
        return lambda i, j: absolute[i].T @ absolute[j]

    def proposals(found: list) -> np.ndarray:
        better = relative(synchronised(found)[0])
        return np.array([better(i, j) for i, j in edges])

    matches = [match(light[i], light[j]) for i, j in edges]
    robust, problem, turn = synchronised(matches)
    plain = fmsync.solve(problem, "mle", tolerance=1e-3).absolute * turn
    with cpu_seconds(seconds, "synchronised maps proposed to the pairs"):
        each = synchronize.parallel(1, progress=False)
        proposed = synchronize.with_proposals(each, light, edges, matches, proposals)
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
    maps = np.array([x.c_ij for x in proposed])
    for size in sorted({min(size, m) for size in (FINE, 80, m)}):
        with cpu_seconds(seconds, f"refined together to {size}"):
            latent = upsample(shapes, edges, maps, size)
        missed = [evaluation.errors(i, j, latent[i], latent[j]) for i, j in pairs]
        errors[f"pipeline (refined together to {size})"] = float(np.mean(missed))
    if peers:
        pyfm_stages(synced, evaluation, matches, errors, seconds)
    ours = [evaluation.change(i, j, evaluation.images(i, j, latent[i], latent[j])) for i, j in pairs]
    true = [evaluation.change(i, j, evaluation.vertices[j]) for i, j in pairs]
    change = {"pairs": len(pairs), "ours": np.mean(ours), "true maps": np.mean(true)}
    change["pairs where ours is smaller"] = int(np.less(ours, true).sum())
    return {"mean_geodesic_error": errors, "cpu_seconds": seconds, "mean_change_of_distances": change}


class Pyfm:
    """pyFM on the bases and samples of our shapes; its maps are our C_ij."""

    def __init__(self, shapes: Sequence[SampledShape]):
        self.meshes = [to_pyfm(s.shape, s.basis) for s in shapes]
        self._samples = np.array([s.samples for s in shapes])

    def model(self, i: int, j: int):
        """A ``FunctionalMapping`` to fit: pyFM maps from its first mesh, our C_ij has j first."""
        from pyFM.functional import FunctionalMapping

        return FunctionalMapping(self.meshes[j], self.meshes[i])

    def zoomout(self, i: int, j: int, start: np.ndarray, size: int) -> np.ndarray:
        """A map upsampled to ``size`` functions."""
        from pyFM.refine.zoomout import zoomout_refine

        vectors, samples = zip(*((self.meshes[k].eigenvectors, self._samples[k]) for k in (j, i)))
        return zoomout_refine(start, *vectors, nit=(size - len(start)) // _STEP, step=_STEP, subsample=samples)

    def consistent(self, start: dict, n: int, size: int) -> dict[tuple[int, int], np.ndarray]:
        """Consistent ZoomOut of maps both ways, cut to n functions, to ``size``."""
        from pyFM.FMN import FMN

        network = FMN(self.meshes)
        network.set_maps({(j, i): c[:n, :n].copy() for (i, j), c in start.items()})
        network.set_subsample(self._samples)
        network.M = n
        while size > network.M:
            network.zoomout_iteration(int(0.9 * network.M), network.M, network.M + _STEP, weight_type="icsm")
        return {(i, j): np.array(c) for (j, i), c in network.maps.items()}


def pyfm_stages(synced: SyncedShapes, evaluation: Evaluation, matches: list, errors: dict, seconds: dict) -> None:
    """Add pyFM's fit, ZoomOut of it, and Consistent ZoomOut of it and of our maps before and after synchronisation."""
    n, m, edges, pairs = synced.problem.n, synced.refined.shape[-1], synced.edges, some_pairs(len(synced.shapes))
    shapes, fine, pyfm = synced.shapes, min(FINE, m), Pyfm(synced.shapes)

    def fit(i: int, j: int) -> np.ndarray:
        model = pyfm.model(i, j)
        model.add_descriptors(*(descriptors(s.basis, s.samples[: s.n_landmarks]) for s in (shapes[j], shapes[i])))
        model.fit(K=(n, n))  # its own default weights
        return model.FM_12

    with single_threaded_blas():
        fitted = {(i, j): fit(i, j) for i, j in [*edges.tolist(), *edges[:, ::-1].tolist()]}
        errors["pyFM pairwise"] = evaluation.mean(pairs, lambda i, j: fitted[i, j])
        zoomed = evaluation.mean(pairs, lambda i, j: pyfm.zoomout(i, j, fitted[i, j], fine))
        errors["pyFM pairwise + ZoomOut"] = zoomed
        own, after = both_ways(edges, matches), both_ways(edges, synced.matches)
        starts = [("its own fit", fitted, fine), ("our pairwise maps", own, fine), ("our pairwise maps", own, m)]
        for name, start, size in [*starts, ("our pairs after proposals", after, fine)]:
            key = f"pyFM Consistent ZoomOut to {size} from {name}"
            with cpu_seconds(seconds, key):
                maps = pyfm.consistent(start, n, size)
            errors[key] = evaluation.mean(pairs, lambda i, j, maps=maps: maps[i, j])


def both_ways(edges: np.ndarray, matches: list) -> dict[tuple[int, int], np.ndarray]:
    """Maps of the pairs by (i, j), and their transposes by (j, i)."""
    one_way = {tuple(e): m.c_ij for e, m in zip(edges.tolist(), matches)}
    return one_way | {(j, i): c.T for (i, j), c in one_way.items()}
