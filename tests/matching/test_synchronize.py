"""The pipeline on small synthetic cats, whose common vertex order evaluates it and is never shown to it."""

from dataclasses import replace

import numpy as np
import pytest

import data_gen
import fmsync
from bench.own_shapes.confidence import planted_noise
from fmsync.matching import fit_conformal, pairwise, synchronize
from fmsync.matching.confidence import Confidence, local_distortion, two_modes
from fmsync.matching.latent import upsample
from fmsync.matching.network import rotation_signs
from fmsync.matching.report import quality_flags
from fmsync.matching.samples import farthest_points, geodesics_between, orientation_operators, sample_shape
from fmsync.shape import Shape
from tests.matching.conftest import OPTIONS
from tests.matching.planted_flips import planted_flips


def straight_errors(shape, image):
    """Straight-line distance from each vertex to its image under the common order, in square roots of the area."""
    vertices = shape.normalised().vertices
    return np.linalg.norm(vertices[image] - vertices, axis=1)


def test_point_maps_find_the_common_order(synced, cats):
    for i, j in ((0, 1), (3, 2)):
        assert straight_errors(cats[j], synced.point_map(i, j)).mean() < 0.04
        image = straight_errors(cats[j], data_gen.left_right_flip(1000)).mean()
    assert image > 0.1  # what a swap of left and right would cost


def test_maps_are_consistent(synced):
    np.testing.assert_allclose(
        synced.functional_map(0, 1) @ synced.functional_map(1, 3), synced.functional_map(0, 3), atol=1e-10
    )


def test_scale_units_and_another_triangulation_do_not_matter(cats):
    import pyvista as pv

    other = pv.PolyData.from_regular_faces(cats[1].vertices, cats[1].faces).subdivide(1, "linear")
    large = Shape(1000 * np.asarray(other.points, dtype=float), other.regular_faces, "large")
    result = fmsync.synchronize_shapes([cats[0], large], n_draws=0, **OPTIONS)
    image = large.vertices[result.point_map(0, 1)]
    assert np.linalg.norm(image - 1000 * cats[1].vertices, axis=1).mean() / np.sqrt(large.area) < 0.08


def test_small_holes_are_closed_before_spectra_are_compared(cats):
    cat = cats[0]
    top = (cat.vertices[:, 2] - 4 * np.abs(cat.vertices[:, 0] - cat.vertices[:, 0].mean())).argmax()
    away = np.linalg.norm(cat.vertices - cat.vertices[top], axis=1)
    faces = cat.faces[(away[cat.faces] > 0.1 * np.sqrt(cat.area)).any(axis=1)]
    kept = np.unique(faces)
    damaged = Shape(cat.vertices[kept], np.searchsorted(kept, faces), "damaged")
    whole, closed, still_open = (
        np.log(sample_shape(shape, 30, 100, fill=fill).basis.eigenvalues[1:])
        for shape, fill in ((cat, True), (damaged, True), (damaged, False))
    )
    assert 4 * np.abs(closed - whole).mean() < np.abs(still_open - whole).mean()


def test_threads_change_no_refined_map(synced):
    start = np.array([m.c_ij[:10, :10] for m in synced.matches])
    alone, together = (upsample(synced.shapes, synced.edges, start, 20, jobs=jobs) for jobs in (1, 2))
    np.testing.assert_array_equal(alone, together)


def test_point_clouds_have_no_orientation(cats):
    clouds = [Shape(cat.vertices, None, cat.name) for cat in cats[:2]]
    result = fmsync.synchronize_shapes(clouds, n_draws=0, **OPTIONS)
    assert result.matches[0].orientation == 0
    assert result.point_map(0, 1).shape == (1000,)


def test_orientation_operators_are_skew_and_turn_with_the_faces(cats):
    cat = cats[0].normalised()
    basis = fmsync.laplace_beltrami(cat.vertices, cat.faces, 10)
    functions = cat.vertices[:, :2]
    operators = orientation_operators(cat, basis, functions)
    turned = orientation_operators(Shape(cat.vertices, cat.faces[:, ::-1], "turned"), basis, functions)
    np.testing.assert_allclose(turned, -operators, atol=1e-12)
    assert np.linalg.norm(operators + operators.transpose(0, 2, 1)) < 1e-8 * np.linalg.norm(operators)


def test_farthest_points_against_the_definition():
    points = np.random.default_rng(0).standard_normal((60, 3))
    chosen = farthest_points(points, 10)
    for k in range(1, 10):
        nearest = np.linalg.norm(points[:, None] - points[chosen[:k]], axis=2).min(axis=1)
        assert nearest[chosen[k]] == pytest.approx(nearest.max())


