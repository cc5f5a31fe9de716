r"""The rotation group SO(n) on plain arrays, batched over leading axes.

Conventions: tangent vectors at C are written C Ω with Ω skew-symmetric (body frame); the inner product is the
Frobenius one, :math:`\langle A, B\rangle = \operatorname{tr}(A^\top B)`, so that
:math:`\operatorname{dist}(A, B) = \lVert\log(A^\top B)\rVert_F`. geomstats uses half that product: its distances are
ours divided by √2.
"""

from collections.abc import Iterable

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from scipy.linalg import expm, schur

from fmsync import checks
from fmsync.log_kernels import log_series, newton_schulz

# Square roots are good to rounding after so many steps where no cos θ/2 is below: no angle within 1e-3 of π.
_LEAST_COSINE, _ROOT_STEPS = 5e-4, 13
# Polar factors, where no singular value is below so much of the Frobenius norm.
_LEAST_SINGULAR, _POLAR_STEPS = 0.01, 10

# θ / sin θ as a polynomial of x = sin²(θ/2) <= 1/2, to rounding: its nearest singularity is at x = 1.
_SERIES_REACH = 0.5
_AT_ONCE = 128  # logarithms: what comes between stays in the cache
_interpolant = Chebyshev.interpolate(
    lambda x: np.arcsin(np.sqrt(x)) / np.sqrt(x * (1 - x)), deg=19, domain=[0, _SERIES_REACH]
)
_SERIES: np.ndarray = _interpolant.convert(kind=Polynomial).coef.reshape(-1, 4).astype(float)


def transpose(a: np.ndarray) -> np.ndarray:
    """Transpose the last two axes (a view)."""
    return np.swapaxes(a, -1, -2)


def sym(a: np.ndarray) -> np.ndarray:
    r"""Symmetric part :math:`(A + A^\top)/2` of (..., n, n)."""
    return (a + transpose(a)) / 2


def skew(a: np.ndarray) -> np.ndarray:
    r"""Skew-symmetric part :math:`(A - A^\top)/2` of (..., n, n)."""
    return (a - transpose(a)) / 2


@checks.checked(c="... n n rotations", v="... n n")
def tangent(c: np.ndarray, v: np.ndarray) -> np.ndarray:
    r"""Project ambient vectors V (..., n, n) onto the tangent spaces at rotations C (..., n, n).

    :math:`\Pi_C(V) = V - C\,\mathrm{sym}(C^\top V) = C\,\mathrm{skew}(C^\top V)`.
    """
    return v - c @ sym(transpose(c) @ v)


@checks.checked(a="... n n")
def project(a: np.ndarray) -> np.ndarray:
    r"""Nearest rotation in the Frobenius norm: :math:`U\,\mathrm{diag}(1,\dots,1,\det(UV^\top))\,V^\top`.

    When det A < 0 the column of U that belongs to the *smallest* singular value is flipped; the last column of
    :math:`UV^\top`, as some libraries have it, does not give the nearest. Takes (..., n, n) to rotations (..., n, n).

    >>> project(np.diag([3.0, 2.0, -1.0]))
    array([[1., 0., 0.],
           [0., 1., 0.],
           [0., 0., 1.]])
    """
    flat = a.reshape(-1, *a.shape[-2:])
    largest = np.abs(flat).max(axis=(1, 2), keepdims=True, initial=0)
    flat = flat / np.where(largest > 0, largest, 1)
    norms = np.linalg.norm(flat, axis=(1, 2), keepdims=True)
    found, good = _polar(flat / np.maximum(norms, 1), _LEAST_SINGULAR, _POLAR_STEPS)
    rest = np.flatnonzero(~good | (np.linalg.det(found) < 0))
    u, _, vt = np.linalg.svd(flat[rest])
    u[:, :, -1] *= np.sign(np.linalg.det(u @ vt))[:, None]
    found[rest] = u @ vt
    return found.reshape(a.shape)


@checks.checked(a="... n n")
def qf(a: np.ndarray) -> np.ndarray:
    r"""Q factor of A = QR with the diagonal of R made positive: the paper's retraction :math:`R_C(\xi) = qf(C + \xi)`.

    Takes invertible (..., n, n) to orthogonal matrices and keeps the sign of the determinant. As det(C + C Ω) =
    det(I + Ω) > 0 for every skew Ω, retracting from a rotation stays in SO(n).
    """
    q, r = np.linalg.qr(a)
    sign = np.where(np.diagonal(r, axis1=-2, axis2=-1) < 0, -1.0, 1.0)
    return q * sign[..., None, :]


