"""Samples that move as rigidly as possible: sums written out, motions followed exactly, and images that are mended."""

import numpy as np
import pytest

from data_gen import load_collection
from fmsync import so
from fmsync.matching import rigid
from fmsync.matching.samples import sample_shape
from fmsync.shape import Shape


@pytest.fixture(scope="module")
def poses():
    return [sample_shape(s, 30, 300) for s in load_collection("creatures", species=1000, count=2, n_vertices=1000)]


@pytest.fixture(scope="module")
def bodies(poses):
    return [rigid.rigid_samples(s) for s in poses]


def energy(body, points, rotations, images):
    """Both sums written out."""
    i, j = body.links.nonzero()
    stretched = points[i] - points[j] - (rotations[i] @ (body.points[i] - body.points[j])[:, :, None])[..., 0]
    return 0.5 * (stretched**2).sum() + rigid._POSITIONS / len(points) * ((points - images) ** 2).sum()


def test_neighbours_are_the_nearest_along_the_surface(poses, bodies):
    for shape, body in zip(poses, bodies):
        links = body.links.toarray()
        np.testing.assert_array_equal(links, links.T)
        assert (links.diagonal() == 0).all()
        assert links.sum(axis=1).min() >= 8
        for k, row in enumerate(shape.geodesics[:20]):
            assert links[k, np.argsort(row, kind="stable")[1:9]].all()


def test_neither_points_nor_rotations_can_be_better(bodies):
    body, rng = bodies[0], np.random.default_rng(0)
    images = bodies[1].points + 0.02 * rng.standard_normal(body.points.shape)
    rotations = body.rotations(images)
    moved = body.moved(rotations, images)
    least = energy(body, moved, rotations, images)
    for size in (1e-4, 1e-2):
        other = moved + size * rng.standard_normal(moved.shape)
        assert energy(body, other, rotations, images) > least
    fitted = body.rotations(moved)
    least = energy(body, moved, fitted, images)
    for size in (1e-3, 0.3):
        turn = so.exp(so.skew(size * rng.standard_normal(fitted.shape)))
        assert energy(body, moved, fitted @ turn, images) > least
    links = body.links.toarray()
    k = 17  # the sum of one sample, written out
    sums = sum(np.outer(moved[k] - moved[j], body.points[k] - body.points[j]) for j in np.flatnonzero(links[k]))
    np.testing.assert_allclose(fitted[k], so.project(sums), atol=1e-9)


def test_polar_factors_are_the_nearest_rotations():
    rng = np.random.default_rng(1)
    a = rng.standard_normal((200, 3, 3))  # half of them turn space inside out
    a[0], a[1] = 0, np.outer([1.0, 2, 3], [0, 1, 0])  # what has no one answer: a rotation all the same
    found = rigid._polar_factors(a)
    np.testing.assert_allclose(found @ so.transpose(found), np.tile(np.eye(3), (200, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(found), 1, atol=1e-9)
    np.testing.assert_allclose(found[2:], so.project(a[2:]), atol=1e-6)
    turns = so.random_uniform(3, 4, rng=0)
    for singular in ([1, 1e-3, 1.1e-3], [1, 1, 3e-6], [1, 1e-2, 2e-4]):  # nearly flat ones, to the last bits as well
        steep = turns[:2] @ np.diag(singular) @ turns[2:]
        np.testing.assert_allclose(rigid._polar_factors(steep), turns[:2] @ turns[2:], atol=1e-11)


def off(shape, rng):
    """For every sample one of the six that are nearest along the surface."""
    near = np.argsort(shape.geodesics, axis=1)[:, :6]
    return shape.samples[near[np.arange(len(near)), rng.integers(6, size=len(near))]]


def missed(shape, images, truth):
    return np.linalg.norm(shape.shape.vertices[images] - shape.shape.vertices[truth], axis=1).mean()


def turned(shape, turn, shift, faces):
    return sample_shape(Shape(shape.shape.vertices @ turn.T + shift, faces), 30, 300, basis=shape.basis)


@pytest.mark.parametrize("shift", [1.0, 1e6])
def test_a_turned_copy_keeps_its_true_images_and_gets_back_those_that_are_off(poses, shift):
    first, rng = poses[0], np.random.default_rng(2)
    second = turned(first, so.random_uniform(3, (), rng), shift, first.shape.faces)
    a, b, truth = rigid.rigid_samples(first), rigid.rigid_samples(second), first.samples
    np.testing.assert_array_equal(rigid.rigid_images(a, b, truth), truth)
    start = off(first, rng)
    assert missed(second, rigid.rigid_images(a, b, start), truth) < missed(second, start, truth) / 2


def test_a_mirrored_copy_is_found_if_it_may_be_one(poses):
    first, rng = poses[0], np.random.default_rng(2)
    second = turned(first, np.diag([-1.0, 1, 1]), 0.0, first.shape.faces[:, ::-1])
    a, b, truth = rigid.rigid_samples(first), rigid.rigid_samples(second), first.samples
    np.testing.assert_array_equal(rigid.rigid_images(a, b, truth, mirrored=True), truth)
    start = off(first, rng)
    assert missed(second, rigid.rigid_images(a, b, start, mirrored=True), truth) < missed(second, start, truth) / 2
    assert missed(second, rigid.rigid_images(a, b, truth), truth) > 0.02


def test_images_on_another_pose_come_nearer_to_the_truth(poses, bodies):
    start, truth = off(poses[0], np.random.default_rng(3)), poses[0].samples  # the poses share their vertices
    assert missed(poses[1], rigid.rigid_images(*bodies, start), truth) < missed(poses[1], start, truth) / 2