def test_geodesics_on_a_sphere():
    import pyvista as pv

    ball = pv.Icosphere(radius=1.0, nsub=4)
    shape = Shape(np.asarray(ball.points, dtype=float), ball.regular_faces, "ball")
    samples = farthest_points(shape.vertices, 12)
    unit = shape.vertices[samples] / np.linalg.norm(shape.vertices[samples], axis=1, keepdims=True)
    expected = np.arccos(np.clip(unit @ unit.T, -1, 1))
    np.testing.assert_allclose(geodesics_between(shape, samples), expected, atol=0.1)


def test_geodesics_do_not_depend_on_where_a_large_mesh_lies(cats):
    import pyvista as pv

    cat = cats[0].normalised()
    large = pv.PolyData.from_regular_faces(cat.vertices, cat.faces).subdivide(1, "loop")
    vertices, faces = np.asarray(large.points, dtype=float), large.regular_faces
    assert len(vertices) > 3900  # decimated to 3000
    samples = farthest_points(vertices, 60)
    near, far = (geodesics_between(Shape(vertices + x, faces), samples) for x in (0, 1e6))
    assert np.abs(far - near).max() < 0.03 * near.max()  # a tenth when decimated where it lies


def test_zoomout_of_the_true_map_stays_there(synced):
    a, b = synced.shapes[0], synced.shapes[1]
    true = a.basis.coefficients(b.basis.eigenfunctions)
    maps, images = pairwise.zoomout(a, b, true[None, :10, :10], 30, 5)
    assert maps.shape == (1, 30, 30)
    assert images.shape == (1, 200)
    reached = b.shape.vertices[b.samples[images[0]]]
    assert np.linalg.norm(reached - b.shape.vertices[a.samples], axis=1).mean() < 0.06


def test_two_hop_compositions_repair_wrong_maps_that_agree_with_each_other(synced):
    """A shape whose maps to two of three others are mirrored alike: each of these triangles closes."""
    flip, n, light = data_gen.left_right_flip(1000), synced.problem.n, [s.light(pairwise.FINE) for s in synced.shapes]
    own = synced.shapes[1].basis
    turn, matches = own.coefficients(own.eigenfunctions[flip]), list(synced.matches)
    for e, (i, j) in enumerate(synced.edges.tolist()):
        if i == 1:
            c = turn[:n, :n] @ matches[e].c_ij[:n, :n]
            matches[e] = pairwise.improve(light[i], light[j], c[None])
            assert matches[e].cost > synced.matches[e].cost + 0.02
    each = synchronize.parallel(1, progress=False)
    wrong = np.array([m.c_ij[:n, :n] for m in matches])
    repaired = synchronize.with_proposals(each, light, synced.edges, matches, lambda _: wrong)
    for found, right in zip(repaired, synced.matches, strict=True):
        assert found.cost < right.cost + 0.01
    composed = synchronize.compositions(synced.edges, synced.matches, n)
    maps = {tuple(e): m.c_ij[:n, :n] for e, m in zip(synced.edges.tolist(), synced.matches)}
    assert len(composed[0]) == 2  # from 0 to 1 through 2 and through 3
    assert any(np.array_equal(c, maps[0, 2] @ maps[1, 2].T) for c in composed[0])


def test_signs_are_found():
    rng = np.random.default_rng(1)
    edges = np.array([(i, j) for i in range(8) for j in range(i + 1, 8)])
    hidden = rng.choice([-1.0, 1.0], 8)
    parity = hidden[edges[:, 0]] * hidden[edges[:, 1]]
    parity[[3, 17]] *= -1
    maps = np.stack([np.diag([p, 1.0, 1.0]) for p in parity])
    signs = rotation_signs(8, edges, maps)
    np.testing.assert_array_equal(signs, hidden * hidden[0])


def test_two_modes_need_two_supported_distant_places():
    geodesics = np.abs(np.subtract.outer([0.0, 0.01, 1.0], [0.0, 0.01, 1.0]))
    votes = np.array([[0, 0, 0], [1, 1, 0], [0, 2, 0], [1, 2, 0], [0, 0, 0], [0, 1, 2], [0, 0, 0], [1, 0, 0]])
    np.testing.assert_array_equal(two_modes(votes, geodesics)[0], [False, True, False])


