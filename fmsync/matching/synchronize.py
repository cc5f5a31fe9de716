"""From shapes to consistent maps with a confidence: the stages of the pipeline in order."""

import contextlib
import itertools
import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import joblib
import networkx as nx
import numpy as np
from tqdm import tqdm

from fmsync import checks, so
from fmsync.estimators import Estimate
from fmsync.estimators.base import nearest
from fmsync.files import replacing
from fmsync.functional_maps import nearest_rows_unchecked as nearest_rows
from fmsync.functional_maps import vertex_images
from fmsync.matching import network
from fmsync.matching.confidence import Confidence, confidence, draw_images
from fmsync.matching.given_maps import Maps, best_of_pairs, checked_maps, given_matches
from fmsync.matching.latent import directions, upsample
from fmsync.matching.outliers import among, belonging, spectral_distances
from fmsync.matching.pairwise import FINE, PairMatch, improve, match
from fmsync.matching.samples import SampledShape, sample_shape
from fmsync.memory import give_back
from fmsync.problem import SyncProblem
from fmsync.samplers import Posterior
from fmsync.shape import Basis, Shape
from fmsync.threads import single_threaded_blas

_RECIPE = 3  # of a pair's map: another number makes finished pairs anew
_ROUNDS = 2  # of proposing synchronised maps to the pairs
_COMPOSED = 3  # two-hop compositions that are tried as well
_DRAWS_SHOWN = 100  # draws that carry vertices
_MIRRORED = 0.6  # distortion of left-right turned maps relative to the others, median over the edges of a shape


