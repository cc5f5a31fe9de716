"""How fast the library is beside what one would use otherwise: ``python -m bench.speed [WORD...] [--runs 5]``.

A line for each pair whose name holds one of the words: median CPU seconds of both, run in turn on one BLAS thread, and
the median of the ratios; for samplers, of an effective draw. On a busy machine trust the ratios. What the suites
``speed`` and ``scale`` measure is not repeated here.
"""

import argparse
import warnings
from collections.abc import Callable
from functools import partial

import numpy as np
import scipy.linalg

import data_gen
import fmsync
from bench import methods
from bench.studies import compare
from fmsync import SyncProblem, bounds, langevin, so

Ways = tuple[Callable[[], object], Callable[[], object]]  # ours and the peer's, their input prepared


def paper_size(sigma2: float, n_nodes: int = 11) -> SyncProblem:
    """Maps of size 20 between all pairs of planted rotations, observed through the paper's noise."""
    return data_gen.perturb(data_gen.planted(n_nodes, 20), sigma2, rng=1)


def afresh(function: Callable, problem: SyncProblem, *arguments, **options) -> object:
    """Call the function on the problem with nothing computed yet."""
    return function(SyncProblem(problem.n_nodes, problem.edges, problem.maps), *arguments, **options)


def logarithms() -> Ways:
    """Of 110 rotations of SO(20): the edges of eleven shapes, both ways."""
    from geomstats.geometry.special_orthogonal import SpecialOrthogonal

    rotations, group = so.random_uniform(20, 110, rng=0), SpecialOrthogonal(n=20)
    return lambda: so.log(rotations), lambda: group.metric.log(rotations, np.eye(20))


def exponentials() -> Ways:
    """Exponentials of eleven shapes in ten directions."""
    tangents = so.skew(np.random.default_rng(0).standard_normal((110, 20, 20)))
    return partial(so.exp, tangents), partial(scipy.linalg.expm, tangents)


def projections() -> Ways:
    """Nearest rotations of as many matrices."""
    matrices = np.random.default_rng(0).standard_normal((110, 20, 20))
    return partial(so.project, matrices), lambda: [scipy.linalg.polar(a)[0] for a in matrices]


def eigenfunctions() -> Ways:
    """Twenty on a bumpy closed surface of 28,000 vertices; shift-invert with SciPy's default factorisation."""
    import pyvista as pv
    import robust_laplacian
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import eigsh

    ball = pv.Icosphere(nsub=7).decimate(1 - 56000 / 327680).clean()
    bump = 1 + 0.3 * np.sin(3 * ball.points[:, :1]) * np.cos(2 * ball.points[:, 1:2])
    vertices, faces = np.asarray(ball.points * bump * [1.0, 0.7, 0.5], dtype=float), np.asarray(ball.regular_faces)

    def peer() -> object:
        stiffness, mass = robust_laplacian.mesh_laplacian(vertices, faces)
        start = np.random.default_rng(0).standard_normal(len(vertices))
        return eigsh(csc_matrix(stiffness), k=20, M=mass, sigma=-1e-8, v0=start)

    return lambda: fmsync.laplace_beltrami(vertices, faces, 20), peer


def maximum_likelihood(sigma2: float, derivatives: str) -> Ways:
    """Both from the spectral start, initialisation included, to gradient norm 1e-6."""
    methods.get("mle-pymanopt")  # registers it
    problem, options = paper_size(sigma2), {"init": "spectral", "derivatives": derivatives}
    ours = partial(afresh, fmsync.solve, problem, "mle")
    return ours, partial(afresh, fmsync.solve, problem, "mle-pymanopt", **options)


def eigenvectors(n_nodes: int) -> Ways:
    """The spectral estimate, and SciPy on the dense matrix."""
    problem, dense = paper_size(0.2, n_nodes), methods.get("scipy-eigh").function
    return partial(afresh, fmsync.solve, problem, "spectral"), partial(afresh, dense, problem, rng=None)


def draws(ours: str, peer: str, sigma2: float = 0.2, n_draws: int = 500, warmup: int = 300) -> Ways:
    """Four chains at the concentration that matches the noise, warm-up included. Draws of ``rlfm`` are biased."""
    methods.get("rlfm-geomstats")  # registers it
    problem = paper_size(sigma2)
    kappa = langevin.matched_kappa(20, bounds.projected_noise_moments(20, sigma2)[0] / 20)
    options = {"n_chains": 4, "n_draws": n_draws, "warmup": warmup, "kappa": kappa}
    return tuple(partial(fmsync.sample, problem, name, **options) for name in (ours, peer))


def effective(posterior: fmsync.Posterior) -> float:
    """Least effective number of draws over energy, traces and entries."""
    return float(np.fmin.reduce(posterior.summary().ess_bulk))


#: Name, maker of the two ways, and what a result is worth.
PAIRS = [
    ("log of 110 rotations of SO(20) / geomstats", logarithms, None),
    ("exp of 110 tangents of SO(20) / scipy expm", exponentials, None),
    ("nearest of 110 rotations of SO(20) / scipy polar", projections, None),
    ("Laplace–Beltrami, 28,000 vertices, n = 20 / eigsh", eigenfunctions, None),
    *(
        (f"mle, N = 11, n = 20, σ² = {s:g} / pymanopt, {d}", partial(maximum_likelihood, s, d), None)
        for s in (0.2, 0.6, 1.0)
        for d in ("hand", "autograd")
    ),
    *((f"spectral, N = {size}, n = 20 / scipy eigh", partial(eigenvectors, size), None) for size in (11, 50)),
    ("twenty steps of rlfm / geomstats", partial(draws, "rlfm", "rlfm-geomstats", n_draws=10, warmup=10), None),
    *(
        (f"draw of heat-bath, σ² = {s:g} / {peer}", partial(draws, "heat-bath", peer, s), effective)
        for peer in ("hmc", "mala", "rlfm")
        for s in (0.1, 0.2)
    ),
]


def main(arguments: list[str] | None = None) -> None:
    """Print a line for each pair."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", metavar="WORD")
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args(arguments)
    warnings.simplefilter("ignore", fmsync.diagnostics.ConvergenceWarning)  # nobody reads these draws
    print(f"{'ours / peer':58s} {'ours, ms':>10s} {'peer, ms':>10s} {'ratio':>8s}")
    for name, make, work in PAIRS:
        if not options.words or any(word in name for word in options.words):
            ours, peer, ratio = compare(*make(), runs=options.runs, work=work)
            print(f"{name:58s} {1e3 * ours:10.3f} {1e3 * peer:10.3f} {ratio:7.2f}x", flush=True)


if __name__ == "__main__":
    main()