def test_confidence_of_certain_draws_is_a_point(synced):
    known = synced.confidence(0, 1, 0.9)
    assert (known.radius >= 0).all()
    assert (known.entropy >= 0).all()
    again = synced.confidence(0, 1, 0.9, synced.point_map(0, 1))
    assert all(np.array_equal(value, getattr(again, name)) for name, value in vars(known).items())
    with pytest.raises(ValueError, match="point_map: 2 vertices; cat0 has 1000"):
        synced.confidence(0, 1, 0.9, synced.point_map(0, 1)[:2])
    wider = synced.confidence(0, 1, 0.99)
    assert (wider.radius >= known.radius).all()
    assert wider.radius.mean() > known.radius.mean()


def test_conformal_regions_cover_what_they_promise():
    rng = np.random.default_rng(0)
    zeros = np.zeros(4000, dtype=int)
    spread = rng.uniform(0.01, 0.2, 4000)
    known = Confidence(zeros, spread, spread, spread, zeros > 0, zeros, 0.9, spread**2, *np.ones((2, 4000)))
    errors = 3 * spread * rng.exponential(size=4000)
    fitted = fit_conformal([known], [errors])
    fresh = 3 * spread * rng.exponential(size=4000)
    assert (fresh <= fitted.radius(known)).mean() == pytest.approx(0.9, abs=0.02)


def test_finished_pairs_are_not_done_again(cats, tmp_path, monkeypatch):
    first = fmsync.synchronize_shapes(cats[:3], n_draws=0, checkpoint=tmp_path, **OPTIONS)
    assert len(list(tmp_path.iterdir())) == 3

    def refuse(*_):
        raise AssertionError("done again")

    monkeypatch.setattr(synchronize, "match", refuse)
    again = fmsync.synchronize_shapes(cats[:3], n_draws=0, checkpoint=tmp_path, **OPTIONS)
    np.testing.assert_array_equal(again.refined, first.refined)


def test_shapes_of_equal_spectrum_are_neighbours_of_each_other(cats):
    twins = [cats[0], replace(cats[0], name="twin"), cats[1]]
    edges = fmsync.synchronize_shapes(twins, n_draws=0, graph="k1", **OPTIONS).edges.tolist()
    assert [0, 1] in edges
    assert all(i < j for i, j in edges)
    assert len(edges) == 2


def test_neighbours_by_spectrum_stay_connected(cats):
    result = fmsync.synchronize_shapes(cats, n_draws=0, graph="k1", **OPTIONS)
    assert 3 <= len(result.edges) < 6


def test_bad_collections_are_refused_by_name(cats):
    with pytest.raises(ValueError, match="at least two"):
        fmsync.synchronize_shapes(cats[:1])
    flipped = Shape(cats[1].vertices * [1, -1, 1], cats[1].faces, "mirror")
    with pytest.raises(ValueError, match="mirror: mirrored or inside out"):
        fmsync.synchronize_shapes([cats[0], flipped], **OPTIONS)
    ball = data_gen.load_collection("cats", count=1, n_vertices=1000)[0]
    plank = Shape(ball.vertices * [9, 1, 1], ball.faces, "plank")
    with pytest.raises(ValueError, match="plank is unlike the rest"):
        fmsync.synchronize_shapes([*cats[:3], plank], **OPTIONS)
    with pytest.raises(ValueError, match="too few"):
        fmsync.synchronize_shapes(cats, n_refined=2000)
    with pytest.raises(ValueError, match="landmarks"):
        fmsync.synchronize_shapes(cats[:2], landmarks=[[1, 2], [1]], **OPTIONS)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"landmarks": [[1, 2], [3.0, 4.5]]}, r"landmarks\[1\]\[1\]: an integer >= 0, got 4.5"),
        (
            {"landmarks": [[1, 2], [3, 1000]]},
            r"landmarks\[1\] \(of cat1\)\[1\] = 1000 is outside the vertices 0\.\.999",
        ),
        ({"landmarks": [[-1, 2], [3, 4]]}, r"landmarks\[0\]\[0\]: an integer >= 0, got -1"),
        ({"landmarks": [[1, 2, 3], [3, 4, 3]]}, r"landmarks\[1\] \(of cat1\)\[2\]: vertex 3 is repeated; remove"),
        ({"landmarks": [range(201)] * 2}, "landmarks: 201 of each shape, but n_samples = 200; raise n_samples"),
        ({"landmarks": [[1, 2]]}, "landmarks: 1 rows for 2 shapes; give one row"),
        ({"n_samples": 11}, "n_basis = 12: lower it to n_refined = 30 and n_samples = 11 at most"),
        ({"n_refined": 11}, "n_basis = 12: lower it to n_refined = 11"),
        ({"n_basis": 12.5}, "n_basis: an integer >= 2, got 12.5"),
        ({"n_refined": -30}, "n_refined: an integer >= 1, got -30"),
        ({"n_samples": 200.5}, "n_samples: an integer >= 1, got 200.5"),
        ({"n_draws": -1}, "n_draws: an integer >= 0, got -1"),
        ({"graph": [(0, 1), (0, 2)]}, r"graph: edge 1 \(0, 2\) is out of range for 2 nodes; give pairs .* 0\.\.1"),
        ({"graph": [(0, 1), (1, 1)]}, r"graph: edge 1 \(1, 1\) is a self-loop; remove it"),
        ({"graph": [(0, 1.5)]}, r"graph\[0\]\[1\]: an integer >= 0, got 1.5"),
        ({"graph": "k0"}, "graph: 'complete', 'k4' or pairs, not 'k0'"),
    ],
)
def test_bad_options_are_refused_before_long_work(cats, monkeypatch, options, said):
    monkeypatch.setattr(synchronize, "sample_shape", lambda *_: pytest.fail("long work began"))
    with pytest.raises(ValueError, match=said):
        fmsync.synchronize_shapes(cats[:2], **OPTIONS | {"n_draws": 0} | options)


