"""Mesh files: sound ones of every dialect are read, broken ones repaired with a warning or refused with the reason."""

import struct
import time
import warnings

import numpy as np
import pytest
import pyvista as pv

from fmsync.mesh_io import mesh_files, read_shape

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
    "half-a-vertex.off": (off().replace("3 1 2 3", "3 1 2.5 3"), "line 9: '2.5' is not the number of a vertex"),
    "two-corners.off": (off(faces=[*TETRA_FACES, [0, 1]]), "face 4 has 2 corners, three are the least"),
    "corner-missing.off": (off().replace("3 1 2 3", "3 1 2"), "line 9: '3 1 2' is not a number of corners"),
    "number-missing.off": (off().replace("0.0 1.0 0.0", "0.0 1.0"), "line 5: '0.0 1.0' does not hold three"),
    "binary.off": ("OFF BINARY\n4 4 0\n", "a text mesh in space begins with OFF"),
    "of-four-dimensions.off": ("4OFF\n4 4 0\n", "a text mesh in space begins with OFF"),
    "far-too-many.off": (off(n_vertices=10**15), "vertices announced, the file ends after 8"),
    "face-too-high.off": (off(faces=[*TETRA_FACES[:3], [0, 3, 4]]), r"face 3 uses vertices \[0, 3, 4\]"),
    "face-negative.off": (off(faces=[*TETRA_FACES[:3], [0, 3, -1]]), "face 3 uses vertices"),
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
    "short-vertex.obj": (OBJ.replace("v 0 0 1", "v 0 0"), "line 4: 'v 0 0' does not hold three coordinates"),
    "edge.obj": (OBJ + "f 1 2\n", "face 4 has 2 corners"),
    "zeroth-vertex.obj": (OBJ.replace("f 1 4 3", "f 0 4 3"), "face 3 uses vertices"),
    "not-yet-read.obj": ("v 0 0 0\nf -1 -2 -3\n" + OBJ, "face 0 uses vertices"),
    "out-of-range.obj": (OBJ.replace("f 1 4 3", "f 1 5 3"), "face 3 uses vertices"),
    "word.obj": (OBJ.replace("v 0 1 0", "v 0 x 0"), "'x' is not a number"),
    "empty.ply": ("", "empty"),
    "header-cut.ply": (ply()[:60], "ply"),
    "truncated.ply": (ply()[:-30], "truncated.ply"),
    "not-a.ply": ("hello\n", "not-a.ply"),
    "empty.stl": ("", "empty"),
    "more-than-announced.ply": (ply() + "3 0 1 2\n", "holds more than its header announces"),
    "strips.ply": (ply().replace("element face", "element tristrips"), "tristrips is no list of the vertices"),
    "far-too-many.ply": (ply().replace("vertex 4", f"vertex {10**15}"), "of vertex announced, the file ends after 8"),
    "no-z.ply": (ply().replace("float z", "float w"), "do not begin with x, y and z"),
    "odd-type.ply": (ply().replace("float z", "long z"), "'property long z', which is not understood"),
    "not-an.stl": ("solid\nnothing\n", "line 2: 'nothing' where 'endsolid' is due"),
    "cut.stl": (
        "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nendsolid\n",
        "'facet' where 'endsolid' is due",
    ),
    "unknown.xyz": ("0 0 0\n", "unknown format"),
    "volume.vtk": ("# vtk DataFile Version 3.0\n", "unknown format '.vtk'; convert it to one of"),
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


WRONG_WORDS = ("nan", "inf", "-inf", "1e999", "null", "1,5", "abc", "0x1", "1_0")


@pytest.mark.parametrize("word", WRONG_WORDS)
def test_a_word_that_is_no_finite_number_is_named_with_its_line(tmp_path, word):
    texts = {"a.off": (off(), 5), "a.obj": (OBJ, 3), "a.ply": (ply(), 12)}
    for name, (text, line) in texts.items():
        old = "0 1 0" if name == "a.obj" else "0.0 1.0 0.0"
        (tmp_path / name).write_text(text.replace(old, f"0 {word} 0", 1))
        with pytest.raises(ValueError, match=f"{name}: line {line}: '{word}' is not a number: mend it"):
            read_shape(tmp_path / name)


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


