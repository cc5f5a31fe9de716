"""One shape more in a synchronised collection, whose other shapes stay as they are."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fmsync import checks, so
from fmsync.estimators import Estimate
from fmsync.matching import synchronize as stages
from fmsync.matching.latent import ROUNDS, directions, map_from_values, rigid_bodies
from fmsync.matching.network import basis_signs, inlier_weights, robust_estimate
from fmsync.matching.outliers import belonging, spectral_distances
from fmsync.matching.pairwise import FINE, PairMatch, match, zoomout
from fmsync.matching.rigid import rigid_map
from fmsync.matching.samples import SampledShape, sample_shape
from fmsync.problem import SyncProblem
from fmsync.samplers import Posterior
from fmsync.samplers.heat_bath import advance
from fmsync.samplers.plane_rotations import rounds
from fmsync.samplers.random_streams import generators
from fmsync.shape import Shape
from fmsync.threads import single_threaded_blas

_STEP, _SETTLE = 6, 8  # functions by which the new maps grow, and rounds at the final size among point clouds
_SWEEPS = 30  # from the mode of a unimodal density, in which planes hardly depend on each other


@checks.checked(landmarks=">= 0")
def add_shape(
    synced: stages.SyncedShapes,
    shape: Shape,
    *,
    neighbours: int | None = None,
    landmarks: Sequence[int] | None = None,
    jobs: int = 1,
    rng: int | np.random.Generator = 0,
) -> stages.SyncedShapes:
    """The collection with one shape more, at the end; maps, draws and functions of the others stay as they are.

    The shape is matched to all others, or to so many ``neighbours`` by spectrum, as :func:`fmsync.synchronize_shapes`
    does (``landmarks``, ``jobs`` and ``rng`` are as there), and its map solved for robustly given theirs. Each of their
    draws gets one of its map from the exact conditional density; what the new maps say about the others is not used.
    Among meshes its samples move as rigidly as possible, also where the others were synchronised ``fast``.

    >>> import data_gen, fmsync
    >>> *cats, last = data_gen.load_collection("cats", count=3, n_vertices=1000)
    >>> synced = fmsync.synchronize_shapes(cats, n_basis=10, n_refined=20, n_samples=150, n_draws=0)
    >>> fmsync.matching.add_shape(synced, last).point_map(2, 0).shape
    (1000,)
    """
    rng, old, n, before = np.random.default_rng(rng), synced.shapes, synced.problem.n, len(synced.edges)
    if shape.name in synced.names:
        shape = replace(shape, name=f"{shape.name} (shape {len(old)})")
    everybody = [*(s.shape for s in old), shape]
    stages.check_shapes(everybody, old[0].basis.n)
    size = max(len(s.samples) for s in old)
    given: list[Any] = [*(s.samples[: s.n_landmarks] for s in old), [] if landmarks is None else landmarks]
    marks = stages.checked_landmarks(given, everybody, size)[-1]
    shapes = (*old, sample_shape(shape, old[0].basis.n, size, n, marks, None, not synced.map_names))
    _, outliers = belonging(shapes, drop=False)
    others = np.sort(np.argsort(spectral_distances(shapes)[-1, :-1], kind="stable")[:neighbours])
    edges, fixed = np.column_stack([others, np.full(len(others), len(old))]), synced.estimate.absolute[others]
    turn, each = basis_signs(synced.signs[others], n)[:, :, None], stages.parallel(jobs, False)  # (K, n, 1)
    light = [s.light(FINE) for s in shapes]
    matches = each("pairs", match, [(light[i], light[j]) for i, j in edges])
    matches = stages.with_proposals(each, light, edges, matches, lambda found: _placed(fixed, turn, found, rng)[-1])
    star, sign, observed, relative = _placed(fixed, turn, matches, rng)
    weights = inlier_weights(star)
    trusted = weights >= min(0.5, weights.max())
    problem, posterior = _extended(synced.problem, edges, observed), synced.posterior
    absolute = np.concatenate([synced.estimate.absolute, star.absolute[1:]])
    weights = np.concatenate([inlier_weights(synced.estimate), weights])
    refined = _refined(synced, shapes[-1], others[trusted], relative[trusted])
    return stages.SyncedShapes(
        shapes=shapes,
        edges=problem.edges,
        matches=(*synced.matches, *matches),
        signs=np.append(synced.signs, sign),
        problem=problem,
        estimate=Estimate.from_absolute(problem, absolute, "robust", edge_weights=weights),
        posterior=posterior and _with_draws(posterior, edges[trusted], observed[trusted], rng),
        refined=np.concatenate([synced.refined, refined[None]]),
        map_names=synced.map_names and (*synced.map_names, *(f"{synced.names[k]}–{shape.name}" for k in others)),
        used=np.concatenate([synced.used, before + np.flatnonzero(trusted)]),
        outliers=tuple(dict.fromkeys([*synced.outliers, *outliers])),
    )


def _placed(
    fixed: np.ndarray, turn: np.ndarray, matches: Sequence[PairMatch], rng: np.random.Generator
) -> tuple[Estimate, float, np.ndarray, np.ndarray]:
    """The new map given the others', its sign, rotations (K, n, n) observed, and synchronised maps in our bases."""
    n = fixed.shape[-1]
    maps = turn * np.array([m.c_ij[:n, :n] for m in matches])
    sign = -1.0 if np.sign(np.linalg.det(maps)).sum() < 0 else 1.0
    own = basis_signs(np.array([sign]), n)
    observed = so.project(maps * own)
    star = SyncProblem(2, [[0, 1]] * len(maps), fixed @ observed)  # every C_k C_kj observes the one map C_j
    estimate = robust_estimate(star, rng)
    return estimate, sign, observed, turn * (so.transpose(fixed) @ estimate.absolute[1]) * own


