"""Maps of another matcher instead of the pipeline's own: every kind, wrong ones named, misfits refused in words."""

import itertools
import json
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp

import data_gen
import fmsync
from fmsync import adapters, so
from fmsync.cli import main
from fmsync.diagnostics import ConvergenceWarning
from fmsync.energy import squared_residuals
from fmsync.estimators import Estimate
from fmsync.matching import output, synchronize
from fmsync.matching.map_files import read_maps
from fmsync.matching.network import posterior_draws, trusted_edges, unchecked_maps
from fmsync.matching.report import quality_flags
from fmsync.shape import Basis, Shape
from tests.matching.conftest import OPTIONS, QUICK, write_off
from tests.samplers.test_tempered import twisted_ring

N, V = 5, 1000
PAIRS = list(itertools.combinations(range(N), 2))


@pytest.fixture(scope="module")
def orders():
    """Vertex v of the common order is vertex ``orders[k][v]`` of shape k."""
    rng = np.random.default_rng(5)
    return [rng.permutation(V) for _ in range(N)]


@pytest.fixture(scope="module")
def shapes(orders):
    cats = data_gen.load_collection("cats", count=N, n_vertices=V)
    return [
        Shape(c.vertices[np.argsort(order)], order[c.faces], f"cat{k}")
        for k, (c, order) in enumerate(zip(cats, orders))
    ]


@pytest.fixture(scope="module")
def bases(shapes):
    return [fmsync.laplace_beltrami(s.vertices, s.faces, 30) for s in shapes]


@pytest.fixture(scope="module")
def truth(orders):
    return {(i, j): orders[j][np.argsort(orders[i])] for i in range(N) for j in range(N) if i != j}


@pytest.fixture(scope="module")
def rough(truth, bases):
    """Point maps of functional maps with noise: what a matcher gives."""
    rng, found = np.random.default_rng(0), {}
    for i, j in PAIRS:
        a, b = bases[i].truncated(12), bases[j].truncated(12)
        c = fmsync.functional_map(a, b, truth[i, j]) + 0.1 * rng.standard_normal((12, 12))
        found[i, j] = fmsync.point_map(c, a, b)
    return found


@pytest.fixture(scope="module")
def spoilt(rough, orders):
    """A fifth of the pairs: one with left and right swapped, one shuffled."""
    maps, flip = dict(rough), data_gen.left_right_flip(V)
    turn = np.empty(V, dtype=int)
    turn[orders[2]] = orders[2][flip]  # in the vertices of shape 2
    maps[0, 2] = turn[maps[0, 2]]
    maps[1, 3] = np.random.default_rng(1).permutation(maps[1, 3])
    return maps


def synced_from(shapes, maps, **options):
    return fmsync.synchronize_shapes(shapes, maps=maps, **OPTIONS | {"n_draws": 0} | options)


@pytest.fixture(scope="module")
def synced(shapes, spoilt):
    return synced_from(shapes, spoilt)


def error(shapes, i, j, image, truth):
    vertices = shapes[j].normalised().vertices
    return np.linalg.norm(vertices[image] - vertices[truth[i, j]], axis=1).mean()


def test_wrong_maps_are_named_and_every_pair_gets_a_better_map(synced, shapes, spoilt, truth):
    weights = dict(zip(PAIRS, synced.estimate.edge_weights))
    bad = [weights.pop((0, 2)), weights.pop((1, 3))]
    assert max(bad) < 0.1
    assert min(weights.values()) > 0.9  # area under the curve 1
    before = [error(shapes, i, j, spoilt[i, j], truth) for i, j in PAIRS]
    after = [error(shapes, i, j, synced.point_map(i, j), truth) for i, j in PAIRS]
    assert max(after) < 0.5 * np.mean(before)
    assert output.edge_table(synced)["map"][1] == "maps[0, 2] (cat0 to cat2)"
    assert set(synced.used) == {e for e, pair in enumerate(PAIRS) if pair not in ((0, 2), (1, 3))}


def test_maps_that_turn_left_into_right_are_said(synced):
    (said,) = [line for line in quality_flags(synced) if "left into right" in line]
    assert "maps[0, 2] (cat0 to cat2)" in said