QUAD_FACES = [[0, 1, 2, 3], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]  # a pyramid
PYRAMID = np.array([[0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0], [0.5, 0.5, 1]])
FANNED = [[0, 1, 2], [0, 2, 3], *QUAD_FACES[1:]]


def binary_ply(order, vertices=TETRA, faces=TETRA_FACES, faces_first=False):
    """With attributes before, between and after what is read, and an element of its own."""
    sizes = f"element vertex {len(vertices)}\n", f"element face {len(faces)}\n"
    heads = [
        f"{sizes[0]}property uchar red\nproperty double x\nproperty double y\nproperty float q\nproperty double z\n",
        f"{sizes[1]}property short material\nproperty list uchar int vertex_index\nproperty list uchar float uv\n",
        "element edge 2\nproperty int a\nproperty list ushort char b\n",
    ]
    bodies = [
        b"".join(struct.pack(f"{order}Bddfd", 7, x, y, np.nan, z) for x, y, z in vertices),
        b"".join(struct.pack(f"{order}hB{len(f)}iB2f", -1, len(f), *f, 2, 0.5, 0.25) for f in faces),
        2 * struct.pack(f"{order}iH3b", 1, 3, 1, 2, 3),
    ]
    if faces_first:
        heads, bodies = [heads[1], heads[0], heads[2]], [bodies[1], bodies[0], bodies[2]]
    kind = {"<": "little", ">": "big"}[order]
    return f"ply\nformat binary_{kind}_endian 1.0\ncomment by hand\n{''.join(heads)}end_header\n".encode() + b"".join(
        bodies
    )


def text_stl(vertices=TETRA, faces=TETRA_FACES):
    rows = ["solid by hand"]
    for face in faces:
        corners = ["vertex " + " ".join(map(str, vertices[v])) for v in face]
        rows += ["facet normal nan nan nan", "outer loop", *corners, "endloop", "endfacet"]
    return "\n".join([*rows, "endsolid by hand"]) + "\n"


def binary_stl(vertices=TETRA, faces=TETRA_FACES, head=b"solid that is none"):
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *vertices[face].ravel(), 0) for face in faces)
    return head.ljust(80, b" ") + struct.pack("<I", len(faces)) + body


ROWS = off().split("\n", 2)[2]
COLOURED = "\n".join(f"{row} 255 0 0 255" for row in ROWS.splitlines()) + "\n"
SOUND = {
    "plain.off": off(),
    "comments.off": "# made by hand\n\n" + off().replace("\n0.0", " # first\n0.0", 1),
    "counts-beside-the-keyword.off": "OFF 4 4 0\n" + ROWS,
    "counts-at-the-keyword.off": "OFF4 4 0\n" + ROWS,
    "one-line.off": " ".join(off().split()),
    "no-edges.off": "OFF\n4 4\n" + ROWS,
    "colours.off": "COFF\n4 4 0\n" + COLOURED,
    "normals.off": "NOFF\n4 4 6\n" + COLOURED,
    "texture.off": "STOFF\n4 4 6\n" + COLOURED,
    "byte-order-mark.off": b"\xef\xbb\xbf" + off().encode(),
    "utf-16.off": off().encode("utf-16"),
    "windows.off": off().replace("\n", "\r\n").encode(),
    "plain.obj": OBJ,
    "dressed.obj": "# by_hand 1,5\nmtllib a.mtl\no x_1\n"
    + OBJ.replace("v 0 1 0", "v 0 1 0 1.0 0.5 nan")
    + "l 1 2\ns off\n",
    "slashes.obj": OBJ.replace("f 1 3 2", "f 1/1/1 3/2/1 2//1"),
    "backwards.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -1 -2\nv 0 0 1\nf 1 2 -1\nf 2 3 4\nf -4 -1 -2\n",
    "continued.obj": OBJ.replace("f 1 3 2", "f 1 3 \\\n2"),
    "plain.ply": ply(),
    "mark.ply": b"\xef\xbb\xbf" + ply().encode(),
    "windows.ply": ply().replace("\n", "\r\n").encode(),
    "little.ply": binary_ply("<"),
    "big.ply": binary_ply(">"),
    "faces-first.ply": binary_ply("<", faces_first=True),
}


