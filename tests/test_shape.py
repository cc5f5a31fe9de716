import numpy as np
import pytest
import robust_laplacian
from scipy.linalg import eigh

from fmsync.shape import Basis, Shape, _cotangent_laplacian, laplace_beltrami, vertex_normals
from tests.surfaces import icosphere, potato, relabelled

SQUARE = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0.0]])
TWO_FACES = np.array([[0, 1, 2], [0, 2, 3]])


def slow_cotangent_laplacian(vertices, faces):
    """The definition, one corner at a time: angles from arccos, areas from Heron."""
    n = len(vertices)
    stiffness, mass = np.zeros((n, n)), np.zeros(n)
    for face in faces:
        for corner in range(3):
            a, b, c = face[corner], face[(corner + 1) % 3], face[(corner + 2) % 3]
            u, v = vertices[b] - vertices[a], vertices[c] - vertices[a]
            angle = np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v))
            stiffness[b, c] -= 0.5 / np.tan(angle)
            stiffness[c, b] -= 0.5 / np.tan(angle)
        lengths = [np.linalg.norm(vertices[face[k]] - vertices[face[k - 1]]) for k in range(3)]
        s = sum(lengths) / 2
        mass[face] += np.sqrt(s * np.prod([s - length for length in lengths])) / 3
    np.fill_diagonal(stiffness, -stiffness.sum(axis=1))
    return stiffness, mass


# --- Shape ----------------------------------------------------------------------------------------------------------


def test_shape_keeps_read_only_copies():
    source = SQUARE.copy()
    shape = Shape(source, TWO_FACES.astype(np.int32), "square")
    source[0] = 7
    assert shape.vertices.dtype == np.float64
    assert shape.faces.dtype == np.int64
    np.testing.assert_array_equal(shape.vertices, SQUARE)
    with pytest.raises(ValueError, match="read-only"):
        shape.vertices[0] = 1


def test_area_of_a_square_and_of_a_point_cloud():
    assert Shape(SQUARE, TWO_FACES).area == pytest.approx(4)
    np.testing.assert_allclose(Shape(SQUARE, TWO_FACES).normalised().vertices, SQUARE / 2)
    with pytest.raises(ValueError, match="cloud: a point cloud has no triangles"):
        _ = Shape(SQUARE, None, "cloud").area


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (SQUARE[:, :2], TWO_FACES, r"vertices must have shape \(V, 3\), got \(4, 2\)"),
        (np.zeros((0, 3)), None, "no vertices"),
        (np.where(np.arange(4)[:, None] == 2, np.nan, SQUARE), TWO_FACES, "vertex 2 is not finite"),
        (SQUARE, TWO_FACES + 1, r"face 1 is \[1 3 4\], outside the vertices 0..3"),
        (SQUARE, TWO_FACES - 1, r"face 0 is \[-1 +0 +1\], outside"),
        (SQUARE, TWO_FACES[:1], "vertex 3 belongs to no face"),
        (SQUARE, np.zeros((0, 3), int), "no faces"),
        (SQUARE, [[0, 1, 2, 3]], r"faces must have shape \(F, 3\), got \(1, 4\)"),
        (SQUARE, TWO_FACES + 0.5, "faces must hold integers"),
        (SQUARE, [[0, 1, 2], [0, 3, 3]], r"face 1 is \[0 3 3\], which repeats a vertex"),
        (SQUARE * [1, 0, 0], TWO_FACES, "area zero"),
    ],
)
def test_broken_shapes_are_named(vertices, faces, message):
    with pytest.raises(ValueError, match=f"thing: .*{message}"):
        Shape(vertices, faces, "thing")


# --- Laplacian and basis --------------------------------------------------------------------------------------------


def test_cotangents_equal_the_loop():
    vertices, faces = potato(1)
    stiffness, mass = _cotangent_laplacian(vertices, faces)
    slow_stiffness, slow_mass = slow_cotangent_laplacian(vertices, faces)
    np.testing.assert_allclose(stiffness.toarray(), slow_stiffness, atol=1e-12)
    np.testing.assert_allclose(mass, slow_mass, rtol=1e-12)


def test_normals_of_a_sphere_point_outwards():
    vertices, faces = icosphere(3)
    normals = vertex_normals(np.vstack([vertices, [[9.0, 9, 9]]]), faces)  # and a vertex that no face has
    assert (np.einsum("vx,vx->v", normals[:-1], vertices) > 0.999).all()
    np.testing.assert_allclose(np.linalg.norm(normals[:-1], axis=1), 1)
    np.testing.assert_array_equal(normals[-1], 0)


def test_basis_equals_the_dense_eigenproblem():
    vertices, faces = potato(2)
    basis = laplace_beltrami(vertices, faces, 12)
    stiffness, mass = slow_cotangent_laplacian(vertices, faces)
    mass /= mass.sum()
    values, vectors = eigh(stiffness, np.diag(mass))
    np.testing.assert_allclose(basis.eigenvalues, values[:12], atol=1e-8)
    overlap = vectors[:, :12].T @ (mass[:, None] * basis.eigenfunctions)
    np.testing.assert_allclose(np.abs(overlap), np.eye(12), atol=1e-7)
    np.testing.assert_allclose(basis.mass, mass)


def test_basis_agrees_with_robust_laplacian():
    """On a mesh whose angles are good the intrinsic-Delaunay Laplacian is close to the plain one."""
    vertices, faces = potato(3)
    ours = laplace_beltrami(vertices, faces, 10).eigenvalues
    stiffness, mass = robust_laplacian.mesh_laplacian(vertices, faces)
    theirs = eigh(stiffness.toarray(), mass.toarray() / mass.sum(), eigvals_only=True)[:10]
    np.testing.assert_allclose(ours, theirs, rtol=5e-3, atol=1e-3)  # measured 2e-3 (mollified, flipped edges)


