"""Random species: closed bodies, near-isometric within a species and far apart between them, with exact truth."""

from itertools import combinations

import numpy as np
import pytest

import data_gen
import fmsync
from data_gen.creature_body import draw_body
from data_gen.creatures import Creature, creatures
from data_gen.mesher import is_sphere, self_intersections
from data_gen.report import edge_distortion
from fmsync.shape import Shape, edges_of_faces

SPECIES = range(12)


@pytest.fixture(scope="module")
def species():
    return [creatures(k, count=3, n_vertices=1000) for k in SPECIES]


@pytest.fixture(scope="module")
def remeshed():
    return creatures(2, count=3, n_vertices=1000, remeshed=True)


def test_every_creature_is_a_closed_surface_of_genus_zero_that_does_not_pass_through_itself(species, remeshed):
    for shape in [shape for shapes in [*species, remeshed] for shape in shapes]:
        assert is_sphere(shape.faces, shape.n_vertices)
        a, b, c = shape.vertices[shape.faces].swapaxes(0, 1)
        assert np.einsum("fi,fi->", a, np.cross(b, c)) > 0  # faces look outwards
        squared = ((shape.vertices[shape.faces] - shape.vertices[np.roll(shape.faces, 1, axis=1)]) ** 2).sum(axis=2)
        double_area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        assert (double_area > 0.005 * squared.max(axis=1)).all()  # .87 for an equilateral triangle
        assert len(self_intersections(shape.vertices, shape.faces)) == 0


def test_poses_are_near_isometric_and_species_are_not(species):
    """The statistics of real scans: those of the cats, and of the eigenvalues of measured animals and humans."""
    logs, distortion = [], []
    for shapes in species:
        distortion.append(np.median(edge_distortion(shapes)))
        spectra = [fmsync.laplace_beltrami(s.vertices, s.faces, 21).eigenvalues[1:] for s in shapes]
        logs.append(np.log(spectra))
    assert 0.02 < min(distortion) < max(distortion) < 0.13
    assert 0.05 < np.median(distortion) < 0.12
    within = [np.abs(a - b).mean() for log in logs for a, b in combinations(log, 2)]
    between = [np.abs(a - b).mean() for a, b in combinations([log.mean(axis=0) for log in logs], 2)]
    assert 0.01 < np.median(within) < 0.08
    assert np.median(between) > 0.09
    assert np.quantile(within, 0.75) < np.quantile(between, 0.05)


def test_parts_are_those_of_the_body_and_of_both_sides(species):
    tails = [(shapes[0].part == "tail").mean() for shapes in species]
    assert min(tails) == 0 < max(tails) < 0.4
    for (shape, *_), tail in zip(species, tails):
        assert set(shape.part) == {"limb", "trunk"} | ({"tail"} if tail else set())
        assert (shape.part == shape.part[shape.opposite]).mean() > 0.95


def test_limbs_are_two_four_or_six():
    counts = set()
    for k in range(60):
        body = draw_body(np.random.default_rng(k))
        limbs = [b for b in body.bones if b.parent and b.parent.startswith("trunk") and b.name.split()[0] in SIDES]
        counts.add(len([bone for bone in limbs if "neck" not in bone.name]))
    assert counts == {2, 4, 6}


SIDES = ("left", "right")


def test_same_arguments_same_bits_without_the_cache(monkeypatch, tmp_path, species, remeshed):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    again = creatures(2, count=2, n_vertices=1000)  # and creature k does not depend on how many are asked for
    for first, second in zip(species[2], again):
        np.testing.assert_array_equal(first.vertices, second.vertices)
    for first, second in zip(remeshed, creatures(2, count=1, n_vertices=1000, remeshed=True)):
        for field in ("vertices", "faces", "common", "opposite", "located"):
            np.testing.assert_array_equal(getattr(first, field), getattr(second, field))
    other = creatures(2, count=1, n_vertices=1000, seed=1)[0]
    assert not np.allclose(other.vertices, again[0].vertices)
    assert (other.faces == again[0].faces).all()


