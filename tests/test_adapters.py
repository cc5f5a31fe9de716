"""What goes to another library comes back the same, and that library sees in it what we do."""

import networkx as nx
import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import adapters, diagnostics, so
from fmsync.energy import energy, gradient, hessian
from fmsync.mesh_io import read_shape
from tests.surfaces import potato


@pytest.fixture(scope="module")
def problem():
    return data_gen.perturb(data_gen.planted(5, 4, rng=0), sigma2=0.05, rng=1)


@pytest.fixture(scope="module")
def post(problem):
    with diagnostics.short_run():
        return fmsync.sample(problem, "heat-bath", n_chains=3, n_draws=60, warmup=50, rng=0)


@pytest.fixture(scope="module")
def mesh():
    return fmsync.Shape(*potato(2), name="potato")


@pytest.fixture(scope="module")
def cloud(mesh):
    return fmsync.Shape(mesh.vertices, None, "cloud")


def test_arviz_computes_our_diagnostics(post):
    az = pytest.importorskip("arviz_stats")
    tree = post.to_arviz()
    with diagnostics.short_run():
        ours = post.summary()
    assert tree["posterior"].sizes == {"chain": 3, "draw": 60, "pair": 10}
    names = {"energy": "energy", "log kappa": "log_kappa"}
    tail = az.ess(tree, method="tail", prob=(0.05, 0.95))  # its default goes with the intervals that it prints
    for rows, at in ((az.rhat(tree), "r_hat"), (az.ess(tree), "ess_bulk"), (tail, "ess_tail")):
        rows = rows["posterior"] if "posterior" in getattr(rows, "children", {}) else rows
        for name, theirs in names.items():
            assert float(rows[theirs]) == pytest.approx(ours[name][at], rel=1e-10)
        for pair in rows["trace"].coords["pair"].values:
            assert float(rows["trace"].sel(pair=pair)) == pytest.approx(ours[f"tr C[{pair}]"][at], rel=1e-10)
            assert float(rows["first_entry"].sel(pair=pair)) == pytest.approx(ours[f"C[{pair}][0,0]"][at], rel=1e-10)


def test_arviz_shows_the_pairs_that_are_asked_for_and_no_fixed_kappa(problem):
    with diagnostics.short_run():
        post = fmsync.sample(problem, "heat-bath", kappa=20.0, n_chains=2, n_draws=8, warmup=5, rng=0)
    group = post.to_arviz(np.array([[3, 0]]))["posterior"]
    assert set(group.data_vars) == {"energy", "trace", "first_entry"}
    trace = np.trace(post.relative(np.array([[3, 0]]))[:, :, 0], axis1=-2, axis2=-1)
    np.testing.assert_allclose(group["trace"].sel(pair="3,0"), trace, atol=1e-12)


def test_draws_come_back_from_arviz(post, problem):
    pytest.importorskip("arviz_base")
    tree = post.to_arviz().copy(deep=True)
    back = fmsync.Posterior.from_arviz(tree, problem)
    for name in ("absolute", "energy", "kappa"):
        np.testing.assert_array_equal(getattr(back, name), getattr(post, name))
    assert (back.method, back.settings) == (post.method, post.settings)
    with diagnostics.short_run():
        assert str(back.summary()) == str(post.summary())
    with pytest.raises(ValueError, match=r"absolute is \(3, 60, 5, 4, 4\), expected \(chain, draw, 2, 3, 3\)"):
        adapters.from_arviz(tree, fmsync.SyncProblem(2, [[0, 1]], np.eye(3)[None]))
    tree["maps"]["absolute"][1, 2, 3] *= 2
    with pytest.raises(ValueError, match="data: absolute map 313 is not a rotation"):
        adapters.from_arviz(tree, problem)
    with pytest.raises(ValueError, match="its group 'maps' has no absolute, energy, kappa; to_arviz writes them"):
        adapters.from_arviz({"posterior": tree["posterior"]}, problem)