@dataclass(frozen=True, eq=False)
class SyncedShapes:
    """Shapes with consistent maps.

    ``shapes`` are N sampled shapes, of unit area when small holes are closed; ``edges`` (E, 2) pairs and ``matches``
    their maps, from descriptors or as they were given, with ``map_names`` then; ``signs`` (N,) ±1 of the last function
    of each; ``problem``, ``estimate`` and ``posterior`` the n x n synchronisation problem, its robust answer, and draws
    (None if none were asked for). ``refined`` (N, M, m) are maps from the refined bases to M <= m functions that all
    shapes share, whose values match points (:meth:`shared_functions`); rows are not orthonormal, and a function that a
    shape hardly has counts little there. ``used`` (U,) are the edges whose maps carry points: all, or of given maps
    those of least cost of each pair that are trusted. ``outliers`` names the shapes that are unlike the rest, whether
    they were left out or are among ``shapes``.
    """

    shapes: tuple[SampledShape, ...]
    edges: np.ndarray
    matches: tuple[PairMatch, ...]
    signs: np.ndarray
    problem: SyncProblem
    estimate: Estimate
    posterior: Posterior | None
    refined: np.ndarray
    map_names: tuple[str, ...]
    used: np.ndarray
    outliers: tuple[str, ...] = ()

    @property
    def names(self) -> list[str]:
        """Names of the shapes."""
        return [s.shape.name for s in self.shapes]

    @property
    def edge_names(self) -> list[str]:
        """What messages call the edges: names of given maps, or of two shapes."""
        names = self.names
        return list(self.map_names) or [f"{names[i]}–{names[j]}" for i, j in self.edges]

    @property
    def observed(self) -> dict[tuple[int, int], np.ndarray]:
        """Maps C_ij (m, m) of the pairs whose maps are used, both ways."""
        found = {}
        for e in self.used:
            i, j = self.edges[e].tolist()
            found[i, j], found[j, i] = self.matches[e].c_ij, self.matches[e].c_ij.T
        return found

    @checks.checked(i="< N", j="< N")
    def functional_map(self, i: int, j: int, bases: Sequence[Basis] | None = None) -> np.ndarray:
        """Synchronised map C_ij of rank M, (m, m) in the bases of ``shapes``, whose signs are ours.

        A product of factors with orthonormal rows, so that cycles close; :meth:`point_map` is the better point map.
        Or (n_i, n_j) between other ``bases`` of these shapes, such as those that came with given maps.
        """
        first, second = nearest(self.refined[[i, j]], "O")
        c = first.T @ second
        if bases is None:
            return c
        ours = [self.shapes[k].basis.truncated(len(c)) for k in (i, j)]
        return bases[i].coefficients(ours[0].eigenfunctions) @ c @ ours[1].coefficients(bases[j].eigenfunctions)

    @checks.checked(i="< N", vertices="K < V")
    def shared_functions(self, i: int, vertices: np.ndarray | slice = slice(None)) -> np.ndarray:
        """(V_i, M) unit vectors by which points are matched: directions of the shared functions' values at vertices."""
        if not isinstance(vertices, slice):
            checks.indices("vertices", vertices, self.shapes[i].basis.n_vertices)
        functions = self.shapes[i].basis.eigenfunctions[vertices, : self.refined.shape[-1]]
        return directions(functions @ self.refined[i].T.astype(functions.dtype))

    @checks.checked(i="< N", j="< N")
    def sample_images(self, i: int, j: int) -> np.ndarray:
        """(S_i,) sample of j for each sample of i."""
        return nearest_rows(*(self.shared_functions(k, self.shapes[k].samples) for k in (i, j)))

    @checks.checked(i="< N", j="< N")
    def point_map(self, i: int, j: int) -> np.ndarray:
        """(V_i,) vertex of j for each vertex of i."""
        with single_threaded_blas():
            return nearest_rows(self.shared_functions(i), self.shared_functions(j))

    @checks.checked(i="< N", j="< N", level=checks.probability, point_map=checks.plain)
    def confidence(self, i: int, j: int, level: float = 0.9, point_map: np.ndarray | None = None) -> Confidence:
        """How far to trust the images on j of the samples of i (ValueError without posterior draws).

        ``point_map`` (V_i,) is :meth:`point_map` of i and j, if that is known already.
        """
        first, second, draws = self.shapes[i], self.shapes[j], self.draws(i, j, _DRAWS_SHOWN)
        with single_threaded_blas():
            image = self.sample_images(i, j)
            if point_map is None:
                vertex = nearest_rows(self.shared_functions(i, first.samples), self.shared_functions(j))
            else:
                own, count = checks.indices("point_map", point_map, second.shape.n_vertices), first.shape.n_vertices
                if len(own) != count:
                    raise ValueError(f"point_map: {len(own)} vertices; {first.shape.name} has {count}")
                vertex = own[first.samples]
        return confidence(first, second, image, vertex, draws, self.votes(i, j), level)

    @checks.checked(i="< N", j="< N")
    def draws(self, i: int, j: int, count: int) -> np.ndarray:
        """(T, n, n) posterior draws of C_ij in the bases of ``shapes``, at most ``count``, evenly from all of them."""
        if self.posterior is None:
            raise ValueError("n_draws: there are no posterior draws; synchronise with n_draws > 0")
        flat = self.posterior.absolute.reshape(-1, *self.posterior.absolute.shape[2:])
        flat = flat[np.linspace(0, len(flat) - 1, min(count, len(flat))).astype(int)]
        return network.flipped(so.transpose(flat[:, i]) @ flat[:, j], np.array([[i, j]]), self.signs)

    @checks.checked(i="< N", j="< N", vertex=">= 0")
    def vertex_images(self, i: int, j: int, vertex: int, count: int = 100) -> np.ndarray:
        """(T,) vertices of shape j where ``count`` posterior draws send one vertex of shape i."""
        n = self.problem.n
        a, b = self.shapes[i].basis.truncated(n), self.shapes[j].basis.truncated(n)
        return vertex_images(self.draws(i, j, count), a, b, vertex)

    @checks.checked(i="< N", j="< N")
    def votes(self, i: int, j: int) -> np.ndarray:
        """(W, S_i) where observed maps send the samples of i: straight to j, and through every other shape."""
        observed = self.observed

        def images(a: int, b: int) -> np.ndarray:
            return draw_images(self.shapes[a], self.shapes[b], observed[a, b][None])[0]

        votes = [images(i, j)] if (i, j) in observed else []
        through = [k for k in range(len(self.shapes)) if (i, k) in observed and (k, j) in observed]
        votes += [images(k, j)[images(i, k)] for k in through]
        return np.array(votes or [self.sample_images(i, j)])


