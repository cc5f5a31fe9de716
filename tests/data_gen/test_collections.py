"""Collections from folders, lists and FMSYNC_DATA; fingerprints; correspondence files; the cache."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from data_gen import __main__ as command_line
from data_gen import cache
from data_gen.collections import (
    collection_files,
    front_paw,
    load_collection,
    load_correspondences,
    require_common_order,
)
from data_gen.fingerprints import fingerprint, known_collections, same_triangulation, verify
from data_gen.report import edge_distortion
from fmsync.shape import Shape

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
_OF_THE_ARITHMETIC = ("OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES", "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES")
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
OFF = "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n"


@pytest.fixture
def folder(tmp_path):
    for k in (0, 1, 2, 10):
        (tmp_path / f"cat{k}.off").write_text(OFF)
    (tmp_path / "notes.txt").write_text("not a mesh")
    return tmp_path


@pytest.fixture
def cache_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "fmsync" / cache.arithmetic()


def test_a_folder_is_read_in_natural_order(folder):
    assert [shape.name for shape in load_collection(folder)] == ["cat0", "cat1", "cat2", "cat10"]


def test_a_list_of_files_keeps_its_order(folder):
    shapes = load_collection([folder / "cat10.off", folder / "cat0.off"])
    assert [shape.name for shape in shapes] == ["cat10", "cat0"]


def test_fmsync_data_names_a_folder_of_collections(folder, monkeypatch):
    monkeypatch.setenv("FMSYNC_DATA", str(folder.parent))
    assert len(load_collection(folder.name)) == 4


def test_without_a_name_the_tosca_cats_come_first(folder, monkeypatch):
    (folder / "tosca_cat").mkdir()
    (folder / "tosca_cat" / "cat7.off").write_text(OFF)
    monkeypatch.setenv("FMSYNC_DATA", str(folder))
    assert [shape.name for shape in load_collection()] == ["cat7"]
    monkeypatch.delenv("FMSYNC_DATA")
    assert load_collection(count=1, n_vertices=1000)[0].n_vertices == 1000


def test_unknown_empty_and_ambiguous_folders_are_refused(folder, monkeypatch):
    monkeypatch.delenv("FMSYNC_DATA", raising=False)
    with pytest.raises(ValueError, match="dogs: neither 'cats' nor 'creatures' nor a folder, and FMSYNC_DATA is not"):
        load_collection("dogs")
    (folder / "nothing").mkdir()
    with pytest.raises(ValueError, match="no meshes in it"):
        load_collection(folder / "nothing")
    (folder / "cat2.obj").write_text("v 0 0 0\n")
    with pytest.raises(ValueError, match="several files are called cat2"):
        collection_files(folder)


def test_different_vertex_counts_are_named():
    more = Shape([*VERTICES.tolist(), [1, 1, 1]], [*FACES.tolist(), [1, 2, 4]], "more")
    same = Shape(VERTICES, FACES, "same")
    require_common_order([same, same])
    with pytest.raises(ValueError, match=r"same has 4, not so more \(5\)"):
        require_common_order([same, more, same])


def test_reoriented_triangles_are_recognised():
    shape = Shape(VERTICES, FACES, "a")
    reoriented = Shape(VERTICES, FACES[::-1, [1, 0, 2]], "b")
    other = Shape(VERTICES, [[0, 1, 2], [0, 2, 3], [1, 2, 3], [1, 3, 2]], "c")
    assert same_triangulation(shape, shape) == "identical"
    assert same_triangulation(shape, reoriented) == "reoriented"
    assert same_triangulation(shape, other) is None
    assert edge_distortion([shape, reoriented])[0] == 0


def test_verify_says_what_differs():
    shape = Shape(VERTICES, FACES, "a")
    table = {"a": fingerprint(shape), "gone": fingerprint(shape)}
    moved = Shape(VERTICES + 0.01 * np.eye(4, 3), FACES, "a")
    rounded = Shape(VERTICES + 1e-9, FACES, "a")
    fewer = Shape(VERTICES, FACES[:3], "a")
    assert verify([shape], table) == {"a": "ok", "gone": "missing"}
    assert verify([rounded], table)["a"] == "ok"
    assert verify([moved], table)["a"] == "other positions"
    assert verify([fewer], table)["a"] == "faces 3 instead of 4"
    assert verify([Shape(VERTICES, FACES, "z")], table)["z"] == "not in the table"


def test_correspondences_count_from_one_in_vts_and_from_zero_in_txt(tmp_path):
    shapes = [Shape(VERTICES, FACES, "a"), Shape(VERTICES, FACES, "b")]
    (tmp_path / "a.vts").write_text("1\n3\n4\n")
    (tmp_path / "b.txt").write_text("0\n2\n3\n")
    for points in load_correspondences(tmp_path, shapes):
        np.testing.assert_array_equal(points, [0, 2, 3])


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("0\n9\n1\n", "line 2 names vertex 9; b has 4"),
        ("0\n", "1 template points, a has 3"),
        ("", "empty"),
        ("0\nx\n1\n", "one vertex number"),
        (None, "neither b.vts nor b.txt"),
    ],
)
def test_broken_correspondences_are_refused(tmp_path, content, reason):
    shapes = [Shape(VERTICES, FACES, "a"), Shape(VERTICES, FACES, "b")]
    (tmp_path / "a.txt").write_text("0\n1\n2\n")
    if content is not None:
        (tmp_path / "b.txt").write_text(content)
    with pytest.raises(ValueError, match=reason):
        load_correspondences(tmp_path, shapes)


def test_the_cache_is_used_when_sound_and_rebuilt_when_not(cache_folder):
    calls = []

    def build():
        calls.append(1)
        return {"x": np.arange(5.0)}

    for _ in range(2):
        np.testing.assert_array_equal(cache.cached("key", build)["x"], np.arange(5.0))
    assert len(calls) == 1
    file = cache_folder / "key.npz"
    whole = file.read_bytes()
    damaged = bytearray(whole)
    position = whole.index(np.arange(5.0).tobytes())
    damaged[position + 12] ^= 1
    np.savez(cache_folder / "other.npz", x=np.zeros(5), checksum=np.array("0" * 64))
    for broken in (b"", whole[:100], bytes(damaged), b"not a zip", (cache_folder / "other.npz").read_bytes()):
        file.write_bytes(broken)
        before = len(calls)
        np.testing.assert_array_equal(cache.cached("key", build)["x"], np.arange(5.0))
        assert len(calls) == before + 1
        assert file.read_bytes() == whole
    assert not list(cache_folder.glob("*.part"))


def test_a_cache_that_cannot_be_written_is_no_error(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("in the way of the folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file" / "cache"))
    np.testing.assert_array_equal(cache.cached("key", lambda: {"x": np.ones(2)})["x"], np.ones(2))


def test_the_cache_folder_is_absolute_or_that_of_the_home(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    for named in ("", "relative/folder"):
        monkeypatch.setenv("XDG_CACHE_HOME", named)
        cache.cached(f"key-{len(named)}", lambda: {"x": np.ones(2)})
        assert (tmp_path / ".cache" / "fmsync" / cache.arithmetic() / f"key-{len(named)}.npz").is_file()


_ANOTHER_PROCESS = """
import numpy as np
from data_gen import cache
made = cache.cached("key", lambda: print("built") or {"x": np.ones(2)})
print(cache.arithmetic())
"""


def test_another_arithmetic_has_another_name_and_reads_no_file_of_ours(tmp_path):
    """Bits of generated shapes differ between processors, so a file that one of them wrote is not for the other."""
    inherited = {name: value for name, value in os.environ.items() if name not in _OF_THE_ARITHMETIC}
    inherited["XDG_CACHE_HOME"] = str(tmp_path)
    other = {"OPENBLAS_CORETYPE": "Nehalem", "NUMBA_CPU_NAME": "generic"}
    said = [
        subprocess.run(
            [sys.executable, "-c", _ANOTHER_PROCESS],
            env=inherited | changed,
            cwd=Path(__file__).parents[2],
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        for changed in ({}, other, {})
    ]
    names = [words[-1] for words in said]
    assert [words[:-1] for words in said] == [["built"], ["built"], []]
    assert names[0] == names[2] != names[1]
    if platform.machine() == "x86_64":
        assert names[1].startswith("Nehalem-")
    assert sorted(file.parent.name for file in tmp_path.rglob("*.npz")) == sorted(set(names))


def test_commands(folder, capsys):
    assert command_line.main(["verify", str(folder)]) == 1
    assert "no fingerprints known" in capsys.readouterr().err
    assert command_line.main(["report", str(folder)]) == 1
    assert "n_basis = 20 must be" in capsys.readouterr().err  # tetrahedra have four vertices


@pytest.mark.tosca
@pytest.mark.skipif(
    not (Path(os.environ.get("FMSYNC_DATA", "")) / "tosca_cat").is_dir() or "FMSYNC_DATA" not in os.environ,
    reason="FMSYNC_DATA has no tosca_cat",
)
def test_tosca_cats_verify_and_have_their_known_isometry():
    shapes = load_collection("tosca_cat")
    assert set(verify(shapes, known_collections()["tosca_cat"]).values()) == {"ok"}
    distortion = edge_distortion(shapes)
    np.testing.assert_allclose(
        [distortion.mean(), distortion.min(), distortion.max()], [0.090, 0.038, 0.147], atol=1e-3
    )


def test_a_data_folder_that_does_not_exist_is_refused_by_name(monkeypatch, tmp_path):
    monkeypatch.setenv("FMSYNC_DATA", str(tmp_path / "nowhere"))
    with pytest.raises(ValueError, match="FMSYNC_DATA=.*nowhere"):
        load_collection()


def test_the_front_paw_is_the_same_place_whatever_the_resolution():
    places = []
    for n_vertices in (1000, 2000, 5000):
        cat = load_collection("cats", count=1, n_vertices=n_vertices)[0]
        places.append(cat.normalised().vertices[front_paw(cat)])
    ahead, across, up = np.array(places).T
    assert np.ptp(places, axis=0).max() < 0.06
    assert (ahead > 0.1).all()  # the trunk is at zero
    assert (across < -0.05).all()
    assert (up < 0.1).all()
