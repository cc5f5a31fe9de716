"""Short pilot chains from dispersed starts: is there a mode that the kept chains have not seen?

Kept chains that started dispersed would weight modes by their starts, so the pilots only look.
"""

import numpy as np

from fmsync import so
from fmsync.energy import energy, geodesic_energy
from fmsync.langevin import matched_kappa
from fmsync.problem import relative_maps
from fmsync.samplers.base import Sampler, Target
from fmsync.samplers.heat_bath import HeatBath
from fmsync.samplers.hmc import HMC

N_PILOTS = 8
_SHARE = 0.04  # of the chain steps of the whole run that all pilots together may take
_LEAST_STEPS = 30  # fewer tell nothing
_MOST_EDGES, _MOST_DRAWS = 32, 100  # that are compared
_APART = 4.0  # standard deviations, of kept draws and pilots together, between two modes
_VISITED = 0.01  # share of kept draws beyond the middle: they know that mode
_NEGLIGIBLE = 10.0  # a mode whose log-density lies so far below has no weight


def pilot_steps(n_chains: int, n_steps: int) -> int:
    """Steps of each pilot beside ``n_chains`` chains of ``n_steps``; 0 where the run is too short to look."""
    steps = int(_SHARE * n_chains * n_steps / N_PILOTS)
    return steps if steps >= _LEAST_STEPS else 0


def unvisited_mode(
    target: Target, draws: np.ndarray, kappa: float, n_steps: int, rng: np.random.Generator
) -> str | None:
    """What to say of a mode that pilots of ``n_steps`` steps found and kept draws (K, T, N, n, n) did not.

    Six of eight start at Haar draws, two at kept draws that are perturbed; they run at the concentration of the kept
    draws. Where a pilot was in its third quarter gives the direction in which its last quarter is compared with
    the kept draws, so that noise in many dimensions is not taken for a distance.
    """
    p, flat = target.problem, draws.reshape(-1, *draws.shape[2:])
    kept = flat[np.linspace(0, len(flat) - 1, min(_MOST_DRAWS, len(flat))).astype(int)]
    potential = energy if target.energy == "euclidean" else geodesic_energy
    start = so.random_uniform(p.n, (N_PILOTS, p.n_nodes), rng)
    noise = 2 * so.skew(rng.standard_normal((N_PILOTS // 4, p.n_nodes, p.n, p.n)))
    start[::4] = kept[rng.integers(len(kept), size=N_PILOTS // 4)] @ so.exp(noise)
    if target.likelihood != "langevin":
        cosine = 1 - potential(p, kept).mean() / (2 * p.n * p.weights.sum())
        kappa = matched_kappa(p.n, min(max(cosine, 1e-3), 1 - 1e-3))
    settled = Target(p, target.prior, kappa, energy=target.energy)
    pilots: Sampler = (HeatBath if target.energy == "euclidean" else HMC)(settled, start, rng)
    states = []
    for k in range(n_steps):
        pilots.step(warmup=4 * k < 2 * n_steps)
        states.append(pilots.state.copy())
    quarter = n_steps // 4
    late = np.array(states[-2 * quarter :])  # (S, pilots, N, n, n)
    edges = p.edges[np.linspace(0, p.n_edges - 1, min(_MOST_EDGES, p.n_edges)).astype(int)]
    known, seen = _relative(kept, edges), _relative(late, edges)
    energies, at_home = potential(p, late), potential(p, kept)
    third, last = energies[:quarter], energies[quarter:]
    moving = np.abs(third.mean(0) - last.mean(0)) > 2 * np.hypot(third.std(0), last.std(0))
    lost = kappa / 2 * (last.mean(0) - at_home.mean()) > _NEGLIGIBLE
    elsewhere = np.array([_apart(seen[:quarter, k], seen[quarter:, k], known) for k in range(N_PILOTS)])
    found = elsewhere & ~moving & ~lost
    if not found.any():
        return None
    return (
        f"{found.sum()} of {N_PILOTS} short pilot chains from dispersed starts settled in another mode, at a mean "
        f"energy of {last.mean(0)[found].min():.4g} where these chains have {at_home.mean():.4g}: the draws say "
        "nothing about it; use method='tempered', which weighs the modes"
    )


def _relative(c: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(..., E n²) relative maps of rotations (..., N, n, n)."""
    maps = relative_maps(c, edges)
    return maps.reshape(*maps.shape[:-3], -1)


def _apart(before: np.ndarray, after: np.ndarray, known: np.ndarray) -> bool:
    """Whether draws ``after`` (S, D) lie apart from ``known`` (T, D), in the direction of ``before`` (S, D)."""
    direction = before.mean(0) - known.mean(0)
    here, there = after @ direction, known @ direction
    gap = here.mean() - there.mean()
    middle = there.mean() + gap / 2
    return bool(gap > _APART * np.hypot(here.std(), there.std()) and (there > middle).mean() < _VISITED)
