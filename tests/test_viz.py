"""Scenes and figures: what is drawn, what is carried over to the display mesh, what is refused."""

import base64
import io
import json
import subprocess
import sys
import zipfile
import zlib
from dataclasses import replace
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from PIL import Image

from fmsync import Shape, viz
from fmsync.viz import scenes


def sphere(n_rings=20, radius=1.0, name="ball"):
    """A closed triangulated sphere by hand."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, n_rings + 2)[1:-1], np.arange(2 * n_rings) * np.pi / n_rings)
    ring = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    vertices = np.concatenate([np.stack([r.ravel() for r in ring], axis=1), [[0, 0, 1], [0, 0, -1]]])
    m, k = 2 * n_rings, n_rings
    faces = []
    for i in range(m):
        here, there = i * k, (i + 1) % m * k
        faces += [[here + j, here + j + 1, there + j] for j in range(k - 1)]
        faces += [[there + j, here + j + 1, there + j + 1] for j in range(k - 1)]
        faces += [[m * k, here, there], [m * k + 1, there + k - 1, here + k - 1]]
    return Shape(radius * vertices, np.array(faces), name)


def pixels(png):
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def inked(png, panel, panels):
    """Rows and columns of one panel that are not white: the extent of what is drawn."""
    image = np.array_split(pixels(png), panels, axis=1)[panel]
    ink = (image < 250).any(axis=2)
    return ink.any(axis=1).sum(), ink.any(axis=0).sum()


@pytest.fixture
def no_gl(monkeypatch):
    monkeypatch.setattr(scenes, "can_render", lambda: False)


needs_gl = pytest.mark.skipif(not scenes.can_render(), reason="no OpenGL here")


def test_still_without_gl_says_how_to_get_the_turnable_one(no_gl):
    shown = viz.scene([sphere()], alt="A ball.")
    assert shown.data is None
    page = shown._repr_mimebundle_()["text/html"]
    assert "apt-get install libegl1 libgl1" in page
    assert 'alt="A ball."' in page
    assert "iframe" not in page


def test_the_still_and_the_turnable_scene_agree_in_size_and_place(monkeypatch):
    if not scenes.can_render():
        pytest.skip("no OpenGL here")
    balls = [sphere(), sphere(radius=0.5)]
    turnable = viz.scene(balls, alt="Two balls.")
    monkeypatch.setattr(scenes, "can_render", lambda: False)
    still = viz.scene(balls, alt="Two balls.")
    for panel in (0, 1):
        np.testing.assert_allclose(inked(turnable.png, panel, 2), inked(still.png, panel, 2), rtol=0.04)


def test_panels_share_one_scale(no_gl):
    shown = viz.scene([sphere(), sphere(radius=0.5)], alt="Two balls.")
    (high, _), (low, _) = inked(shown.png, 0, 2), inked(shown.png, 1, 2)
    assert low / high == pytest.approx(0.5, rel=0.06)  # perspective brings the larger ball nearer


def test_the_third_axis_points_up(no_gl):
    ball = sphere()
    red_above = np.where(ball.vertices[:, 2:] > 0, [1.0, 0, 0], [0, 0, 1.0])
    image = pixels(viz.scene([ball], [red_above], alt="A ball.", flat=True).png)
    top, bottom = np.array_split(image, 2)
    assert (top[..., 0] > top[..., 2] + 100).sum() > 2 * (top[..., 2] > top[..., 0] + 100).sum()
    assert (bottom[..., 2] > bottom[..., 0] + 100).sum() > (bottom[..., 0] > bottom[..., 2] + 100).sum()


def test_display_mesh_is_small_and_keeps_the_colours():
    ball = sphere(n_rings=80)  # 12,802 vertices
    colours = viz.colours_from_coordinates(ball.vertices)
    vertices, faces, shown, marks = scenes._panel(ball, colours, np.array([5]), 3000)
    assert len(vertices) <= 3001
    assert faces.max() < len(vertices)
    assert vertices.dtype == np.float32
    np.testing.assert_allclose(shown, 0.1 + 0.45 * (vertices + 1), atol=0.04)
    np.testing.assert_allclose(marks, ball.vertices[[5]], atol=1e-6)


def test_every_vertex_lies_inside_its_panel(no_gl):
    """A shape far from the origin, long towards the eye: nothing may touch the frame."""
    ball = sphere()
    long = replace(ball, vertices=ball.vertices * [3, 1, 1] + 100)
    image = pixels(viz.scene([long], alt="A long ball.").png)
    frame = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
    assert frame.min() > 250


@needs_gl
def test_turnable_scene_is_a_vtkjs_file_with_one_renderer_a_panel():
    shown = viz.scene([sphere(), sphere()], alt="Two balls.")
    state = json.loads(zipfile.ZipFile(io.BytesIO(shown.data)).read("index.json"))
    renderers = [d for d in state["scene"]["dependencies"] if "Renderer" in d["type"]]
    cameras = {r["properties"].get("activeCamera") or str(r["calls"]) for r in renderers}
    assert len([r for r in renderers if "Renderer" in r["type"]]) >= 2
    assert cameras
    assert all(a["content"] for a in state["hashes"].values())


def test_more_than_two_shapes_in_a_row_are_a_still_overview():
    balls = [sphere(5)] * 4
    wide, narrow = viz.scene(balls, alt="Four balls.", columns=4), viz.scene(balls, alt="Four balls.")
    assert (wide.rows, wide.data) == (1, None)
    assert "OpenGL" not in wide.html()
    assert (narrow.rows, narrow.columns) == (2, 2)
    assert (narrow.data is not None) == scenes.can_render()


@needs_gl
def test_pages_share_the_viewer_and_notebooks_bring_their_own(monkeypatch):
    shown = viz.scene([sphere()], alt="A ball.")
    monkeypatch.delenv("FMSYNC_SHARED_VIEWER", raising=False)
    alone = shown._repr_mimebundle_()["text/html"]
    monkeypatch.setenv("FMSYNC_SHARED_VIEWER", "1")
    shared = shown._repr_mimebundle_()["text/html"]
    assert "<iframe" in alone
    assert "<iframe" not in shared
    assert len(alone) - len(shared) > 900_000  # the viewer itself
    assert base64.b64encode(shown.data).decode() in shared


def test_drawing_opens_no_network_connection():
    """PyVista's own exporter starts a web server and downloads a viewer; ours must not."""
    code = (
        "import socket, numpy as np\n"
        "from types import SimpleNamespace\n"
        "def refuse(*a, **k): raise OSError('network')\n"
        "socket.socket.connect = socket.getaddrinfo = socket.socket.bind = refuse\n"
        "from fmsync import viz\n"
        "m = SimpleNamespace(vertices=np.eye(4)[:, :3], faces=[[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]])\n"
        "viz.scene([m], alt='x')._repr_mimebundle_()\n"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert ran.stderr == ""


def test_colour_bar_shows_the_limits_and_the_label(no_gl):
    ball = sphere()
    shown = viz.scene([ball], [ball.vertices[:, 2]], alt="A ball.", clim=(-2, 3.5), label="height (m)")
    assert "−2" in shown.colour_bar
    assert "3.5" in shown.colour_bar
    assert "height (m)" in shown.colour_bar


@pytest.mark.parametrize("scalars", [None, [np.full((sphere().vertices.shape[0], 3), 0.5)]])
def test_words_stand_below_shapes_without_values(no_gl, scalars):
    shown = viz.scene([sphere()], scalars, alt="A ball.", label="red: <many>")
    assert "red: &lt;many&gt;" in shown.html()
    assert "gradient" not in shown.html()
    assert "fm-bar" not in viz.scene([sphere()], scalars, alt="A ball.").html()


def test_marks_are_drawn_in_the_palette(no_gl):
    image = pixels(viz.scene([sphere()], alt="A ball.", points=[[0, 800]], flat=True).png)
    wanted = np.array([int(viz.PALETTE[0][i : i + 2], 16) for i in (1, 3, 5)])
    assert (np.abs(image - wanted).max(axis=2) < 3).sum() > 20


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"meshes": []}, "meshes or alt is empty"),
        ({"alt": " "}, "meshes or alt is empty"),
        ({"scalars": []}, "scalars has 0 entries for 1 meshes"),
        ({"scalars": [np.zeros(3)]}, r"scalars\[0\] has shape \(3,\)"),
        ({"titles": ["a", "b"]}, "titles has 2 entries"),
        ({"points": [[0], [1]]}, "points has 2 entries"),
        ({"meshes": [SimpleNamespace(vertices=np.zeros((4, 3)), faces=None)]}, r"meshes\[0\] is a point cloud"),
        ({"meshes": [Shape(np.eye(3), None, "cloud")]}, r"meshes\[0\] is a point cloud"),
    ],
)
def test_bad_scenes_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        viz.scene(**({"meshes": [sphere()], "alt": "A ball."} | arguments))


