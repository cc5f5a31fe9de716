r"""Wrong observations: which are inliers is drawn together with the maps, their share and their concentration.

An observation is Langevin around :math:`C_i^\top C_j` with probability p and otherwise Haar-uniform on SO(n), with
density 1. Given everything else the indicators z are independent,

.. math:: \operatorname{logit} P(z_{ij}=1) =
    \operatorname{logit} p + \kappa\operatorname{tr}(C_{ij}^\top C_i^\top C_j) - \log c_n(\kappa),

and given them the maps see the inliers alone, p is beta distributed, uniform a priori, and κ is that of the inliers.

With the indicators fixed a map hardly leaves what its present inliers say. So every step begins with a jump of each
map, the indicators summed out: two of its neighbours, drawn at random, say :math:`A_j, A_k` for it;
:math:`C_i \to A_j A_k^\top C_i` keeps the Haar measure, is as likely as its way back, and is accepted by the ratio of
:math:`\prod_e(1-p+p\,e^{\kappa\operatorname{tr}}/c_n(\kappa))` over the maps of i.
"""

import numba
import numpy as np
from scipy.special import betaincinv, expit, logit

from fmsync import checks
from fmsync.samplers.base import Target
from fmsync.samplers.concentration import Concentration, traces
from fmsync.samplers.plane_rotations import inner
from fmsync.samplers.random_streams import LANES, fill, uniform


@numba.njit(cache=True, nogil=True)
def jump(
    x: np.ndarray,
    maps: np.ndarray,
    incidence: tuple[np.ndarray, ...],
    field: np.ndarray,
    exponent: np.ndarray,
    prior: np.ndarray,
    states: np.ndarray,
) -> None:
    r"""One jump of every map of every chain from what one of its neighbours says to what another says.

    Transposed maps x (K, N, n, n) change in place; ``exponent`` (K, 2) are κ and log c_n(κ), ``prior`` (K,) is logit p,
    ``incidence`` the problem's, the rest as for :func:`~fmsync.samplers.plane_rotations.sweep`.
    """
    (start, edge, other, forward), n = incidence, x.shape[-1]
    for k in range(len(x)):
        for i in range(x.shape[1]):
            degree = start[i + 1] - start[i]
            if degree < 2:
                continue
            said = np.empty((degree, n, n))  # A_jᵀ
            for t in range(degree):
                m = maps[edge[start[i] + t]]
                np.dot(np.ascontiguousarray(m.T) if forward[start[i] + t] else m, x[k, other[start[i] + t]], said[t])
            a = int(degree * uniform(states[k]))
            b = (a + 1 + int((degree - 1) * uniform(states[k]))) % degree
            proposal = np.dot(np.dot(x[k, i], np.ascontiguousarray(said[a].T)), said[b])
            gain = 0.0
            for t in range(degree):
                offset = prior[k] - exponent[k, 1]
                gain += np.logaddexp(0.0, offset + exponent[k, 0] * inner(said[t], proposal))
                gain -= np.logaddexp(0.0, offset + exponent[k, 0] * inner(said[t], x[k, i]))
            if len(field):
                gain += np.sum(field[i] * (proposal - x[k, i]))
            if np.log(uniform(states[k])) < gain:  # a step towards O(n), or rounding would grow from jump to jump
                x[k, i] = 1.5 * proposal - 0.5 * np.dot(np.dot(proposal, np.ascontiguousarray(proposal.T)), proposal)


class Inliers:
    """Indicators, their share p and κ of every chain; map sweeps read ``maps`` (1, E, n, n) and ``weights`` (K, E).

    The weights are the indicators: 1 for an inlier, 0 for an outlier.
    As long as κ does not move, all observations count, so that chains from random maps can order first.
    """

    def __init__(self, target: Target, n_chains: int, rng: np.random.Generator):
        self._problem = p = target.problem
        checks.rotations("maps (node = edge)", p.maps)
        self._field = target.field
        self._concentration = Concentration(target, n_chains, rng)
        self.kappa, self.inferred = self._concentration.value, self._concentration.inferred
        self._share = np.full(n_chains, 0.5)
        self.maps, self.weights = p.maps[None], np.ones((n_chains, p.n_edges))
        self._numbers = np.empty((-(-(p.n_edges + 1) // LANES), LANES))

    def step(self, x: np.ndarray, states: np.ndarray, infer: bool, over_chains: object, powers: np.ndarray) -> None:
        """A jump of the transposed maps x (K, N, n, n), in place; then indicators, p and κ.

        ``powers`` (K,) multiply the log-likelihood of the inliers.
        """
        p = self._problem
        if infer:
            exponent = powers[:, None] * np.stack([self.kappa, self._concentration.log_normaliser()], axis=1)
            jump(x, p.maps, p.incidence, self._field, exponent, logit(self._share), states)
        seen = traces(p, x)
        chances = expit(logit(self._share)[:, None] + self._gains(seen) * powers[:, None])
        for k in range(len(x) if infer else 0):
            fill(states[k], self._numbers)
            first, *numbers = self._numbers.flat[: p.n_edges + 1]
            self.weights[k] = numbers < chances[k]
            count = self.weights[k].sum()
            self._share[k] = np.clip(betaincinv(1 + count, 1 + p.n_edges - count, first), 1e-300, 1 - 1e-16)
        if infer and self.inferred:
            counts = self.weights.sum(axis=1)
            self._concentration.update((self.weights * seen).sum(axis=1), states, powers, counts)

    def probabilities(self, x: np.ndarray) -> np.ndarray:
        """(K, E) of being inliers given the transposed maps x (K, N, n, n), κ and p."""
        return expit(logit(self._share)[:, None] + self._gains(traces(self._problem, x)))

    def log_likelihood(self, x: np.ndarray) -> np.ndarray:
        """(K,) of the inliers at transposed maps x (K, N, n, n); that of an outlier is 0."""
        return (self.weights * self._gains(traces(self._problem, x))).sum(axis=1)

    def _gains(self, traces: np.ndarray) -> np.ndarray:
        """(K, E) log-likelihoods as inliers, those as outliers being 0."""
        return self.kappa[:, None] * traces - self._concentration.log_normaliser()[:, None]
