"""The command: what it leaves behind, and what it says when it cannot."""

import contextlib
import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from fmsync.cli import main
from fmsync.matching import conformal, network
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
    assert not (out / ".fmsync").exists()


def test_thin_draws_are_said_in_plain_words_everywhere(written):
    page, words = (written.folder / "report.html").read_text(), (written.folder / "README.txt").read_text()
    for said in (written.said, page, words):
        assert "the regions are rough; ask for more draws" in said
    assert "warnings.warn" not in written.said
    assert "%|" not in written.said  # bars are for terminals
    assert "random species" in page  # what the regions were learnt from


def test_modes_of_the_posterior_are_one_line_with_an_option_that_helps(folder, tmp_path, monkeypatch, capsys):
    drawn = network.sample
    monkeypatch.setattr(network, "sample", lambda *a, **k: replace(drawn(*a, **k), modes="one chain is in another"))
    assert main(["sync", str(folder), "-o", str(tmp_path / "out"), "--json", *QUICK]) == 0
    out, err = capsys.readouterr()
    (line,) = [line for line in err.splitlines() if "in another" in line]
    assert line.startswith("fmsync: warning: The maps can agree in more ways than one (one chain is in another): ")
    (said,) = [text for text in json.loads(out)["warnings"] if "in another" in text]
    assert line.endswith(said)
    assert said in (tmp_path / "out" / "README.txt").read_text()
    with pytest.raises(SystemExit):
        main(["sync", "--help"])
    assert set(re.findall("--[a-z]+", said)) == {"--graph", "--landmarks"}
    assert set(re.findall("--[a-z]+", said)) <= set(re.findall("--[a-z]+", capsys.readouterr().out))


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
    assert (full / "kept.txt").read_text() == "mine"


def test_a_calibration_of_ones_own_is_used(folder, written, tmp_path):
    own, out = tmp_path / "own.json", tmp_path / "out"
    shipped = conformal.default_calibration()
    wide = replace(shipped, fitted_on="my scans", scales=tuple(3 * s for s in shipped.scales))
    wide.save(own)
    assert conformal.ConformalCalibration.load(own) == wide
    assert main(["sync", str(folder), "-o", str(out), "--calibration", str(own), *QUICK]) == 0
    regions = [np.genfromtxt(f / "point_maps" / "cat1_to_cat0.csv", delimiter=",") for f in (out, written.folder)]
    wider = regions[0][1:, 2] / regions[1][1:, 2]
    assert ((wider > 0.999) & (wider < 3.001)).all()
    assert (wider > 2.999).mean() > 0.6  # the others are as wide as a symmetry, or beside such
    assert "my scans" in (out / "README.txt").read_text()


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_killed_and_restarted_finished_pairs_are_not_redone(folder, tmp_path):
    out = tmp_path / "out"
    command = [sys.executable, "-m", "fmsync.cli", "sync", str(folder), "-o", str(out), *QUICK]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    pairs = out / ".fmsync" / "pairs"
    finished = "?" * 24 + ".npz"  # and not what is being written
    while process.poll() is None and not list(pairs.glob(finished)):
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert process.returncode == -signal.SIGKILL
    kept = {f: os.stat(f).st_mtime_ns for f in pairs.glob(finished)}
    assert kept
    assert [path.name for path in out.iterdir()] == [".fmsync"]
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


def test_numbers_and_choices_are_refused_before_any_file_is_read(tmp_path, capsys):
    nowhere, out = tmp_path / "nowhere", tmp_path / "out"
    for option, value, said in (
        ("--samples", 0, "--samples: at least 20"),
        ("--draws", 0, "--draws: at least 1"),
        ("--basis", 1, "--basis: at least 2"),
        ("--refined", 5, "--refined: at least 20"),
        ("--jobs", 0, "--jobs: at least one process"),
        ("--seed", -1, "--seed: a whole number >= 0"),
        ("--level", "nan", "--level: a probability"),
        ("--graph", "k0", "--graph: 'complete', or k"),
        ("--landmarks", nowhere, "there is no such file"),
    ):
        assert main(["sync", str(nowhere), "-o", str(out), option, str(value)]) == 2
        told = capsys.readouterr().err
        assert said in told
        assert told.count("\n") == 1
    assert not out.exists()


@pytest.mark.parametrize("kind", ["link", "here", "empty"])
def test_folders_that_are_there_are_written_into(folder, tmp_path, kind, monkeypatch, capsys):
    place = tmp_path / "place"
    place.mkdir()
    out = {"link": tmp_path / "link", "here": ".", "empty": place}[kind]
    if kind == "link":
        out.symlink_to(place)
    if kind == "here":
        monkeypatch.chdir(place)
    assert main(["sync", str(folder), "-o", str(out), "--json", *QUICK]) == 0
    assert {path.name for path in place.iterdir()} >= {"report.html", "maps.npz", "meshes", "point_maps", "README.txt"}
    assert not (place / ".fmsync").exists()
    told = capsys.readouterr()
    assert "3 shapes, in this order: cat0, cat1, cat2" in told.err
    summary = json.loads(told.out)
    assert [shape["name"] for shape in summary["shapes"]] == ["cat0", "cat1", "cat2"]
    assert len(summary["pairs"]) == 3
    assert summary["kappa"] > 0


