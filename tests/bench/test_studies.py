"""The stand-alone studies, each in its smallest size: they run, and their results have the parts that pages read."""

import json
import warnings
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest

import data_gen
import fmsync
from bench import calibration_coverage, prior_coverage, studies
from bench.own_shapes import __main__ as own_shapes
from bench.own_shapes import confidence, matching, outliers, species, stages

OPTIONS = {"n_basis": 10, "n_refined": 30, "n_samples": 120, "n_draws": 40}


@pytest.fixture(scope="module")
def cats():
    return data_gen.load_collection("cats", count=3, n_vertices=1000)


@pytest.fixture(scope="module")
def observed(cats):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # few draws
        return confidence.observe(cats, **OPTIONS)


def test_a_part_is_added_to_a_file_and_the_others_stay(tmp_path):
    path = tmp_path / "deep" / "found.json"
    studies.add_part(path, "one", {"a": 1}, "first")
    studies.add_part(path, "two", {"b": 2}, "second")
    studies.add_part(path, "one", {"a": 3}, "third")
    found = json.loads(path.read_text(encoding="utf-8"))
    assert found["one"].items() >= {"a": 3, "command": "third"}.items()
    assert found["two"]["b"] == 2
    assert list(path.parent.iterdir()) == [path]


def test_coverage_runs_what_is_missing_and_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr(calibration_coverage, "CASES", [("langevin", 8.0, "langevin"), ("langevin", 8.0, "beta = 1")])
    real = calibration_coverage.one
    monkeypatch.setattr(calibration_coverage, "one", lambda *case: real(*case, n=3, n_draws=20))
    calibration_coverage.main(["--problems", "2", "--jobs", "1", "--results", str(tmp_path)])
    rows = pd.read_csv(tmp_path / "calibration_problems.csv")
    assert rows.model.tolist() == ["langevin", "beta = 1", "langevin"]  # wrong models get every fourth problem
    assert rows.covered_95.between(0, 1).all()
    calibration_coverage.main(["--problems", "2", "--jobs", "1", "--results", str(tmp_path)])
    assert len(pd.read_csv(tmp_path / "calibration_problems.csv")) == 3
    table = pd.read_csv(tmp_path / "calibration_coverage.csv")
    assert table.problems.tolist() == [1, 2]
    assert {"0.5", "se 0.5", "ess", "cpu_hours"} <= set(table.columns)


def test_coverage_under_the_prior_goes_on_and_pools_its_settings(tmp_path, monkeypatch):
    monkeypatch.setattr(prior_coverage, "_EFFECTIVE", 100)
    monkeypatch.setattr(prior_coverage, "_DRAWS", 25)
    for problems, lines in ((1, 4), (3, 7), (3, 7)):  # not every setting takes part in every problem
        prior_coverage.main(["--problems", str(problems), "--results", str(tmp_path)])
        assert len(pd.read_csv(tmp_path / "prior_coverage_problems.csv")) == lines
    found = json.loads((tmp_path / "prior_coverage.json").read_text(encoding="utf-8"))["drawn"]
    pooled = found["settings"]["all"]
    assert pooled["problems"] + pooled["passed over"] == 7
    assert 0 <= pooled["0.5"] <= pooled["0.95"] <= 1
    assert found["command"] == "python -m bench.prior_coverage"


def test_ranks_and_coverage_of_uniform_levels_stay_within_their_bands():
    rng, count = np.random.default_rng(1), 2000
    level = rng.random(count)
    line = {"setting": "Langevin, n = 3", "ess": 1000.0}
    rows = pd.DataFrame({**dict.fromkeys(("rank_level", "rank_energy", "rank_entry"), level), **line})
    for q, column in calibration_coverage.COVERED.items():
        rows[column] = (level <= q).astype(float)
    right = prior_coverage.table(rows)["all"]
    wrong = prior_coverage.table(rows.assign(rank_level=level**1.3))["all"]
    assert abs(right["0.8"] - 0.8) < 5 * right["se 0.8"]
    assert right["ranks"]["level"] < 1.5 * right["band"] < wrong["ranks"]["level"]
    assert abs(right["se 0.8"] - 0.4 / np.sqrt(count)) < 0.001