def test_a_mirrored_mesh_among_given_maps_is_no_worse(shapes, truth):
    points = shapes[1].vertices * [-1.0, 1, 1]
    mirrored = [shapes[0], fmsync.Shape(points, shapes[1].faces[:, ::-1], "mirrored"), shapes[2]]
    maps = {pair: truth[pair] for pair in ((0, 1), (0, 2), (1, 2))}
    before, after = (
        np.mean([error(those, i, j, synced_from(those, maps).point_map(i, j), truth) for i, j in maps])
        for those in (shapes[:3], mirrored)
    )
    assert after < 1.2 * before + 0.002


def test_given_maps_are_data_that_stay_what_they_are(synced, shapes, spoilt, bases):
    for e, (i, j) in enumerate(PAIRS):
        expected = fmsync.functional_map(bases[i], bases[j], spoilt[i, j])
        np.testing.assert_allclose(synced.matches[e].c_ij, expected, atol=1e-6)


def as_soft(point_map):
    return sp.csr_matrix((np.ones(V), (np.arange(V), point_map)), shape=(V, V))


def in_other_bases(bases):
    """Signs, order within, and area as other software might have them."""
    rng, found = np.random.default_rng(3), []
    for k, basis in enumerate(bases):
        turn, scale = np.linalg.qr(rng.standard_normal((30, 30)))[0], 7.0 + k
        found.append(Basis(basis.eigenvalues, basis.eigenfunctions @ turn / scale**0.5, basis.mass * scale))
    return found


KINDS = ("soft", "half", "functional", "bases", "reverse", "several")


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_gives_the_synchronisation_of_its_functional_map(kind, synced, shapes, spoilt, bases, truth):
    own, options = in_other_bases(bases), {}
    if kind == "soft":
        maps = {pair: as_soft(p) for pair, p in spoilt.items()}
    elif kind == "half":  # of all rows the same share: weights cancel
        maps = {pair: 0.5 * as_soft(p).tocoo() for pair, p in spoilt.items()}
    elif kind == "functional":
        maps = {(i, j): fmsync.functional_map(bases[i], bases[j], p) for (i, j), p in spoilt.items()}
    elif kind == "bases":
        options["bases"] = own
        maps = {(i, j): fmsync.functional_map(own[i], own[j], p) for (i, j), p in spoilt.items()}
    elif kind == "reverse":
        maps = {(j, i): fmsync.functional_map(bases[i], bases[j], p).T for (i, j), p in spoilt.items()}
    else:
        maps = {pair: {"first": p, "again": p} for pair, p in spoilt.items()}
    again = synced_from(shapes, maps, **options)
    weights = again.estimate.edge_weights[:: 2 if kind == "several" else 1]
    np.testing.assert_allclose(weights > 0.5, synced.estimate.edge_weights > 0.5)
    for i, j in ((0, 2), (3, 1)):
        a, b = (error(shapes, i, j, s.point_map(i, j), truth) for s in (again, synced))
        assert a == pytest.approx(b, abs=0.002)
    if kind not in ("reverse", "several"):
        np.testing.assert_allclose(again.problem.maps, synced.problem.maps, atol=1e-5)


def test_unmatched_vertices_are_left_out(shapes, rough, truth):
    """Three vertices of four without an image: the fit to those that are left is near the fit to all."""
    rng = np.random.default_rng(2)
    synced = synced_from(shapes, {pair: np.where(rng.random(V) < 0.75, -1, rough[pair]) for pair in PAIRS})
    full = synced_from(shapes, rough)
    far = np.linalg.norm(synced.problem.maps - full.problem.maps, axis=(1, 2))
    assert np.median(far) < 0.25 * np.sqrt(24)  # how far two unrelated rotations of twelve functions are apart
    assert error(shapes, 0, 4, synced.point_map(0, 4), truth) < 0.04


