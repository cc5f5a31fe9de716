"""What :func:`fmsync.sample` returns: draws, and the answers read off them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fmsync import adapters, checks, so
from fmsync.diagnostics import Draws, Summary, summary
from fmsync.problem import SyncProblem
from fmsync.problem import relative_maps_unchecked as relative_maps


@dataclass(frozen=True, eq=False)
class Posterior(Draws):
    r"""Draws of the absolute maps; only what does not change under :math:`C_i \to Q C_i` means anything.

    ``absolute`` (chains, draws, N, n, n) are rotations in whatever gauge the chains were. Of every draw (chains, draws)
    ``energy`` is the potential U without the temperature and ``kappa`` the concentration of the observations, 1/σ²
    under the projected Gaussian likelihood. ``interrupted``: Ctrl-C ended the run early; the draws before it are kept.
    ``settings`` are plain values the sampler ran with: step, warm-up, thinning, … ``edge_weights`` (E,) are the
    posterior inlier probabilities of the observations under the mixture likelihood, and ``kappas`` the concentrations
    whose mean ``kappa`` is, (chains, draws, E) under the likelihood by edge, (chains, draws, n) by frequency.
    ``modes`` says that chains lie in different modes or that pilots found another one, as :func:`fmsync.sample` warns.
    """

    edge_weights: np.ndarray | None = None
    kappas: np.ndarray | None = None
    modes: str = ""

    @property
    def n_chains(self) -> int:
        return self.energy.shape[0]

    @property
    def n_draws(self) -> int:
        return self.energy.shape[1]

    @property
    def sigma2(self) -> np.ndarray:
        """(chains, draws) noise variance of an entry, under ``likelihood="projected-gaussian"`` (else ValueError)."""
        if self.settings.get("likelihood") != "projected-gaussian":
            raise ValueError("sigma2: only likelihood='projected-gaussian' has a noise variance; see kappa")
        return 1 / self.kappa

    @checks.checked(edges="K 2 < N")
    def relative(self, edges: np.ndarray | None = None) -> np.ndarray:
        r"""Relative maps :math:`C_i^\top C_j` of every draw, (chains, draws, E, n, n).

        ``edges`` (E, 2) are any pairs, by default the problem's own: for a thousand draws ask for a few only.
        """
        return relative_maps(self.absolute, self.problem.edges if edges is None else edges)

    @checks.checked(edges="K 2 < N")
    def relative_mean(self, edges: np.ndarray | None = None, *, projected: bool = True) -> np.ndarray:
        """Chordal mean over all draws of the relative maps, (E, n, n): independent of every gauge.

        ``edges`` (E, 2) are the problem's own by default. With ``projected=False`` it is the arithmetic mean itself,
        which is not a rotation but of all matrices the one with the least expected squared Frobenius error.
        """
        edges = self.problem.edges if edges is None else edges
        # one product per pair over all draws at once, and no (draws, E, n, n) array
        stacked = {k: self.absolute[:, :, k].reshape(-1, self.problem.n) for k in np.unique(edges)}  # (draws n, n)
        mean = np.stack([stacked[i].T @ stacked[j] for i, j in edges]) / (self.n_chains * self.n_draws)
        return so.project_unchecked(mean) if projected else mean

    @checks.checked(level=checks.probability, edges="K 2 < N")
    def credible_balls(self, level: float, edges: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        r"""Centres (E, n, n) and radii (E,) of Frobenius balls that hold each relative map with probability ``level``.

        The centre is the arithmetic mean of the draws. A draw's distance is taken to the mean of the *others*,
        :math:`\tfrac{T}{T-1}\lVert C_t-\bar C\rVert_F`. The radius is the (k+1)-th smallest of these T distances, k the
        largest integer with k/T <= ``level``: :func:`fmsync.calibration.ball_level` of what it covers is at most that.
        """
        edges = self.problem.edges if edges is None else edges
        centres = self.relative_mean(edges, projected=False)
        count = self.n_chains * self.n_draws
        k = np.count_nonzero(np.arange(1, count + 1) / count <= level)
        radii = np.empty(len(edges))
        for e, centre in enumerate(centres):
            draws = self.relative(edges[e : e + 1]).reshape(-1, *centre.shape)
            radii[e] = np.partition(count / max(count - 1, 1) * np.linalg.norm(draws - centre, axis=(1, 2)), k)[k]
        return centres, radii

    def summary(self) -> Summary:
        """Mean, spread, R-hat and bulk and tail ESS of gauge-invariant scalars (:func:`fmsync.diagnostics.summary`)."""
        return summary(self)

    def to_arviz(self, edges: np.ndarray | None = None) -> Any:
        """The same scalars, and the draws, as an object of ArviZ (:func:`fmsync.adapters.to_arviz`)."""
        return adapters.to_arviz(self, edges)

    @classmethod
    @checks.checked()
    def from_arviz(cls, data: Mapping[str, Any], problem: SyncProblem) -> "Posterior":
        """What :meth:`to_arviz` gave away, less all that has a default here (:func:`fmsync.adapters.from_arviz`)."""
        return cls(**vars(adapters.from_arviz(data, problem)))