def test_pyfm_measures_our_map_and_gives_it_back(mesh):
    convert = pytest.importorskip("pyFM.spectral")
    turned = fmsync.Shape(1.7 * mesh.vertices[::-1] * [1.1, 1.0, 0.9], len(mesh.vertices) - 1 - mesh.faces, "turned")
    pair = [(shape, fmsync.laplace_beltrami(shape.vertices, shape.faces, 12)) for shape in (mesh, turned)]
    first, second = (adapters.to_pyfm(shape, basis) for shape, basis in pair)
    assert first.area == pytest.approx(1)
    image = np.arange(mesh.n_vertices)[::-1]  # for every vertex of the second a vertex of the first: p2p_21
    theirs = convert.mesh_p2p_to_FM(image, first, second, dims=12)  # FM_12
    ours = fmsync.functional_map(pair[1][1], pair[0][1], image)  # C_21
    np.testing.assert_allclose(theirs, ours, atol=1e-10)
    np.testing.assert_array_equal(convert.mesh_FM_to_p2p(ours, first, second), image)
    np.testing.assert_array_equal(fmsync.point_map(ours, pair[1][1], pair[0][1]), image)

    problem = adapters.from_pyfm_maps({(0, 1): theirs})
    assert problem.edges.tolist() == [[1, 0]]
    back = adapters.to_pyfm_maps(problem)
    np.testing.assert_array_equal(back[0, 1], theirs)
    np.testing.assert_array_equal(back[1, 0], theirs.T)


def test_a_mesh_of_pyfm_comes_with_its_basis_at_unit_area(mesh):
    trimesh = pytest.importorskip("pyFM.mesh").TriMesh(3 * mesh.vertices, mesh.faces, name="theirs").process(k=10)
    shape, basis = adapters.from_pyfm(trimesh)
    np.testing.assert_array_equal(shape.faces, mesh.faces)
    assert (shape.name, basis.mass.sum()) == ("theirs", pytest.approx(1))
    np.testing.assert_allclose(basis.coefficients(basis.eigenfunctions), np.eye(10), atol=1e-6)
    ours = fmsync.laplace_beltrami(mesh.vertices, mesh.faces, 10)
    np.testing.assert_allclose(basis.eigenvalues[1:], ours.eigenvalues[1:], rtol=1e-5)
    with pytest.raises(ValueError, match=r"process\(k\)"):
        adapters.from_pyfm(adapters.to_pyfm(mesh))
    again, same = adapters.from_pyfm(adapters.to_pyfm(shape, basis))
    assert again.area == pytest.approx(1)
    np.testing.assert_allclose(same.eigenfunctions, basis.eigenfunctions, rtol=1e-12)


def test_a_mesh_of_pyfm_in_place_of_a_shape_is_told_the_way(mesh):
    with pytest.raises(ValueError, match=r"shapes\[1\]: expected Shape, got TriMesh; .*fmsync.adapters make one"):
        fmsync.synchronize_shapes([mesh, adapters.to_pyfm(mesh)])


def test_pyfm_maps_that_do_not_fit_are_named():
    with pytest.raises(ValueError, match=r"FM of \(1, 2\) is \(4, 3\), expected \(3, 3\)"):
        adapters.from_pyfm_maps({(0, 1): np.eye(3), (1, 2): np.ones((4, 3))})
    with pytest.raises(ValueError, match="none given"):
        adapters.from_pyfm_maps({})


def test_geomstats_points_are_rotations_at_half_the_squared_distance():
    pytest.importorskip("geomstats")
    rotations = so.random_uniform(4, 6, rng=0)
    space, points = adapters.to_geomstats(rotations)
    assert np.all(space.belongs(points))
    theirs = space.metric.dist(points[:3], points[3:])
    np.testing.assert_allclose(theirs * np.sqrt(2), so.dist(rotations[:3], rotations[3:]), rtol=1e-8)
    np.testing.assert_array_equal(adapters.from_geomstats(points), rotations)
    with pytest.raises(ValueError, match="points: node 2 is not a rotation"):
        adapters.from_geomstats(points * np.array([1, 1, 2, 1, 1, 1])[:, None, None])


def test_pymanopt_minimises_our_energy(problem):
    optimizers = pytest.importorskip("pymanopt.optimizers")
    theirs = adapters.to_pymanopt(problem)
    point = so.random_uniform(problem.n, problem.n_nodes, rng=0)
    assert theirs.cost(point) == pytest.approx(float(energy(problem, point)))
    np.testing.assert_allclose(theirs.riemannian_gradient(point), gradient(problem, point), atol=1e-10)
    tangent = theirs.manifold.random_tangent_vector(point)
    np.testing.assert_allclose(theirs.riemannian_hessian(point, tangent), hessian(problem, point, tangent), atol=1e-10)
    start = fmsync.solve(problem, "spectral").absolute
    found = optimizers.TrustRegions(verbosity=0).run(theirs, initial_point=start)
    assert found.cost == pytest.approx(fmsync.solve(problem).cost, rel=1e-8)
    back = adapters.from_pymanopt(found.point, problem)
    np.testing.assert_allclose(back.relative(), fmsync.solve(problem).relative(), atol=1e-4)
    assert fmsync.certify(problem, back).certified
    with pytest.raises(ValueError, match="point: node 2 is not a rotation"):
        adapters.from_pymanopt(found.point * np.array([1, 1, 2, 1, 1])[:, None, None], problem)


