r"""Random numbers in compiled loops: xoshiro256++ in eight lanes, and normal numbers by the ziggurat.

A stream belongs to a chain or to a node of a chain, never to a thread: draws are the same however work is shared out.
"""

import numba
import numpy as np

LANES = 8
_LAYERS, _LAST, _AREA = 256, 3.6541528853610088, 4.92867323399141e-3  # of Marsaglia & Tsang (2000), for exp(-x²/2)


def _layers() -> np.ndarray:
    """(257,) right ends of layers of one area under exp(-x²/2), from the lowest, which has the tail, to the top."""
    ends = [_AREA / np.exp(-(_LAST**2) / 2), _LAST]
    while len(ends) < _LAYERS:
        ends.append(np.sqrt(-2 * np.log(_AREA / ends[-1] + np.exp(-(ends[-1] ** 2) / 2))))
    return np.array([*ends, 0.0])


_ENDS = _layers()


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


@numba.njit(cache=True, nogil=True)
def normals(state: np.ndarray, out: np.ndarray) -> None:
    """Standard normal numbers for all of ``out`` (m, 8), by the ziggurat of Marsaglia & Tsang (2000)."""
    fill(state, out)
    flat = out.reshape(-1)
    for p in range(len(flat)):
        flat[p] = _normal_of(flat[p], state)


@numba.njit(cache=True, nogil=True)
def normal(state: np.ndarray) -> float:
    """One standard normal number."""
    return _normal_of(uniform(state), state)


@numba.njit(cache=True, nogil=True, inline="always")
def _normal_of(u: float, state: np.ndarray) -> float:
    scaled = _LAYERS * u
    layer = int(scaled)
    x = (2 * (scaled - layer) - 1) * _ENDS[layer]
    return x if abs(x) < _ENDS[layer + 1] else _rare(state, layer, x)


@numba.njit(cache=True, nogil=True)
def _rare(state: np.ndarray, layer: int, x: float) -> float:
    """A normal number where x of a layer is not below the whole of the next: one in a hundred."""
    while True:
        if abs(x) < _ENDS[layer + 1]:
            return x
        if layer == 0:  # beyond the last layer
            beyond, level = 0.0, 0.0
            while 2 * level <= beyond * beyond:
                beyond, level = -np.log(1 - uniform(state)) / _LAST, -np.log(1 - uniform(state))
            return np.copysign(_LAST + beyond, x)
        low, high = np.exp((x * x - _ENDS[layer] ** 2) / 2), np.exp((x * x - _ENDS[layer + 1] ** 2) / 2)
        if low + uniform(state) * (high - low) < 1:
            return x
        scaled = _LAYERS * uniform(state)
        layer = int(scaled)
        x = (2 * (scaled - layer) - 1) * _ENDS[layer]
