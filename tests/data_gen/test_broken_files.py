"""Broken files: each is repaired with a warning that says what was done, or refused with its name and the reason."""

import warnings

import numpy as np
import pytest
import pyvista as pv

from data_gen.mesh_io import read_shape

TETRA = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
TETRA_FACES = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]


def off(vertices=TETRA, faces=TETRA_FACES, n_vertices=None, n_faces=None):
    counts = f"{len(vertices) if n_vertices is None else n_vertices} {len(faces) if n_faces is None else n_faces} 0"
    rows = [" ".join(map(str, v)) for v in np.asarray(vertices).tolist()]
    rows += [f"{len(f)} " + " ".join(map(str, f)) for f in faces]
    return "\n".join(["OFF", counts, *rows]) + "\n"


def ply(faces=TETRA_FACES):
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [" ".join(map(str, v)) for v in TETRA.tolist()] + [f"{len(f)} " + " ".join(map(str, f)) for f in faces]
    return head + "\n".join(rows) + "\n"


def with_vertex(value):
    vertices = TETRA.copy()
    vertices[2, 1] = value
    return vertices


OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"

REFUSED = {
    "empty.off": ("", "empty"),
    "blank.off": ("\n\n", "begins with OFF"),
    "wrong-header.off": ("PLY\n4 4 0\n", "begins with OFF"),
    "counts-missing.off": ("OFF\n4\n", "line of counts"),
    "negative-count.off": (off(n_faces=-4), "line of counts"),
    "truncated-vertices.off": ("OFF\n4 4 0\n0 0 0\n1 0 0\n", "4 vertices announced, the file ends after 2"),
    "truncated-faces.off": (off()[: off().index("3 1 2 3")], "4 faces announced, the file ends after 2"),
    "too-few-faces-announced.off": (off(n_faces=3), "3 faces announced, 4 found"),
    "too-many-faces-announced.off": (off(n_faces=9), "9 faces announced, the file ends after 4"),
    "word.off": (off().replace("1.0", "one", 1), "'one' is not a number"),
    "half-a-vertex.off": (off().replace("3 1 2 3", "3 1 2.5 3"), "2.5 is not the number of a vertex"),
    "quad.off": (off(faces=[[0, 1, 2, 3], [0, 1, 2], [0, 1, 3], [1, 2, 3]]), "triangles|corners"),
    "nan.off": (off(with_vertex(np.nan)), "vertex 2 is not finite"),
    "infinity.off": (off(with_vertex(np.inf)), "vertex 2 is not finite"),
    "face-too-high.off": (off(faces=[*TETRA_FACES[:3], [0, 3, 4]]), r"face 3 uses vertices \[0, 3, 4\]"),
    "face-negative.off": (off(faces=[*TETRA_FACES[:3], [0, 3, -1]]), "face 3 uses vertices"),
    "no-faces.off": (off(faces=[]), "no faces"),
    "flat-face.off": (off([*TETRA, [0.5, 0, 0]], [*TETRA_FACES, [0, 4, 1]]), "face 4 has no area"),
    "all-faces-collapsed.off": (off(faces=[[0, 0, 1], [1, 2, 2]]), "no face with three different corners"),
    "two-halves.off": (
        off(np.vstack([TETRA, TETRA + 5]), TETRA_FACES + [[i + 4 for i in f] for f in TETRA_FACES]),
        "2 components, the largest with 50%",
    ),
    "three-sheets.off": (
        off(
            [[0, 0, 0], [1, 0, 0], [0.5, 1, 1], [0.5, -1, 1], [0.5, 0, -1], [0.5, 0, 5]],
            # two tetrahedra that share one edge: four faces on it, none of them a fin
            [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2], [0, 1, 4], [0, 4, 5], [0, 5, 1], [1, 5, 4]],
        ),
        "not a manifold",
    ),
    "short-vertex.obj": (OBJ.replace("v 0 0 1", "v 0 0"), "vertex 3 has 2 coordinates"),
    "quad.obj": (OBJ + "f 1 2 3 4\n", "face 4 has 4 corners"),
    "out-of-range.obj": (OBJ.replace("f 1 4 3", "f 1 5 3"), "face 3 uses vertices"),
    "word.obj": (OBJ.replace("v 0 1 0", "v 0 x 0"), "'x' is not a number"),
    "empty.ply": ("", "empty"),
    "header-cut.ply": (ply()[:60], "ply"),
    "truncated.ply": (ply()[:-30], "truncated.ply"),
    "not-a.ply": ("hello\n", "not-a.ply"),
    "empty.stl": ("", "empty"),
    "not-an.stl": ("solid\nnothing\n", "not-an.stl"),
    "unknown.xyz": ("0 0 0\n", "unknown format"),
    "alone.vert": ("0 0 0\n", "there is no alone.tri"),
}