def test_evaluation_knows_the_right_images(observed):
    vertices = observed.evaluation.vertices
    assert observed.evaluation.distances[1].shape == (80, 1000)
    assert np.abs(observed.evaluation.distances[1][np.arange(80), vertices[1]]).max() < 0.02
    assert np.mean(observed.errors) < 0.08


def test_regions_hold_more_where_they_promise_more(observed):
    for calibration in (
        None,
        confidence.default_calibration(),
        confidence.fit_conformal(observed.known, observed.errors),
    ):
        covered = list(observed.covered(calibration).values())
        assert covered == sorted(covered)
    exact = (np.concatenate(observed.errors) < 1e-9).mean()  # images that every region holds
    assert np.abs(np.array(covered) - np.maximum(confidence.LEVELS, exact)).max() < 0.02  # on what it was fitted on


def test_risk_falls_the_most_for_who_knows_the_errors(observed):
    found = confidence.risk_coverage(observed, confidence.default_calibration())
    assert list(found) == ["kept", "curve", "area"]
    assert all(curve[0] == pytest.approx(1) for curve in found["curve"].values())
    assert min(found["area"], key=found["area"].get) == "oracle"


def test_stages_have_errors_and_seconds(observed):
    pytest.importorskip("pyFM")
    found = stages.stages(observed.synced, observed.evaluation, peers=True)
    errors = found["mean_geodesic_error"]
    assert errors["pipeline (refined together to 30)"] < errors["pairwise (with its own ZoomOut)"] + 0.02
    assert set(found["cpu_seconds"]) >= {"synchronised maps proposed to the pairs", "refined together to 30"}
    assert "pyFM Consistent ZoomOut to 30 from our pairwise maps" in errors
    change = found["mean_change_of_distances"]
    assert 0 < change["true maps"] < 0.1 > change["ours"] > 0
    own = observed.evaluation.vertices[0]
    assert observed.evaluation.change(0, 0, own) == pytest.approx(0, abs=1e-9)


def test_copies_have_vertices_of_their_own(cats):
    vertices = stages.evaluation_vertices(cats, 5)
    copies, moved = stages.decimated(cats, vertices)
    assert len({copy.n_vertices for copy in copies}) == 3
    for shape, copy, old, new in zip(cats, copies, vertices, moved):
        apart = np.linalg.norm(shape.vertices[old] - copy.vertices[new], axis=1) / np.sqrt(shape.area)
        assert apart.max() < 0.1


def test_points_of_a_species_are_kept_and_read_again(tmp_path, monkeypatch, observed):
    monkeypatch.setattr(species, "species", lambda number: None)
    monkeypatch.setattr(species, "observe", lambda shapes, **options: observed)
    monkeypatch.setattr(species, "kept_results", partial(studies.kept_results, jobs=1))
    rows = species.all_points([7], tmp_path)
    assert list(rows) == ["pair", "score", "fullness", "error", "species"]
    assert len(rows) == sum(map(len, observed.errors))
    monkeypatch.setattr(species, "observe", None)
    pd.testing.assert_frame_equal(species.all_points([7], tmp_path), rows)