@checks.checked(n_basis=">= 2", n_draws=">= 0", graph=">= 0", landmarks=">= 0")
def synchronize_shapes(
    shapes: Sequence[Shape],
    *,
    maps: Maps | None = None,
    bases: Sequence[Basis] | None = None,
    n_basis: int = 20,
    n_refined: int = 120,
    n_samples: int = 1000,
    graph: str | Sequence[tuple[int, int]] = "complete",
    n_draws: int = 1000,
    landmarks: Sequence[Sequence[int]] | None = None,
    jobs: int = 1,
    checkpoint: str | Path | None = None,
    progress: bool = False,
    drop_outliers: bool = False,
    fast: bool = False,
    rng: int | np.random.Generator = 0,
) -> SyncedShapes:
    """Consistent functional maps of shapes, from the shapes alone or from given ``maps``, with posterior draws.

    Bases and evenly spread samples; a map for every pair of the graph (:func:`fmsync.matching.pairwise.match`); signs;
    robust synchronisation; synchronised maps and two-hop compositions proposed to every pair, taken where they keep
    distances better; posterior with inferred concentration; larger maps through functions that all shapes share, of
    meshes by moving samples as rigidly as possible (``fmsync.matching.rigid``). A shape in several pieces, inside
    out or mirrored is a ValueError that names it; shapes of equal names become ``name (shape k)``. Shapes that are
    unlike the rest are named in a warning, or left out (:mod:`fmsync.matching.outliers`).
    Unless maps are given, small holes are closed for bases and distances, not in ``shapes``.

    Given maps are data and none is replaced by a proposal, which would hide the wrong ones. Those that the others
    contradict get an inlier weight near 0 in ``estimate.edge_weights``. Of the rest, posterior and points use the best
    of each pair: errors of several maps of one pair are not independent.

    * ``shapes``: at least two meshes or point clouds in any unit, with any numbers of vertices, each in one piece.
    * ``maps``, ``bases``: maps from i to j, ``{(i, j): map}``, instead of the pipeline's own: any pairs that connect
      all shapes, in one direction or both; ``{name: map}`` or a list for several of a pair. One axis of whole numbers
      is a point map (V_i,) of vertices of j counted from zero, -1 for unmatched ones; a ``scipy.sparse`` matrix a soft
      map (V_i, V_j), rows summing to at most one; any other matrix a functional map C_ij (n_i, n_j), from coefficients
      on j to those on i, n_i and n_j >= ``n_basis``, in the first functions of ``bases`` or, without these, of
      :func:`fmsync.laplace_beltrami` alone: other programs choose other signs. A map that does not fit, or fits far
      better in reverse, and functional maps that mostly fit far better with other signs are a ValueError; poor ones,
      and maps that no cycle of trusted ones checks, are named in a warning.
    * ``n_basis``, ``n_refined``: size n of the maps that are sampled, and m >= n of those that carry points.
    * ``n_samples``, ``n_draws``: samples of each shape, at least n, and posterior draws (0 for none).
    * ``graph``: ``"complete"``; ``"k"`` + a number: as many neighbours by spectrum, such as ``"k4"``; or pairs (i, j)
      that connect all shapes.
    * ``landmarks``: for each shape the same L <= ``n_samples`` vertices in the same order.
    * ``jobs``, ``checkpoint``: processes of bases and pairs, through joblib and its active backend, and threads of the
      last stage; folder of pairs that are finished. ``progress`` shows a bar for each long stage.
    * ``drop_outliers``: leave out shapes that do not belong: by their spectra or, for ``n_refined`` >= 50, by how their
      maps distort. ``fast``: the last stage by functions alone, in larger steps, as if the shapes were point clouds.

    >>> import data_gen, fmsync
    >>> cats = data_gen.load_collection("cats", count=3, n_vertices=1000)
    >>> synced = fmsync.synchronize_shapes(cats, n_basis=10, n_refined=20, n_samples=150, n_draws=0)
    >>> synced.point_map(0, 2).shape
    (1000,)
    """
    rng, names = np.random.default_rng(rng), [s.name for s in shapes]
    shapes = [replace(s, name=f"{s.name} (shape {k})") if names.count(s.name) > 1 else s for k, s in enumerate(shapes)]
    if n_basis > min(n_refined, n_samples):
        most = f"n_refined = {n_refined} and n_samples = {n_samples} at most"
        raise ValueError(f"n_basis = {n_basis}: lower it to {most}")
    check_shapes(shapes, n_refined)
    marks = [None] * len(shapes) if landmarks is None else checked_landmarks(landmarks, shapes, n_samples)
    if bases if maps is None else graph != "complete":
        raise ValueError("bases, graph: the one belongs to given maps, the other to shapes without; leave it out")
    given = () if maps is None else checked_maps(maps, shapes, bases, n_basis)
    pairs = np.array([(g.i, g.j) for g in given]) if given else _checked_graph(graph, len(shapes))
    each = parallel(jobs, progress)
    each_shape = [(s, n_refined, n_samples, n_basis, m, None, not given) for s, m in zip(shapes, marks)]
    sampled = tuple(each("bases", sample_shape, each_shape))
    stay, outliers = belonging(sampled, drop_outliers)
    sampled = tuple(sampled[k] for k in stay)
    if not isinstance(pairs, int):
        kept, pairs = among(stay, pairs)
        given = tuple(replace(given[g], i=int(i), j=int(j)) for g, (i, j) in zip(kept, pairs)) if given else given
    edges = _neighbours(sampled, pairs) if isinstance(pairs, int) else pairs
    if given:
        matches = given_matches(given, sampled, bases and [bases[k] for k in stay])
    else:
        light = [s.light(FINE) for s in sampled]
        matches = each("pairs", _cached_match, [(light[i], light[j], checkpoint) for i, j in edges])
        stay, found = belonging(sampled, drop_outliers, edges, matches)
        sampled, light, outliers = tuple(sampled[k] for k in stay), [light[k] for k in stay], (*outliers, *found)
        kept, edges = among(stay, edges)
        matches = [matches[e] for e in kept]
        _refuse_mirrored(sampled, edges, matches)

        def proposed(found: list[PairMatch]) -> np.ndarray:
            estimate, signs, _ = network.robust_maps(len(sampled), edges, found, n_basis, rng)
            return network.flipped(estimate.relative(), edges, signs)

        matches = with_proposals(each, light, edges, matches, proposed)
    map_names = tuple(g.name for g in given)
    synced = synchronize_matches(
        sampled, edges, matches, n_basis, n_refined, n_draws, rng, progress, map_names, fast, jobs
    )
    if given:
        for said in network.unchecked_maps(synced.problem, synced.estimate, synced.names, map_names, given=True):
            warnings.warn(said, stacklevel=3)
    return replace(synced, outliers=tuple(dict.fromkeys(outliers)))


