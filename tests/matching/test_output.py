"""The folder that ``fmsync sync`` leaves: what its files hold, and that a collection comes back from it."""

import numpy as np
import pandas as pd
import pytest

from fmsync.matching import output
from fmsync.matching.conformal import default_calibration
from fmsync.mesh_io import read_shape


@pytest.fixture(scope="module")
def folder(synced, tmp_path_factory):
    path = tmp_path_factory.mktemp("matched")
    output.write_all(synced, path, 0.9, default_calibration(), jobs=1, progress=False)
    return path


def test_every_ordered_pair_has_a_point_map(synced, folder):
    names = synced.names
    files = {f"{a}_to_{b}.{kind}" for a in names for b in names if a != b for kind in ("npy", "csv")}
    assert {file.name for file in (folder / "point_maps").iterdir()} == files
    images = np.load(folder / "point_maps" / f"{names[0]}_to_{names[2]}.npy")
    np.testing.assert_array_equal(images, synced.point_map(0, 2))
    table = pd.read_csv(folder / "point_maps" / f"{names[0]}_to_{names[2]}.csv", index_col="vertex")
    np.testing.assert_array_equal(table["image"], images)
    assert (table["region"] > 0).all()


def test_edges_tell_the_consistency_of_every_pair(synced, folder):
    edges = pd.read_csv(folder / "edges.csv")
    assert len(edges) == len(synced.edges)
    assert edges["first"].tolist() == [synced.names[i] for i in synced.edges[:, 0]]
    residual = np.linalg.norm(synced.estimate.relative() - synced.problem.maps, axis=(1, 2))
    np.testing.assert_allclose(edges["residual"], residual, rtol=1e-3)


def test_meshes_are_read_back(synced, folder):
    shape = synced.shapes[1].shape
    found = read_shape(folder / "meshes" / f"{shape.name}.ply")
    np.testing.assert_allclose(found.vertices, shape.vertices, atol=1e-5 * np.ptp(shape.vertices))
    np.testing.assert_array_equal(found.faces, shape.faces)


def test_threads_change_no_file_but_the_order_in_which_it_is_written(synced, folder, tmp_path):
    output.write_all(synced, tmp_path, 0.9, default_calibration(), jobs=2, progress=False)
    for name in ("report.html", "edges.csv", "point_maps/cat0_to_cat2.csv"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes(), name


def test_the_collection_comes_back(synced, folder):
    again = output.load_synced(folder)
    assert again.names == synced.names
    np.testing.assert_array_equal(again.edges, synced.edges)
    np.testing.assert_allclose(again.functional_map(0, 3), synced.functional_map(0, 3))
    np.testing.assert_allclose(again.posterior.absolute, synced.posterior.absolute, atol=1e-6)
    np.testing.assert_array_equal(again.point_map(0, 2), synced.point_map(0, 2))


def test_a_damaged_or_missing_archive_is_refused(folder, tmp_path):
    with pytest.raises(ValueError, match="maps.npz: there is no such file"):
        output.load_synced(tmp_path)
    (tmp_path / "maps.npz").write_bytes((folder / "maps.npz").read_bytes()[:1000])
    with pytest.raises(ValueError, match="damaged, or of another version"):
        output.load_synced(tmp_path)
