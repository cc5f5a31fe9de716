"""Draw from the posterior of a problem by any sampler."""

import warnings
from collections.abc import Callable

import numpy as np
from tqdm import tqdm

from fmsync import checks, so
from fmsync.diagnostics import ConvergenceWarning, warn_unless_converged
from fmsync.estimators.base import Estimate
from fmsync.estimators.solve import solve
from fmsync.estimators.starts import starting_point
from fmsync.problem import LangevinPrior, SyncProblem
from fmsync.samplers.base import SAMPLERS, Sampler, Target
from fmsync.samplers.pilots import pilot_steps, split_chains, unvisited_mode
from fmsync.samplers.posterior import Posterior
from fmsync.threads import single_threaded_blas

Callback = Callable[[int, np.ndarray, np.ndarray], None]  # (draw, state (chains, N, n, n), energy (chains,))

_CHECK_EVERY = 50  # warm-up steps between two looks at the energy


@checks.checked(warmup=">= 0", kappa=checks.positive, beta=checks.positive)
def sample(
    problem: SyncProblem,
    method: str = "rlfm",
    *,
    rng: int | np.random.Generator = 0,
    n_chains: int = 4,
    n_draws: int = 1000,
    warmup: int = 1000,
    thin: int = 1,
    init: str | np.ndarray | Estimate = "spectral",
    prior: LangevinPrior | None = None,
    kappa: float | str | None = None,
    beta: float | None = None,
    likelihood: str = "langevin",
    energy: str = "euclidean",
    callback: Callback | None = None,
    **options: object,
) -> Posterior:
    r"""Draw the absolute maps from their posterior :math:`\propto\exp(-\beta U(C))`, all chains as one batch.

    Warns with a :class:`~fmsync.diagnostics.ConvergenceWarning` when the energy or an inferred concentration has R-hat
    above 1.01 or fewer than 400 effective draws, when chains stay in different modes, or when short pilot chains from
    dispersed starts, which long runs of all samplers but ``"tempered"`` can afford, find a mode that the chains have
    not visited. Raises a RuntimeError with a step to try when a chain diverges.

    * ``method``: a name of :func:`fmsync.samplers.methods`.
    * ``n_chains``, ``n_draws``, ``warmup``, ``thin``, ``rng``: chains, draws kept of each, steps before the first draw,
      steps from one draw to the next, and a seed or generator: same seed, same draws.
    * ``init``: where chains start: ``"spectral"``; ``"random"``, another Haar draw for each chain; ``"dispersed"``,
      every other chain at the maximum of the likelihood and the rest at Haar draws; rotations (N, n, n), the same for
      all chains, or (chains, N, n, n); an :class:`~fmsync.Estimate` on the group.
    * ``prior``: Langevin prior on the absolute maps; it fixes the gauge.
    * ``kappa``, ``beta``: concentration of the observations, one of the two: κ = 2β, and β = 1, as in the paper, where
      neither is given. ``"heat-bath"``, ``"tempered"``, and ``"hmc"`` and ``"mala"`` with the Euclidean energy, infer κ
      instead, under a uniform prior on [0, 1e5], when it is ``"auto"`` or neither is given.
    * ``likelihood``: ``"langevin"``: :math:`p(C_{ij})\propto\exp(\kappa\operatorname{tr}(C_{ij}^\top C_i^\top C_j))`,
      weights are multiplicities. ``"projected-gaussian"``, for ``"heat-bath"`` and tempered heat baths:
      :math:`C_{ij}=\mathrm{proj}_{SO(n)}(C_i^\top C_j+\sigma G)`, the paper's noise; σ² is inferred with
      :math:`\log\sigma^2` uniform on [log 1e-5, log 10]. ``"mixture"``, for the same two: an observation is Langevin
      with probability p, uniform a priori, and otherwise a uniformly random rotation; the posterior has the probability
      of every edge in ``edge_weights``. ``"by-edge"``, for the same two: every observation has its own κ, gamma
      distributed around a common mean, both inferred; its draws are ``kappas``. ``"by-frequency"``, for the same two:
      :math:`p(C_{ij})\propto\exp\operatorname{tr}(\Lambda C_{ij}^\top C_i^\top C_j)`, a κ for every basis function
      on the diagonal of Λ, uniform on [0, 1e5], in ``kappas``, with an approximate normaliser
      (``fmsync.samplers.concentration``); tempered replicas of it rarely exchange. The last four need observations in
      SO(n): for matrices with noise in every entry, not projected, there is ``"langevin"`` with κ = 1/σ² alone.
    * ``energy``: ``"euclidean"`` :math:`\sum w\lVert C_i^\top C_j-C_{ij}\rVert_F^2`, or, for all but ``"heat-bath"``,
      ``"geodesic"`` :math:`\sum w\lVert\log(C_{ij}^\top C_i^\top C_j)\rVert_F^2`.
    * ``callback``: called as ``callback(draw, state, energy)`` for every draw kept, with the (chains, N, n, n) where
      the chains are: not rotations in an unconstrained chain. Do not change it.
    * ``options``: passed to the sampler; an unknown option is refused with the list of known ones.

    After Ctrl-C the posterior has fewer draws and ``interrupted`` set (without any draw it goes through).

    >>> import numpy as np, fmsync
    >>> p = fmsync.SyncProblem(3, [[0, 1], [1, 2], [0, 2]], np.stack([np.eye(4)] * 3))
    >>> post = fmsync.sample(p, "rlfm", n_chains=2, n_draws=50, warmup=20, rng=0)
    >>> post.absolute.shape, post.relative_mean().shape
    ((2, 50, 3, 4, 4), (3, 4, 4))
    """
    kind, _ = SAMPLERS.find(method, options)
    target = Target(problem, prior, kappa, beta, likelihood, energy)
    rng = np.random.default_rng(rng)
    with single_threaded_blas():
        chains = kind(target, starts(problem, init, n_chains, rng), rng, **options)
        drawn = run_chains(chains, n_draws, warmup, thin, callback)
        absolute, energies = drawn["absolute"], drawn["energy"]
        said, stopped = split_chains(problem, absolute), energies.shape[1] < n_draws
        n_steps = pilot_steps(n_chains, warmup + thin * n_draws)
        piloted = method != "tempered" and likelihood not in ("mixture", "by-edge", "by-frequency")
        looks = n_steps and piloted and chains.settings.get("constrained", True)
        if looks and not said and not stopped:
            said = unvisited_mode(target, absolute, energies, float(drawn["kappa"].mean()), n_steps, rng.spawn(1)[0])
        if said:
            todo = "use method='tempered', which weighs the modes"
            warnings.warn(f"{said}; {todo}", ConvergenceWarning, stacklevel=3)
    settings = {"warmup": warmup, "thin": thin, **chains.settings}
    post = Posterior(problem, method, interrupted=stopped, settings=settings, modes=said, **drawn)
    checks.unchecked(warn_unless_converged)(post)
    return post