def test_a_wrong_direction_is_said(shapes, rough, truth):
    maps = {pair: truth[pair] for pair in PAIRS} | {(1, 3): truth[3, 1]}
    with pytest.raises(
        ValueError, match=r"maps\[1, 3\] \(cat1 to cat3\): keeps distances far better .* other direction"
    ):
        synced_from(shapes, maps)
    maps[1, 3] = as_soft(truth[3, 1])
    maps[0, 1] = {"zoomout.npy": as_soft(truth[1, 0])}
    with pytest.raises(ValueError, match=r"^zoomout.npy, maps\[1, 3\] \(cat1 to cat3\): keeps"):
        synced_from(shapes, maps)
    with pytest.raises(ValueError, match=r"^maps\[0, 1\] \(cat0 to cat1\), .*, maps\[0, 3\] .* and 7 more: keeps"):
        synced_from(shapes, {(i, j): truth[j, i] for i, j in PAIRS})


def test_a_wrong_direction_of_rectangular_maps_is_said(shapes, bases, truth):
    own = in_other_bases(bases)
    maps = {(i, j): fmsync.functional_map(own[i], own[j], truth[i, j])[:, :29] for i, j in PAIRS}
    maps[1, 3] = fmsync.functional_map(own[3], own[1], truth[3, 1])[:, :29]
    with pytest.raises(ValueError, match=r"^maps\[1, 3\] \(cat1 to cat3\): keeps distances far better"):
        synced_from(shapes, maps, bases=own)


def test_maps_come_back_in_the_bases_that_were_handed_in(synced, bases):
    others = in_other_bases(bases)
    ours, c = synced.functional_map(1, 3), synced.functional_map(1, 3, others)
    m = len(ours)
    one, three = (synced.shapes[k].basis.truncated(m) for k in (1, 3))
    function = others[3].eigenfunctions[:, 4]  # carried from shape 3 to shape 1 both ways
    np.testing.assert_allclose(
        others[1].eigenfunctions @ c[:, 4], one.eigenfunctions @ ours @ three.coefficients(function), atol=1e-6
    )
    flipped = [Basis(s.basis.eigenvalues, -s.basis.eigenfunctions, s.basis.mass) for s in synced.shapes]
    assert synced.shapes[1].basis.eigenfunctions.dtype == np.float32  # orthonormal up to its rounding
    np.testing.assert_allclose(synced.functional_map(1, 3, flipped), synced.functional_map(1, 3), atol=1e-7)


def test_functional_maps_in_other_bases_are_refused_where_other_signs_show_it(shapes, bases, truth):
    mesh = pytest.importorskip("pyFM.mesh").TriMesh
    theirs = [adapters.from_pyfm(mesh(s.vertices, s.faces).process(k=30))[1] for s in shapes]
    maps = {(i, j): fmsync.functional_map(theirs[i], theirs[j], truth[i, j]) for i, j in PAIRS}
    with pytest.raises(ValueError, match=r"^maps: \d of 5 .* other signs .*: they are in other bases than fmsync's;"):
        synced_from(shapes, maps)
    with pytest.raises(ValueError, match="in other bases than those in bases=; give point maps instead, or in Python"):
        synced_from(shapes, maps, bases=bases)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        synced_from(shapes, maps, bases=theirs)


def test_functional_maps_that_are_poor_are_said_to_be_poor_or_in_other_bases(shapes, bases, truth):
    turned = in_other_bases(bases)
    maps = {(i, j): fmsync.functional_map(turned[i], turned[j], truth[i, j]) for i, j in PAIRS}
    with pytest.warns(UserWarning, match="5 of 5 functional maps .* far worse .*: they are poor, or in other bases"):
        synced_from(shapes, maps)


def test_noisy_functional_maps_in_our_bases_are_taken(shapes, bases, truth):
    rng, maps = np.random.default_rng(7), {}
    for i, j in PAIRS:
        c = fmsync.functional_map(bases[i], bases[j], truth[i, j])
        maps[i, j] = c + 0.2 * rng.standard_normal(c.shape)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        synced_from(shapes, maps)


