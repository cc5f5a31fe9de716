"""The network of maps: signs, robust synchronisation, which edges to trust, and posterior draws."""

import warnings
from collections.abc import Sequence
from typing import Any

import networkx as nx
import numpy as np
from tqdm import tqdm

from fmsync import so
from fmsync.diagnostics import LARGEST_RHAT, LEAST_ESS, ConvergenceWarning, ess, rhat, short_run
from fmsync.energy import squared_residuals
from fmsync.estimators import Estimate, solve
from fmsync.matching.pairwise import PairMatch
from fmsync.problem import SyncProblem
from fmsync.samplers import Posterior, sample

_MORE_DRAWS = "ask for more draws (n_draws, --draws)"
_MORE_PAIRS = {True: "give maps of more pairs", False: "use a graph with more pairs (graph, --graph)"}  # maps given?


def basis_signs(signs: np.ndarray, n: int) -> np.ndarray:
    """(N, n) signs of all basis functions: the last one of a shape with -1 is flipped."""
    flips = np.ones((len(signs), n))
    flips[:, -1] = signs
    return flips


def flipped(maps: np.ndarray, edges: np.ndarray, signs: np.ndarray) -> np.ndarray:
    """Maps (E, n, n) between the bases with these signs."""
    flips = basis_signs(signs, maps.shape[-1])
    return flips[edges[:, 0]][:, :, None] * maps * flips[edges[:, 1]][:, None]


def rotation_signs(n_nodes: int, edges: np.ndarray, maps: np.ndarray) -> np.ndarray:
    """Signs s with det C_ij = s_i s_j on as many edges (E, 2) as greedy ascent from the leading eigenvector finds.

    (N,) of ±1, the first +1: flip one eigenfunction of every shape with -1.

    >>> maps = np.array([np.diag([1.0, -1.0]), np.diag([1.0, -1.0]), np.eye(2)])
    >>> rotation_signs(3, np.array([[0, 1], [1, 2], [0, 2]]), maps)
    array([ 1., -1.,  1.])
    """
    first, second = np.asarray(edges).T
    parity = np.sign(np.linalg.det(maps))
    votes = np.zeros((n_nodes, n_nodes))
    np.add.at(votes, (first, second), parity)
    votes = votes + votes.T
    signs = np.where(np.linalg.eigh(votes)[1][:, -1] < 0, -1.0, 1.0)
    while (gain := signs * (votes @ signs)).min() < 0:  # each flip satisfies more edges, so that this ends
        signs[gain.argmin()] *= -1
    return signs * signs[0]


def robust_maps(
    count: int, edges: np.ndarray, matches: Sequence[PairMatch], n: int, rng: int | np.random.Generator
) -> tuple[Estimate, np.ndarray, SyncProblem]:
    """Robust synchronisation of the matches: the estimate, signs, and the problem solved."""
    maps = np.array([m.c_ij[:n, :n] for m in matches])
    signs = rotation_signs(count, edges, maps)
    problem = SyncProblem(count, edges, so.project(flipped(maps, edges, signs)))
    return robust_estimate(problem, rng), signs, problem