@checks.checked(n_draws=">= 0", edges="E 2 < N")
def synchronize_matches(
    shapes: Sequence[SampledShape],
    edges: np.ndarray,
    matches: Sequence[PairMatch],
    n_basis: int,
    n_refined: int,
    n_draws: int,
    rng: int | np.random.Generator,
    progress: bool = False,
    map_names: tuple[str, ...] = (),
    fast: bool = False,
    jobs: int = 1,
) -> SyncedShapes:
    """The last stages of :func:`synchronize_shapes`, from maps of the pairs (E, 2): give it other maps to compare.

    Maps with ``map_names`` are given ones: of each pair the best trusted one carries points, see there. ``jobs`` are
    threads.
    """
    rng = np.random.default_rng(rng)
    estimate, signs, problem = network.robust_maps(len(shapes), edges, matches, n_basis, rng)
    used = np.arange(len(edges))
    if map_names:
        used = best_of_pairs(edges, matches, network.trusted_edges(problem, estimate))
    part, are_given = network.trusted_part(problem, estimate, used), bool(map_names)
    posterior = network.posterior_draws(part, estimate, n_draws, rng, progress, are_given) if n_draws else None
    known = n_basis if are_given else min(n_refined, *(len(m.c_ij) for m in matches))
    start = np.array([matches[e].c_ij[:known, :known] for e in used.tolist()])
    refined = upsample(shapes, edges[used], start, n_refined, fast=fast, given=are_given, jobs=jobs, progress=progress)
    give_back()
    return SyncedShapes(
        tuple(shapes), edges, tuple(matches), signs, problem, estimate, posterior, refined, map_names, used
    )