def test_networkx_carries_repeated_weighted_maps_both_ways():
    maps = so.random_uniform(3, 4, rng=0)
    problem = fmsync.SyncProblem(3, [[0, 1], [0, 1], [2, 1], [1, 0]], maps, [1.0, 2.0, 3.0, 4.0])
    back = adapters.from_networkx(adapters.to_networkx(problem))
    order = [int(np.flatnonzero((maps == c).all((1, 2)))[0]) for c in back.maps]
    assert sorted(order) == [0, 1, 2, 3]
    np.testing.assert_array_equal(back.edges, problem.edges[order])
    np.testing.assert_array_equal(back.weights, problem.weights[order])


def test_graphs_that_say_too_little_are_refused():
    with pytest.raises(ValueError, match="undirected"):
        adapters.from_networkx(nx.path_graph(2))
    with pytest.raises(ValueError, match=r"the edge 'a' -> 'b' has no map; add_edge\('a', 'b', map=C\)"):
        adapters.from_networkx(nx.DiGraph([("a", "b")]))


def test_the_table_of_edges_tells_which_map_is_bad(problem):
    maps = problem.maps.copy()
    maps[3] = so.random_uniform(problem.n, 1, rng=5)[0]
    wrong = fmsync.SyncProblem(problem.n_nodes, problem.edges, maps)
    table = adapters.to_pandas(wrong, fmsync.solve(wrong, "robust"))
    assert list(table) == ["i", "j", "weight", "orthogonality_error", "residual", "inlier_weight"]
    assert table["residual"].idxmax() == table["inlier_weight"].idxmin() == 3
    assert list(adapters.to_pandas(wrong)) == ["i", "j", "weight", "orthogonality_error"]


def test_a_table_of_maps_is_a_problem_again():
    problem = fmsync.SyncProblem(3, [[2, 1], [0, 1], [0, 1]], so.random_uniform(3, 3, rng=0), [1.0, 2.0, 3.0])
    table = adapters.to_pandas(problem).assign(map=list(problem.maps))
    back = adapters.from_pandas(table)
    for name in ("edges", "maps", "weights"):
        np.testing.assert_array_equal(getattr(back, name), getattr(problem, name))
    assert adapters.from_pandas(table.drop(columns="weight")[:2]).weights.tolist() == [1, 1]
    with pytest.raises(ValueError, match="table: no column map; it has i, j, weight, orthogonality_error"):
        adapters.from_pandas(adapters.to_pandas(problem))


@pytest.mark.parametrize("library", ["pyvista", "trimesh", "meshio"])
def test_meshes_and_point_clouds_keep_their_order(library, mesh, cloud):
    pytest.importorskip(library)
    to, back = getattr(adapters, f"to_{library}"), getattr(adapters, f"from_{library}")
    for shape in (mesh, cloud):
        again = back(to(shape), shape.name)
        np.testing.assert_array_equal(again.vertices, shape.vertices)
        assert again.name == shape.name
        if shape.faces is None:
            assert again.faces is None
        else:
            np.testing.assert_array_equal(again.faces, shape.faces)


def test_the_other_libraries_agree_on_what_a_mesh_is(mesh, tmp_path):
    pv, meshio = pytest.importorskip("pyvista"), pytest.importorskip("meshio")
    assert adapters.to_trimesh(mesh).is_watertight
    assert adapters.to_pyvista(mesh).area == pytest.approx(mesh.area)
    adapters.to_meshio(mesh).write(tmp_path / "mesh.obj")
    assert read_shape(tmp_path / "mesh.obj").area == pytest.approx(mesh.area)
    box = adapters.from_pyvista(pv.Box().clean())  # six squares
    assert (box.n_vertices, len(box.faces), box.area) == (8, 12, pytest.approx(24))
    with pytest.raises(ValueError, match="cells of type quad; a surface of triangles"):
        adapters.from_meshio(meshio.Mesh(np.eye(4, 3), [("quad", [[0, 1, 2, 3]])]))
