r"""The paper's noise, exactly: the symmetric polar factor that projection threw away is put back as a latent variable.

:math:`C_{ij}P_{ij} = C_i^\top C_j + \sigma G` with P symmetric and :math:`\lambda_a+\lambda_b>0` for all pairs of its
eigenvalues: that is the region which projection to SO(n) maps to C_ij, and the Jacobian is
:math:`\prod_{a<b}(\lambda_a+\lambda_b)`. Given P and σ the maps see plain Gaussian observations M = C P, whose exponent
is linear in each map: the heat bath applies. Given the maps, with A the symmetric part of
:math:`C_{ij}^\top C_i^\top C_j`,

.. math:: p(P)\propto\prod_{a<b}(\lambda_a+\lambda_b)\,\exp\bigl(-\lVert P-A\rVert_F^2/2\sigma^2\bigr),

moved in eigen-coordinates :math:`P = V\Lambda V^\top`: planes of eigenvectors as those of maps are,
and eigenvalues by slices, half of either in turn. The maps mix more slowly than the polar factors: half is enough.
"""

from collections.abc import Callable

import numba
import numpy as np

from fmsync.samplers.base import Target
from fmsync.samplers.plane_rotations import over_relaxed, plane_room, rotate_rows, rounds
from fmsync.samplers.random_streams import LANES, fill, normal, normals, uniform

Pool = Callable[[Callable[[int, int], None], int], None]  # calls work on chains first .. last, of so many

LEAST_SIGMA2, LARGEST_SIGMA2 = 1e-5, 10.0
_SIGMA2_ROUNDS = 8  # alternations of σ² and the common scale, which cost nothing beside the rest


class PolarFactors:
    """Symmetric polar factors and noise variance of every chain, and the observations that map sweeps read.

    ``sigma2`` (K,), ``maps`` (K, E, n, n), and ``weights`` (1, E), which are ones. The start is what projection does
    to a Gaussian matrix around I.
    """

    inferred = True

    def __init__(self, target: Target, n_chains: int, rng: np.random.Generator):
        self._problem = target.problem
        n, n_edges = self._problem.n, self._problem.n_edges
        if target.kappa is not None:
            raise ValueError("kappa, beta: likelihood='projected-gaussian' infers sigma2; leave them out")
        sigma2 = np.clip(1 / target.matched_kappa("sigma2", rng), LEAST_SIGMA2, 1.0)
        self.sigma2 = np.full(n_chains, sigma2)
        noise = np.eye(n) + np.sqrt(sigma2) * rng.standard_normal((n_chains, n_edges, n, n))
        _, self._values, self._vectors = np.linalg.svd(noise)  # rows of the vectors are eigenvectors
        self._values[..., -1] *= np.sign(np.linalg.det(noise))
        self.maps, self.weights = np.empty((n_chains, *self._problem.maps.shape)), np.ones((1, n_edges))
        self._halves, self._age = [np.ascontiguousarray(rounds(n)[k::2]) for k in (0, 1)], 0

    @property
    def kappa(self) -> np.ndarray:
        return 1 / self.sigma2

    def step(self, x: np.ndarray, states: np.ndarray, infer: bool, over_chains: Pool, powers: np.ndarray) -> None:
        """New polar factors given the transposed maps x (K, N, n, n), with ``infer`` a new σ², and observations.

        The coupling of maps and observations, tr(Mᵀ C_iᵀ C_j)/σ², is multiplied by ``powers`` (K,).
        """
        p, self._age = self._problem, self._age + 1
        parity = self._age % 2

        def some(first: int, last: int) -> None:
            own = slice(first, last)
            polar_factor_step(
                x[own], self._vectors[own], self._values[own], self.sigma2[own], powers[own], self.maps[own],
                states[own], p.edges, p.maps, self._halves[parity], parity, infer,
            )  # fmt: skip

        over_chains(some, len(x))

    def log_likelihood(self, x: np.ndarray) -> np.ndarray:
        """(K,) Σ tr(Mᵀ C_iᵀ C_j)/σ² of transposed maps x (K, N, n, n), M the unprojected observations C_ij P."""
        i, j = self._problem.edges.T
        relative = x[:, i] @ np.swapaxes(x[:, j], -1, -2)
        against = np.swapaxes(self._problem.maps, -1, -2) @ relative
        polar = np.swapaxes(self._vectors, -1, -2) * self._values[..., None, :] @ self._vectors
        return np.einsum("keab,keab->k", polar, against) / self.sigma2