def check_shapes(shapes: Sequence[Shape], n_refined: int) -> None:
    """Refuse too few shapes or vertices, and meshes that are mirrored or inside out while others are not."""
    if len(shapes) < 2:
        raise ValueError(f"shapes: {len(shapes)} given, correspondences need at least two")
    volumes = {}  # of closed meshes that are inside out, or whose points are mirrored, it is negative
    for k, shape in enumerate(shapes):
        if shape.n_vertices <= n_refined:
            many = f"{shape.name}: {shape.n_vertices} vertices"
            raise ValueError(f"{many}, too few for n_refined = {n_refined}; lower it")
        if shape.faces is not None:
            a, b, c = (shape.vertices - shape.vertices.mean(axis=0))[shape.faces.T]
            volumes[k] = float(np.einsum("fx,fx->", a, np.cross(b, c))) / 6 / shape.area**1.5
    inside_out = [shapes[k].name for k, volume in volumes.items() if volume < -1e-3]
    if inside_out and len(inside_out) < len(volumes):
        todo = "mirror it back, or reverse the order of corners in every face"
        raise ValueError(f"{', '.join(inside_out)}: mirrored or inside out while the others are not; {todo}")


def checked_landmarks(landmarks: Sequence[Sequence[int]], shapes: Sequence[Shape], n_samples: int) -> list[np.ndarray]:
    """The vertices (L,) of each shape."""
    if len(landmarks) != len(shapes):
        raise ValueError(f"landmarks: {len(landmarks)} rows for {len(shapes)} shapes; give one row for each")
    marks = []
    for k, (given, shape) in enumerate(zip(landmarks, shapes)):
        row = f"landmarks[{k}] (of {shape.name})"
        marks.append(checks.indices(row, given, shape.n_vertices))
        if len(marks[k]) != len(marks[0]):
            raise ValueError(f"{row}: {len(marks[k])} vertices, {shapes[0].name} has {len(marks[0])}; give as many")
        again = np.setdiff1d(np.arange(len(marks[k])), np.unique(marks[k], return_index=True)[1])
        if again.size:
            raise ValueError(f"{row}[{again[0]}]: vertex {marks[k][again[0]]} is repeated; remove it from every shape")
    if len(marks[0]) > n_samples:
        raise ValueError(f"landmarks: {len(marks[0])} of each shape, but n_samples = {n_samples}; raise n_samples")
    return marks


def _checked_graph(graph: str | Sequence[tuple[int, int]], count: int) -> np.ndarray | int:
    """Pairs (E, 2), i < j, or a number of neighbours."""
    if isinstance(graph, str) and graph == "complete":
        return np.array(list(itertools.combinations(range(count), 2)))
    if isinstance(graph, str):
        if not re.fullmatch("k[1-9][0-9]*", graph):
            raise ValueError(f"graph: 'complete', 'k4' or pairs, not {graph!r}")
        return int(graph[1:])
    try:
        return np.unique(np.sort(checks.connected_edges(count, graph), axis=1), axis=0)
    except ValueError as error:
        what = str(error).removeprefix("edges: ")
        raise ValueError(f"graph: {what}; give pairs of different shapes 0..{count - 1} that connect all") from None