def run_chains(
    chains: Sampler, n_draws: int, warmup: int, thin: int, callback: Callback | None
) -> dict[str, np.ndarray]:
    """What :class:`Posterior` keeps of the draws, by its names; of fewer than ``n_draws`` after Ctrl-C."""
    kept: dict[str, np.ndarray] = {}
    done, weights = 0, None
    with tqdm(total=warmup + thin * n_draws, disable=None, unit="step", leave=False) as bar:
        try:
            for k in range(warmup):
                chains.step(warmup=True)
                bar.update()
                if (k + 1) % _CHECK_EVERY == 0:
                    checked_energy(chains)
            while done < n_draws:
                for _ in range(thin):
                    chains.step(warmup=False)
                    bar.update()
                now = {"energy": checked_energy(chains), "kappa": chains.kappa, "absolute": chains.draw()}
                if (own := chains.kappas) is not None:
                    now["kappas"] = own
                for name, values in now.items():
                    if name not in kept:
                        kept[name] = np.empty((len(values), n_draws, *values.shape[1:]))
                    kept[name][:, done] = values
                if (new := chains.edge_weights) is not None:
                    mean = new.mean(axis=0)
                    weights = mean if weights is None else weights + (mean - weights) / (done + 1)
                if callback is not None:
                    callback(done, chains.state, kept["energy"][:, done])
                done += 1
        except KeyboardInterrupt:
            if done == 0:
                raise
    drawn = {name: values[:, :done] for name, values in kept.items()}
    return drawn if weights is None else drawn | {"edge_weights": weights}


def checked_energy(chains: Sampler) -> np.ndarray:
    """Energies (K,) of the chains; a RuntimeError when one of them is where no sound chain goes."""
    with np.errstate(over="ignore", invalid="ignore"):  # a chain that blew up is told of below
        energy = chains.energy()
    if (bad := np.flatnonzero(~(energy <= chains.ceiling))).size:
        raise RuntimeError(f"chain {bad[0]} diverged: energy {energy[bad[0]]:.4g}; {chains.advice}")
    return energy


def starts(
    problem: SyncProblem, init: str | np.ndarray | Estimate, n_chains: int, rng: np.random.Generator
) -> np.ndarray:
    """Rotations (K, N, n, n), one start for each chain."""
    if isinstance(init, str):
        checks.one_of("init", init, ("spectral", "random", "dispersed"))
        if init != "spectral":
            starts = so.random_uniform(problem.n, (n_chains, problem.n_nodes), rng)
            if init == "dispersed":
                starts[::2] = solve(problem, "mle", rng=rng).absolute
            return starts
    elif not isinstance(init, Estimate) and np.ndim(init) == 4:
        if len(init) != n_chains:
            raise ValueError(f"init: {len(init)} starts for {n_chains} chains")
        return np.stack([checks.unchecked(starting_point)(problem, start, rng) for start in init])
    return np.stack([starting_point(problem, init, rng)] * n_chains)
