"""Values carried across: probabilities and standard deviations that mean something, and the command."""

import numpy as np
import pandas as pd
import pytest

from fmsync.cli import main
from fmsync.matching import load_synced, transfer, transfer_landmarks
from fmsync.matching.conformal import default_calibration
from fmsync.matching.transferred import image_probabilities


def most_likely(carried):
    return carried.labels[carried.mean.argmax(axis=1)]


def test_rings_hold_what_they_were_calibrated_to_hold(synced):
    calibration = default_calibration()
    share = image_probabilities(synced, 1, 0, calibration)
    np.testing.assert_allclose(share.sum(axis=1), 1, atol=1e-12)
    known = synced.confidence(1, 0)
    away = synced.shapes[0].geodesics[known.image]
    for level in calibration.levels:
        inside = away <= calibration.radius(known, level)[:, None]
        assert (share * inside).sum(axis=1).min() >= level - 1e-9
    assert share[away > 2 * calibration.radius(known, 0.98)[:, None]].max() == 0


def test_labels_get_probabilities(synced, cats):
    parts = np.digitize(cats[0].vertices[:, 0], [-0.3, 0.0, 0.3])  # of the resting body, in the common order
    words = np.array(["tail", "rump", "chest", "head"])[parts]
    found = transfer(synced, 0, words)
    assert found[0].labels.tolist() == ["chest", "head", "rump", "tail"]
    np.testing.assert_array_equal(most_likely(found[0]), words)
    for carried in found:
        assert carried.mean.shape == (1000, 4)
        np.testing.assert_allclose(carried.mean.sum(axis=1), 1, atol=1e-9)
        np.testing.assert_allclose(carried.std, np.sqrt(np.maximum(carried.mean * (1 - carried.mean), 0)), atol=1e-6)
    right = np.concatenate([most_likely(carried) == words for carried in found[1:]])
    believed = np.concatenate([carried.mean.max(axis=1) for carried in found[1:]])
    assert right.mean() > 0.85
    assert abs(right.mean() - believed.mean()) < 0.1
    assert right[believed > 0.9].mean() > right[believed < 0.7].mean()
    np.testing.assert_array_equal(transfer(synced, 0, parts == 2)[1].labels, [False, True])


def test_functions_get_a_mean_and_a_standard_deviation(synced):
    place = synced.shapes[2].shape.vertices
    found = transfer(synced, 2, place)
    np.testing.assert_array_equal(found[2].mean, place)
    assert found[2].std.max() == 0
    for j in (0, 1, 3):
        error = np.abs(found[j].mean - place)
        assert found[j].labels is None
        assert error.mean() < 0.04
        assert (error <= found[j].std).mean() > 0.5
        assert (error <= 2 * found[j].std + 1e-9).mean() > 0.8
    flat = transfer(synced, 2, np.full(1000, 3.5))[0]
    np.testing.assert_allclose(flat.mean, 3.5)
    assert flat.std.max() < 1e-6


def test_landmarks_get_images_and_radii(synced):
    found = transfer_landmarks(synced, 1, [3, 500])
    assert found[1][0].tolist() == [3, 500]
    np.testing.assert_array_equal(found[0][0], synced.point_map(1, 0)[[3, 500]])
    assert (found[0][1] >= 0).all()


def test_values_that_do_not_fit_are_refused(synced):
    for values, said in (
        (np.zeros(5), r"values: \(5,\) for the 1000 vertices of cat0"),
        (np.zeros((1000, 2), int), r"\(1000, 2\)"),
        (np.zeros((1000, 2, 2)), r"\(1000, 2, 2\)"),
        (np.where(np.arange(1000) == 7, np.nan, 0.5), "vertex 7 is NaN"),
    ):
        with pytest.raises(ValueError, match=said):
            transfer(synced, 0, values)
    with pytest.raises(ValueError, match=r"i: 4 is outside 0\.\.3"):
        transfer(synced, 4, np.zeros(1000))
    with pytest.raises(ValueError, match="outside the vertices"):
        transfer_landmarks(synced, 0, [1000])


def test_what_the_command_left_is_read_again(written):
    again = load_synced(written.folder)
    for i, j in ((0, 1), (2, 0)):
        image = np.load(written.folder / "point_maps" / f"cat{i}_to_cat{j}.npy")
        np.testing.assert_array_equal(again.point_map(i, j), image)
    table = pd.read_csv(written.folder / "point_maps" / "cat1_to_cat2.csv")
    known = again.confidence(1, 2)
    samples = again.shapes[1].samples
    np.testing.assert_allclose(np.median(known.radius), np.median(table["radius"][samples]), atol=0.01)
    np.testing.assert_allclose(default_calibration().radius(known), table["region"][samples], rtol=0.02, atol=0.01)


def test_the_command_carries_a_table(written, tmp_path, capsys):
    values, out = tmp_path / "values.csv", tmp_path / "carried"
    v = np.arange(1000)
    pd.DataFrame({"part": np.where(v < 500, "low", "high"), "number": v // 100, "height": v / 1000}).to_csv(values)
    command = ["transfer", str(written.folder), str(values), "--on", "cat1", "-o", str(out)]
    pd.DataFrame({"part": np.where(v < 500, "low", "high"), "height": v / 1000}).to_csv(values, index=False)
    assert main(command) == 0
    assert {path.name for path in out.iterdir()} == {"cat0.csv", "cat2.csv"}
    table = pd.read_csv(out / "cat2.csv")
    assert list(table) == ["part", "part_probability", "height", "height_std"]
    assert len(table) == 1000
    assert set(table["part"]) == {"low", "high"}
    assert table["part_probability"].between(0.5, 1.0001).all()
    assert "a table for each of 2 shapes" in capsys.readouterr().out
    pd.DataFrame({"vertex": [4, 70]}).to_csv(values, index=False)
    assert main([*command[:-1], str(tmp_path / "marks")]) == 0
    assert list(pd.read_csv(tmp_path / "marks" / "cat0.csv")) == ["vertex", "image", "region"]


def test_the_command_refuses_in_one_line_and_leaves_nothing(written, tmp_path, capsys):
    values, out, empty = tmp_path / "values.csv", tmp_path / "out", tmp_path / "empty"
    pd.DataFrame({"height": np.zeros(7)}).to_csv(values, index=False)
    damaged = tmp_path / "damaged"
    damaged.mkdir()
    (damaged / "maps.npz").write_bytes((written.folder / "maps.npz").read_bytes()[:5000])
    empty.write_text("")
    for folder, table, more, said in (
        (written.folder, values, (), "for the 1000 vertices of cat0"),
        (written.folder, values, ("--on", "dog"), "--on: 'dog' is none of the shapes cat0, cat1, cat2"),
        (written.folder, empty, (), "empty: cannot be read as a table"),
        (written.folder, tmp_path / "none.csv", (), "none.csv: cannot be read as a table"),
        (tmp_path, values, (), "name a folder that fmsync sync has written"),
        (damaged, values, (), "damaged, or of another version"),
    ):
        assert main(["transfer", str(folder), str(table), "-o", str(out), *more]) == 2
        told = capsys.readouterr().err
        assert said in told
        assert told.count("\n") == 1
        assert not out.exists()
