"""What a mesh file may contain is repaired where there is one right answer, and said; the rest is refused by name."""

import numpy as np
import pytest

import data_gen
from fmsync.mesh_repair import filled, repaired
from fmsync.shape import edges_of_faces, triangle_areas

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])  # of a tetrahedron


def moved(vertices, by, scale=1.0):
    """Vertices elsewhere, smaller."""
    return scale * vertices + by


def test_a_sound_mesh_stays_as_it_is():
    vertices, faces, said = repaired(CORNERS, FACES)
    assert said == []
    np.testing.assert_array_equal(vertices, CORNERS)
    np.testing.assert_array_equal(faces, FACES)


@pytest.mark.parametrize(
    ("vertices", "faces", "said"),
    [
        (np.vstack([CORNERS, CORNERS[2:3]]), np.vstack([FACES[:3], [[4, 0, 3]]]), "1 vertices lie exactly on others"),
        (CORNERS, np.vstack([FACES, [[1, 1, 2]]]), "1 faces use a vertex twice"),
        (CORNERS, np.vstack([FACES, [[1, 0, 2]]]), "1 faces repeat others"),
        (np.vstack([CORNERS, [[2.0, 0, 0.5]]]), np.vstack([FACES, [[1, 2, 4]]]), "1 faces stood as fins"),
        (
            np.vstack([CORNERS, moved(CORNERS, 3, 0.1)]),
            np.vstack([FACES, FACES + 4]),
            "2 components; the largest, 99",
        ),
        (
            np.vstack([CORNERS, [[9.0, 9, 9]]]),
            FACES,
            "1 vertices are on no face and were dropped",
        ),
    ],
)
def test_what_has_one_right_answer_is_repaired_and_said(vertices, faces, said):
    found, triangles, told = repaired(vertices, faces)
    assert any(line.startswith(said) for line in told)
    np.testing.assert_array_equal(found, CORNERS)
    assert {frozenset(face) for face in triangles.tolist()} == {frozenset(face) for face in FACES.tolist()}
    assert triangle_areas(found, triangles).sum() == pytest.approx(triangle_areas(CORNERS, FACES).sum())


@pytest.mark.parametrize(
    ("vertices", "faces", "said"),
    [
        (CORNERS, [[0, 1, 4]], r"face 0 uses vertices \[0, 1, 4\] of 0..3"),
        (CORNERS, [[1, 1, 2]], "no face with three different corners"),
        (
            np.vstack([CORNERS, moved(CORNERS, 3)]),
            np.vstack([FACES, FACES + 4]),
            "2 components, the largest with 50%",
        ),
        (np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), [[0, 1, 2]], "face 0 has no area"),
        (np.vstack([CORNERS, [[2.0, 2, 2]]]), np.vstack([FACES, [[1, 2, 4], [2, 3, 4], [3, 1, 4]]]), "not a manifold"),
    ],
)
def test_the_rest_is_refused_and_its_first_offender_named(vertices, faces, said):
    with pytest.raises(ValueError, match=said):
        repaired(vertices, np.array(faces))


def test_only_a_manifold_need_be_one():
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    assert repaired(flat, np.array([[0, 1, 2]]), manifold=False)[2] == []


def _is_closed(faces):
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()
    directed = {tuple(end) for end in ends}
    return len(directed) == len(ends) and {(b, a) for a, b in directed} == directed


@pytest.mark.parametrize("pinched", [False, True])
def test_holes_are_filled_with_faces_that_look_outwards(pinched):
    import pyvista as pv

    ball = pv.Icosphere(nsub=3)
    vertices, faces = np.asarray(ball.points, dtype=float), ball.regular_faces
    gone = (faces == 0).any(axis=1) | (vertices[faces].mean(axis=1)[:, 2] > 0.9)
    if pinched:  # two fans of faces about neighbours of one vertex, which alone is between them
        ring = np.setdiff1d(faces[(faces == 300).any(axis=1)], [300])
        far = ring[np.linalg.norm(vertices[ring] - vertices[ring[0]], axis=1).argmax()]
        gone |= np.isin(faces, [ring[0], far]).any(axis=1) & ~np.isin(faces, 300).all(axis=1)
    left = faces[~gone]
    ends = left[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()
    rim = [a for a, b in ends if [b, a] not in ends]
    assert (len(set(rim)) < len(rim)) == pinched  # a vertex that is twice on a rim
    closed = filled(vertices, left, longest=10)
    np.testing.assert_array_equal(closed[: len(left)], left)
    assert _is_closed(closed)
    a, b, c = vertices[closed].swapaxes(0, 1)
    assert (np.einsum("fx,fx->f", np.cross(b - a, c - a), a + b + c) > 0).all()
    np.testing.assert_array_equal(filled(vertices, left, longest=0.1), left)
    np.testing.assert_array_equal(filled(vertices, faces, longest=10), faces)


def test_filled_meshes_have_no_edge_in_three_faces_and_reversed_faces_are_no_holes():
    cat = data_gen.load_collection("cats", count=1, n_vertices=1000)[0]
    rng = np.random.default_rng(0)
    turned = rng.random(len(cat.faces)) < 0.3
    reversed_faces = np.where(turned[:, None], cat.faces[:, ::-1], cat.faces)
    np.testing.assert_array_equal(filled(cat.vertices, reversed_faces, longest=10), reversed_faces)
    grown = 0
    for _ in range(20):
        away = np.linalg.norm(cat.vertices - cat.vertices[rng.integers(1000)], axis=1)
        left = cat.faces[(away[cat.faces].mean(axis=1) > 0.1)]
        closed = filled(cat.vertices, left, longest=10)
        assert np.unique(edges_of_faces(closed), axis=0, return_counts=True)[1].max() == 2
        grown += len(closed) > len(left)
    assert grown > 15  # some hole may stay open: its patch would have edges that are there already
