import numpy as np
import pytest
from scipy.spatial.distance import cdist

from fmsync import so
from fmsync.descriptors import heat_kernel_signature, wave_kernel_signature
from fmsync.functional_maps import (
    functional_map,
    functional_map_from_descriptors,
    images_both_ways,
    nearest_rows,
    point_map,
    vertex_images,
)
from fmsync.shape import Basis, laplace_beltrami
from tests.surfaces import icosphere, potato, relabelled, rotation


@pytest.fixture(scope="module")
def pair():
    """A mesh, the same mesh renumbered and rotated, and the exact point map from the first to the second."""
    vertices, faces = potato(3)
    other, other_faces, old = relabelled(vertices @ rotation(1).T, faces, rng=2)
    return laplace_beltrami(vertices, faces, 12), laplace_beltrami(other, other_faces, 12), np.argsort(old)


def descriptors(basis):
    return np.hstack([heat_kernel_signature(basis), wave_kernel_signature(basis)])


# --- point map to functional map ------------------------------------------------------------------------------------


def test_map_equals_the_definition(pair):
    basis_i, basis_j, _ = pair
    any_map = np.random.default_rng(0).integers(basis_j.n_vertices, size=basis_i.n_vertices)
    pullback = np.zeros((basis_i.n_vertices, basis_j.n_vertices))
    pullback[np.arange(basis_i.n_vertices), any_map] = 1
    expected = basis_i.eigenfunctions.T @ np.diag(basis_i.mass) @ pullback @ basis_j.eigenfunctions
    np.testing.assert_allclose(functional_map(basis_i, basis_j, any_map), expected, atol=1e-12)


def test_identity_is_the_identity(pair):
    basis = pair[0]
    np.testing.assert_allclose(functional_map(basis, basis, np.arange(basis.n_vertices)), np.eye(12), atol=1e-10)


def test_relabelling_gives_signs_and_comes_back_exactly(pair):
    basis_i, basis_j, truth = pair
    for k in (3, 7):
        basis_j = basis_j.with_flipped(k)
    c = functional_map(basis_i, basis_j, truth)
    np.testing.assert_allclose(c, np.diag(np.where(np.isin(np.arange(12), [3, 7]), -1.0, 1.0)), atol=1e-6)
    np.testing.assert_array_equal(point_map(c, basis_i, basis_j), truth)


def test_isometries_compose():
    """C_ij C_jk = C_ik, and the map takes coefficients on j to coefficients on i."""
    vertices, faces = potato(3)
    meshes = [relabelled(vertices @ rotation(seed).T, faces, rng=seed) for seed in range(3)]
    bases = [laplace_beltrami(v, f, 10) for v, f, _ in meshes]
    # vertex v of i is the original vertex old_i[v], which has number argsort(old_j)[old_i[v]] on j
    maps = {
        (i, j): functional_map(bases[i], bases[j], np.argsort(meshes[j][2])[meshes[i][2]])
        for i in range(3)
        for j in range(3)
    }
    np.testing.assert_allclose(maps[0, 1] @ maps[1, 2], maps[0, 2], atol=1e-6)
    original = bases[0].eigenfunctions @ np.arange(10)  # a function on shape 0, carried to shape 1 by the vertices
    carried = original[np.argsort(meshes[0][2])[meshes[1][2]]]
    np.testing.assert_allclose(bases[0].coefficients(original), maps[0, 1] @ bases[1].coefficients(carried), atol=1e-5)


def test_maps_of_unequal_meshes_and_sizes_are_nearly_orthogonal():
    coarse, fine = (laplace_beltrami(*potato(level), 8) for level in (3, 4))
    nearest = point_map(np.eye(8), fine.truncated(8), coarse)  # the signs agree by the sign rule
    c = functional_map(fine.truncated(6), coarse, nearest)
    assert c.shape == (6, 8)
    assert np.linalg.norm(c @ c.T - np.eye(6)) < 0.2


# --- functional map to point map ------------------------------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_point_map_equals_brute_force(pair, noise):
    basis_i, basis_j, _ = pair
    c = np.eye(12)[:, :9] + noise * np.random.default_rng(1).standard_normal((12, 9))
    basis_j = basis_j.truncated(9)
    images = basis_i.eigenfunctions @ c
    slow = [np.linalg.norm(image - basis_j.eigenfunctions, axis=1).argmin() for image in images]
    np.testing.assert_array_equal(point_map(c, basis_i, basis_j), slow)
    some = np.array([5, 0, 5, 600])
    np.testing.assert_array_equal(point_map(c, basis_i, basis_j, vertices=some), np.array(slow)[some])