def test_equal_names_do_not_hide_which_shape_is_meant(cats, monkeypatch):
    same = [replace(cat, name="cat") for cat in cats]
    plank = Shape(cats[3].vertices * [9, 1, 1], cats[3].faces, "cat")
    with pytest.raises(ValueError, match=r"^cat \(shape 3\) is unlike the rest"):
        fmsync.synchronize_shapes([*same[:3], plank], **OPTIONS)
    turned = Shape(cats[1].vertices, cats[1].faces[:, ::-1], "cat")
    monkeypatch.setattr(synchronize, "sample_shape", lambda *_: pytest.fail("long work began"))
    for shapes in ([same[0], turned, *same[2:]], [*same[2:], same[0], turned]):
        with pytest.raises(ValueError, match=rf"^cat \(shape {shapes.index(turned)}\): mirrored or inside out"):
            fmsync.synchronize_shapes(shapes, **OPTIONS)
    mirrored = {"c_ij": np.eye(2), "distortion": 1.0, "orientation": 1.0, "mirrored_distortion": 0.1}
    monkeypatch.undo()
    monkeypatch.setattr(synchronize, "match", lambda *_: pairwise.PairMatch(**mirrored))
    with pytest.raises(ValueError, match=r"^cat \(shape 0\): maps that turn left into right"):
        fmsync.synchronize_shapes(same[:2], **OPTIONS)


def test_landmarks_are_samples_and_are_met(cats):
    marks = [[5, 400, 900]] * 2
    result = fmsync.synchronize_shapes(cats[:2], n_draws=0, landmarks=marks, **OPTIONS)
    assert result.shapes[0].samples[:3].tolist() == marks[0]
    assert straight_errors(cats[1], result.point_map(0, 1))[marks[0]].max() < 0.2


def test_two_modes_on_planted_flips(synced):
    """Left and right swapped on every third pair: samples that then have two places are flagged, others are not."""
    precision, recall = planted_flips(synced, 0.3)
    assert precision > 0.8
    assert recall > 0.8
    assert planted_flips(synced, 0.0)[1] == 0  # nothing to find


def test_regions_hold_what_they_promise_where_the_model_is_right(synced):
    covered = planted_noise(synced, kappas=(200.0,), seeds=1)["200.0"]
    for level in ("0.5", "0.8", "0.9"):
        assert covered[level] > float(level) - 0.08  # samples are coarse: regions hold more, not less
    assert covered["0.5"] < covered["0.9"]


def test_the_uncertainty_score_grows_with_errors_it_has_not_seen(synced):
    """Maps turned at random by more and more: every turn is an error that no truth is needed to notice."""
    rng, size = np.random.default_rng(0), synced.refined.shape[-1]
    direction = rng.standard_normal((size, size))
    direction = (direction - direction.T) / np.sqrt(size)
    scores = []
    for angle in (0.0, 0.3, 0.6, 1.2):
        refined = synced.refined.copy()
        refined[1] = refined[1] @ fmsync.so.exp(angle * direction)
        scores.append(np.median(replace(synced, refined=refined).confidence(0, 1).uncertainty_score()))
    assert scores == sorted(scores)
    assert 1.5 * scores[0] < scores[2] < scores[3] / 1.5


