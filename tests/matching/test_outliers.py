"""Shapes that do not belong: named before and after pairs are matched, or left out as if they had not been given."""

import json
import warnings

import numpy as np
import pytest

import data_gen
import fmsync
from fmsync.cli import main
from fmsync.matching import outliers, synchronize
from fmsync.matching.outliers import OutlierWarning, among, groups
from fmsync.matching.report import quality_flags
from fmsync.shape import Shape
from tests.matching.conftest import write_off

FULL = {"n_basis": 10, "n_refined": 50, "n_samples": 300, "n_draws": 0, "rng": 0}  # distortions are looked at


@pytest.fixture(scope="module")
def own():
    return data_gen.load_collection("creatures", species=8, count=3, n_vertices=1000)


@pytest.fixture(scope="module")
def strangers():
    """Another species, whose spectra alone do not tell."""
    other = data_gen.load_collection("creatures", species=7, count=3, n_vertices=1000)
    return [Shape(s.vertices, s.faces, f"stranger{k}") for k, s in enumerate(other)]


@pytest.fixture(scope="module")
def plank(own):
    return Shape(own[0].vertices * [9, 1, 1], own[0].faces, "plank")


@pytest.mark.parametrize("seed", range(5))
def test_planted_groups_are_found_in_any_order(seed):
    rng = np.random.default_rng(seed)
    kinds = rng.permutation(np.repeat([0, 1, 2], [5, 2, 1]))
    apart = np.where(kinds[:, None] == kinds, rng.uniform(0.1, 0.5, (8, 8)), rng.uniform(1.5, 3, (8, 8)))
    found = groups((apart + apart.T) / 2, 1.0)
    assert found == [np.flatnonzero(kinds == k).tolist() for k in range(3)]
    path = np.column_stack([found[0][:-1], found[0][1:]])
    kept, edges = among(np.array(found[0]), np.vstack([[found[0][0], found[1][0]], path]))
    assert kept.tolist() == [1, 2, 3, 4]
    assert edges.tolist() == [[0, 1], [1, 2], [2, 3], [3, 4]]
    with pytest.raises(ValueError, match="the graph falls into 2 components"):
        among(np.array([0, 2, 3]), np.array([[0, 1], [1, 2], [0, 3]]))


def test_an_outlier_is_named_or_left_out_as_if_it_had_not_been_given(own, strangers):
    spectra = outliers.spectral_distances([synchronize.sample_shape(s, 50, 300, 10, None) for s in [*own, *strangers]])
    assert len(groups(spectra, outliers.SPECTRUM)) == 1
    alone = fmsync.synchronize_shapes(own, **FULL)
    assert alone.outliers == ()
    mixed = [own[0], strangers[0], *own[1:]]
    with pytest.warns(OutlierWarning, match="^stranger0 is unlike the rest"):
        named = fmsync.synchronize_shapes(mixed, **FULL)
    assert named.outliers == ("stranger0",)
    assert len(named.shapes) == 4
    assert any(flag.startswith("Unlike the rest and doubtful") for flag in quality_flags(named))
    with warnings.catch_warnings():
        warnings.simplefilter("error", OutlierWarning)
        dropped = fmsync.synchronize_shapes(mixed, drop_outliers=True, **FULL)
    assert dropped.names == alone.names
    assert dropped.outliers == ("stranger0",)
    np.testing.assert_array_equal(dropped.refined, alone.refined)
    assert "Unlike the rest and left out: stranger0." in quality_flags(dropped)


def test_what_spectra_tell_is_said_before_pairs_are_matched(own, plank, monkeypatch):
    """A plank is refused if nobody says what to do, and does not disturb maps that are given."""
    monkeypatch.setattr(synchronize, "match", lambda *_: pytest.fail("long work began"))
    with pytest.raises(ValueError, match="^plank is unlike the rest"):
        fmsync.synchronize_shapes([plank, *own], **FULL)
    maps = {(i, j): np.arange(1000) for i in range(4) for j in range(4) if i != j}
    found = fmsync.synchronize_shapes([plank, *own], maps=maps, drop_outliers=True, **FULL)
    alone = fmsync.synchronize_shapes(own, maps={(i, j): m for (i, j), m in maps.items() if max(i, j) < 3}, **FULL)
    assert found.outliers == ("plank",)
    np.testing.assert_array_equal(found.refined, alone.refined)
    monkeypatch.setattr(outliers, "_HOPELESS", np.inf)

    def begins(*_):
        raise OSError("long work")

    monkeypatch.setattr(synchronize, "match", begins)
    with pytest.warns(OutlierWarning, match="^plank is unlike the rest"), pytest.raises(OSError, match="long work"):
        fmsync.synchronize_shapes([plank, *own], **FULL)


def test_two_groups_of_one_size_are_two_kinds(own, strangers):
    mixed = [*own[:2], *strangers[:2]]
    with pytest.warns(OutlierWarning, match=r"2 kinds, creature0, creature1 \| stranger0, stranger1"):
        fmsync.synchronize_shapes(mixed, **FULL)
    with pytest.raises(ValueError, match="2 kinds"):
        fmsync.synchronize_shapes(mixed, drop_outliers=True, **FULL)


def test_a_graph_of_neighbours_tells_outliers_too(own, strangers):
    with pytest.warns(OutlierWarning, match="^stranger0 is unlike the rest"):
        fmsync.synchronize_shapes([*own, strangers[0]], graph="k2", **FULL)


def test_the_command_leaves_outliers_out(own, plank, tmp_path, capsys):
    files = [str(write_off(tmp_path / f"{s.name}.off", s.vertices, s.faces)) for s in [plank, *own[:2]]]
    quick = ["--basis", "10", "--refined", "20", "--samples", "120", "--draws", "40", "--jobs", "1", "--json"]
    assert main(["sync", *files, "-o", str(tmp_path / "out"), "--drop-outliers", "--fast", *quick]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["left_out"] == summary["outliers"] == ["plank"]
    assert [shape["file"] for shape in summary["shapes"]] == files[1:]
    assert "left out: plank" in (tmp_path / "out" / "report.html").read_text()
    loaded = fmsync.matching.load_synced(tmp_path / "out")
    assert loaded.outliers == ("plank",)