def parallel(jobs: int, progress: bool) -> Callable[[str, Callable[..., Any], Sequence[tuple[Any, ...]]], list[Any]]:
    """Call a function with each of some arguments, in so many processes, under a bar with a name."""
    # No files shared between processes: joblib may delete one that the next stage, with the same arrays, still needs.
    run = joblib.Parallel(n_jobs=jobs, return_as="generator", max_nbytes=None)

    def each(what: str, function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
        tasks = (joblib.delayed(function)(*a) for a in arguments)
        results = list(tqdm(run(tasks), what, len(arguments), disable=not progress))
        give_back()
        return results

    return each


def with_proposals(
    each: Callable[..., list[Any]],
    light: Sequence[SampledShape],
    edges: np.ndarray,
    matches: list[PairMatch],
    propose: Callable[[list[PairMatch]], np.ndarray],
) -> list[PairMatch]:
    """Maps of the edges, or what keeps distances better: the network's proposals (E, n, n) or two-hop compositions."""
    for k in range(_ROUNDS):
        synchronised = propose(matches)
        composed = compositions(edges, matches, synchronised.shape[-1])
        proposed = [(light[i], light[j], np.array([c, *two])) for (i, j), c, two in zip(edges, synchronised, composed)]
        better = each(f"pairs again {k + 1}/{_ROUNDS}", improve, proposed)
        matches = [min(pair, key=lambda m: m.cost) for pair in zip(matches, better)]
    return matches


def compositions(edges: np.ndarray, matches: Sequence[PairMatch], n: int) -> list[list[np.ndarray]]:
    """For every edge (i, j) maps C_ik C_kj (n, n) through other shapes: where both look good, and first the best.

    They repair a wrong map even where other wrong ones agree with it, which the synchronised maps would then follow.
    """
    found = {}
    for (i, j), pair in zip(edges.tolist(), matches):
        c = pair.c_ij[:n, :n]
        found[i, j], found[j, i] = (pair.cost, c), (pair.cost, c.T)
    composed = []
    for i, j in edges.tolist():
        through = [(found[i, k], found[k, j]) for k in range(edges.max() + 1) if (i, k) in found and (k, j) in found]
        through.sort(key=lambda pair: max(cost for cost, _ in pair))
        composed.append([first @ second for (_, first), (_, second) in through[:_COMPOSED]])
    return composed


def _refuse_mirrored(shapes: Sequence[SampledShape], edges: np.ndarray, matches: Sequence[PairMatch]) -> None:
    ratio = np.array([m.mirrored_distortion / max(m.distortion, 1e-12) for m in matches])
    for k, shape in enumerate(shapes):
        own = ratio[(edges == k).any(axis=1)]
        if shape.orientation is not None and len(own) and np.median(own) < _MIRRORED:
            told = "maps that turn left into right keep distances far better than those that do not"
            raise ValueError(f"{shape.shape.name}: {told}: the mesh is mirrored; mirror it back")


def _neighbours(shapes: Sequence[SampledShape], number: int) -> np.ndarray:
    """Pairs (E, 2) of every shape and so many others of nearest spectrum, connected."""
    apart = spectral_distances(shapes) + np.diag([np.inf] * len(shapes)) + 1e-12  # equal spectra are near, not absent
    nearest = np.argsort(apart, axis=1, kind="stable")[:, : min(number, len(shapes) - 1)]
    chosen = nx.minimum_spanning_tree(nx.from_numpy_array(np.triu(apart, 1)))  # keeps the graph in one piece
    chosen.add_edges_from((i, int(j)) for i in range(len(shapes)) for j in nearest[i])
    return np.array(sorted(map(sorted, chosen.edges)))


def _cached_match(first: SampledShape, second: SampledShape, folder: str | Path | None) -> PairMatch:
    """The match of a pair, read from ``folder`` where it was finished before."""
    if folder is None:
        return match(first, second)
    parts = [(s.shape.vertices, s.normals, s.basis.eigenvalues, s.coefficients, s.geodesics) for s in (first, second)]
    key = joblib.hash((_RECIPE, parts))
    file = Path(folder) / f"{key[:24]}.npz"
    with contextlib.suppress(OSError, ValueError, KeyError, EOFError, BadZipFile), np.load(file) as kept:
        return PairMatch(kept["c_ij"], *(float(x) for x in kept["numbers"]))  # a damaged file is made anew
    found = match(first, second)
    file.parent.mkdir(parents=True, exist_ok=True)
    with replacing(file) as stream:
        numbers = [found.distortion, found.orientation, found.mirrored_distortion, found.missed]
        np.savez(stream, c_ij=found.c_ij, numbers=numbers)
    return found
