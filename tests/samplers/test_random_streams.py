"""The compiled random numbers against their definitions and distributions."""

import numpy as np
import pytest
from scipy import stats
from scipy.special import ive

from fmsync.samplers import random_streams


def test_generators_against_their_definition():
    """Python's whole numbers in place of 64-bit registers, one lane after the other."""
    state = random_streams.generators(np.random.default_rng(0), 2)[1]
    lanes, mask = [[int(v) for v in state[:, lane]] for lane in range(8)], 2**64 - 1
    expected = np.empty((100, 8))
    for t in range(100):
        for lane, s in enumerate(lanes):
            total = (s[0] + s[3]) & mask
            result = (((total << 23) | (total >> 41)) + s[0]) & mask
            shifted = (s[1] << 17) & mask
            s[2] ^= s[0]
            s[3] ^= s[1]
            s[1] ^= s[2]
            s[0] ^= s[3]
            s[2] ^= shifted
            s[3] = ((s[3] << 45) | (s[3] >> 19)) & mask
            expected[t, lane] = (result >> 11) / 2**53
    drawn = np.empty((100, 8))
    drawn[0, 0] = random_streams.uniform(state.copy())
    assert drawn[0, 0] == expected[0, 0]
    random_streams.fill(state, drawn)
    np.testing.assert_array_equal(drawn, expected)
    assert len(np.unique(drawn)) == drawn.size


def half_angles(k, count, state):
    """(count, 2) cosines and sines by the compiled draw, each with another place in its vectors."""
    pool, at, drawn = np.empty(random_streams.POOL), random_streams.POOL, np.empty((count // 5, 5, 2))
    room = np.empty((3, 8))
    for t in range(len(drawn)):
        at = random_streams.von_mises_halves(np.full(8, k), room[0], room[1], room[2], 5, state, pool, at)
        drawn[t] = room[:2, :5].T
    return drawn.reshape(-1, 2)


@pytest.mark.parametrize("k", [0.0, 1e-13, 0.3, 1.99, 2.0, 5.0, 200.0, 1e7])
def test_von_mises_draws(k):
    half = half_angles(k, 20_000, random_streams.generators(np.random.default_rng(1), 1)[0])
    np.testing.assert_allclose((half**2).sum(1), 1)
    angle = 2 * np.arctan2(half[:, 1], half[:, 0])
    angle = np.angle(np.exp(1j * angle))
    expected = stats.uniform(-np.pi, 2 * np.pi) if k < 1e-6 else stats.vonmises(k)
    if k > 1e5:
        expected = stats.norm(0, 1 / np.sqrt(k))
    assert stats.kstest(angle, expected.cdf).pvalue > 1e-4
    if 0.1 < k < 1e3:
        cosine = np.cos(angle)
        assert abs(cosine.mean() - ive(1, k) / ive(0, k)) < 4 * cosine.std() / np.sqrt(len(cosine))


def test_the_envelope_lies_above_the_von_mises_density():
    """The bounds 2.4 and 1.14 that the rejections rest on, over all k and all angles."""
    k = np.concatenate([np.linspace(0, 5, 501), np.geomspace(5, 1e9, 200)])[:, None]
    w = 1 / (8 * k + 0.5)
    z = np.minimum(np.concatenate([w * np.linspace(0, 30, 1000), np.tile(np.linspace(0, 1, 2000), (len(k), 1))], 1), 1)
    ratio = np.exp(-8 * k * z / (1 + z) ** 2) * (1 + z / w) ** 1.5 / (1 + z)
    assert (ratio <= np.where(k >= 2, 1.14, 2.4)).all()


def test_an_exponential_of_plain_arithmetic():
    x = np.concatenate([-np.geomspace(1e-12, 50, 300), [0.0]])
    np.testing.assert_allclose([random_streams._exp(v) for v in x], np.exp(x), rtol=0, atol=3e-14)