REPAIRED = {
    "duplicate-vertices.off": (
        off(np.vstack([TETRA, TETRA[1]]), [[0, 2, 1], [0, 4, 3], [1, 2, 3], [0, 3, 2]]),
        "1 vertices lie exactly on others",
    ),
    "collapsed-face.off": (off(faces=[*TETRA_FACES, [1, 1, 2]]), "1 faces use a vertex twice"),
    "repeated-face.off": (off(faces=[*TETRA_FACES, [2, 1, 0]]), "1 faces repeat others"),
    "unreferenced.off": (off([*TETRA, [9, 9, 9]]), "1 vertices are on no face"),
    "fin.off": (off([*TETRA, [0.5, -1, -1]], [*TETRA_FACES, [0, 1, 4]]), "1 faces stood as fins"),
    "debris.off": (
        off(np.vstack([TETRA, TETRA / 100 + 5]), TETRA_FACES + [[i + 4 for i in f] for f in TETRA_FACES]),
        "2 components; the largest",
    ),
    "unreferenced.obj": (OBJ + "v 7 7 7\n", "1 vertices are on no face"),
    "repeated-face.ply": (ply([*TETRA_FACES, [0, 2, 1]]), "1 faces repeat others"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_broken_file_is_refused_with_its_name_and_the_reason(tmp_path, name):
    content, reason = REFUSED[name]
    (tmp_path / name).write_text(content)
    with pytest.raises(ValueError, match=reason) as refusal:
        read_shape(tmp_path / name)
    assert name in str(refusal.value)


@pytest.mark.parametrize("name", REPAIRED)
def test_a_repairable_file_is_repaired_to_the_tetrahedron_with_a_warning(tmp_path, name):
    content, what = REPAIRED[name]
    (tmp_path / name).write_text(content)
    with pytest.warns(UserWarning, match=what) as caught:
        shape = read_shape(tmp_path / name)
    assert all(name in str(warning.message) for warning in caught)
    np.testing.assert_allclose(shape.vertices, TETRA)
    assert {tuple(sorted(face)) for face in shape.faces.tolist()} == {tuple(sorted(face)) for face in TETRA_FACES}


def test_sound_files_of_every_format_are_read_without_a_warning(tmp_path):
    (tmp_path / "a.off").write_text(off())
    (tmp_path / "b.off").write_text("# made by hand\n" + off().replace("\n0.0", " # first\n0.0", 1))
    (tmp_path / "c.obj").write_text(OBJ)
    (tmp_path / "d.obj").write_text(OBJ.replace("f 1 3 2", "f -4//1 -2//1 -3//1"))
    (tmp_path / "e.ply").write_text(ply())
    pv.PolyData.from_regular_faces(TETRA, TETRA_FACES).save(tmp_path / "f.ply")
    (tmp_path / "g.vert").write_text("0 0 0\n1 0 0\n0 1 0\n0 0 1\n")
    (tmp_path / "g.tri").write_text("1 3 2\n1 2 4\n2 3 4\n1 4 3\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for path in sorted(p for p in tmp_path.iterdir() if p.suffix != ".tri"):
            shape = read_shape(path)
            np.testing.assert_array_equal(shape.vertices, TETRA, err_msg=path.name)
            np.testing.assert_array_equal(shape.faces, TETRA_FACES, err_msg=path.name)
            assert shape.name == path.stem


def test_stl_corners_are_merged(tmp_path):
    pv.PolyData.from_regular_faces(TETRA, TETRA_FACES).save(tmp_path / "t.stl")
    assert read_shape(tmp_path / "t.stl").vertices.shape == (4, 3)


def test_a_ply_without_faces_is_a_point_cloud(tmp_path):
    (tmp_path / "cloud.ply").write_text(ply([]))
    shape = read_shape(tmp_path / "cloud.ply")
    assert shape.faces is None
    np.testing.assert_array_equal(shape.vertices, TETRA)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ValueError, match="nowhere.off: there is no such file"):
        read_shape(tmp_path / "nowhere.off")