def robust_estimate(problem: SyncProblem, rng: int | np.random.Generator) -> Estimate:
    """To a part in a thousand, maps are not better known than that; of a tree, which tells no wrong edge, the MLE."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        if problem.n_edges < problem.n_nodes:
            return solve(problem, "mle", rng=rng)
        return solve(problem, "robust", rng=rng, tolerance=1e-3, max_iterations=100)


def trusted_edges(problem: SyncProblem, estimate: Estimate) -> np.ndarray:
    """(E,) whether the robust estimate keeps an edge; of the others those of least residual that join its parts."""
    keep = inlier_weights(estimate) > 0.5
    squares = np.where(keep, 0, squared_residuals(problem, estimate.absolute))
    graph = nx.MultiGraph()
    graph.add_edges_from((*pair, e, {"weight": squares[e]}) for e, pair in enumerate(problem.edges.tolist()))
    keep[[e for *_, e in nx.minimum_spanning_edges(graph, data=False)]] = True
    return keep


def trusted_part(problem: SyncProblem, estimate: Estimate, used: np.ndarray) -> SyncProblem:
    """What the posterior is of: those of some edges (U,) that are trusted."""
    keep = used[trusted_edges(problem, estimate)[used]]
    return SyncProblem(problem.n_nodes, problem.edges[keep], problem.maps[keep])


def inlier_weights(estimate: Estimate) -> np.ndarray:
    """(E,) of an estimate that need not have any: then they are 1."""
    weights = estimate.edge_weights
    return np.ones(estimate.problem.n_edges) if weights is None else weights


def posterior_draws(
    problem: SyncProblem, estimate: Estimate, n_draws: int, rng: np.random.Generator, progress: bool, given: bool
) -> Posterior:
    """Draws with the concentration inferred; on a tree, which does not identify it, with that of a middling noise.

    Warns with :func:`doubts_of_draws` in place of what :func:`fmsync.sample` says to those who choose the sampler.
    """
    tree = problem.n_edges < problem.n_nodes
    each = -(-n_draws // 4)
    with tqdm(desc="posterior", total=each, disable=not progress) as bar, short_run():
        steps = {"n_chains": 4, "n_draws": each, "warmup": 300, "thin": 4}
        told: dict[str, Any] = {"kappa": 20.0 if tree else "auto", "callback": lambda *_: bar.update(), **steps}
        posterior = sample(problem, "heat-bath", init=estimate, rng=rng, **told)
    for said in doubts_of_draws(posterior, given):
        warnings.warn(said, ConvergenceWarning, stacklevel=6)
    return posterior


def doubts_of_draws(posterior: Posterior, given: bool) -> list[str]:
    """Sentences about draws, each with what a user of the pipeline, with maps ``given`` or without, can do."""
    said, varying = [], [x for x in (posterior.energy, posterior.kappa) if np.ptp(x) > 0]
    apart = max((rhat(x) for x in varying), default=np.nan)
    effective = min((ess(x) for x in varying), default=np.nan)
    if posterior.modes:
        todo = _MORE_PAIRS[given] + ", or give landmarks (landmarks, --landmarks)" * (not given)
        ways = f"The maps can agree in more ways than one ({posterior.modes})"
        said.append(f"{ways}: do not rely on the regions; {todo}.")
    if not np.isfinite(apart):
        said.append(f"There are too few posterior draws to tell whether the chains agree: {_MORE_DRAWS}.")
    elif apart > LARGEST_RHAT:
        text = f"The chains of posterior draws do not agree (R-hat {apart:.3f}; it should be below {LARGEST_RHAT}): "
        said.append(text + f"do not rely on the regions; {_MORE_DRAWS}, doubt the maps if it stays.")
    if np.isfinite(effective) and effective < LEAST_ESS:
        text = f"The posterior draws are worth only {effective:.0f} independent ones (ESS; {LEAST_ESS} effective draws "
        said.append(text + f"are wanted): the regions are rough; {_MORE_DRAWS}.")
    return said


def unchecked_maps(
    problem: SyncProblem, estimate: Estimate, names: Sequence[str], edge_names: Sequence[str], given: bool
) -> list[str]:
    """Sentences about maps that no cycle of trusted ones checks, and shapes without a majority of trusted ones."""
    graph, trust = nx.empty_graph(problem.n_nodes), inlier_weights(estimate) > 0.5
    trusted, said = np.flatnonzero(trust).tolist(), []
    graph.add_edges_from(problem.edges[trusted].tolist())
    parts = [" + ".join(names[k] for k in sorted(part)) for part in nx.connected_components(graph)]
    bridges = {frozenset(pair) for pair in nx.bridges(graph)}
    lone = ", ".join(edge_names[e] for e in trusted if frozenset(problem.edges[e].tolist()) in bridges)
    if len(parts) > 1:
        said.append(f"No map that agrees with others connects {', '.join(parts)}: what joins them is a guess")
    elif len(bridges) == problem.n_nodes - 1:
        text = "The graph has no cycle, so pairs cannot be checked against each other and the noise level is a guess"
        said.append(f"{text}: {lone}")
    elif lone:
        said.append(f"No cycle of trusted maps checks these, and nothing shows whether they are wrong: {lone}")
    right, wrong = (np.bincount(problem.edges[kept].ravel(), minlength=problem.n_nodes) for kept in (trust, ~trust))
    even = np.flatnonzero((wrong >= right) & (right > 1))  # a single map is a bridge
    if split := [f"{names[k]} ({right[k]} of {right[k] + wrong[k]})" for k in even]:
        text = "No majority of the maps of these shapes agrees with the others, so that the wrong ones may be trusted"
        said.append(f"{text}: {', '.join(split)}")
    return [f"{text}; {_MORE_PAIRS[given]}." for text in said]