def test_fullness_is_the_area_nearby_over_that_of_a_plane(synced):
    """Legs and tails are less full than a plane, backs and bellies are not."""
    known, first = synced.confidence(0, 1), synced.shapes[0]
    weights = np.exp(-((first.geodesics / 0.1) ** 2))  # their integral over a plane is π 0.1²
    points, areas = first.shape.vertices, np.zeros(len(first.samples))
    for point, mass in zip(points, first.basis.mass):
        areas[np.linalg.norm(points[first.samples] - point, axis=1).argmin()] += mass
    np.testing.assert_allclose(known.fullness, [(row * areas).sum() / (np.pi * 0.1**2) for row in weights])
    assert np.quantile(known.fullness, 0.1) < 0.8 < np.quantile(known.fullness, 0.9)
    twice = replace(known, fullness=known.fullness / 2)
    np.testing.assert_allclose(twice.region_score(), 2 * known.region_score())
    np.testing.assert_array_equal(twice.uncertainty_score(), known.uncertainty_score())


def test_images_of_one_vertex(synced):
    images = synced.vertex_images(0, 1, 17, count=60)
    assert images.shape == (60,)
    points = synced.shapes[1].shape.vertices
    assert np.median(np.linalg.norm(points[images] - points[17], axis=1)) < 0.15


def test_thin_draws_and_pairs_that_mix_left_and_right_are_flagged(synced):
    rng = np.random.default_rng(0)
    draws = synced.posterior.energy.shape
    apart = replace(synced.posterior, energy=rng.standard_normal(draws) + 5 * np.arange(draws[0])[:, None])
    matches = (replace(synced.matches[0], orientation=0.3), *synced.matches[1:])
    said = " ".join(quality_flags(replace(synced, posterior=apart, matches=matches)))
    assert "R-hat" in said
    assert "do not rely on the regions" in said
    assert "cat0–cat1" in said
    mixed = (*synced.shapes[:3], replace(synced.shapes[3], orientation=None))  # a point cloud among meshes
    (line,) = [x for x in quality_flags(replace(synced, shapes=mixed, matches=matches)) if "left and right apart" in x]
    assert "cat0–cat1" in line


def test_a_mesh_that_is_not_a_manifold(cats):
    fin = len(cats[0].vertices)  # a third triangle on an edge of the first face
    a, b = cats[0].faces[0][:2]
    tip = cats[0].vertices[a] + [0, 0, 0.02]
    torn = Shape(np.vstack([cats[0].vertices, tip]), np.vstack([cats[0].faces, [a, b, fin]]), "fin")
    result = fmsync.synchronize_shapes([torn, cats[1]], n_draws=0, **OPTIONS)
    assert straight_errors(cats[1], result.point_map(0, 1)[:fin]).mean() < 0.06


def test_units_do_not_matter_at_all(cats, synced):
    large = [Shape(1000 * c.vertices + [5e3, 0, 0], c.faces, c.name) for c in cats[:2]]
    scaled = fmsync.synchronize_shapes(large, n_draws=0, **OPTIONS)
    same = fmsync.synchronize_shapes(cats[:2], n_draws=0, **OPTIONS)
    np.testing.assert_array_equal(scaled.point_map(0, 1), same.point_map(0, 1))
    assert scaled.shapes[0].geodesics == pytest.approx(same.shapes[0].geodesics, abs=1e-6)


def test_other_processes_are_sent_the_samples_alone(synced):
    light = synced.shapes[0].light(20)
    again = pairwise.match(light, synced.shapes[1].light(20))
    whole = pairwise.match(
        replace(synced.shapes[0], basis=synced.shapes[0].basis.truncated(20)),
        replace(synced.shapes[1], basis=synced.shapes[1].basis.truncated(20)),
    )
    np.testing.assert_allclose(again.c_ij, whole.c_ij, atol=1e-12)
    assert light.shape.n_vertices == 200


def test_local_distortion_is_none_under_a_copy_and_grows_with_scale(synced):
    """Against the definition, sample by sample: a Gaussian of the distance counts neighbours, another averages."""
    first = synced.shapes[0]
    points, g = first.shape.vertices[first.samples], first.geodesics
    assert local_distortion(first, points) == pytest.approx(0)
    np.testing.assert_allclose(local_distortion(first, 1.3 * points + 1), 0.3, atol=1e-12)
    images = points + 0.02 * np.random.default_rng(0).standard_normal(points.shape)
    change = np.empty(len(points))
    for k in range(len(points)):
        others = np.arange(len(points)) != k
        before, after = (np.linalg.norm(x[k] - x[others], axis=1) for x in (points, images))
        weights = np.exp(-((g[k, others] / 0.1) ** 2))
        change[k] = (weights * abs(after - before)).sum() / (weights * before).sum()
    expected = [np.average(change, weights=np.exp(-((row / 0.15) ** 2))) for row in g]
    np.testing.assert_allclose(local_distortion(first, images), expected, rtol=1e-9)
