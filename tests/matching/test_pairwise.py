"""The map of one pair: candidates beyond signs, and samples that move rigidly."""

import numpy as np
import pytest

from bench.own_shapes.matching import evaluated, varied
from bench.own_shapes.stages import Evaluation
from data_gen import load_collection
from fmsync.functional_maps import row_images
from fmsync.matching.pairwise import match, moved, zoomout
from fmsync.matching.rigid import rigid_samples
from fmsync.matching.samples import sample_shape
from fmsync.shape import Basis


@pytest.mark.parametrize("plane", [3, 5])
def test_eigenfunctions_that_a_pose_has_mixed_are_turned_back(cats, plane):
    """No signs do that: the map is as good as that of eigenfunctions that were not mixed."""
    first, second = (sample_shape(cat, 50, 300) for cat in cats[:2])
    mixed, eigenvalues = second.basis.eigenfunctions.copy(), second.basis.eigenvalues.copy()
    pair = [plane, plane + 1]
    mixed[:, pair] = mixed[:, pair] @ np.array([[1, -1], [1, 1]]) / np.sqrt(2)
    eigenvalues[pair] = eigenvalues[pair].mean()
    turned = sample_shape(cats[1], 50, 300, basis=Basis(eigenvalues, mixed, second.basis.mass))
    assert match(first, turned).distortion < 1.1 * match(first, second).distortion


@pytest.mark.parametrize("species", [1000, 1002, 1004])
def test_moving_samples_nearly_halves_the_error_of_a_rough_map_in_both_directions(species):
    creatures = load_collection("creatures", species=species, count=2, n_vertices=1000)  # of one order of vertices
    first, second = (sample_shape(s, 50, 300) for s in creatures)

    def missed(c):
        images, points = row_images(first.sampled(), c[None], second.basis.eigenfunctions)[0], second.shape.vertices
        return np.linalg.norm(points[images] - points[first.samples], axis=1).mean()

    true = np.linalg.pinv(first.sampled()) @ second.basis.eigenfunctions[first.samples]
    rough = zoomout(first, second, true[None, :12, :12], 50, 6)[0]
    found = moved(first, second, (rigid_samples(first), rigid_samples(second)), rough)
    assert len(found) == 2
    assert max(missed(c) for c in found) < 0.6 * missed(rough[0])


def test_meshes_may_have_different_numbers_of_samples(cats):
    few, many = sample_shape(cats[0], 20, 120), sample_shape(cats[1], 20, 300)
    assert max(match(few, many).distortion, match(many, few).distortion) < 0.1


def test_more_landmarks_than_candidates_are_compared_by(cats):
    marks = np.arange(0, cats[0].n_vertices, cats[0].n_vertices // 100)
    first, second = (sample_shape(cat, 20, 200, landmarks=marks) for cat in cats[:2])
    assert match(first, second).missed < 0.1


def test_a_copy_of_a_mesh_is_not_called_mirrored(cats):
    first, second = (sample_shape(cat, 50, 300) for cat in (cats[0], cats[0]))
    found = match(first, second)
    assert found.distortion < 1e-9
    assert found.mirrored_distortion > 1e-3


@pytest.mark.parametrize("species", [1011, 1019, 1020])
def test_a_stretched_skin_does_not_hide_the_map(species):
    """Signs of eigenfunctions alone give wrong maps here."""
    shapes = varied(species, "stretched")[:2]
    first, second = (sample_shape(s, 50, 400) for s in shapes)
    vertices, _ = evaluated(shapes)
    assert Evaluation([first, second], vertices).errors(0, 1, match(first, second).c_ij.T).mean() < 0.08