def _extended(problem: SyncProblem, edges: np.ndarray, maps: np.ndarray) -> SyncProblem:
    both = np.concatenate([problem.edges, edges]), np.concatenate([problem.maps, maps])
    return SyncProblem(problem.n_nodes + 1, *both)


def _with_draws(posterior: Posterior, edges: np.ndarray, maps: np.ndarray, rng: np.random.Generator) -> Posterior:
    """Draws of the new map given those of the others, by the heat bath: density exp(κ tr(SᵀC)), S = Σ C_k C_kj."""
    n, size = maps.shape[-1], posterior.energy.shape
    force = sum(posterior.absolute[:, :, k] @ c for k, c in zip(edges[:, 0], maps)).reshape(-1, n, n)
    # transposed maps of two nodes: an identity that is not visited, and the new map from its mode on
    x = np.stack([np.broadcast_to(np.eye(n), force.shape), so.transpose(so.project(force))], axis=1)
    observed, weights, incidence = force[:, None], np.ones((1, 1)), SyncProblem(2, [[0, 1]], np.eye(n)[None]).incidence
    for a in (observed, weights):
        a.setflags(write=False)
    streams, ones, traces = generators(rng, len(x), 2), np.ones(len(x)), np.zeros(len(x))
    fixed = observed, weights, incidence, np.empty((0, n, n)), rounds(n), np.array([1]), streams, np.zeros((len(x), 2))
    states, kept = np.ascontiguousarray(streams[:, 0]), (x[:, None].copy(), *np.zeros((2, len(x), 1)))
    for _ in range(_SWEEPS):
        advance(x, *fixed, traces, posterior.kappa.ravel(), ones, False, 0.0, np.empty((2, 0)), states, kept)
    drawn = so.transpose(x[:, 1])
    return replace(
        posterior,
        problem=_extended(posterior.problem, edges, maps),
        absolute=np.concatenate([posterior.absolute, drawn.reshape(*size, 1, n, n)], axis=2),
        energy=posterior.energy + 2 * (n * len(maps) - (force * drawn).sum((1, 2)).reshape(size)),
    )


def _refined(synced: stages.SyncedShapes, new: SampledShape, others: np.ndarray, maps: np.ndarray) -> np.ndarray:
    """(M, m) map of the new shape to the functions that the others share, from maps (K, n, n) to it."""
    known, old = synced.refined[others], [synced.shapes[k] for k in others]
    m, bodies = known.shape[-1], rigid_bodies([*old, new])

    def placed(grown: Sequence[np.ndarray]) -> np.ndarray:  # minimises the cost of latent_maps, with equal weights
        maps = np.array(grown)  # from the new shape
        squares = (so.transpose(maps) @ maps + np.eye(m)).sum(axis=0)
        return np.linalg.solve(squares, 2 * (so.transpose(maps) @ so.transpose(known)).sum(axis=0)).T

    with single_threaded_blas():
        *at, own = [s.sampled()[:, :m] for s in (*old, new)]
        *back, own_back = [np.linalg.pinv(phi) for phi in (*at, own)]
        values = [directions(phi @ y.T) for phi, y in zip(at, known)]
        latent = placed([zoomout(s, new, c[None], m, _STEP)[0][0] for s, c in zip(old, maps)])
        for step in range(ROUNDS if bodies else _SETTLE):
            mine = directions(own @ latent.T)
            if not bodies:
                pairs = zip(at, back, values)
                grown = [map_from_values((a, own), (b, own_back), (v, mine)) for a, b, v in pairs]
            elif step % 2:
                own_body, others_of = bodies[-1], zip(bodies, old, values)
                grown = [rigid_map((own_body, body), own_back, s, (mine, v)).T for body, s, v in others_of]
            else:
                grown = [rigid_map((body, bodies[-1]), b, new, (v, mine)) for body, b, v in zip(bodies, back, values)]
            latent = placed(grown)
    return latent
