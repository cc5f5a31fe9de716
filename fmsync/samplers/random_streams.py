r"""Random numbers in compiled loops: xoshiro256++ in eight lanes, and von Mises draws without trigonometry.

A stream belongs to a chain or to a node of a chain, never to a thread: draws are the same however work is shared out.
"""

import numba
import numpy as np

LANES = 8
POOL = 32 * LANES  # numbers kept in stock


def generators(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """States (*shape, 4, 8) of independent xoshiro256++ generators (Blackman & Vigna 2021), seeded from ``rng``."""
    return rng.integers(1, 2**64, size=(*shape, 4, LANES), dtype=np.uint64, endpoint=False)


@numba.njit(cache=True, nogil=True, inline="always")
def _next(state: np.ndarray, lane: int) -> float:
    s0, s1, s2, s3 = state[0, lane], state[1, lane], state[2, lane], state[3, lane]
    total = s0 + s3
    result = ((total << np.uint64(23)) | (total >> np.uint64(41))) + s0
    t = s1 << np.uint64(17)
    s2 ^= s0
    s3 ^= s1
    s1 ^= s2
    s0 ^= s3
    s2 ^= t
    s3 = (s3 << np.uint64(45)) | (s3 >> np.uint64(19))
    state[0, lane], state[1, lane], state[2, lane], state[3, lane] = s0, s1, s2, s3
    return np.int64(result >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@numba.njit(cache=True, nogil=True)
def fill(state: np.ndarray, out: np.ndarray) -> None:
    """Numbers in [0, 1) for all of ``out`` (m, 8), a column from every lane of ``state`` (4, 8), which moves on."""
    lanes = state.shape[1]
    for r in range(len(out)):
        for lane in range(lanes):
            out[r, lane] = _next(state, lane)


@numba.njit(cache=True, nogil=True)
def uniform(state: np.ndarray) -> float:
    """One number in [0, 1) from the first lane of ``state`` (4, 8)."""
    return _next(state, 0)


@numba.njit(cache=True, nogil=True, inline="always")
def _exp(x: float) -> float:
    """e^x for x <= 0, off by less than 3e-14; e^-50 below -50. Of plain arithmetic, for loops of vector code."""
    t = max(x, -50.0) * (1 / 64)
    y = 1 + t * (1 / 5) * (1 + t * (1 / 6) * (1 + t * (1 / 7) * (1 + t * (1 / 8) * (1 + t * (1 / 9)))))
    y = 1 + t * (1 + t * (1 / 2) * (1 + t * (1 / 3) * (1 + t * (1 / 4) * y)))
    y = (y * y) * (y * y)
    y = (y * y) * (y * y)
    return (y * y) * (y * y)


@numba.njit(cache=True, nogil=True, inline="always")
def _proposal(k: float, root_w: float, a: float, level: float) -> tuple[float, float, bool]:
    """From a in [-1, 1) and level in [0, 1): cos φ, sin φ, and whether they pass."""
    q = 1 - a * a
    root = np.sqrt(q)
    tail = root_w * a
    r = tail * tail
    shrink = 1 / (q + r)
    most = 1.14 if k >= 2 else 2.4
    passed = (r <= q) and (level * most * root * (q + r) < _exp(-8 * k * (q * shrink) * (r * shrink)))
    return (q - r) * shrink, 2 * tail * root * shrink, passed


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def von_mises_halves(
    k: np.ndarray,
    cosine: np.ndarray,
    sine: np.ndarray,
    spare: np.ndarray,
    m: int,
    state: np.ndarray,
    pool: np.ndarray,
    at: int,
) -> int:
    r"""cos φ and sin φ of half angles φ = ψ/2, where ψ has density :math:`\propto e^{k\cos\psi}`, k >= 0.

    The tangent of ψ/4 is proposed by Student's t distribution with two degrees of freedom,
    :math:`v=\sqrt{w}\,a/\sqrt{1-a^2}` with a uniform on (-1, 1) and w = 1/(8k + 1/2), cut to \|v\| <= 1. Target over
    envelope, :math:`e^{-8kz/(1+z)^2}(1+z/w)^{3/2}/(1+z)` with :math:`z=v^2`, is at most 2.4, and 1.14 for k >= 2: then
    at least 77 % of the proposals pass. The first proposals for all k are vector code, those that fail are redone one
    by one.

    Of the (M,) arrays ``k`` is read, the others are written; entries from number m on fill vectors and are proposals
    only. ``pool`` (POOL,) is a stock of uniform numbers and ``at`` the place of the next, POOL when there is none;
    returns the new place.
    """
    count = len(k)
    if at + 2 * count > len(pool):
        fill(state, pool.reshape(-1, LANES))
        at = 0
    for p in range(count):
        root_w = np.sqrt(1 / (8 * k[p] + 0.5))
        cosine[p], sine[p], passed = _proposal(k[p], root_w, 2 * pool[at + p] - 1, pool[at + count + p])
        spare[p] = 1.0 if passed else 0.0
    at += 2 * count
    for p in range(m):
        while spare[p] == 0.0:
            if at + 2 > len(pool):
                fill(state, pool.reshape(-1, LANES))
                at = 0
            root_w = np.sqrt(1 / (8 * k[p] + 0.5))
            cosine[p], sine[p], passed = _proposal(k[p], root_w, 2 * pool[at] - 1, pool[at + 1])
            spare[p] = 1.0 if passed else 0.0
            at += 2
    return at
