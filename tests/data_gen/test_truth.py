"""Planted truths are consistent, trees are what they say, and signs are fixed before maps are formed."""

import networkx as nx
import numpy as np
import pytest
from scipy.spatial import cKDTree

import data_gen
import fmsync
from data_gen.truth import absolute_maps
from fmsync import so
from fmsync.problem import cycle_error


@pytest.fixture(scope="module")
def shapes():
    return data_gen.load_collection("cats", count=4, n_vertices=1000)


@pytest.fixture(scope="module")
def truth(shapes):
    return data_gen.ground_truth(shapes, nx.complete_graph(4), n_basis=15)


def test_planted_truth_is_consistent_and_gauged():
    truth = data_gen.planted(5, 4, rng=1)
    np.testing.assert_allclose(truth.absolute[0], np.eye(4))
    i, j = truth.edges.T
    np.testing.assert_allclose(truth.absolute[i] @ truth.maps, truth.absolute[j], atol=1e-13)
    np.testing.assert_allclose(truth.measured_maps, truth.maps)
    with pytest.raises(ValueError, match="5 nodes"):
        data_gen.planted(4, 3, nx.complete_graph(5))


@pytest.mark.parametrize("tree", ["depth-first", "breadth-first", "minimum-distortion"])
def test_absolute_maps_multiply_along_the_tree(tree):
    truth = data_gen.planted(6, 3, rng=2)
    distortion = np.random.default_rng(0).random(len(truth.edges))
    absolute = absolute_maps(6, truth.edges, truth.maps, tree=tree, distortion=distortion)
    np.testing.assert_allclose(absolute, truth.absolute, atol=1e-12)  # consistent: every tree gives the same


def test_trees_differ_when_maps_do_not_agree():
    p = data_gen.perturb(data_gen.planted(6, 3, rng=2), 0.1, rng=1)
    deep, wide = (absolute_maps(6, p.edges, p.maps, tree=tree) for tree in ("depth-first", "breadth-first"))
    lookup = {tuple(e): m for e, m in zip(p.edges.tolist(), p.maps)}
    np.testing.assert_allclose(wide[3], lookup[0, 3], atol=1e-12)  # a star
    np.testing.assert_allclose(deep[3], lookup[0, 1] @ lookup[1, 2] @ lookup[2, 3], atol=1e-12)  # a path


def test_shapes_give_rotations_in_the_gauge_of_the_first(truth):
    np.testing.assert_allclose(truth.absolute[0], np.eye(15), atol=1e-12)
    for maps in (truth.maps, truth.measured_maps):
        np.testing.assert_allclose(so.transpose(maps) @ maps, np.broadcast_to(np.eye(15), maps.shape), atol=1e-10)
        np.testing.assert_allclose(np.linalg.det(maps), 1)
    assert cycle_error(4, truth.edges, truth.maps).max() < 1e-10
    assert truth.provenance["tree"] == "depth-first"
    assert truth.provenance["shapes"] == ["cat0", "cat1", "cat2", "cat3"]
    assert len(set(truth.provenance["positions"])) == 4  # digests: which meshes, not only which names
    assert len(truth.bases) == 4