def test_heatmaps_share_a_symmetric_scale():
    picture = viz.heatmaps([np.diag([1.0, -4.0]), np.eye(2)], ["a", "b"], alt="Two.")
    image = pixels(picture.png)
    blue = (np.abs(image - [5, 48, 97]).max(axis=2) < 3).sum()  # RdBu_r at -4: only the first panel's entry
    assert blue > 500
    assert (np.abs(image - [103, 0, 31]).max(axis=2) < 3).sum() < blue / 2  # nothing reaches +4 but the colour bar


@pytest.mark.parametrize(
    ("matrices", "titles", "message"),
    [
        ([], None, "matrices is empty"),
        ([np.zeros(3)], None, r"matrices\[0\]: expected \(n, m\), got shape \(3,\)"),
        ([np.eye(2)], ["a", "b"], "2 titles for 1 matrices"),
    ],
)
def test_bad_heatmaps_are_refused(matrices, titles, message):
    with pytest.raises(ValueError, match=message):
        viz.heatmaps(matrices, titles, alt="Bad.")


def test_axes_take_labels_and_a_picture_adds_the_one_missing_legend():
    fig, ax = viz.subplots(figsize=(3, 2), xlabel="x", yscale="log", ylim=(1, 9))
    assert (ax.get_xlabel(), ax.get_yscale(), ax.get_ylim()) == ("x", "log", (1, 9))
    ax.plot([1, 2], [3, 4], label="a line")
    viz.picture(fig, alt="A line.")
    assert [text.get_text() for text in ax.get_legend().texts] == ["a line"]
    fig, (left, right) = viz.subplots(1, 2)
    for one in (left, right):
        one.plot([1, 2], label="a line")
    left.legend()
    viz.picture(fig, alt="Two lines, one legend.")
    assert right.get_legend() is None