@numba.njit(cache=True, nogil=True)
def polar_factor_step(
    x: np.ndarray,
    vectors: np.ndarray,
    values: np.ndarray,
    sigma2: np.ndarray,
    powers: np.ndarray,
    unprojected: np.ndarray,
    states: np.ndarray,
    edges: np.ndarray,
    maps: np.ndarray,
    planes: np.ndarray,
    parity: int,
    infer: bool,
) -> None:
    """All edges of every chain in place: eigenvectors in rounds of ``planes``, eigenvalues of one ``parity``, 0 or 1.

    With ``infer`` a new σ² of every chain; ``unprojected`` (K, E, n, n) become C P.
    """
    n_edges, n = maps.shape[0], maps.shape[1]
    relative, centre = np.empty((n, n)), np.empty((n, n))
    product, scaled = np.empty((n, n)), np.empty((n, n))
    rows, diagonal = np.empty((n, 2 * n)), np.empty(n)  # V beside V A, and the diagonal of V A Vᵀ
    room = plane_room(planes)
    for k in range(len(x)):
        quadratic = linear = 0.0  # Σ ‖P‖² and Σ tr(P A)
        for e in range(n_edges):
            np.dot(x[k, edges[e, 0]], x[k, edges[e, 1]].T, relative)
            np.dot(maps[e].T, relative, product)
            for a in range(n):
                for b in range(n):
                    centre[a, b] = powers[k] * (product[a, b] + product[b, a]) / 2
            np.dot(vectors[k, e], centre, product)
            for a in range(n):
                diagonal[a] = 0.0
                for b in range(n):
                    rows[a, b], rows[a, n + b] = vectors[k, e, a, b], product[a, b]
                    diagonal[a] += vectors[k, e, a, b] * product[a, b]
            rotate_eigenvectors(rows, diagonal, values[k, e], sigma2[k], planes, room, states[k])
            draw_eigenvalues(values[k, e], diagonal, sigma2[k], parity, states[k])
            for a in range(n):
                quadratic += values[k, e, a] * values[k, e, a]
                linear += values[k, e, a] * diagonal[a]
            vectors[k, e] = rows[:, :n]
        scale = 1.0
        if infer:
            sigma2[k], scale = draw_sigma2(quadratic, linear, n_edges * n, n_edges * n * n, sigma2[k], states[k])
            values[k] *= scale
        for e in range(n_edges):
            for a in range(n):
                for b in range(n):
                    scaled[a, b] = values[k, e, a] * vectors[k, e, a, b]
            np.dot(vectors[k, e].T, scaled, product)
            np.dot(maps[e], product, unprojected[k, e])


@numba.njit(cache=True, nogil=True, inline="always")
def _half_angle(cosine: float, sine: float) -> tuple[float, float]:
    """Cosine and sine of half the angle in [-π, π] that has these."""
    root = np.sqrt((1 + abs(cosine)) / 2)
    other = abs(sine) / (2 * root)
    return (root, np.copysign(other, sine)) if cosine >= 0.0 else (other, np.copysign(root, sine))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})
def rotate_eigenvectors(
    rows: np.ndarray,
    diagonal: np.ndarray,
    values: np.ndarray,
    sigma2: float,
    planes: np.ndarray,
    room: tuple[np.ndarray, np.ndarray, np.ndarray],
    state: np.ndarray,
) -> None:
    r"""Over-relaxed moves of planes of eigenvectors: rows (n, 2n) hold V and V A, rotated together.

    With B = V A Vᵀ, whose diagonal is kept up to date and whose other entries are products of two rows, twice the angle
    is von Mises about the direction of :math:`(\lambda_a-\lambda_b)\,((B_{aa}-B_{bb})/2, B_{ab})`. ``room`` is that of
    :func:`~fmsync.samplers.plane_rotations.plane_room`.
    """
    (angles, normal_numbers, level), n, count = room, len(values), planes.shape[1]
    along, across, cosine, sine, size, half, between = angles
    normals(state, normal_numbers.reshape(-1, LANES))
    fill(state, level.reshape(-1, LANES))
    for r in range(len(planes)):
        for k in range(count):
            a, b = planes[r, k, 0], planes[r, k, 1]
            p, q = rows[a], rows[b]
            product = 0.0
            for c in range(n):
                product += p[c] * q[n + c]
            between[k], half[k] = product, (diagonal[a] - diagonal[b]) / 2
            gap = (values[a] - values[b]) / sigma2
            along[k], across[k] = gap * half[k], gap * between[k]
        over_relaxed(along, across, cosine, sine, size, normal_numbers[r * count :], level[r * count :], count, state)
        for k in range(count):  # half the angle of the mode comes on top
            x, y = _half_angle(along[k], across[k])
            cosine[k], sine[k] = cosine[k] * x - sine[k] * y, sine[k] * x + cosine[k] * y
            a, b = planes[r, k, 0], planes[r, k, 1]
            middle = (diagonal[a] + diagonal[b]) / 2
            c, s = cosine[k], sine[k]
            turned = half[k] * (c * c - s * s) + between[k] * 2 * c * s
            diagonal[a], diagonal[b] = middle + turned, middle - turned
        rotate_rows(rows, planes[r], cosine, sine)


