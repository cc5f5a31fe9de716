"""Pairwise maps of any matcher: three kinds of them, told apart and checked, and each as a matrix in our bases."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import networkx as nx
import numpy as np
import scipy.sparse as sp

from fmsync.matching.pairwise import FINE, PairMatch, improve, match
from fmsync.matching.samples import SampledShape
from fmsync.shape import Basis, Shape

Maps = Mapping[tuple[int, int], Any]  # an array, a list of arrays, or arrays by the names of their matchers or files
_ORTHONORMAL = 1e-2  # largest entry of ΦᵀAΦ - I
_ROUGH = 1  # mean squared step of the first function along edges over its variance: 2 in a random order of vertices
_SEEN = 0.1  # functions that the matched vertices see less of than this, of the best seen one, are left out of the fit
_TURN = "rename the file, or exchange i and j"
_REVERSED = 0.5  # a map whose distortion falls below this share of itself when it is read otherwise is misread
_POOR, _PROBES = 0.1, 5  # median distortion from which so many functional maps are tried with other signs


@dataclass(frozen=True, eq=False)
class GivenMap:
    """A map from shape i to shape j: ``matrix`` is a sparse soft map (V_i, V_j), or dense a functional map C_ij."""

    i: int
    j: int
    name: str
    matrix: np.ndarray | sp.csr_array


def checked_maps(
    maps: Maps, shapes: Sequence[Shape], bases: Sequence[Basis] | None, n_basis: int
) -> tuple[GivenMap, ...]:
    """Every map of every pair; what does not fit the shapes is a ValueError that names the map and what to do."""
    if bases is not None:
        _check_bases(bases, shapes, n_basis)
    given, graph, numbers = [], nx.empty_graph(len(shapes)), range(len(shapes))
    for pair, value in maps.items():
        if not isinstance(pair, tuple) or len(pair) != 2 or pair[0] == pair[1] or not {*pair} <= {*numbers}:
            raise ValueError(f"maps: {pair!r} is no pair; keys are (i, j), different numbers from 0 to {numbers[-1]}")
        i, j = pair
        pair_name = f"maps[{i}, {j}] ({shapes[i].name} to {shapes[j].name})"
        several = value if isinstance(value, Mapping | list) else [value]
        if isinstance(several, list):
            several = {f"{pair_name}{f', number {k}' if len(several) > 1 else ''}": m for k, m in enumerate(several)}
        size = shapes[i].n_vertices, shapes[j].n_vertices
        most = size if bases is None else (bases[i].n, bases[j].n)
        for name, array in several.items():
            graph.add_edge(i, j)
            try:
                given.append(GivenMap(i, j, str(name), _checked(array, size, most, n_basis)))
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
    parts = [" + ".join(shapes[k].name for k in sorted(part)) for part in nx.connected_components(graph)]
    if len(parts) > 1:
        raise ValueError(f"maps: none connect the components {', '.join(parts)}; add some, or solve each on its own")
    return tuple(given)


def _checked(given: Any, size: tuple[int, int], most: tuple[int, int], n_basis: int) -> np.ndarray | sp.csr_array:
    """A soft or functional map between shapes of so many vertices and at ``most`` so many functions."""
    array = given if sp.issparse(given) else np.asarray(given)
    if array.dtype.kind not in "iuf" or array.ndim not in (1, 2) or 0 in array.shape:
        raise ValueError(f"need numbers, an array with one or two axes, not {array.dtype} of shape {array.shape}")
    if not sp.issparse(array) and max(array.shape) == array.size:
        array = _soft(array.ravel(), size)
    if sp.issparse(array):
        _refuse_misfit(f"a soft map of shape {array.shape}", array.shape == size, array.shape == size[::-1], size)
        soft = sp.csr_array(array, dtype=float)
        total = soft.sum(axis=1)
        if not (np.isfinite(soft.data).all() and (soft.data >= 0).all() and (total <= 1 + 1e-6).all()):
            raise ValueError("rows of a soft map are probabilities that sum to at most one; divide each by its sum")
        if (total > 0).sum() < 2 * n_basis:
            raise ValueError(f"it matches {(total > 0).sum()} vertices, too few for n_basis = {n_basis}; lower n_basis")
        return soft
    if array.shape in (size, size[::-1]):
        raise ValueError(f"a dense {array.shape} matrix, a row for each vertex; give soft maps as scipy.sparse ones")
    there, back = (array.shape[0] <= most[k] and array.shape[1] <= most[1 - k] for k in (0, 1))
    _refuse_misfit(f"C_ij of shape {array.shape}, for bases of {most[0]} and {most[1]} functions,", there, back, size)
    if min(array.shape) < n_basis:
        raise ValueError(f"C_ij of shape {array.shape} is smaller than n_basis = {n_basis}; lower n_basis")
    if not np.isfinite(array).all():
        raise ValueError("C_ij holds NaN or infinity; mend it or leave the map out")
    return array.astype(float)


def _soft(images: np.ndarray, size: tuple[int, int]) -> sp.csr_array:
    """A point map (V_i,) with -1 for unmatched vertices as rows of a one or of nothing."""
    _refuse_misfit(f"a point map of {len(images)} vertices", len(images) == size[0], len(images) == size[1], size)
    low, high = images.min(), images.max()
    if not (np.isfinite(images) & (images == np.rint(images))).all():
        raise ValueError("a point map holds whole numbers, -1 for unmatched vertices; this one does not")
    if low < -1 or high >= size[1]:
        why = "it counts from one: subtract one" if low > 0 and high == size[1] else "count from zero, -1 for unmatched"
        raise ValueError(f"vertex {int(low if low < -1 else high)} is none of 0..{size[1] - 1}; {why}")
    rows = np.flatnonzero(images >= 0)
    return sp.csr_array((np.ones(len(rows)), (rows, images[rows].astype(int))), shape=size)


def _refuse_misfit(what: str, fits: bool, fits_reversed: bool, size: tuple[int, int]) -> None:
    if not fits:
        todo = f"it fits the other direction: {_TURN}" if fits_reversed else "look which meshes it belongs to"
        raise ValueError(f"{what} does not lead from {size[0]} to {size[1]} vertices; {todo}")


def _check_bases(bases: Sequence[Basis], shapes: Sequence[Shape], n_basis: int) -> None:
    if len(bases) != len(shapes):
        raise ValueError(f"bases: {len(bases)} for {len(shapes)} shapes; give one of each")
    for k, (basis, shape) in enumerate(zip(bases, shapes)):
        name = f"bases[{k}] (of {shape.name})"
        if basis.n_vertices != shape.n_vertices or basis.n < n_basis:
            have = f"{basis.n} functions on {basis.n_vertices} vertices"
            raise ValueError(f"{name}: {have}; n_basis = {n_basis} on {shape.n_vertices} are needed")
        error = np.abs(basis.coefficients(basis.eigenfunctions) - np.eye(basis.n)).max()
        if not error <= _ORTHONORMAL:
            raise ValueError(f"{name}: not orthonormal, ΦᵀAΦ is off by {error:.2g}; scale it, or give the mass it has")
        if shape.faces is not None and basis.n > 1:
            first = basis.eigenfunctions[:, 1]
            steps = first[shape.faces] - first[np.roll(shape.faces, 1, axis=1)]  # (F, 3), along the edges
            if (steps**2).mean() > _ROUGH * np.var(first):
                raise ValueError(f"{name}: its functions jump along edges; it is of another mesh or order of vertices")


def observed(
    given: GivenMap, first: SampledShape, second: SampledShape, bases: tuple[Basis, Basis] | None
) -> np.ndarray:
    """C_ij (k, k), k as large as is known up to ``pairwise.FINE``, in the bases of the two shapes.

    A soft map is fitted by least squares, a vertex with the weight of its area times the sum of its row; unmatched ones
    are left out.
    """
    top, c = min(FINE, first.basis.n, second.basis.n), given.matrix
    if not isinstance(c, np.ndarray):
        total = c.sum(axis=1)
        rows = np.flatnonzero(total > 0)
        top = min(top, len(rows) // 2)
        root = np.sqrt(first.basis.mass[rows] * total[rows])[:, None]
        images = c[rows] @ second.basis.eigenfunctions[:, :top] / total[rows, None]
        seen = np.linalg.pinv(root * first.basis.eigenfunctions[rows, :top], rcond=_SEEN)
        return seen @ (root * images)
    top = min(top, *c.shape)
    if bases is None:
        return c[:top, :top]
    theirs = bases[0].truncated(c.shape[0]), bases[1].truncated(c.shape[1])
    to_ours = first.basis.truncated(top).coefficients(theirs[0].eigenfunctions)
    return to_ours @ c @ theirs[1].coefficients(second.basis.eigenfunctions[:, :top])


def given_matches(
    given: Sequence[GivenMap], shapes: Sequence[SampledShape], bases: Sequence[Basis] | None
) -> list[PairMatch]:
    """The maps in our bases with their scores; a ValueError names those that are far better in reverse."""
    found, turned, light = [], [], [s.light(FINE) for s in shapes]
    for g in given:
        rows, columns = g.matrix.shape
        fits = isinstance(g.matrix, np.ndarray) and (not bases or (rows <= bases[g.j].n and columns <= bases[g.i].n))
        ends = [(g.i, g.j)] + [(g.j, g.i)] * (rows == columns or fits)
        read = []
        for i, j in ends:
            c = observed(g, shapes[i], shapes[j], None if bases is None else (bases[i], bases[j]))
            read.append(improve(light[i], light[j], c[None], len(c)))
        found.append(read[0])
        if read[-1].distortion < _REVERSED * read[0].distortion:
            turned.append(g.name)
    if turned:
        names = ", ".join(turned[:3]) + f" and {len(turned) - 3} more" * (len(turned) > 3)
        raise ValueError(f"{names}: keeps distances far better when read in the other direction; {_TURN}")
    functional = [k for k, g in enumerate(given) if isinstance(g.matrix, np.ndarray)]
    if functional and np.median([found[k].distortion for k in functional]) > _POOR:
        probes = functional[:: -(-len(functional) // _PROBES)]
        _doubt_bases([(light[given[k].i], light[given[k].j], found[k]) for k in probes], bases is None)
    return found


def _doubt_bases(probes: Sequence[tuple[SampledShape, SampledShape, PairMatch]], ours: bool) -> None:
    """Refuse functional maps that other signs of eigenfunctions make far better, and warn of poor ones.

    The signs are those that agree with the pipeline's own map, which need not be right: what counts is distortion.
    """
    turned = poor = 0
    for first, second, given in probes:
        own = match(first, second)
        n = min(len(given.c_ij), len(own.c_ij))
        agreement = given.c_ij[:n, :n] * own.c_ij[:n, :n]
        left = np.copysign(1, np.linalg.svd(agreement)[0][:, 0])
        right = np.copysign(1, left @ agreement)
        signed = left[:, None] * given.c_ij[:n, :n] * right
        turned += improve(first, second, signed[None], n).distortion < _REVERSED * given.distortion
        poor += own.distortion < _REVERSED * given.distortion
    made = "other bases than fmsync's" if ours else "other bases than those in bases="
    todo = "give point maps instead, or in Python the bases that they were computed in as bases="
    tried = f"of {len(probes)} functional maps that were tried"
    if 2 * turned > len(probes):
        told = f"maps: {turned} {tried} keep distances far better with other signs of the eigenfunctions"
        raise ValueError(f"{told}: they are in {made}; {todo}")
    if 2 * poor > len(probes):
        told = f"{poor} {tried} keep distances far worse than maps from the shapes alone"
        warnings.warn(f"{told}: they are poor, or in {made}; {todo}", stacklevel=5)


def best_of_pairs(edges: np.ndarray, matches: Sequence[PairMatch], trusted: np.ndarray) -> np.ndarray:
    """Of the trusted edges (E,) of every pair, in either direction, the one whose map costs least."""
    best: dict[frozenset[int], int] = {}
    for e in sorted(np.flatnonzero(trusted).tolist(), key=lambda e: -matches[e].cost):
        best[frozenset(edges[e].tolist())] = e
    return np.array(sorted(best.values()))
