"""The command: what it leaves behind, and what it says when it cannot."""

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from fmsync.cli import main
from fmsync.matching import conformal
from fmsync.mesh_io import read_shape
from tests.matching.conftest import QUICK, write_off


def test_everything_is_written(written):
    import pyvista as pv

    out = written.folder
    image = np.load(out / "point_maps" / "cat1_to_cat0.npy")
    assert image.shape == (1000,)
    vtp = pv.read(out / "meshes" / "cat2.vtp")
    assert vtp.n_points == 1000
    assert {"region", "expected", "radius", "spread", "entropy", "two_modes"} <= set(vtp.point_data)
    header, _, body = (out / "meshes" / "cat2.ply").read_bytes().partition(b"end_header\n")
    assert b"property float quality" in header
    rows = np.frombuffer(body, dtype="<f4", count=5 * 1000).reshape(1000, 5)  # x, y, z, quality, spread
    np.testing.assert_allclose(rows[:, :3], vtp.points, rtol=1e-6)
    np.testing.assert_array_equal(rows[:, 3], vtp["region"])
    assert len(read_shape(out / "meshes" / "cat2.ply").faces) == vtp.n_cells
    with np.load(out / "maps.npz") as maps:
        assert maps["refined"].shape == (3, 18, 20)
        assert maps["draws"].shape == (40, 3, 10, 10)
    assert not out.with_name("out.partial").exists()


def test_thin_draws_are_said_in_plain_words_everywhere(written):
    page, words = (written.folder / "report.html").read_text(), (written.folder / "README.txt").read_text()
    for said in (written.said, page, words):
        assert "the regions are rough; ask for more draws" in said
    assert "warnings.warn" not in written.said
    assert "%|" not in written.said  # bars are for terminals
    assert "synthetic cats" in page  # what the regions were learnt from


def test_the_report_reaches_every_pair_and_asks_for_nothing(written):
    page = (written.folder / "report.html").read_text()
    data = json.loads(page.split('id="data">')[1].split("</script>")[0])
    assert set(data["pairs"]) == {f"{i},{j}" for i, j in itertools.permutations(range(3), 2)}
    assert "http" not in page
    assert "Correspondences of 3 shapes" in page


def refused(capsys, *arguments) -> str:
    assert main(["sync", *map(str, arguments), *QUICK]) == 2
    return capsys.readouterr().err


def test_bad_input_ends_with_status_two_and_leaves_nothing(folder, tmp_path, capsys):
    good, out = folder / "cat0.off", tmp_path / "out"
    shape = read_shape(good)
    empty, torn = tmp_path / "empty.off", tmp_path / "torn.off"
    empty.write_text("")
    torn.write_text("OFF\n5 3 0\n0 0 0\n1 0")
    twice = np.concatenate([shape.vertices, shape.vertices + 5])
    split = write_off(tmp_path / "split.off", twice, np.concatenate([shape.faces, shape.faces + 1000]))
    mirror = write_off(tmp_path / "mirror.off", shape.vertices * [1, -1, 1], shape.faces)
    plank = write_off(tmp_path / "plank.off", shape.vertices * [9, 1, 1], shape.faces)
    full = tmp_path / "full"
    full.mkdir()
    (full / "kept.txt").write_text("mine")
    assert "torn.off" in refused(capsys, good, torn, "-o", out)
    assert "empty" in refused(capsys, good, empty, "-o", out)
    assert "no such file" in refused(capsys, good, tmp_path / "missing.off", "-o", out)
    assert "split.off: 2 components, the largest with 50%" in refused(capsys, good, split, "-o", out)
    assert "at least two" in refused(capsys, good, "-o", out)
    assert "mirror: mirrored or inside out" in refused(capsys, good, mirror, "-o", out)
    said = refused(capsys, folder, plank, "-o", out)
    assert "plank is unlike the rest" in said
    assert "outlier" in said
    assert "not empty" in refused(capsys, folder, "-o", full)
    assert "no such file" in refused(capsys, folder, "-o", out, "--calibration", tmp_path / "none.json")
    assert "not a calibration" in refused(capsys, folder, "-o", out, "--calibration", empty)
    assert "level" in refused(capsys, folder, "-o", out, "--level", "0.999")
    assert not out.exists()
    assert not (tmp_path / "out.partial").exists()
    assert (full / "kept.txt").read_text() == "mine"


def test_a_calibration_of_ones_own_is_used(folder, written, tmp_path):
    own, out = tmp_path / "own.json", tmp_path / "out"
    shipped = conformal.default_calibration()
    wide = replace(shipped, fitted_on="my scans", scales=tuple(3 * s for s in shipped.scales))
    wide.save(own)
    assert conformal.ConformalCalibration.load(own) == wide
    assert main(["sync", str(folder), "-o", str(out), "--calibration", str(own), *QUICK]) == 0
    regions = [np.genfromtxt(f / "point_maps" / "cat1_to_cat0.csv", delimiter=",") for f in (out, written.folder)]
    np.testing.assert_allclose(regions[0][1:, 2], 3 * regions[1][1:, 2], rtol=1e-3)
    assert "my scans" in (out / "README.txt").read_text()


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_killed_and_restarted_finished_pairs_are_not_redone(folder, tmp_path):
    out = tmp_path / "out"
    command = [sys.executable, "-m", "fmsync.cli", "sync", str(folder), "-o", str(out), *QUICK]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    pairs = tmp_path / "out.partial" / "pairs"
    finished = "?" * 24 + ".npz"  # and not what is being written
    while process.poll() is None and not list(pairs.glob(finished)):
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert process.returncode == -signal.SIGKILL
    kept = {f: os.stat(f).st_mtime_ns for f in pairs.glob(finished)}
    assert kept
    assert not out.exists()
    seen = {}

    def look(*_):  # just before the folder of pairs goes, at the end
        seen.update({f: os.stat(f).st_mtime_ns for f in kept})

    with pytest.MonkeyPatch.context() as patch:
        import fmsync.sync_cli

        move = os.replace
        patch.setattr(fmsync.sync_cli.os, "replace", lambda a, b: (look(), move(a, b))[1])
        assert main(command[3:]) == 0
    assert seen == kept
    assert (out / "report.html").is_file()
