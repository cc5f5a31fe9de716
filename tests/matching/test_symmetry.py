"""Shapes that turn into themselves: regions say so, and a flag names the symmetry."""

import warnings

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import data_gen
import fmsync
from fmsync import so
from fmsync.matching.conformal import default_calibration
from fmsync.matching.report import quality_flags
from fmsync.shape import Shape

QUICK = {"n_basis": 12, "n_refined": 30, "n_samples": 200, "n_draws": 200, "rng": 0}


def ball(seed, spindle, count=1200):
    """A sphere, or a spindle with ends that differ, each with an own triangulation, turned about its axis."""
    rng = np.random.default_rng(seed)
    k = np.arange(count) + 0.5
    height, around = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k + rng.uniform(0, 2 * np.pi)
    ring = np.sqrt(1 - height**2)
    points = np.stack([np.cos(around) * ring, np.sin(around) * ring, height], axis=1)
    faces = ConvexHull(points).simplices
    a, b, c = points[faces.T]
    inward = np.einsum("fx,fx->f", np.cross(b - a, c - a), a + b + c) < 0
    faces[inward] = faces[inward][:, ::-1]
    if spindle:
        points = points * np.stack([1 + 0.3 * height, 1 + 0.3 * height, np.full(count, 2.5)], axis=1)
    return shuffled(points @ so.random_uniform(3, rng=rng), faces, rng, f"{'spindle' if spindle else 'sphere'}{seed}")


def torus(seed):
    rng = np.random.default_rng(seed)
    i, j = (x.ravel() for x in np.meshgrid(np.arange(48), np.arange(25), indexing="ij"))
    a, b = 2 * np.pi * (i + rng.random()) / 48, 2 * np.pi * (j + rng.random()) / 25
    points = np.stack([(2 + 0.7 * np.cos(b)) * np.cos(a), (2 + 0.7 * np.cos(b)) * np.sin(a), 0.7 * np.sin(b)], axis=1)
    here, right, up, both = (((i + p) % 48) * 25 + (j + q) % 25 for p, q in ((0, 0), (1, 0), (0, 1), (1, 1)))
    faces = np.concatenate([np.stack([here, right, both], axis=1), np.stack([here, both, up], axis=1)])
    return shuffled(points, faces, rng, f"torus{seed}")


def shuffled(points, faces, rng, name):
    order = rng.permutation(len(points))
    return Shape(points[order], np.argsort(order)[faces], name)


def synced(shapes):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fmsync.synchronize_shapes(shapes, **QUICK)


@pytest.mark.parametrize(
    "make", [lambda k: ball(k, True), torus, lambda k: ball(k, False)], ids=["spindle", "torus", "sphere"]
)
def test_regions_are_as_wide_as_the_symmetry(make):
    answer = synced([make(k) for k in range(3)])
    known = answer.confidence(0, 1)
    region = default_calibration().radius(known)
    assert (region >= known.symmetry_radius).all()
    assert (known.radius >= known.symmetry_radius).all()
    assert known.two_modes.mean() > 0.8
    assert np.median(region) > 0.2  # square roots of the area
    (flag,) = [line for line in quality_flags(answer) if "surface of revolution" in line]
    assert all(name in flag for name in answer.names)


def test_an_ordinary_body_has_none():
    cats = data_gen.load_collection("cats", count=3, n_vertices=1000)
    answer = synced(cats)
    assert not any("revolution" in line or "mirror" in line for line in quality_flags(answer))
    assert answer.confidence(0, 1).two_modes.mean() < 0.2


def test_clouds_do_not_tell_left_from_right():
    cats = data_gen.load_collection("cats", count=3, n_vertices=1000, symmetric=True)
    answer = synced([Shape(cat.vertices, None, cat.name) for cat in cats])
    assert any("left from right" in line for line in quality_flags(answer))
    known = answer.confidence(0, 1)
    radius = default_calibration().radius(known)[known.two_modes]
    assert (radius >= known.symmetry_radius[known.two_modes]).all()
    assert radius.min() >= 0.06  # the places are .12 apart, and the image may lie between them
    assert np.median(radius) > 0.2