def test_maps_that_no_cycle_checks_are_named(shapes, rough):
    tree = {pair: rough[pair] for pair in [(0, 1), (1, 2), (2, 3), (3, 4)]}
    with pytest.warns(
        UserWarning, match=r"no cycle.* guess: maps\[0, 1\] \(cat0 to cat1\), .*maps of more pairs"
    ) as told:
        synced = synced_from(shapes, tree)
    assert str(told[0].message) in quality_flags(synced)


@pytest.mark.parametrize(
    ("pairs", "wrong", "said"),
    [
        ("01 12 02 23 34 24", "", None),
        ("01 12 02 23 34 34", "", "No cycle of trusted maps checks these.*: e3, e4, e5; give maps of more pairs"),
        ("01 12 02 23 34 24 13", "24", "No cycle of trusted maps .*: e4; give"),
        ("01 12 02 23 34 24", "23 24", r"No map that agrees with others connects a \+ b \+ c, d \+ e: "),
        ("01 12 23 34 04", "04", "The graph has no cycle, .*: e0, e1, e2, e3; give"),
        ("01 01 12 23 34", "", "The graph has no cycle"),
        ("01 02 03 12 13 23 04 14 24 34", "24 34", r"No majority of the maps of .*: e \(2 of 4\); give maps of more"),
        ("01 02 03 12 13 23 04 14 24 34", "34", None),
    ],
)
def test_bridges_of_the_trusted_maps_are_named(pairs, wrong, said):
    edges = np.array([[int(a), int(b)] for a, b in pairs.split()])
    problem = fmsync.SyncProblem(5, edges, np.tile(np.eye(3), (len(edges), 1, 1)))
    weights = np.array([0.1 if pair in wrong.split() else 0.9 for pair in pairs.split()])
    estimate = Estimate.from_absolute(problem, np.tile(np.eye(3), (5, 1, 1)), "robust", edge_weights=weights)
    told = unchecked_maps(problem, estimate, "abcde", [f"e{k}" for k in range(len(edges))], given=True)
    assert bool(told) == bool(said)
    assert re.search(said or "", "".join(told))


def test_parts_are_joined_by_the_least_contradicted_maps_alone():
    pairs = [(0, 1), (1, 2), (0, 2), (2, 3), (1, 3), (0, 3), (0, 3)]
    estimate = Estimate.from_absolute(
        problem := fmsync.SyncProblem(4, pairs, so.random_uniform(3, len(pairs), 0)),
        np.tile(np.eye(3), (4, 1, 1)),
        "robust",
        edge_weights=np.array([0.9, 0.1, 0.8, 0.2, 0.1, 0.1, 0.1]),
    )
    best = 3 + np.argmin(squared_residuals(problem, estimate.absolute)[3:])  # of those that lead to the last shape
    assert np.flatnonzero(trusted_edges(problem, estimate)).tolist() == [0, 2, best]


def test_advice_about_draws_names_what_the_pipeline_has(shapes, rough):
    with pytest.warns(ConvergenceWarning, match=r"effective draws.*ask for more draws \(n_draws, --draws\)") as told:
        synced_from(shapes, rough, n_draws=40)
    said = " ".join(str(w.message) for w in told)
    assert not {"warmup", "thin", "method"} & {*said.replace("=", " ").split()}
    assert told[0].filename == synced_from.__code__.co_filename


@pytest.mark.parametrize(
    ("given", "advice"),
    [(True, "give maps of more pairs."), (False, r"\(graph, --graph\), or give landmarks \(landmarks, --landmarks\).")],
)
def test_a_mode_that_the_draws_miss_is_said_with_what_helps(given, advice):
    ring = twisted_ring(3, n_nodes=9)  # observed ten times, which makes its two modes narrow
    problem = fmsync.SyncProblem(9, np.tile(ring.edges, (10, 1)), np.tile(ring.maps, (10, 1, 1)))
    with pytest.warns(ConvergenceWarning, match=f"more ways than one.*do not rely on the regions; .*{advice}$"):
        draws = posterior_draws(problem, fmsync.solve(problem, rng=0), 2000, np.random.default_rng(0), False, given)
    assert "settled in another mode" in draws.modes


