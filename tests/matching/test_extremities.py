"""Extremities of a body, and the maps that come of pairing them."""

import itertools
from types import SimpleNamespace

import numpy as np

from fmsync.matching.extremities import extremities, extremity_maps
from fmsync.matching.samples import sample_shape
from fmsync.shape import Shape


def test_extremities_of_a_line_are_its_ends_the_farther_one_first():
    """Two samples are in one place at the left end, and more are on the right: so the left end is farther."""
    at = np.array([0, 0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.72, 0.74, 0.76, 0.78, 0.8])
    line = SimpleNamespace(geodesics=np.abs(at[:, None] - at))
    assert extremities(line).tolist() == [0, 13]


def test_extremities_are_paired_as_distances_say(cats):
    """The obvious way: score every pairing of five, keep the best ones, and match samples by distances one by one."""
    first, second = (sample_shape(cat, 20, 150) for cat in cats[:2])
    a, b, size, few = extremities(first), extremities(second), 12, 60
    far = second.geodesics.mean(axis=1)
    tops = [p for p, row in enumerate(second.geodesics) if all(far[p] >= far[q] for q in np.flatnonzero(row < 0.15))]
    assert set(b) <= set(tops)
    assert len(b) == min(8, len(tops)) >= 5
    pairings = [
        (
            sum(
                abs(first.geodesics[p, q] - second.geodesics[x, y])
                for (p, x), (q, y) in itertools.combinations(pairs, 2)
            ),
            pairs,
        )
        for own in itertools.combinations(a, 5)
        for pairs in (list(zip(own, images)) for images in itertools.permutations(b, 5))
    ]
    maps = []
    for _, pairs in sorted(pairings)[:3]:
        own, images = zip(*pairs)
        apart = ((first.geodesics[:few, None, own] - second.geodesics[None, :, images]) ** 2).sum(axis=-1)
        rows = second.sampled()[apart.argmin(axis=1), :size]
        maps.append(np.linalg.lstsq(first.sampled(few)[:, :size], rows)[0])
    np.testing.assert_allclose(extremity_maps(first, second, size, few)[:3], maps, atol=1e-8)


def test_shapes_with_few_or_no_extremities_give_few_candidates(cats):
    corners = np.vstack([np.eye(3), -np.eye(3)])
    others = np.random.default_rng(0).standard_normal((600, 3))
    ball = Shape(np.vstack([corners, others / np.linalg.norm(others, axis=1, keepdims=True)]), None, "ball")
    ball, cat = sample_shape(ball, 20, 100), sample_shape(cats[0], 20, 100)
    for first, second in ((ball, cat), (cat, ball), (ball, ball)):
        maps = extremity_maps(first, second, 12, 80)
        assert maps.shape[1:] == (12, 12)
        assert 1 <= len(maps) <= 128
        assert np.isfinite(maps).all()