def test_picture_carries_its_words_and_closes_its_figure():
    fig, ax = plt.subplots()
    ax.plot([0, 1])
    shown = viz.picture(fig, alt='A "line".')
    assert fig.number not in plt.get_fignums()
    assert 'alt="A &quot;line&quot;."' in shown._repr_mimebundle_()["text/html"]
    with pytest.raises(ValueError, match="alt is empty"):
        viz.picture(plt.figure(), alt="")


def test_colours_follow_position():
    colours = viz.colours_from_coordinates(sphere().vertices)
    assert colours.min() == pytest.approx(0.1)
    assert colours.max() == pytest.approx(1.0)
    np.testing.assert_allclose(viz.colours_from_coordinates([[1, 2, 3], [1, 2, 4]])[:, :2], 0.1)


def growing(count, size=(2, 1.5)):
    for k in range(count):
        fig, ax = plt.subplots(figsize=size)
        ax.plot([0, 1], [0, k])
        ax.set_ylim(0, count)
        yield fig


def test_player_has_all_frames_and_rests_on_the_last():
    open_before = plt.get_fignums()
    shown = viz.player(growing(5), alt="A <steeper> line.", seconds=0.2)
    assert plt.get_fignums() == open_before
    assert (shown.count, shown.columns) == (5, 3)
    with Image.open(io.BytesIO(shown.webp)) as sheet:
        frames = [f for row in np.split(np.asarray(sheet.convert("RGB")), 2) for f in np.split(row, 3, axis=1)]
    assert len({f.tobytes() for f in frames[:5]}) == 5
    assert frames[5].min() == 255
    still = Image.open(io.BytesIO(shown.png)).convert("RGB")
    assert still.width * still.height > 1.7 * frames[4].size / 3  # sharper: for paper
    still = np.asarray(still.resize(frames[4].shape[1::-1], Image.Resampling.LANCZOS), dtype=int)
    apart = [np.abs(frame - still).mean() for frame in frames[:5]]
    assert np.argmin(apart) == 4, apart
    assert apart[4] < 3  # fewer colours, softer letters
    page = shown._repr_mimebundle_()["text/html"]
    assert page.count('"A &lt;steeper&gt; line."') == 2
    assert 'data-columns="3" data-rows="2" data-time="200"' in page
    assert "50.000% 100%/300% 200%" in page  # the last frame is the second one of the second row
    assert 'class="fm-still" style="display:none"' in page


