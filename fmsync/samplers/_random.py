r"""Random numbers in compiled loops: one xoshiro256++ generator a chain, and von Mises draws without trigonometry."""

import numba
import numpy as np


def generators(rng: np.random.Generator, count: int) -> np.ndarray:
    """States (count, 4) of independent xoshiro256++ generators (Blackman & Vigna 2021), seeded from ``rng``."""
    return rng.integers(1, 2**64, size=(count, 4), dtype=np.uint64, endpoint=False)


@numba.njit(cache=True, nogil=True, inline="always")
def _rotl(x, k):
    return (x << np.uint64(k)) | (x >> np.uint64(64 - k))


@numba.njit(cache=True, nogil=True)
def uniform(state):
    """One number in [0, 1) from a generator (4,), which moves on."""
    s0, s1, s2, s3 = state[0], state[1], state[2], state[3]
    result = _rotl(s0 + s3, 23) + s0
    t = s1 << np.uint64(17)
    s2 ^= s0
    s3 ^= s1
    s1 ^= s2
    s0 ^= s3
    s2 ^= t
    s3 = _rotl(s3, 45)
    state[0], state[1], state[2], state[3] = s0, s1, s2, s3
    return (result >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@numba.njit(cache=True, nogil=True)
def von_mises_half(k, state):
    r"""A vector at the angle φ = ψ/2 for ψ with density :math:`\propto e^{k\cos\psi}`, k >= 0: (x, y, x² + y²).

    On the circle of φ the density is :math:`e^{-2k\sin^2\varphi}`, a Bingham law; an angular central Gaussian lies over
    it (Kent, Ganeiber & Mardia 2018), whose tangent is a scaled ratio of two coordinates of a point in the disc. It is
    the wrapped Cauchy envelope of Best & Fisher (1979), and at least 66 % of the proposals pass. The vector is not
    normalised, for half of the callers need no root.
    """
    root = np.sqrt(4 * k * k + 1)
    less = (root - 1) + 2 * k  # the envelope has axes 1 and less + 1
    half_b = 2 * k / less if k > 0.0 else 1.0
    widen = np.sqrt(less + 1)
    while True:
        u, y = 2 * uniform(state) - 1, 2 * uniform(state) - 1
        if u * u + y * y > 1.0:
            continue
        x = widen * u
        square = x * x + y * y
        if square == 0.0:
            continue
        c = half_b + 2 * k * (y * y / square)
        level = uniform(state)
        if level < c * (2 - c) or level < c * np.exp(1 - c):
            return x, y, square