@pytest.mark.parametrize("name", SOUND)
def test_a_sound_file_is_read_without_a_warning(tmp_path, name):
    content = SOUND[name]
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        shape = read_shape(tmp_path / name)
    np.testing.assert_array_equal(shape.vertices, TETRA)
    np.testing.assert_array_equal(shape.faces, TETRA_FACES)
    assert shape.vertices.dtype == np.float64
    assert shape.name == name[:-4]


def test_faces_before_vertices_in_text(tmp_path):
    head, body = ply().split("end_header\n")
    vertex, face = head.index("element vertex"), head.index("element face")
    rows = body.splitlines()
    lines = [f"{row} 0.5" for row in rows[4:]] + rows[:4]
    text = head[:vertex] + head[face:] + "property float flatness\n" + head[vertex:face] + "end_header\n"
    (tmp_path / "a.ply").write_text(text + "\n".join(lines))
    shape = read_shape(tmp_path / "a.ply")
    np.testing.assert_array_equal(shape.vertices, TETRA)
    np.testing.assert_array_equal(shape.faces, TETRA_FACES)


def test_files_of_another_writer_and_of_tosca(tmp_path):
    pv.PolyData.from_regular_faces(TETRA, TETRA_FACES).save(tmp_path / "f.ply")
    (tmp_path / "g.vert").write_text("0 0 0\n1 0 0\n0 1 0\n0 0 1\n")
    (tmp_path / "g.tri").write_text("1 3 2\n1 2 4\n2 3 4\n1 4 3\n")
    for name in ("f.ply", "g.vert"):
        shape = read_shape(tmp_path / name)
        np.testing.assert_array_equal(shape.vertices, TETRA)
        np.testing.assert_array_equal(shape.faces, TETRA_FACES)


def test_polygons_are_cut_into_fans(tmp_path):
    rows = [" ".join(map(str, p)) for p in PYRAMID.tolist()]
    faces = [" ".join(str(v + 1) for v in f) for f in QUAD_FACES]
    contents = {
        "a.off": off(PYRAMID, QUAD_FACES).encode(),
        "a.obj": ("".join(f"v {r}\n" for r in rows) + "".join(f"f {f}\n" for f in faces)).encode(),
        "a.ply": binary_ply(">", PYRAMID, QUAD_FACES),
    }
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
        shape = read_shape(tmp_path / name)
        np.testing.assert_array_equal(shape.vertices, PYRAMID)
        np.testing.assert_array_equal(shape.faces, FANNED)


@pytest.mark.parametrize("content", [text_stl().encode(), binary_stl(), binary_stl(head=b"by hand")])
def test_stl_corners_are_merged_with_a_warning(tmp_path, content):
    (tmp_path / "t.stl").write_bytes(content)
    with pytest.warns(UserWarning, match="vertices lie exactly on others and were merged"):
        shape = read_shape(tmp_path / "t.stl")
    assert {tuple(v) for v in shape.vertices.tolist()} == {tuple(v) for v in TETRA.tolist()}
    corners = [sorted(map(tuple, shape.vertices[face].tolist())) for face in shape.faces]
    assert corners == [sorted(map(tuple, TETRA[face].tolist())) for face in TETRA_FACES]


@pytest.mark.parametrize("content", [binary_stl()[:-7], binary_stl(head=b"by hand")[:-7], binary_stl()[:30]])
def test_a_binary_stl_of_the_wrong_size_is_refused(tmp_path, content):
    (tmp_path / "t.stl").write_bytes(content)
    with pytest.raises(ValueError, match=r"t\.stl"):
        read_shape(tmp_path / "t.stl")


