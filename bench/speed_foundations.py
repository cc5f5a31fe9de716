"""Foundations against what one would write otherwise. Run: ``python -m bench.speed_foundations``."""

import numpy as np
import pyvista as pv
import robust_laplacian
import scipy.sparse as sp
from geomstats.geometry.special_orthogonal import SpecialOrthogonal
from scipy.sparse.linalg import eigsh

import fmsync
from bench.timing import Comparison, compare
from fmsync import so


def laplace_beltrami_28k() -> Comparison:
    """n = 20 on a bumpy closed surface of 28k vertices, against shift-invert with SciPy's default factorisation."""
    ball = pv.Icosphere(nsub=7).decimate(1 - 56000 / 327680).clean()
    bump = 1 + 0.3 * np.sin(3 * ball.points[:, :1]) * np.cos(2 * ball.points[:, 1:2])
    vertices, faces = np.asarray(ball.points * bump * [1.0, 0.7, 0.5], dtype=float), np.asarray(ball.regular_faces)

    def peer():
        stiffness, mass = robust_laplacian.mesh_laplacian(vertices, faces)
        start = np.random.default_rng(0).standard_normal(len(vertices))
        return eigsh(sp.csc_matrix(stiffness), k=20, M=mass, sigma=-1e-8, v0=start)

    return compare(
        f"Laplace-Beltrami, {len(vertices)} vertices, n = 20 / eigsh default",
        lambda: fmsync.laplace_beltrami(vertices, faces, 20),
        peer,
        runs=3,
        goal=1.5,
    )


def logarithms() -> Comparison:
    """110 rotations of SO(20), the edges of eleven shapes both ways, against geomstats."""
    rotations = so.random_uniform(20, 110, rng=0)
    group = SpecialOrthogonal(n=20)
    return compare(
        "log of 110 SO(20) / geomstats",
        lambda: so.log(rotations),
        lambda: group.metric.log(rotations, np.eye(20)),
        goal=10,
    )


def maximum_likelihood(sigma2: float) -> Comparison:
    """MLE (2) at N = 11, n = 20, complete, to gradient norm 1e-6, against pymanopt with automatic derivatives."""
    rng = np.random.default_rng(1)
    edges = np.array([(i, j) for i in range(11) for j in range(i + 1, 11)])
    truth = so.random_uniform(20, 11, rng)
    exact = so.transpose(truth[edges[:, 0]]) @ truth[edges[:, 1]]
    maps = so.project(exact + np.sqrt(sigma2) * rng.standard_normal(exact.shape))
    return compare(
        f"MLE (2), N = 11, n = 20, σ² = {sigma2:g} / pymanopt, autograd",
        lambda: fmsync.solve(fmsync.SyncProblem(11, edges, maps), "mle"),
        lambda: fmsync.solve(
            fmsync.SyncProblem(11, edges, maps), "mle-pymanopt", init="spectral", derivatives="autograd"
        ),
        goal=6,
    )


if __name__ == "__main__":
    print(f"{'ours / peer':58s} {'ours':>13s} {'peer':>13s} {'ratio':>8s}")
    for row in (laplace_beltrami_28k, logarithms):
        print(row(), flush=True)
    for sigma2 in (0.2, 0.6, 1.0):
        print(maximum_likelihood(sigma2), flush=True)
