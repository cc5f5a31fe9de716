"""The compiled random numbers against their definitions and distributions."""

import numpy as np
from scipy import stats

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


def test_layers_of_the_ziggurat_have_one_area():
    """Every rectangle between neighbouring ends, and the lowest layer with the tail."""
    ends, area = random_streams._ENDS, random_streams._AREA
    height = np.exp(-(ends**2) / 2)
    np.testing.assert_allclose(ends[1:-1] * np.diff(height)[1:], area, rtol=1e-8)
    np.testing.assert_allclose(ends[1] * height[1] + np.sqrt(2 * np.pi) * stats.norm.sf(ends[1]), area, rtol=1e-8)


def test_normal_numbers():
    """Their distribution, in the tail too, which one in 3,900 reaches, and no two alike."""
    drawn = np.empty((250_000, 8))
    random_streams.normals(random_streams.generators(np.random.default_rng(1), 1)[0], drawn)
    assert stats.kstest(drawn.ravel(), stats.norm.cdf).pvalue > 1e-4
    last = random_streams._LAST
    tail = np.abs(drawn[np.abs(drawn) > last])
    expected = drawn.size * 2 * stats.norm.sf(last)
    assert abs(len(tail) - expected) < 4 * np.sqrt(expected)
    assert stats.kstest(stats.norm.sf(tail) / stats.norm.sf(last), "uniform").pvalue > 1e-4
    assert len(np.unique(drawn)) == drawn.size