def smaller(shape):
    """Another number of vertices."""
    import pyvista as pv

    mesh = pv.PolyData.from_regular_faces(shape.vertices, shape.faces).decimate(0.1)
    return Shape(np.asarray(mesh.points, dtype=float), mesh.regular_faces, "small")


POINTS = np.arange(V)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (POINTS[:-1], r"maps\[0, 1\] \(cat0 to cat1\): a point map of 999 vertices does not lead from 1000 to 1000"),
        (POINTS + 1, "vertex 1000 is none of 0..999; it counts from one: subtract one"),
        (POINTS - 2, "vertex -2 is none of 0..999; count from zero, -1 for unmatched"),
        (POINTS + 0.5, "whole numbers"),
        (np.where(POINTS == 3, np.nan, POINTS), "whole numbers"),
        (np.where(POINTS == 3, np.inf, POINTS), "whole numbers"),
        (np.where(POINTS < 23, POINTS, -1), "matches 23 vertices, too few for n_basis = 12; lower n_basis"),
        (POINTS.astype(str), "need numbers"),
        (POINTS.astype(object), "need numbers"),
        (np.zeros((12, 0)), "need numbers, .* of shape"),
        (np.eye(11), r"C_ij of shape \(11, 11\) is smaller than n_basis = 12; lower n_basis"),
        (np.full((12, 12), np.nan), "C_ij holds NaN"),
        (np.eye(V), "give soft maps as scipy.sparse"),
        (sp.eye_array(V) * 1.01, "sum to at most one"),
        (-sp.eye_array(V), "sum to at most one"),
        (sp.eye_array(V - 1), r"a soft map of shape \(999, 999\) does not lead from 1000 to 1000 vertices"),
        (np.eye(V + 1), r"C_ij of shape \(1001, 1001\), for bases of 1000"),
        ([POINTS, POINTS[:5]], r"maps\[0, 1\] \(cat0 to cat1\), number 1: a point map of 5"),
        ({"wks": POINTS[:5]}, "^wks: a point map of 5"),
    ],
)
def test_misfits_are_refused_before_long_work(shapes, monkeypatch, value, said):
    monkeypatch.setattr(synchronize, "sample_shape", lambda *_: pytest.fail("long work began"))
    with pytest.raises(ValueError, match=said) as caught:
        synced_from(shapes[:2], {(0, 1): value})
    assert "\n" not in str(caught.value)


def test_graphs_and_bases_are_refused_before_long_work(shapes, bases, monkeypatch):
    monkeypatch.setattr(synchronize, "sample_shape", lambda *_: pytest.fail("long work began"))
    few = {(0, 1): POINTS, (2, 3): POINTS, (3, 4): POINTS}
    with pytest.raises(ValueError, match=r"connect the components cat0 \+ cat1, cat2 \+ cat3 \+ cat4; add some"):
        synced_from(shapes, few)
    with pytest.raises(ValueError, match="connect the components"):
        synced_from(shapes[:2], {(0, 1): []})
    for key in ((0, 0), (0, 7), (0, 1, 2), "cat0"):
        with pytest.raises(ValueError, match="is no pair; keys are"):
            synced_from(shapes, {key: POINTS})
    two, c = shapes[:2], {(0, 1): np.eye(12)}
    doubled = Basis(bases[1].eigenvalues, 2 * bases[1].eigenfunctions, bases[1].mass)
    short = Basis(bases[1].eigenvalues, bases[1].eigenfunctions[1:], bases[1].mass[1:])
    order = np.random.default_rng(0).permutation(V)
    mixed = Basis(bases[1].eigenvalues, bases[1].eigenfunctions[order], bases[1].mass[order])
    for own, said in (
        ([bases[0], doubled], r"bases\[1\] \(of cat1\): not orthonormal, .* off by 3"),
        ([bases[0]], "bases: 1 for 2 shapes"),
        ([bases[0], mixed], r"bases\[1\] \(of cat1\): its functions jump along edges; .* another mesh or order"),
        ([bases[0], short], r"bases\[1\] \(of cat1\): 30 functions on 999 vertices"),
        ([bases[0], bases[1].truncated(5)], r"bases\[1\] .* 5 functions .* n_basis = 12"),
    ):
        with pytest.raises(ValueError, match=said):
            synced_from(two, c, bases=own)
    own = [bases[0], bases[1].truncated(15)]
    with pytest.raises(ValueError, match="bases of 30 and 15 functions, .* fits the other direction: rename"):
        synced_from(two, {(0, 1): np.eye(15, 30)}, bases=own)
    with pytest.raises(ValueError, match="leave it out"):
        synced_from(two, c, graph="k1")
    with pytest.raises(ValueError, match="leave it out"):
        fmsync.synchronize_shapes(two, bases=bases[:2])