# --- descriptors to functional map ----------------------------------------------------------------------------------


def free_objective(c, a, b, w, values_i, values_j):
    largest = max(values_i[-1], values_j[-1])
    commutator = np.diag(values_i) @ c - c @ np.diag(values_j)
    return ((c @ b - a) ** 2).sum() + w * (b**2).sum() * (commutator**2).sum() / largest**2


@pytest.mark.parametrize("kind", ["surface", "cloud", "far apart", "one place"])
def test_nearest_rows_of_many_equal_brute_force(kind):
    """From 4,000 rows on, groups that are too far are passed over; nothing may be lost by it."""
    rng = np.random.default_rng(5)
    if kind == "surface":  # 60 waves on a square, as eigenfunctions are, and a query between their values
        places, waves = rng.random((9000, 2)), 20 * rng.standard_normal((2, 60))
        rows = np.cos(places @ waves + rng.random(60))
        queries, targets = rows[:4500] + 0.1 * rng.standard_normal((4500, 60)), rows[4500:]
    else:
        queries, targets = rng.standard_normal((2, 4200, 8))
        targets = targets * {"cloud": 1, "far apart": 1e-4, "one place": 0}[kind] + (kind == "far apart")
    gap = cdist(queries, targets)
    found = gap[np.arange(len(queries)), nearest_rows(queries, targets)]
    assert np.all(found <= gap.min(axis=1) * (1 + 1e-7))


@pytest.mark.parametrize("orthogonal", [False, True])
def test_descriptors_recover_an_isometry(pair, orthogonal):
    basis_i, basis_j, truth = pair
    c = functional_map_from_descriptors(basis_i, basis_j, descriptors(basis_i), descriptors(basis_j), orthogonal)
    np.testing.assert_allclose(c, functional_map(basis_i, basis_j, truth), atol=1e-5)


def test_free_fit_is_the_minimum():
    """No step in any direction goes down, and without the second term it is plain least squares."""
    rng = np.random.default_rng(4)
    basis_i, basis_j = laplace_beltrami(*potato(2), 6), laplace_beltrami(*icosphere(2), 5)
    f, g = rng.standard_normal((basis_i.n_vertices, 9)), rng.standard_normal((basis_j.n_vertices, 9))
    a, b = basis_i.coefficients(f), basis_j.coefficients(g)
    least_squares = np.linalg.lstsq(b.T, a.T, rcond=None)[0].T
    np.testing.assert_allclose(
        functional_map_from_descriptors(basis_i, basis_j, f, g, commutativity=0), least_squares, atol=1e-9
    )
    c = functional_map_from_descriptors(basis_i, basis_j, f, g, commutativity=0.3)
    best = free_objective(c, a, b, 0.3, basis_i.eigenvalues, basis_j.eigenvalues)
    for _ in range(50):
        step = 1e-3 * rng.standard_normal(c.shape)
        assert free_objective(c + step, a, b, 0.3, basis_i.eigenvalues, basis_j.eigenvalues) > best


@pytest.mark.parametrize("weight", [0.0, 0.1, 3.0])
def test_rotation_fit_is_a_local_minimum_on_the_group(weight):
    rng = np.random.default_rng(5)
    basis_i, basis_j = laplace_beltrami(*potato(2), 5), laplace_beltrami(*icosphere(2), 5)
    f, g = rng.standard_normal((basis_i.n_vertices, 7)), rng.standard_normal((basis_j.n_vertices, 7))
    a, b = basis_i.coefficients(f), basis_j.coefficients(g)
    c = functional_map_from_descriptors(basis_i, basis_j, f, g, orthogonal=True, commutativity=weight)
    np.testing.assert_allclose(c.T @ c, np.eye(5), atol=1e-12)
    assert np.linalg.det(c) == pytest.approx(1)
    best = free_objective(c, a, b, weight, basis_i.eigenvalues, basis_j.eigenvalues)
    for _ in range(100):
        nearby = c @ so.exp(1e-3 * so.skew(rng.standard_normal((5, 5))))
        assert free_objective(nearby, a, b, weight, basis_i.eigenvalues, basis_j.eigenvalues) > best


