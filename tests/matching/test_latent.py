"""Shared functions: the dense twin, known answers, and what they leave out."""

import itertools

import numpy as np
import pytest

from fmsync import so
from fmsync.functional_maps import nearest_rows
from fmsync.matching import latent

COUNT, SIZE = 6, 10
EDGES = np.array(list(itertools.combinations(range(COUNT), 2)))


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def test_sizes_grow_to_the_last_one_and_stay():
    assert latent.sizes(20, 40) == [25, 30, 35, 40, 40, 40]
    assert latent.sizes(20, 50, fast=True) == [26, 34, 44, 50, 50, 50]
    assert latent.sizes(20, 20) == [20, 20, 20]


def consistent(rng, dim):
    """Maps C_ij = A_i^T A_j of rank ``dim``, determinants of either sign."""
    frames = np.linalg.qr(rng.standard_normal((COUNT, SIZE, SIZE)))[0][:, :dim]
    return so.transpose(frames[EDGES[:, 0]]) @ frames[EDGES[:, 1]]


def cost(y, maps, weights):
    i, j = EDGES.T
    there = maps @ so.transpose(y[j]) - so.transpose(y[i])
    again = so.transpose(maps) @ so.transpose(y[i]) - so.transpose(y[j])
    return float((weights * ((there**2).sum((1, 2)) + (again**2).sum((1, 2)))).sum())


def test_consistent_maps_come_back_on_the_directions_they_share(rng):
    maps = consistent(rng, 9)  # nine of ten directions are shared
    y = latent.latent_maps(COUNT, EDGES, maps)
    assert y.shape == (COUNT, 9, SIZE)
    np.testing.assert_allclose(so.transpose(y[EDGES[:, 0]]) @ y[EDGES[:, 1]], maps, atol=1e-9)
    np.testing.assert_allclose(cost(y, maps, np.ones(len(EDGES))), 0, atol=1e-18)


def test_directions_match_points_whose_values_are_larger_on_one_shape(rng):
    values = rng.standard_normal((300, 5)) * np.geomspace(1, 10, 300)[:, None]  # of many sizes, as at ends of limbs
    larger = values * rng.uniform(0.7, 1.3, (300, 1))
    nearest = nearest_rows(latent.directions(larger), latent.directions(values))
    np.testing.assert_array_equal(nearest, np.arange(300))
    assert (nearest_rows(larger, values) != np.arange(300)).any()


def test_no_other_frame_costs_less(rng):
    maps = consistent(rng, SIZE) + 0.1 * rng.standard_normal((len(EDGES), SIZE, SIZE))
    weights = 1 / ((so.transpose(maps) @ maps - np.eye(SIZE)) ** 2).sum((1, 2))
    degrees = np.bincount(EDGES.ravel(), np.repeat(weights, 2))
    y = latent.latent_maps(COUNT, EDGES, maps)
    total = np.einsum("i,imk,ilk->ml", degrees, y, y)
    np.testing.assert_allclose(total, degrees.mean() * COUNT * np.eye(9), atol=1e-9)
    least = cost(y, maps, weights)
    for step in (0.01, 0.3):
        other = (y + step * rng.standard_normal(y.shape)) * np.sqrt(degrees)[:, None, None]
        flat = np.linalg.qr(other.transpose(0, 2, 1).reshape(COUNT * SIZE, 9))[0].reshape(COUNT, SIZE, 9)
        flat = flat.transpose(0, 2, 1) * np.sqrt(degrees.mean() * COUNT / degrees)[:, None, None]
        assert cost(flat, maps, weights) > least


def test_large_collections_have_the_same_answer_without_the_dense_matrix(rng, monkeypatch):
    maps = consistent(rng, SIZE) + 0.05 * rng.standard_normal((len(EDGES), SIZE, SIZE))
    dense = latent.latent_maps(COUNT, EDGES, maps)
    monkeypatch.setattr(latent, "_DENSE_UP_TO", 0)
    sparse = latent.latent_maps(COUNT, EDGES, maps)
    relative = [so.transpose(y[EDGES[:, 0]]) @ y[EDGES[:, 1]] for y in (dense, sparse)]
    np.testing.assert_allclose(*relative, atol=1e-3)


def test_a_function_with_signs_that_no_choice_explains_is_left_out(rng):
    base = np.linalg.qr(rng.standard_normal((COUNT, SIZE, SIZE)))[0]
    core = np.tile(np.eye(SIZE), (len(EDGES), 1, 1))
    core[:, -1, -1] = rng.choice([-1.0, 1.0], len(EDGES))  # signs that no choice for the shapes explains
    maps = base[EDGES[:, 0]] @ core @ so.transpose(base[EDGES[:, 1]])
    y = latent.latent_maps(COUNT, EDGES, maps)
    np.testing.assert_allclose(y @ base[:, :, -1:], 0, atol=1e-6)