@checks.checked(omega="... n n skew")
def exp(omega: np.ndarray) -> np.ndarray:
    """Matrix exponential of skew-symmetric (..., n, n): the geodesic from I, by SciPy's scaling and squaring."""
    return expm(omega)


@checks.checked(omega="... n n skew")
def cayley(omega: np.ndarray) -> np.ndarray:
    r"""Cayley retraction :math:`(I - \Omega/2)^{-1}(I + \Omega/2) = 2(I - \Omega/2)^{-1} - I` of skew (..., n, n).

    Agrees with ``exp`` to second order, is time-reversible and costs one inverse.
    """
    identity = np.eye(omega.shape[-1])
    return 2 * np.linalg.inv(identity - omega / 2) - identity


@checks.checked(r="... n n rotations")
def log(r: np.ndarray) -> np.ndarray:
    r"""Principal logarithm of rotations (..., n, n): the skew Ω with eigen-angles in [-π, π] and exp Ω = R.

    The symmetric part S of R has the eigenvalues cos θ, twice each, and commutes with the skew part K: the logarithm is
    :math:`f(S)\,K` with f(cos θ) = θ / sin θ: within a quarter turn of I a polynomial of S. Otherwise it is twice the
    logarithm of the square root, all of whose angles are within a quarter turn. Near θ = π, where f grows without
    bound, matrices are done one by one from the real Schur form. At π itself (the cut locus) the logarithm is not
    unique; one of the shortest is returned.

    >>> log(np.array([[0.0, -1.0], [1.0, 0.0]])).round(4)
    array([[ 0.    , -1.5708],
           [ 1.5708,  0.    ]])
    """
    r = np.asarray(r, dtype=float)
    n = r.shape[-1]
    flat = r.reshape(-1, n, n)
    omega = np.empty(flat.shape)
    for first in range(0, len(flat), _AT_ONCE):
        part, found = flat[first : first + _AT_ONCE], omega[first : first + _AT_ONCE]
        found[:], near = _log_series(part)
        if (far := np.flatnonzero(~near)).size:
            roots, good = _square_roots(part[far])
            halves, sound = _log_series(roots, np.inf)
            found[far] = 2 * halves
            for index in far[~(good & sound)]:
                found[index] = _log_schur(part[index])
    return omega.reshape(r.shape)


def _log_series(r: np.ndarray, reach: float = _SERIES_REACH) -> tuple[np.ndarray, np.ndarray]:
    r"""Logarithms (B, n, n), and of which matrices they are good: those whose angles are clearly below π/2.

    Beyond ``reach``, a bound of :math:`\sin^2(\theta/2)`, they are left out.
    """
    out, near = np.empty(r.shape), np.empty(len(r), bool)
    log_series(np.ascontiguousarray(r), _SERIES, reach, out, near)
    return out, near