def test_a_symmetric_species_has_an_exact_mirror_map_at_rest():
    """Rest is not among the poses, but lengths of edges tell a pose from its mirror image, and less so if symmetric."""
    distortion = {}
    for symmetric in (True, False):
        shape = creatures(0, count=1, n_vertices=1000, symmetric=symmetric)[0]
        mirror = shape.opposite
        np.testing.assert_array_equal(mirror[mirror], np.arange(1000))
        flipped = np.sort(mirror[shape.faces], axis=1)
        assert {*map(tuple, flipped.tolist())} == {*map(tuple, np.sort(shape.faces, axis=1).tolist())}
        distortion[symmetric] = edge_distortion([shape, Shape(shape.vertices[mirror], shape.faces, "mirrored")])[0]
    assert distortion[True] < distortion[False] < 0.3


def test_remeshed_creatures_know_their_body(species, remeshed):
    """A vertex lies where its point of the body does, and the vertex located at a point of the body is near it."""
    assert len({shape.n_vertices for shape in remeshed}) > 1
    for posed, shape in zip(species[2], remeshed):
        assert isinstance(shape, Creature)
        assert shape.name == posed.name
        assert len(shape.located) == len(posed.located)
        ends = shape.vertices[np.unique(edges_of_faces(shape.faces), axis=0)]
        edge = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean()
        away = np.linalg.norm(shape.vertices - posed.vertices[posed.located[shape.common]], axis=1)
        assert away.mean() < 0.6 * edge
        assert away.max() < 1.5 * edge  # the longest edges are longer than this
        same = shape.common < 1000
        np.testing.assert_array_equal(shape.vertices[same], posed.vertices[shape.common[same]])
        np.testing.assert_array_equal(shape.located[shape.common], np.arange(shape.n_vertices))
        np.testing.assert_array_equal(posed.located[posed.common], np.arange(1000))
        assert np.linalg.norm(posed.vertices - shape.vertices[shape.located[:1000]], axis=1).max() < 1.5 * edge
        np.testing.assert_array_equal(shape.part, posed.part[posed.located[shape.common]])
        assert (np.diff(shape.common) < 0).mean() == pytest.approx(0.5, abs=0.1)  # shuffled: sd .009
        mirrored = posed.opposite[posed.located[shape.common]]  # of the nearest vertex, and the nearest of the mirrored
        away = np.linalg.norm(posed.vertices[mirrored] - posed.vertices[posed.located[shape.opposite]], axis=1)
        assert np.median(away) < edge


def test_true_maps_between_creatures_serve_as_ground_truth(remeshed):
    maps = data_gen.correspondence_maps(remeshed, [shape.located for shape in remeshed], [[0, 1]])
    first, second = remeshed[:2]
    difference = second.vertices[maps[0, 1]] - second.vertices[second.located[first.common]]
    assert np.median(np.linalg.norm(difference, axis=1)) < 0.03


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"count": 0}, "count: an integer >= 1, got 0"),
        ({"n_vertices": 10}, "n_vertices = 10: ask for 1000 to 30000"),
        ({"species": -1}, "species: an integer >= 0, got -1"),
        ({"remeshed": 2}, "remeshed: expected True or False, got 2"),
        ({"source": "cats", "species": 3}, "species: has no meaning for cats; leave it out"),
        ({"source": "cats", "remeshed": True}, "remeshed: has no meaning for cats; leave it out"),
        ({"source": "tests", "species": 3}, "species: has no meaning for files; leave it out"),
    ],
)
def test_bad_requests_are_refused(arguments, reason):
    with pytest.raises(ValueError, match=reason):
        data_gen.load_collection(**{"source": "creatures", **arguments})


def test_a_skin_with_faces_without_area_is_meshed():
    shape = creatures(1094, count=1, n_vertices=1500)[0]
    assert shape.n_vertices == 1500
    assert np.isfinite(shape.vertices).all()