def test_species_left_out_are_covered_as_promised():
    rng, count = np.random.default_rng(0), 200
    number = np.repeat(np.arange(count), 60)
    score, fullness = rng.random((2, len(number))) + 0.1
    error = np.exp(rng.standard_normal(count))[number] * score / fullness * rng.exponential(size=len(number))
    rows = pd.DataFrame({"species": number, "pair": np.arange(len(number)) // 20 % 3, "score": score, "error": error})
    rows["fullness"] = fullness
    for q, found in species.summary(species.left_out(rows)).items():
        assert abs(found["mean"] - float(q)) < 5 * found["se"]
        assert found["least"] < float(q)


def test_every_part_of_the_command_writes_its_results(tmp_path, monkeypatch, cats):
    monkeypatch.setattr(own_shapes, "load_collection", lambda name: cats)
    monkeypatch.setitem(own_shapes.PARTS, "planted", lambda loaded: {name: len(one) for name, one in loaded.items()})
    own_shapes.main(["planted", "some/cats", "--out", str(tmp_path / "found.json")])
    found = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))
    assert found["planted"]["cats"] == 3
    assert found["planted"]["command"] == "python -m bench.own_shapes planted cats"


def test_half_a_body_is_a_mesh_in_one_piece(cats):
    half = outliers.half(cats[0])
    assert half.area == pytest.approx(cats[0].area / 2, rel=0.3)
    edges, count = np.unique(fmsync.shape.edges_of_faces(half.faces), axis=0, return_counts=True)
    assert 1 in count  # a rim
    assert len(np.unique(edges)) == half.n_vertices
    assert len(fmsync.laplace_beltrami(half.vertices, half.faces, 10).eigenvalues) == 10  # which refuses pieces


def test_rates_of_outliers_are_those_of_the_folders(monkeypatch, tmp_path):
    """Every folder has six of one kind, a stranger that is found in half of the folders, and a sphere."""

    def planted(number):
        apart = 0.01 * (1 - np.eye(8))
        far = apart.copy()
        far[6, :6] = far[:6, 6] = 0.2 * (number % 2)
        apart[7, :7] = apart[:7, 7] = 1.0
        return {"kinds": np.array(["own"] * 6 + ["cat", "sphere"]), "spectra": apart, "both": far[:7, :7]}

    monkeypatch.setattr(outliers, "distances", planted)
    monkeypatch.setattr(outliers, "kept_results", partial(studies.kept_results, jobs=1))
    found = outliers.table(tmp_path)
    assert set(found) == {"development", "test"}
    test = found["test"]
    assert test["found"]["mean"] == 0.75
    assert test["found"]["se"] == pytest.approx(0.25 / np.sqrt(31))
    assert test["found of cat"] == {"mean": 0.5, "se": pytest.approx(0.5 / np.sqrt(31)), "shapes": 32, "folders": 32}
    assert test["false alarms"] == {"mean": 0.0, "se": 0.0, "shapes": 192, "folders": 32}
    assert test["false alarms without outliers"]["shapes"] == 192


@pytest.fixture(scope="module")
def creatures():
    return data_gen.load_collection("creatures", species=2, count=3, n_vertices=1000, remeshed=True)


def test_a_creature_with_holes_is_one_piece_that_knows_what_is_left(creatures):
    whole, rng = creatures[0], np.random.default_rng(0)
    cut = matching.with_holes(whole, rng)
    assert cut.area == pytest.approx(0.95 * whole.area, rel=0.005)
    edges, count = np.unique(fmsync.shape.edges_of_faces(cut.faces), axis=0, return_counts=True)
    assert set(count) == {1, 2}
    assert len(np.unique(edges)) == cut.n_vertices == len(cut.common) == len(cut.opposite) == len(cut.part)
    assert len(fmsync.laplace_beltrami(cut.vertices, cut.faces, 10).eigenvalues) == 10  # which refuses pieces
    np.testing.assert_array_equal(cut.located[cut.common], np.arange(cut.n_vertices))
    there = cut.located >= 0
    np.testing.assert_array_equal(cut.vertices[cut.located[there]], whole.vertices[whole.located[there]])
    assert 0.9 < there.mean() < 1