def _square_roots(r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r"""Rotations (B, n, n) of half the angles, and of which matrices they are good: those without angles near π.

    :math:`(I + R)/2` is :math:`R^{1/2}` times a symmetric matrix whose eigenvalues are cos θ/2: its polar factor.
    """
    return _polar((r + np.eye(r.shape[-1])) / 2, _LEAST_COSINE, _ROOT_STEPS)


def _polar(a: np.ndarray, least: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Polar factors of (B, n, n), and which of them are good: those of matrices with singular values in [least, 1]."""
    factors, last = np.array(a, dtype=float, order="C"), np.empty(len(a))
    newton_schulz(factors, least, steps, last)
    return factors, last < 1e-8  # one more step would do nothing


def _log_schur(r: np.ndarray) -> np.ndarray:
    """One (n, n) logarithm from the real Schur form, which is block diagonal for a normal matrix."""
    t, z = schur(r, output="real")
    n = len(r)
    block, k, reflections = np.zeros((n, n)), 0, []
    while k < n:
        if k + 1 < n and abs(t[k + 1, k]) > 1e-14:
            angle = np.arctan2((t[k + 1, k] - t[k, k + 1]) / 2, (t[k, k] + t[k + 1, k + 1]) / 2)
            block[k + 1, k], block[k, k + 1] = angle, -angle
            k += 2
        else:
            if t[k, k] < 0:
                reflections.append(k)
            k += 1
    for a, b in zip(reflections[::2], reflections[1::2]):  # eigenvalues -1 come in pairs: half turns of their planes
        block[b, a], block[a, b] = np.pi, -np.pi
    return skew(z @ block @ z.T)


@checks.checked(a="... n n rotations", b="... n n rotations")
def dist(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    r"""Geodesic distance :math:`\lVert\log(A^\top B)\rVert_F` between rotations, without forming the logarithm.

    The squared singular values of A - B are :math:`4\sin^2(\theta/2)`. Random rotations of SO(20) are about 8 apart;
    the diameter is :math:`\pi\sqrt{2\lfloor n/2\rfloor}`. Rotations (..., n, n) are broadcast against each other; the
    distances (...) are in radians in the Frobenius convention, √2 times those of geomstats.

    >>> float(dist(np.eye(2), np.array([[0.0, -1.0], [1.0, 0.0]])) / np.sqrt(2))
    1.5707963267948966
    """
    difference = np.asarray(a) - b
    sine_squared = np.linalg.eigvalsh(transpose(difference) @ difference) / 4
    angles = 2 * np.arcsin(np.sqrt(np.clip(sine_squared, 0, 1)))
    return np.sqrt((angles**2).sum(-1))


def _lengths(name: str, size: object) -> tuple[int, ...]:
    return tuple(checks.count(name, k, 0) for k in (size if isinstance(size, Iterable) else (size,)))


@checks.checked(size=_lengths)
def random_uniform(n: int, size: int | tuple[int, ...] = (), rng: int | np.random.Generator = 0) -> np.ndarray:
    """Haar-uniform rotations ``(*size, n, n)``: the sign-adjusted Q of a Gaussian, one column flipped if det < 0."""
    shape = tuple(size) if isinstance(size, Iterable) else (size,)
    q = qf_unchecked(np.random.default_rng(rng).standard_normal((*shape, n, n)))
    q[..., :, 0] *= np.sign(np.linalg.det(q))[..., None]
    return q


@checks.checked(rotations="K ... n n rotations", tolerance=checks.not_negative, max_iterations=">= 0")
def frechet_mean(
    rotations: np.ndarray, *, distance: str = "geodesic", tolerance: float = 1e-10, max_iterations: int = 100
) -> np.ndarray:
    r"""Fréchet mean over the first axis: the rotation with the least sum of squared distances to all.

    Takes (K, ..., n, n); the axes in the middle are independent problems. ``distance`` is ``"chordal"``,
    :math:`\lVert A-B\rVert_F`, in closed form the projection of the arithmetic mean, or ``"geodesic"``, by the fixed
    point :math:`M \leftarrow M\exp(\overline{\log(M^\top R_k)})`, started at the chordal mean; unique when all
    rotations lie within π/2 (operator norm) of it. It stops when the mean logarithm is shorter than ``tolerance``; a
    RuntimeError when it does not in ``max_iterations`` steps: the rotations are too far apart to trust a mean.

    >>> turn = exp(np.array([[0.0, -0.3], [0.3, 0.0]]))
    >>> bool(np.allclose(frechet_mean(np.stack([turn, turn.T])), np.eye(2)))
    True
    """
    checks.one_of("distance", distance, ("chordal", "geodesic"))
    if len(rotations) == 0:
        raise ValueError("rotations: need at least one to take a mean of")
    mean = project_unchecked(np.mean(rotations, axis=0))
    if distance == "chordal":
        checks.unused("for a chordal mean", tolerance=(tolerance, 1e-10), max_iterations=(max_iterations, 100))
        return mean
    last_step, last_pull, length = mean, mean, np.ones(mean.shape[:-2])
    for iteration in range(max_iterations):
        pull = log_unchecked(transpose(mean) @ rotations).mean(axis=0)
        if iteration:  # how much of the last pull its step took off tells how far to go (Barzilai & Borwein 1988)
            curved = (last_step * (last_pull - pull)).sum((-2, -1))
            length = np.clip((last_step**2).sum((-2, -1)) / np.maximum(curved, 1e-300), 1, 2)
        last_pull, last_step = pull, length[..., None, None] * pull
        mean = mean @ exp_unchecked(last_step)
        if np.sqrt((pull**2).sum((-2, -1))).max() < tolerance:
            return project_unchecked(mean)  # takes off the rounding of many products
    why = "the rotations are too spread for a unique mean, use distance='chordal'"
    raise RuntimeError(f"frechet_mean: the geodesic fixed point did not converge in {max_iterations} iterations; {why}")


# without the tests of arguments: for loops inside the library
project_unchecked, qf_unchecked = checks.unchecked(project), checks.unchecked(qf)
exp_unchecked, log_unchecked = checks.unchecked(exp), checks.unchecked(log)
cayley_unchecked, dist_unchecked = checks.unchecked(cayley), checks.unchecked(dist)