def test_sizes_that_fit_in_reverse_alone_are_said(shapes):
    two = [shapes[0], smaller(shapes[1])]
    short = two[1].n_vertices
    for value in (np.zeros(short, dtype=int), sp.csr_array((short, V))):
        with pytest.raises(ValueError, match="fits the other direction: rename the file, or exchange i and j"):
            synced_from(two, {(0, 1): value})


def write(folder, name, array):
    folder.mkdir(exist_ok=True)
    path = folder / name
    if path.suffix == ".npy":
        np.save(path, array)
    elif path.suffix == ".npz":
        sp.save_npz(path, array)
    elif path.suffix == ".mat":
        scipy.io.savemat(path, {"p2p" if 1 in np.shape(array) or np.ndim(array) == 1 else "C": array})
    else:
        np.savetxt(path, array, delimiter="," if path.suffix == ".csv" else " ", fmt="%.17g")
    return path


def test_the_command_reads_every_format_and_names_the_bad_file(shapes, spoilt, bases, truth, tmp_path, capsys):
    meshes, maps, out = tmp_path / "meshes", tmp_path / "maps", tmp_path / "out"
    meshes.mkdir()
    for shape in shapes:
        write_off(meshes / f"{shape.name}.off", shape.vertices, shape.faces)
    for e, ((i, j), p) in enumerate(spoilt.items()):
        c = fmsync.functional_map(bases[i], bases[j], p)
        kinds = [(".npy", p), (".npz", as_soft(p)), (".csv", p), (".txt", c), (".mat", c), (".mat", p), (".csv", c)]
        suffix, array = kinds[e % len(kinds)]
        write(maps, f"cat{i}_to_cat{j}{suffix}", array)
    write(maps, "cat0_to_cat1.second.mat", as_soft(spoilt[0, 1]))
    assert main(["sync", str(meshes), "--maps", str(maps), "-o", str(out), "--json", *QUICK]) == 0
    pairs = json.loads(capsys.readouterr().out)["pairs"]
    assert len(pairs) == 11
    bad = {pair["map"] for pair in pairs if pair["inlier_weight"] < 0.5}
    assert {name.partition(".")[0] for name in bad} == {"cat0_to_cat2", "cat1_to_cat3"}
    for i, j in truth:
        image = np.load(out / "point_maps" / f"cat{i}_to_cat{j}.npy")
        assert error(shapes, i, j, image, truth) < 0.06
        assert (out / "point_maps" / f"cat{i}_to_cat{j}.csv").is_file()
    assert "given maps" in (out / "report.html").read_text()


def test_files_that_are_no_maps_are_named(shapes, tmp_path, capsys):
    names, sizes, where = ["a", "a_to_a", "b"], [V, V, V], tmp_path / "maps"
    for name, said in (
        ("a_to_c.npy", "is not A_to_B of two meshes; rename it .*meshes are a, a_to_a, b"),
        ("a_to_a_to_a.npy", "could be of several pairs"),
        ("a_to_b.pkl", "suffixes .npy"),
        ("notes.txt", "is not A_to_B"),
    ):
        path = where / name
        where.mkdir(exist_ok=True)
        path.write_bytes(b"")
        with pytest.raises(ValueError, match=f"{name}: its name {said}" if name != "a_to_b.pkl" else said):
            read_maps(where, names, sizes)
        path.unlink()
    with pytest.raises(ValueError, match="no maps in it"):
        read_maps(where, names, sizes)
    with pytest.raises(ValueError, match="no such folder"):
        read_maps(tmp_path / "none", names, sizes)


