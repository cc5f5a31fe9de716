"""The command: what it leaves behind, and what it says when it cannot."""

import numpy as np
import pytest

import data_gen
from fmsync.cli import main
from fmsync.pipeline.reading import read_mesh

QUICK = ["--basis", "10", "--refined", "20", "--samples", "120", "--draws", "40", "--jobs", "1"]


def write_off(path, vertices, faces):
    with path.open("w") as stream:
        stream.write(f"OFF\n{len(vertices)} {len(faces)} 0\n")
        np.savetxt(stream, vertices, fmt="%.9g")
        np.savetxt(stream, np.column_stack([np.full(len(faces), 3), faces]), fmt="%d")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("meshes")
    for shape in data_gen.load_collection("cats", count=3, n_vertices=1000):
        write_off(place / f"{shape.name}.off", shape.vertices, shape.faces)
    return place


def test_everything_is_written(folder, tmp_path):
    import pyvista as pv

    out = tmp_path / "out"
    assert main(["sync", str(folder), "-o", str(out), *QUICK]) == 0
    image = np.load(out / "point_maps" / "cat1_to_cat0.npy")
    assert image.shape == (1000,)
    vtp = pv.read(out / "meshes" / "cat2.vtp")
    assert vtp.n_points == 1000
    assert {"radius", "spread", "entropy", "two_modes"} <= set(vtp.point_data)
    header, _, body = (out / "meshes" / "cat2.ply").read_bytes().partition(b"end_header\n")
    assert b"property float quality" in header
    rows = np.frombuffer(body, dtype="<f4", count=5 * 1000).reshape(1000, 5)  # x, y, z, quality, spread
    np.testing.assert_allclose(rows[:, :3], vtp.points, rtol=1e-6)
    np.testing.assert_array_equal(rows[:, 3], vtp["radius"])
    assert len(read_mesh(out / "meshes" / "cat2.ply").faces) == vtp.n_cells
    with np.load(out / "maps.npz") as maps:
        assert maps["refined"].shape == (3, 20, 20)
        assert maps["draws"].shape == (40, 3, 10, 10)
    page = (out / "report.html").read_text()
    assert "Correspondences of 3 shapes" in page
    assert 'src="http' not in page
    assert not (tmp_path / "out.partial").exists()


def refused(capsys, *arguments) -> str:
    assert main(["sync", *map(str, arguments), *QUICK]) == 2
    return capsys.readouterr().err


def test_bad_input_ends_with_status_two_and_leaves_nothing(folder, tmp_path, capsys):
    good, out = folder / "cat0.off", tmp_path / "out"
    shape = read_mesh(good)
    empty, torn = tmp_path / "empty.off", tmp_path / "torn.off"
    empty.write_text("")
    torn.write_text("OFF\n5 3 0\n0 0 0\n1 0")
    twice = np.concatenate([shape.vertices, shape.vertices + 5])
    split = write_off(tmp_path / "split.off", twice, np.concatenate([shape.faces, shape.faces + 1000]))
    mirror = write_off(tmp_path / "mirror.off", shape.vertices * [1, -1, 1], shape.faces)
    full = tmp_path / "full"
    full.mkdir()
    (full / "kept.txt").write_text("mine")
    assert "torn.off" in refused(capsys, good, torn, "-o", out)
    assert "empty" in refused(capsys, good, empty, "-o", out)
    assert "no such file" in refused(capsys, good, tmp_path / "missing.off", "-o", out)
    assert "components" in refused(capsys, good, split, "-o", out)
    assert "at least two" in refused(capsys, good, "-o", out)
    assert "mirrored" in refused(capsys, good, mirror, "-o", out)
    assert "not empty" in refused(capsys, folder, "-o", full)
    assert not out.exists()
    assert not (tmp_path / "out.partial").exists()
    assert (full / "kept.txt").read_text() == "mine"