@pytest.mark.parametrize("cloud", [False, True])
def test_sphere_has_the_eigenvalues_of_a_sphere(cloud):
    """4π l (l + 1) with multiplicity 2l + 1 at unit area; single-vector Lanczos drops copies here."""
    vertices, faces = icosphere(4)
    basis = laplace_beltrami(vertices, None if cloud else faces, 16)
    expected = np.concatenate([[4 * np.pi * order * (order + 1)] * (2 * order + 1) for order in range(4)])
    np.testing.assert_allclose(basis.eigenvalues, expected, rtol=0.01, atol=1e-6)  # h² error: .55 %


@pytest.mark.parametrize("cloud", [False, True])
def test_basis_is_orthonormal_sorted_and_starts_constant(cloud):
    vertices, faces = potato(3)
    basis = laplace_beltrami(vertices, None if cloud else faces, 25)
    gram = basis.eigenfunctions.T @ (basis.mass[:, None] * basis.eigenfunctions)
    np.testing.assert_allclose(gram, np.eye(25), atol=1e-8)
    np.testing.assert_allclose(basis.eigenfunctions[:, 0], 1, atol=1e-8)
    assert (np.diff(basis.eigenvalues) >= 0).all()
    assert basis.eigenvalues[0] == pytest.approx(0, abs=1e-9)
    assert basis.mass.sum() == pytest.approx(1)


def test_same_input_same_bits():
    vertices, faces = potato(3)
    first, second = (laplace_beltrami(vertices, faces, 15) for _ in range(2))
    np.testing.assert_array_equal(first.eigenfunctions, second.eigenfunctions)


def test_units_place_and_numbering_do_not_matter():
    vertices, faces = potato(3)
    basis = laplace_beltrami(vertices, faces, 10)
    moved, moved_faces, old = relabelled(vertices * 1e-3 + [50, -20, 7], faces, rng=3)
    other = laplace_beltrami(moved, moved_faces, 10)
    np.testing.assert_allclose(other.eigenvalues, basis.eigenvalues, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(other.eigenfunctions, basis.eigenfunctions[old], atol=1e-6)  # the sign rule holds too


def test_non_manifold_and_degenerate_meshes_have_a_basis():
    vertices, faces = potato(2)
    fin = np.vstack([vertices, vertices[faces[0, 0]] * 1.4])  # a third face on one edge
    split = np.vstack([vertices, vertices[faces[0, :2]].mean(axis=0)])  # a face of area zero on one edge
    plain = laplace_beltrami(vertices, faces, 6).eigenvalues
    for broken in (fin, split):
        extra = np.array([[faces[0, 0], faces[0, 1], len(vertices)]])
        basis = laplace_beltrami(broken, np.vstack([faces, extra]), 6)
        assert np.isfinite(basis.eigenfunctions).all()
        np.testing.assert_allclose(basis.eigenvalues, plain, rtol=0.05, atol=1e-6)


def test_basis_refuses_what_it_cannot_do():
    vertices, faces = potato(1)
    n = len(vertices)
    for n_basis in (0, n):
        with pytest.raises(ValueError, match=f"n_basis = {n_basis} must be at least 1 and less than"):
            laplace_beltrami(vertices, faces, n_basis)
    with pytest.raises(ValueError, match=f"2 components; vertex {n} is not connected"):
        laplace_beltrami(np.vstack([vertices, vertices + 9]), np.vstack([faces, faces + n]), 5)
    with pytest.raises(ValueError, match="vertex 1 is not finite"):
        laplace_beltrami(np.where(np.arange(n)[:, None] == 1, np.inf, vertices), faces, 5)


def test_flipping_and_truncating():
    basis = laplace_beltrami(*potato(1), 5)
    flipped = basis.with_flipped(2)
    np.testing.assert_array_equal(flipped.eigenfunctions, basis.eigenfunctions * [1, 1, -1, 1, 1])
    np.testing.assert_array_equal(basis.truncated(3).eigenfunctions, basis.eigenfunctions[:, :3])
    with pytest.raises(ValueError, match="k: 5 is outside 0..4"):
        basis.with_flipped(5)
    with pytest.raises(ValueError, match="n = 6"):
        basis.truncated(6)
    with pytest.raises(ValueError, match="eigenfunctions must be"):
        Basis([0.0, 1.0], np.ones((4, 3)), np.ones(4))


def test_coefficients_of_a_function_in_the_span():
    basis = laplace_beltrami(*potato(2), 6)
    np.testing.assert_allclose(basis.coefficients(basis.eigenfunctions @ np.arange(6)), np.arange(6), atol=1e-9)
    with pytest.raises(ValueError, match=r"functions: expected \(V, ...\) with V = "):
        basis.coefficients(np.ones(3))


def test_every_copy_of_a_multiple_eigenvalue_is_found():
    """The dense spectrum of an icosahedral mesh, whose eigenvalues have up to five copies."""
    vertices, faces = icosphere(3)
    stiffness, mass = _cotangent_laplacian(vertices, faces)
    dense = eigh(stiffness.toarray(), np.diag(mass / mass.sum()), eigvals_only=True)
    for n_basis in (4, 8, 20, 30):
        basis = laplace_beltrami(vertices, faces, n_basis)
        np.testing.assert_allclose(basis.eigenvalues, dense[:n_basis], atol=1e-7)