def test_bad_players_are_refused():
    with pytest.raises(ValueError, match="alt is empty"):
        viz.player(growing(2), alt=" ")
    with pytest.raises(ValueError, match="at least two of one size"):
        viz.player(growing(1), alt="One.")
    with pytest.raises(ValueError, match="at least two of one size"):
        viz.player([*growing(1), *growing(1, (3, 3))], alt="Two sizes.")

    def noise():
        for image in np.random.default_rng(0).random((4, 300, 300)):
            fig, ax = plt.subplots(figsize=(4, 4))
            ax.imshow(image, interpolation="nearest")
            yield fig

    with pytest.raises(ValueError, match="bytes: draw fewer or smaller frames"):
        viz.player(noise(), alt="Noise.")


def test_walk_ends_where_the_chain_does():
    eye = np.array([0.78, -0.45, 0.43]) / np.linalg.norm([0.78, -0.45, 0.43])
    image = pixels(viz.walk_on_sphere(np.tile(eye, (30, 1)), "A chain that rests.", frames=2).png)
    wanted = np.array([int(viz.PALETTE[1][i : i + 2], 16) for i in (1, 3, 5)])
    rows, columns = np.nonzero(np.abs(image - wanted).max(axis=2) < 3)
    height, width = image.shape[:2]
    assert abs(columns.mean() / width - 0.5) < 0.05  # what looks at the eye is in the middle
    assert abs(rows.mean() / height - 0.5) < 0.08


@pytest.mark.parametrize(
    ("points", "message"),
    [(np.ones((40, 3)), r"points has shape \(40, 3\)"), (np.eye(3), "3 points for 20 frames")],
)
def test_bad_walks_are_refused(points, message):
    with pytest.raises(ValueError, match=message):
        viz.walk_on_sphere(points, "A chain.")


def test_type_too_small_for_a_phone_is_raised():
    fig, ax = plt.subplots()
    small, large = ax.annotate("small", (0.2, 0.2), fontsize=5), ax.set_title("large", fontsize=15)
    viz.picture(fig, alt="Two sizes of type.")
    assert small.get_fontsize() == 10
    assert large.get_fontsize() == 15


def two_balls(**changed):
    """Arguments of an explorer: four vertices to choose from, one image and a region each, or twenty images."""
    ball, other = sphere(), sphere(radius=1.2, name="other")
    chosen = np.array([0, 100, 300, 700])
    image = np.stack([chosen, chosen[::-1]], axis=1)
    states = [
        viz.State("map", (image[:, :1], image[:, :1])),
        viz.State("draws", (image, image), ([0.5] * 4, [0.25] * 4), (chosen, chosen), 0.1, "β = 1"),
        viz.State("draws", (image[:, ::-1], image), ([0.1] * 4, [0.2] * 4), (chosen, chosen), 0.1, "β = 2"),
    ]
    return {"shapes": [ball, other], "vertices": (chosen, chosen), "states": states, "alt": "Two balls."} | changed


def unpacked(shown):
    head, _, arrays = zlib.decompress(base64.b64decode(shown.data)).partition(b"\n")
    return json.loads(head), arrays


def test_explorer_carries_shapes_and_images_in_small_integers(no_gl):
    given = two_balls()
    shown = viz.explorer(**given, truth=given["vertices"], start=1)
    head, arrays = unpacked(shown)
    ball = given["shapes"][0]
    assert [s["name"] for s in head["shapes"]] == ["ball", "other"]
    assert head["vertices"] == [[0, 100, 300, 700]] * 2
    assert [(s["view"], s["noise"], s["temperature"], s["images"], s["region"]) for s in head["states"]] == [
        ("map", 0.0, "", 1, False),
        ("draws", 0.1, "β = 1", 2, True),
        ("draws", 0.1, "β = 2", 2, True),
    ]
    count = len(ball.vertices)
    points = np.frombuffer(arrays, "<i2", 3 * count).reshape(-1, 3) * head["scale"]
    np.testing.assert_allclose(points, ball.vertices, atol=1e-4)
    faces = np.frombuffer(arrays, "<u2", 3 * len(ball.faces), 6 * count).reshape(-1, 3)
    np.testing.assert_array_equal(faces, ball.faces)
    last = arrays[-(8 + 16) :]  # centres and radii of the last state, from the second shape to the first
    np.testing.assert_array_equal(np.frombuffer(last, "<u2", 4), given["vertices"][1])
    np.testing.assert_allclose(np.frombuffer(last, "<f4", 4, 8), 0.2)