@pytest.mark.parametrize("cut", [30, 100])
@pytest.mark.parametrize("order", ["<", ">"])
def test_a_binary_ply_that_is_cut_or_announces_too_much_is_refused(tmp_path, order, cut):
    whole = binary_ply(order)
    (tmp_path / "t.ply").write_bytes(whole[:-cut])
    with pytest.raises(ValueError, match=r"t\.ply: .* announced, the file is too short for them"):
        read_shape(tmp_path / "t.ply")
    for old, new in ((b"vertex 4", b"vertex 4000000000000"), (b"face 4", b"face 4000000000000")):
        (tmp_path / "t.ply").write_bytes(whole.replace(old, new))
        with pytest.raises(ValueError, match="announced, the file is too short for them"):
            read_shape(tmp_path / "t.ply")


def test_a_binary_vertex_that_is_not_finite_is_refused(tmp_path):
    broken = TETRA.copy()
    broken[2, 1] = np.nan
    (tmp_path / "t.ply").write_bytes(binary_ply("<", broken))
    with pytest.raises(ValueError, match="vertex 2 is not finite"):
        read_shape(tmp_path / "t.ply")


def test_texture_seams_are_closed_with_a_warning(tmp_path):
    (tmp_path / "seam.obj").write_text(OBJ.replace("v 0 0 1\n", "v 0 0 1\nv 1 0 0\n").replace("f 2 3 4", "f 5 3 4"))
    with pytest.warns(UserWarning, match="1 vertices lie exactly on others"):
        shape = read_shape(tmp_path / "seam.obj")
    np.testing.assert_array_equal(shape.faces, TETRA_FACES)


@pytest.mark.parametrize(
    ("name", "content"), [("c.ply", ply([])), ("c.off", off(faces=[])), ("c.obj", OBJ[: OBJ.index("f")])]
)
def test_a_file_that_announces_no_faces_is_a_point_cloud(tmp_path, name, content):
    (tmp_path / name).write_text(content)
    shape = read_shape(tmp_path / name)
    assert shape.faces is None
    np.testing.assert_array_equal(shape.vertices, TETRA)


def test_a_surface_that_is_no_manifold_is_read_on_request(tmp_path):
    for name in ("flat-face.off", "three-sheets.off"):
        (tmp_path / name).write_text(REFUSED[name][0])
        shape = read_shape(tmp_path / name, manifold=False)
        assert len(shape.faces) == int(REFUSED[name][0].split()[2])


def test_many_vertices_are_read_quickly(tmp_path):
    mesh = pv.Plane(i_resolution=167, j_resolution=167).triangulate()
    vertices, faces = np.asarray(mesh.points, dtype=float), mesh.regular_faces
    (tmp_path / "a.off").write_text(off(vertices, faces.tolist()))
    rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
    (tmp_path / "a.obj").write_text("\n".join(rows))
    for name in ("a.off", "a.obj"):
        began = time.process_time()
        shape = read_shape(tmp_path / name)
        assert time.process_time() - began < 5  # about half a second: every word in a Python loop of its own takes more
        np.testing.assert_array_equal(shape.vertices, vertices)
        np.testing.assert_array_equal(shape.faces, faces)


def test_folders_are_read_in_natural_order_without_the_litter_of_macos(tmp_path):
    for name in ("cat10.off", "cat2.obj", "Cat1.OFF", "._cat2.obj", "notes.txt"):
        (tmp_path / name).write_text("")
    (tmp_path / "folder.off").mkdir()
    names = [file.name for file in mesh_files([tmp_path, tmp_path / "cat2.obj"])]
    assert names == ["Cat1.OFF", "cat2.obj", "cat10.off"]
    (tmp_path / "cat2.ply").write_text("")
    with pytest.raises(ValueError, match="several files are called cat2"):
        mesh_files([tmp_path])
    with pytest.raises(ValueError, match="no meshes in it"):
        mesh_files([tmp_path / "folder.off"])


def test_a_link_to_nothing_is_refused(tmp_path):
    (tmp_path / "a.off").symlink_to(tmp_path / "gone.off")
    for read in (read_shape, lambda path: mesh_files([path]), lambda path: mesh_files([path.parent])):
        with pytest.raises(ValueError, match=r"a\.off: a link to a file that is gone"):
            read(tmp_path / "a.off")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ValueError, match="nowhere.off: there is no such file"):
        read_shape(tmp_path / "nowhere.off")