def test_bases_come_from_the_cache_the_second_time(shapes, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    pair = nx.path_graph(2)
    made = data_gen.ground_truth(shapes[:2], pair, n_basis=6)
    monkeypatch.setattr("data_gen.truth.laplace_beltrami", None)
    again = data_gen.ground_truth(shapes[:2], pair, n_basis=6)
    for first, second in zip(made.bases, again.bases):
        assert (first.eigenfunctions == second.eigenfunctions).all()
        assert (first.mass == second.mass).all()
    with pytest.raises(TypeError):  # other functions, other meshes: computed
        data_gen.ground_truth(shapes[:2], pair, n_basis=7)
    with pytest.raises(TypeError):
        data_gen.ground_truth(shapes[1:3], pair, n_basis=6)


def test_fixing_signs_repairs_determinants_however_they_came(shapes, truth):
    flipped = [basis.with_flipped(3) if k % 2 else basis for k, basis in enumerate(truth.bases)]
    raw = data_gen.measure_maps(flipped, truth.edges)
    fixed = data_gen.measure_maps(data_gen.fix_signs(flipped), truth.edges)
    assert (np.linalg.det(raw) < 0).sum() >= 3
    assert (np.linalg.det(fixed) < 0).sum() <= (
        np.linalg.det(data_gen.measure_maps(truth.bases, truth.edges)) < 0
    ).sum()
    alone = cycle_error(4, truth.edges, so.project(raw)).mean()
    together = cycle_error(4, truth.edges, so.project(fixed)).mean()
    assert together < alone - 0.5


def test_point_maps_replace_a_common_order(shapes):
    """Relabelling the vertices of one shape and saying so changes nothing that can be observed."""
    graph = nx.path_graph(3)
    order = np.random.default_rng(0).permutation(shapes[1].n_vertices)  # new label -> old label
    new_label = np.argsort(order)
    relabelled = fmsync.Shape(shapes[1].vertices[order], new_label[shapes[1].faces], "relabelled")
    identity = np.arange(shapes[0].n_vertices)
    point_maps = {(0, 1): new_label, (1, 2): order}
    bases = [fmsync.laplace_beltrami(s.vertices, s.faces, 8) for s in (shapes[0], relabelled, shapes[2])]
    plain = [bases[0], fmsync.Basis(bases[1].eigenvalues, bases[1].eigenfunctions[new_label], bases[1].mass[new_label])]
    with_maps = data_gen.ground_truth([shapes[0], relabelled, shapes[2]], graph, 8, bases=bases, point_maps=point_maps)
    without = data_gen.ground_truth(shapes[:3], graph, 8, bases=[*plain, bases[2]])
    np.testing.assert_allclose(np.abs(with_maps.measured_maps), np.abs(without.measured_maps), atol=1e-8)
    assert identity.shape == order.shape


@pytest.fixture(scope="module")
def fine(shapes):
    """The second shape with four times the faces."""
    import pyvista as pv

    mesh = pv.PolyData.from_regular_faces(shapes[1].vertices, shapes[1].faces).subdivide(1, "loop")
    return fmsync.Shape(np.asarray(mesh.points, dtype=float), mesh.regular_faces, "fine")


def test_bad_input(shapes, fine):
    with pytest.raises(ValueError, match="equal vertex counts"):
        data_gen.ground_truth([shapes[0], fine], nx.complete_graph(2), 5)
    with pytest.raises(ValueError, match="3 nodes for 4 shapes"):
        data_gen.ground_truth(shapes, nx.complete_graph(3), 5)
    with pytest.raises(ValueError, match="tree"):
        data_gen.ground_truth(shapes, nx.complete_graph(4), 5, tree="longest")
    with pytest.raises(ValueError, match="2 components"):
        data_gen.ground_truth(shapes, nx.Graph([(0, 1), (2, 3)]), 5)


def test_correspondence_files_reach_shapes_of_unequal_vertex_counts(shapes, fine):
    """A finer mesh of the same pose, known through a common template, gives nearly the same maps."""
    nearest = cKDTree(fine.vertices).query(shapes[1].vertices)[1]
    identity = np.arange(shapes[0].n_vertices)
    graph = nx.path_graph(3)
    mixed = [shapes[0], fine, shapes[2]]
    maps = data_gen.correspondence_maps(mixed, [identity, nearest, identity], data_gen.graph_edges(graph))
    assert [len(maps[edge]) for edge in ((0, 1), (1, 2))] == [1000, fine.n_vertices]
    truth = data_gen.ground_truth(mixed, graph, 10, point_maps=maps)
    same_order = data_gen.ground_truth(shapes[:3], graph, 10)
    np.testing.assert_allclose(np.abs(truth.measured_maps), np.abs(same_order.measured_maps), atol=0.05)
