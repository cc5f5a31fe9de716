"""Short pilot chains from dispersed starts: is there a mode that the kept chains have not seen?

Kept chains that started dispersed would weight modes by their starts, so the pilots only look.
"""

import numpy as np

from fmsync import so
from fmsync.energy import energy, geodesic_energy
from fmsync.langevin import matched_kappa
from fmsync.problem import SyncProblem
from fmsync.problem import relative_maps_unchecked as relative_maps
from fmsync.samplers.base import Sampler, Target
from fmsync.samplers.heat_bath import HeatBath
from fmsync.samplers.hmc import HMC

N_PILOTS = 8
_SHARE = 0.03  # of the chain steps of the whole run that all pilots together may take: 5 % of its CPU time
_LEAST_STEPS = 30  # fewer tell nothing
_MOST_EDGES, _MOST_DRAWS = 32, 100  # that are compared
_DRAWS_A_CHAIN, _FEWEST_DRAWS = 50, 10
_APART = 4.0  # standard deviations, of kept draws and pilots together, between two modes
_VISITED = 0.01  # share of kept draws beyond the middle: they know that mode
_NEGLIGIBLE = 10.0  # a mode whose log-density lies so far below has no weight


def pilot_steps(n_chains: int, n_steps: int) -> int:
    """Steps of each pilot beside ``n_chains`` chains of ``n_steps``; 0 where the run is too short to look."""
    steps = int(_SHARE * n_chains * n_steps / N_PILOTS)
    return steps if steps >= _LEAST_STEPS else 0


def unvisited_mode(
    target: Target, draws: np.ndarray, energies: np.ndarray, kappa: float, n_steps: int, rng: np.random.Generator
) -> str:
    """What to say of a mode that pilots of ``n_steps`` steps found and kept draws (K, T, N, n, n) did not, or nothing.

    The kept draws have ``energies`` (K, T) and mean concentration ``kappa``, at which the pilots run. Six of eight
    start at Haar draws, two at kept draws that are perturbed. Where a pilot was in its third quarter, and the kept
    draws in their first half, gives the direction in which the rest of both is compared: in many dimensions noise
    would be taken for a distance otherwise.
    """
    p, few = target.problem, _thinned(draws, max(_MOST_DRAWS // len(draws), 2))
    kept = few.reshape(-1, *few.shape[2:])
    at_home = energies.mean()
    if target.prior is not None:  # the energies of "rlfm" hold the prior
        at_home = (energy if target.energy == "euclidean" else geodesic_energy)(p, kept).mean()
    start = so.random_uniform(p.n, (N_PILOTS, p.n_nodes), rng)
    noise = 2 * so.skew(rng.standard_normal((N_PILOTS // 4, p.n_nodes, p.n, p.n)))
    start[::4] = kept[rng.integers(len(kept), size=N_PILOTS // 4)] @ so.exp_unchecked(noise)
    if target.likelihood != "langevin":
        cosine = 1 - at_home / (2 * p.n * p.weights.sum())
        kappa = matched_kappa(p.n, min(max(cosine, 1e-3), 1 - 1e-3))
    fixed = Target(p, target.prior, kappa, energy=target.energy)
    pilots: Sampler = (HeatBath if target.energy == "euclidean" else HMC)(fixed, start, rng)
    states, potentials = [], []
    for k in range(n_steps):
        pilots.step(warmup=4 * k < 2 * n_steps)
        if 2 * k >= n_steps:
            states.append(pilots.state.copy())
            potentials.append(pilots.energy().copy())
    quarter = n_steps // 4
    late = np.array(states[-2 * quarter :])  # (S, pilots, N, n, n)
    known, seen = _halves(_relative(p, few)), _relative(p, late)
    third, last = np.split(np.array(potentials[-2 * quarter :]), 2)
    moving = np.abs(third.mean(0) - last.mean(0)) > 2 * np.hypot(third.std(0), last.std(0))
    lost = kappa / 2 * (last.mean(0) - at_home) > _NEGLIGIBLE
    elsewhere = np.array([_apart((seen[:quarter, k], seen[quarter:, k]), known) for k in range(N_PILOTS)])
    found = elsewhere & ~moving & ~lost
    if not found.any():
        return ""
    settled = f"{found.sum()} of {N_PILOTS} short pilot chains from dispersed starts settled in another mode"
    lower = f"at a mean energy of {last.mean(0)[found].min():.4g} where these chains have {at_home:.4g}"
    return f"{settled}, {lower}: the draws say nothing about it"


def split_chains(problem: SyncProblem, draws: np.ndarray) -> str:
    """What to say where draws (K, T, N, n, n) of the chains lie in different modes; empty where they do not.

    The energy does not see modes that are equally high, relative maps do.
    """
    if draws.shape[1] < _FEWEST_DRAWS:
        return ""
    maps = _relative(problem, _thinned(draws, _DRAWS_A_CHAIN))[:, None]  # (K, 1, T, D)
    apart = [k for k in range(1, len(maps)) if _apart(_halves(maps[k]), _halves(maps[0]))]
    what = f"{len(apart)} of {len(maps)} chains stay in another mode than the first"
    return f"{what}: the draws weigh modes by their starts" if apart else ""


def _relative(problem: SyncProblem, c: np.ndarray) -> np.ndarray:
    """(..., E n²) relative maps of rotations (..., N, n, n) along some of the edges."""
    some = np.linspace(0, problem.n_edges - 1, min(_MOST_EDGES, problem.n_edges)).astype(int)
    maps = relative_maps(c, problem.edges[some])
    return maps.reshape(*maps.shape[:-3], -1)


def _thinned(draws: np.ndarray, count: int) -> np.ndarray:
    """At most so many draws of each chain (K, T, ...), evenly from all."""
    return draws[:, np.linspace(0, draws.shape[1] - 1, min(count, draws.shape[1])).astype(int)]


def _halves(draws: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first and the second halves (.., D) of chains (K, T, D)."""
    half, size = draws.shape[1] // 2, draws.shape[-1]
    return draws[:, :half].reshape(-1, size), draws[:, half:].reshape(-1, size)


def _apart(ours: tuple[np.ndarray, np.ndarray], others: tuple[np.ndarray, np.ndarray]) -> bool:
    """Whether later draws (S, D) and (T, D) lie apart in the direction that the earlier draws of both give."""
    direction = ours[0].mean(0) - others[0].mean(0)
    here, there = ours[1] @ direction, others[1] @ direction
    gap = here.mean() - there.mean()
    middle = there.mean() + gap / 2
    return bool(gap > _APART * np.hypot(here.std(), there.std()) and (there > middle).mean() < _VISITED)