@numba.njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _log_density(squares: np.ndarray, least: float, x: float, mean: float, sigma2: float) -> float:
    """Logarithm of the density of an eigenvalue at x given the squares and the least of the others."""
    if x + least <= 0:
        return -np.inf
    logarithm, square = -((x - mean) ** 2) / (2 * sigma2), x * x
    for first in range(0, len(squares), 24):  # one logarithm for many factors, few enough not to overflow
        few = squares[first : first + 24]
        left, right, odd = 1.0, 1.0, len(few) % 2  # two products, which do not wait for each other
        for c in range(odd, len(few), 2):
            left *= square - few[c]
            right *= square - few[c + 1]
        logarithm += np.log(abs(left * right * (square - few[0] if odd else 1.0)))
    return logarithm


@numba.njit(cache=True, nogil=True)
def draw_eigenvalues(values: np.ndarray, diagonal: np.ndarray, sigma2: float, parity: int, state: np.ndarray) -> None:
    r"""One slice for every other eigenvalue, from number ``parity`` on, by the density

    :math:`\prod_{c\ne k}(\lambda+\lambda_c)|\lambda-\lambda_c|\;e^{-(\lambda-B_{kk})^2/2\sigma^2}`.
    """
    width = 2 * np.sqrt(sigma2)
    squares = np.empty(len(values) - 1)
    for k in range(parity, len(values), 2):
        least = np.inf
        for c in range(len(values)):
            if c != k:
                least = min(least, values[c])
                squares[c - (c > k)] = values[c] * values[c]
        mean, here = diagonal[k], values[k]
        level = _log_density(squares, least, here, mean, sigma2) + np.log(1 - uniform(state))
        low = here - width * uniform(state)
        high = low + width
        while _log_density(squares, least, low, mean, sigma2) > level:
            low -= width
        while _log_density(squares, least, high, mean, sigma2) > level:
            high += width
        while True:
            new = low + (high - low) * uniform(state)
            if _log_density(squares, least, new, mean, sigma2) >= level:
                break
            if new < here:
                low = new
            else:
                high = new
        values[k] = new


@numba.njit(cache=True, nogil=True)
def draw_sigma2(
    quadratic: float, linear: float, constant: int, dimension: int, sigma2: float, state: np.ndarray
) -> tuple[float, float]:
    r"""σ² and a factor s for all polar factors, given their directions: (σ², s).

    Two exact steps in turn, with Q = Σ‖P‖², L = Σ tr(P A), c the constant and :math:`\sum\lVert M-R\rVert^2 = Q-2L+c`.
    σ² alone is inverse gamma. Along the joint scaling :math:`(P, \sigma)\to(sP, s\sigma)` all powers of s cancel but
    one: with v = 1/s the density is :math:`v^{-1}\exp(-c\,(v-L/c)^2/2\sigma^2)`.
    """
    scale = 1.0
    for _ in range(_SIGMA2_ROUNDS):
        v = linear / constant + np.sqrt(sigma2 / constant) * normal(state)
        if v > 0 and uniform(state) * v < 1 and LEAST_SIGMA2 <= sigma2 / (v * v) <= LARGEST_SIGMA2:
            scale /= v
            quadratic, linear, sigma2 = quadratic / (v * v), linear / v, sigma2 / (v * v)
        rest = quadratic - 2 * linear + constant
        new = rest / 2 / _gamma(dimension / 2, state)
        if LEAST_SIGMA2 <= new <= LARGEST_SIGMA2:
            sigma2 = new
    return sigma2, scale


@numba.njit(cache=True, nogil=True)
def _gamma(shape: float, state: np.ndarray) -> float:
    """Marsaglia & Tsang (2000), shape >= 1."""
    d = shape - 1 / 3
    c = 1 / np.sqrt(9 * d)
    while True:
        z = normal(state)
        v = (1 + c * z) ** 3
        if v > 0 and np.log(1 - uniform(state)) < z * z / 2 + d * (1 - v + np.log(v)):
            return d * v