def test_finished_pairs_outlive_typos_and_damage(folder, tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"
    command = ["sync", str(folder), "-o", str(out), *QUICK]

    def full_disk(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("fmsync.sync_cli.write_all", full_disk)
    assert main(command) == 1
    assert "No space left" in capsys.readouterr().err
    monkeypatch.undo()
    pairs = sorted((out / ".fmsync" / "pairs").glob("*.npz"))
    assert len(pairs) == 3
    landmarks = tmp_path / "marks.txt"
    landmarks.write_text("cat0: 1 2\ncat1: 1 2\ncat7: 1 2\n")
    for typo in (["--graph", "k0"], ["--landmarks", str(landmarks)], ["--refined", "5"]):
        assert main([*command, *typo]) == 2
    assert "no line 'NAME: ...' for cat2; it has cat0, cat1, cat7" in capsys.readouterr().err
    assert sorted((out / ".fmsync" / "pairs").glob("*.npz")) == pairs
    pairs[0].write_bytes(pairs[0].read_bytes()[:100])
    pairs[1].write_bytes(b"")
    assert main(command) == 0
    assert (out / "report.html").is_file()


def test_failures_are_one_line(folder, tmp_path, monkeypatch, capsys):
    import fmsync.matching

    command = ["sync", str(folder), "-o", str(tmp_path / "out"), *QUICK]
    for error, status, said in (
        (KeyboardInterrupt(), 130, "give the same command again"),
        (PermissionError(13, "Permission denied", "x"), 1, "Permission denied"),
        (MemoryError(), 1, "MemoryError"),
    ):

        def fails(*_, error=error, **__):
            raise error

        monkeypatch.setattr(fmsync.matching, "synchronize_shapes", fails)
        assert main(command) == status
        told = capsys.readouterr().err
        assert said in told
        assert "Traceback" not in told
    monkeypatch.undo()
    (tmp_path / "file").write_text("")
    assert main(["sync", str(folder), "-o", str(tmp_path / "file"), *QUICK]) == 2
    assert "it is a file" in capsys.readouterr().err


def test_a_closed_stdout_is_not_a_traceback(folder):
    command = [sys.executable, "-m", "fmsync.cli", "info", str(folder)]  # of the commands the one that starts fastest
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True)
    os.close(write)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "Exception" not in done.stderr


def test_names_of_files_become_names_in_the_output(cats, tmp_path):
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    for shape, name in zip(cats, ("..off", "\udcff\udcfe.off", "n" * 200 + ".off")):
        write_off(meshes / name, shape.vertices, shape.faces)
    out = tmp_path / "out"
    assert main(["sync", *map(str, sorted(meshes.iterdir())), "-o", str(out), *QUICK]) == 0
    assert {path.stem for path in (out / "meshes").glob("*.vtp")} == {"shape", "__", "n" * 80}
    assert {path.name for path in tmp_path.iterdir()} == {"meshes", "out"}


def test_landmarks_by_name_in_any_order(folder, tmp_path):
    from fmsync.matching.synchronize import checked_landmarks
    from fmsync.sync_cli import _landmarks

    shapes = [read_shape(folder / f"cat{k}.off") for k in range(3)]
    named, plain = tmp_path / "named.txt", tmp_path / "plain.txt"
    named.write_text("cat2: 7, 8\ncat0: 1 2\n\ncat1: 3 4\n")
    plain.write_text("1 2\n3 4\n7 8\n")
    assert _landmarks(named, shapes) == _landmarks(plain, shapes) == [[1, 2], [3, 4], [7, 8]]
    for text, said in (("1 2\n3 x\n7 8", "line of cat1"), ("1 2\n3 4\n7 1000", r"cat2\)\[1\] = 1000 is outside")):
        plain.write_text(text)
        with pytest.raises(ValueError, match=said):
            checked_landmarks(_landmarks(plain, shapes), shapes, 20)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_two_hundred_kills_lose_nothing_and_repeat_nothing(folder, tmp_path):
    """Killed with its two workers at random moments, from imports to the last file, then left alone."""
    out, clean = tmp_path / "out", tmp_path / "clean"
    command = [sys.executable, "-m", "fmsync.cli", "sync", str(folder), *QUICK, "--jobs", "2", "-o"]
    subprocess.run([*command, str(clean)], check=True, capture_output=True)
    rng, kept, n_killed = np.random.default_rng(0), {}, 0
    while n_killed < 200:
        process = subprocess.Popen(
            [*command, str(out)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        time.sleep(rng.uniform(0.5, 12))
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        n_killed += process.wait() == -signal.SIGKILL
        if (out / "report.html").is_file():  # it was done: begin again
            shutil.rmtree(out)
            kept = {}
        now = {file: os.stat(file).st_mtime_ns for file in (out / ".fmsync" / "pairs").glob("?" * 24 + ".npz")}
        assert kept.items() <= now.items()
        kept = now
    subprocess.run([*command, str(out)], check=True, capture_output=True)
    for path in clean.rglob("*.npy"):
        np.testing.assert_array_equal(np.load(path), np.load(out / path.relative_to(clean)))
    assert {p.relative_to(clean) for p in clean.rglob("*")} == {p.relative_to(out) for p in out.rglob("*")}