def test_errors_are_measured_where_all_shapes_have_the_point_and_its_opposite(creatures):
    rng = np.random.default_rng(0)
    cut = [matching.with_holes(shape, rng) for shape in creatures]
    for vertices in matching.evaluated(cut):
        assert vertices.shape == (3, 80)
        assert vertices.min() >= 0
    own, other = matching.evaluated(creatures)  # without holes, to look points up
    for shape, here, there in zip(creatures, own, other):
        np.testing.assert_array_equal(there, shape.located[shape.opposite[here]])


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_a_stretched_skin_moves_by_a_hundredth_of_the_root_of_the_area(creatures, scale):
    whole = replace(creatures[0], vertices=scale * creatures[0].vertices)
    away = matching.stretched(whole, np.random.default_rng(0)).vertices - whole.vertices
    share = fmsync.laplace_beltrami(whole.vertices, whole.faces, 2).mass
    assert np.sqrt(share @ (away**2).sum(axis=1) / whole.area) == pytest.approx(0.01)


def test_noise_is_a_fifth_of_an_edge_along_the_normals(creatures):
    noisy = matching.noisy(creatures[0], np.random.default_rng(0))
    ends = creatures[0].vertices[fmsync.shape.edges_of_faces(creatures[0].faces)]
    edge = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean()
    away = np.linalg.norm(noisy.vertices - creatures[0].vertices, axis=1)
    assert np.sqrt((away**2).mean()) == pytest.approx(0.2 * edge, rel=0.1)
    np.testing.assert_array_equal(noisy.faces, creatures[0].faces)


def test_a_run_of_the_suite_sees_errors_regions_and_warnings(monkeypatch, creatures):
    pytest.importorskip("pyFM")
    monkeypatch.setattr(matching, "load_collection", lambda *_, **__: creatures)
    monkeypatch.setattr(matching, "observe", partial(confidence.observe, **(OPTIONS | {"n_refined": 40})))
    found = matching.run((2, "noise"))
    errors = found["errors"]
    assert min(errors, key=errors.get) == "bound"
    assert errors["ours"] < 0.2
    assert set(found["cpu_seconds"]) == set(errors) - {"bound", "ours from the true first 50"}
    assert {"all", "limb", "trunk", "surer half", "surer half of the oracle"} <= set(found["regions"])
    assert {kind for kind, _ in found["said"]} >= {*matching.SAID, "given up", "two candidate places"}
    assert found["said"]["given up", "wrong"][:, 1].sum() == 3
    assert found["said"]["unlike the rest", "wrong"][:, 1].sum() == 3
    assert found["said"]["few effective draws", "regions fail"][:, 0].sum() == 1  # forty are


def test_the_suite_names_what_was_refused_and_sums_warnings(monkeypatch, tmp_path):
    def planted(task):
        number, _ = task
        if task == (3, "noise"):
            return {"refused": "mirrored"}
        errors = {"bound": 0.1, "ours": 0.1 * (1 + number)}
        said = {("given up", "wrong"): np.array([[1, 2], [number, 4]])}
        return {"errors": errors, "cpu_seconds": {"ours": 1.0}, "regions": {"all": 0.9}, "said": said}

    monkeypatch.setattr(matching, "run", planted)
    monkeypatch.setattr(matching, "kept_results", partial(studies.kept_results, jobs=1))
    found = matching.table(tmp_path, range(4))
    assert found["refused"] == {"species 3, noise": "mirrored"}
    assert list(found["errors"]) == list(matching.VARIANTS)
    ours = found["errors"]["holes"]["ours"]
    assert ours["median"] == pytest.approx(0.25)
    assert ours["largest ratio to the bound"] == pytest.approx(4)
    assert ours["species of the largest"] == 3
    assert found["errors"]["noise"]["ours"]["median ratio to the bound"] == pytest.approx(2)
    assert found["regions"]["noise"]["all"] == {"mean": pytest.approx(0.9), "se": pytest.approx(0, abs=1e-9)}
    assert found["warnings"]["given up: wrong"] == {"with the fault": [19, 38], "without": [27, 76]}
    assert len(found["runs"]) == 19
    json.dumps(found)