def test_explorer_thins_large_shapes_and_carries_vertices_to_the_nearest_drawn_ones(no_gl):
    ball = sphere(n_rings=80)  # 12,802 vertices
    ball = replace(ball, vertices=ball.vertices + 10)  # drawn about the origin
    chosen = np.array([0, 5000, 12801])
    head, arrays = unpacked(
        viz.explorer([ball, ball], (chosen, chosen), [viz.State("map", (chosen[:, None],) * 2)], alt="Large balls.")
    )
    count, faces = head["shapes"][0]["points"], head["shapes"][0]["faces"]
    assert count <= 5001
    points = np.frombuffer(arrays, "<i2", 3 * count).reshape(-1, 3) * head["scale"]
    picks = np.frombuffer(arrays, "<u2", 3, 6 * (count + faces))
    np.testing.assert_allclose(points[picks], ball.vertices[chosen] - 10, atol=0.05)


def test_books_share_the_script_of_explorers_and_notebooks_bring_their_own(no_gl, monkeypatch):
    shown = viz.explorer(**two_balls(alt='Two "balls".'))
    monkeypatch.delenv("FMSYNC_SHARED_VIEWER", raising=False)
    alone = shown._repr_mimebundle_()["text/html"]
    monkeypatch.setenv("FMSYNC_SHARED_VIEWER", "1")
    shared = shown.html()
    assert "DecompressionStream" in alone
    assert "DecompressionStream" not in shared
    assert shown.data in shared
    assert 'alt="Two &quot;balls&quot;."' in shared
    assert "http" not in alone  # it asks for nothing


def test_the_still_of_an_explorer_shows_where_the_images_are(no_gl):
    chosen = np.array([0])
    ball = sphere(n_rings=40)
    front = int((ball.vertices @ scenes.AXES[:, 2]).argmax())
    state = viz.State("map", (np.array([[front]]), np.array([[front]])))
    image = pixels(viz.explorer([ball, ball], (chosen, chosen), [state], alt="Balls.").png)
    reddish = (image[..., 0] > image[..., 2] + 60).sum(axis=0)
    middle = len(reddish) // 2
    assert reddish[:middle].sum() < 20
    assert reddish[middle:].sum() > 20


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"shapes": [sphere()]}, "give two shapes with faces"),
        ({"states": []}, "states or alt is empty"),
        ({"alt": " "}, "states or alt is empty"),
        ({"vertices": ([0], [99999])}, r"vertices\[1\]\[0\] = 99999 is outside"),
        ({"states": [viz.State("map", (np.zeros((3, 1), int),) * 2)]}, r"states\[0\].images\[0\] has 3 rows for 4"),
        ({"truth": (np.arange(4), np.arange(5))}, r"truth\[1\] has 5 rows for 4"),
    ],
)
def test_bad_explorers_are_refused(changed, message):
    with pytest.raises(ValueError, match=message):
        viz.explorer(**two_balls(**changed))


def test_an_explorer_too_heavy_for_a_page_is_refused(no_gl, monkeypatch):
    module = sys.modules["fmsync.viz.explorer"]  # the package has a function of this name
    assert module._MOST_BYTES == 1_000_000  # which take seconds to compress
    monkeypatch.setattr(module, "_MOST_BYTES", 100_000)
    chosen = np.arange(600)
    images = np.random.default_rng(0).integers(0, 802, (600, 60))
    state = viz.State("map", (images, images))
    viz.explorer([sphere(), sphere()], (chosen, chosen), [state], alt="Enough.")
    with pytest.raises(ValueError, match="give fewer vertices or states, 100000 at most"):
        viz.explorer([sphere(), sphere()], (chosen, chosen), [state, state], alt="Much.")