def test_damaged_and_hostile_files_are_one_line(tmp_path):
    import io
    import zipfile

    where = tmp_path / "maps"
    where.mkdir()
    objects = io.BytesIO()
    np.save(objects, np.array([print, 1], dtype=object), allow_pickle=True)
    huge = io.BytesIO()
    np.lib.format.write_array_header_1_0(huge, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    crash = io.BytesIO()
    sp.save_npz(crash, sp.csr_array((np.ones(2), np.array([0, 10**9]), np.array([0, 1, 2])), shape=(2, 2)))
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("data.npy", bytes(10**8))
    wide = io.BytesIO()
    scipy.io.savemat(wide, {"C": np.zeros((3000, 500))})
    other = io.BytesIO()
    scipy.io.savemat(other, {"D": np.eye(3)})
    for suffix, data in (
        (".npy", objects.getvalue()),
        (".npy", huge.getvalue()),
        (".npy", b"\x93NUMPY"),
        (".npz", crash.getvalue()),
        (".npz", bomb.getvalue()),
        (".npz", b"PK"),
        (".csv", b"vertex,image\n0,1\n"),
        (".csv", b"\xff\xfe"),
        (".txt", b"1 2\n3\n"),
        (".mat", wide.getvalue()),
        (".mat", other.getvalue()),
        (".mat", b"MATLAB 5.0 MAT-file" + bytes(200)),
    ):
        path = where / f"a_to_b{suffix}"
        path.write_bytes(data)
        with pytest.raises(ValueError, match=f"a_to_b{suffix}: cannot be read as a map") as caught:
            read_maps(where, ["a", "b"], [100, 100])
        assert "\n" not in str(caught.value)
        path.unlink()


def test_the_command_refuses_bad_maps_and_leaves_nothing(shapes, bases, truth, tmp_path, capsys):
    meshes, maps, out = tmp_path / "meshes", tmp_path / "maps", tmp_path / "out"
    meshes.mkdir()
    for shape in shapes[:3]:
        write_off(meshes / f"{shape.name}.off", shape.vertices, shape.faces)
    write(maps, "cat0_to_cat1.txt", np.arange(V))
    for name, array, said in (
        ("cat1_to_cat2.csv", np.arange(V - 1), "cat1_to_cat2.csv: a point map of 999 vertices"),
        ("cat1_to_cat0.csv", np.arange(V), "components cat0 + cat1, cat2"),
        ("cat1_to_cat0.csv", np.eye(5), "smaller than --basis = 10; lower --basis"),
        ("cat7_to_cat0.csv", np.arange(V), "cat7_to_cat0.csv: its name is not A_to_B"),
    ):
        path = write(maps, name, array)
        assert main(["sync", str(meshes), "--maps", str(maps), "-o", str(out), *QUICK]) == 2
        told = capsys.readouterr().err
        assert said in told
        assert not out.exists()
        path.unlink()
    assert main(["sync", str(meshes), "--maps", str(maps), "-o", str(out), *QUICK, "--graph", "k1"]) == 2
    assert "--graph: the maps say which pairs there are; leave it out" in capsys.readouterr().err
    (maps / "cat0_to_cat1.txt").unlink()
    turns = np.sign(np.random.default_rng(1).standard_normal((3, 30)))  # signs of another program
    for i, j in ((0, 1), (1, 2), (0, 2)):
        write(
            maps,
            f"cat{i}_to_cat{j}.mat",
            turns[i][:, None] * fmsync.functional_map(bases[i], bases[j], truth[i, j]) * turns[j],
        )
    assert main(["sync", str(meshes), "--maps", str(maps), "-o", str(out), *QUICK]) == 2
    *_, told = capsys.readouterr().err.splitlines()
    assert "other signs" in told
    assert "give point maps instead" in told
    assert not out.exists()


def test_votes_and_flags_read_the_maps_that_are_used(synced):
    assert synced.votes(0, 2).shape[1] == 200
    named = replace(synced, map_names=tuple(f"m{e}" for e in range(len(PAIRS))))
    assert named.edge_names[1] == "m1"