def test_scaling_descriptors_changes_nothing(pair):
    basis_i, basis_j, _ = pair
    f, g = descriptors(basis_i), descriptors(basis_j)
    np.testing.assert_allclose(
        functional_map_from_descriptors(basis_i, basis_j, f, g),
        functional_map_from_descriptors(basis_i, basis_j, 1e6 * f, 1e6 * g),
        atol=1e-8,
    )


def test_what_descriptors_do_not_see_is_left_at_zero():
    basis = laplace_beltrami(*potato(2), 4)
    seen = basis.eigenfunctions[:, [0, 2]]
    c = functional_map_from_descriptors(basis, basis, seen, seen)
    np.testing.assert_allclose(c, np.diag([1.0, 0, 1, 0]), atol=1e-9)


# --- draws to images of a vertex -----------------------------------------------------------------------------------


def random_basis(n_vertices, n=20, rng=0):
    rng = np.random.default_rng(rng)
    return Basis(np.arange(n, dtype=float), rng.standard_normal((n_vertices, n)), np.full(n_vertices, 1 / n_vertices))


def test_images_against_the_point_map_of_every_draw():
    basis_i, basis_j, draws = random_basis(60), random_basis(70, rng=1), so.random_uniform(20, 30, rng=2)
    images = vertex_images(draws, basis_i, basis_j, 7)
    assert images.tolist() == [point_map(c, basis_i, basis_j)[7] for c in draws]
    there, back = images_both_ways(draws, (basis_i, basis_j), ([2, 7], [69]))
    assert there[1].tolist() == images.tolist()
    assert back.tolist() == [[point_map(c.T, basis_j, basis_i)[69] for c in draws]]


# --- bad input ------------------------------------------------------------------------------------------------------


def test_bad_input_is_named():
    basis = Basis([0.0, 2.0], [[1.0, 1.0], [1.0, -1.0]], [0.5, 0.5])
    small = basis.truncated(1)
    f = np.ones((2, 3))
    with pytest.raises(ValueError, match="a vertex of j for each of 2 of i"):
        functional_map(basis, basis, np.array([0, 1, 1]))
    with pytest.raises(ValueError, match="point_map: must be a row of integers"):
        functional_map(basis, basis, np.array([0.0, 1.0]))
    with pytest.raises(ValueError, match=r"point_map\[1\] = 2 is outside the vertices 0..1"):
        functional_map(basis, basis, np.array([0, 2]))
    with pytest.raises(ValueError, match=r"finite \(2, 1\) matrix"):
        point_map(np.eye(2), basis, small)
    with pytest.raises(ValueError, match="finite"):
        point_map(np.full((2, 2), np.nan), basis, basis)
    with pytest.raises(ValueError, match=r"vertices\[0\] = -1"):
        point_map(np.eye(2), basis, basis, vertices=np.array([-1]))
    with pytest.raises(ValueError, match="integers"):
        point_map(np.eye(2), basis, basis, vertices=np.array([0.5]))
    with pytest.raises(ValueError, match=r"descriptors_j: expected \(W, K\) with K = 3, got shape \(2, 2\)"):
        functional_map_from_descriptors(basis, basis, f, f[:, :2])
    with pytest.raises(ValueError, match="descriptors_j: 3 rows for the 2 vertices of j"):
        functional_map_from_descriptors(basis, basis, f, np.ones((3, 3)))
    with pytest.raises(ValueError, match=r"descriptors_i: entry \[1, 2\] is not finite"):
        functional_map_from_descriptors(basis, basis, np.array([[1, 1, 1], [1, 1, np.nan]]), f)
    with pytest.raises(ValueError, match="commutativity: must be finite and >= 0"):
        functional_map_from_descriptors(basis, basis, f, f, commutativity=-1)
    with pytest.raises(ValueError, match="bases of one size, got 2 and 1"):
        functional_map_from_descriptors(basis, small, f, f, orthogonal=True)
    with pytest.raises(ValueError, match=r"expected \(K, 2, 2\)"):
        vertex_images(np.eye(2), basis, basis, 0)
    with pytest.raises(ValueError, match=r"vertex\[0\] = 10"):
        vertex_images(np.eye(2)[None], basis, basis, 10)
    with pytest.raises(ValueError, match=r"vertices\[1\]\[0\] = 2 is outside"):
        images_both_ways([np.eye(2)], (basis, basis), ([0], [2]))
    with pytest.raises(ValueError, match=r"maps: expected \(K, 2, 2\)"):
        images_both_ways([np.eye(3)], (basis, basis), ([0], [1]))
