"""Turnable scenes of shapes that stay alive in a static page, and a shaded still where there is no OpenGL."""

import base64
import functools
import html
import io
import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, to_rgb
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from fmsync import checks
from fmsync.extras import require
from fmsync.shape import Shape
from fmsync.viz.figures import PALETTE, Limits, Shown, image_tag

_MAX_VERTICES = 10_000  # of one displayed scene, shared by its meshes: what a page can carry and a phone can turn
_PIXELS = 1280  # width of the still: twice that of the text of a page
_VIEW = np.array([0.74, -0.61, 0.28]) / np.linalg.norm([0.74, -0.61, 0.28])  # from the scene to the eye, z up
AXES = np.stack([np.cross([0, 0, 1], _VIEW), np.zeros(3), _VIEW], axis=1)  # columns: right, up, towards the eye
AXES[:, 0] /= np.linalg.norm(AXES[:, 0])
AXES[:, 1] = np.cross(_VIEW, AXES[:, 0])
_TAN = np.tan(np.pi / 12)  # half of 30 degrees, the angle of view that vtk.js always takes
_GREY = to_rgb("#b9c4cf")
_NO_GL = "Still picture: OpenGL is missing here. For the turnable scene: apt-get install libegl1 libgl1"

# VTK aborts the whole process when it finds no OpenGL, so another process has to try first
_PROBE = """
from vtkmodules.vtkRenderingOpenGL2 import vtkOpenGLRenderer
from vtkmodules.vtkRenderingCore import vtkRenderWindow
import trame_vtk
w = vtkRenderWindow(); w.SetOffScreenRendering(1); w.SetSize(8, 8); w.AddRenderer(vtkOpenGLRenderer()); w.Render()
raise SystemExit(0 if w.SupportsOpenGL() else 1)
"""


# of one shape: vertices (v, 3), faces (f, 3), colours (v, 3), marked positions (m, 3)
Panel = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, repr=False)
class Scene(Shown):
    """A drawn scene: a still, and ``data``, the one that turns.

    ``data`` is a zipped vtk.js file, or None of an overview, or where only the still could be drawn. ``rows`` and
    ``columns`` are those of the grid of panels with ``titles``; ``colour_bar`` is HTML, its words too, or empty.
    """

    data: bytes | None
    rows: int
    columns: int
    titles: tuple[str, ...]
    colour_bar: str

    def html(self) -> str:
        """The built book holds one viewer for all its scenes; elsewhere (JupyterLab) each brings its own."""
        width, height = (int.from_bytes(self.png[k : k + 4], "big") for k in (16, 20))  # of the PNG header
        still = image_tag(self.png, self.alt, 720)
        moving = ""
        if self.data is not None and os.environ.get("FMSYNC_SHARED_VIEWER"):
            moving = f'<script type="text/plain">{base64.b64encode(self.data).decode()}</script>'
        elif self.data is not None:
            page = io.StringIO()
            require("trame_vtk.tools.vtksz2html", "viz").write_html(self.data, page)
            moving = (
                f'<iframe title="{html.escape(self.alt)}" loading="lazy" srcdoc="{html.escape(page.getvalue())}" '
                'style="position:absolute;inset:0;width:100%;height:100%;border:0"></iframe>'
            )
        grid = f"display:grid;grid-template:repeat({self.rows},1fr)/repeat({self.columns},1fr)"
        titles = "".join(f"<span>{html.escape(t)}</span>" for t in self.titles)
        overview = self.columns > 2
        below = f'<figcaption class="fm-bar">{self.colour_bar}</figcaption>' if self.colour_bar else ""
        note = "" if self.data is not None or overview else f'<figcaption class="fm-note">{_NO_GL}</figcaption>'
        return (
            f'<figure class="fm-scene{" fm-overview" if overview else ""}" style="margin:0"><div class="fm-stage" '
            f'data-rows="{self.rows}" data-columns="{self.columns}" '
            f'style="position:relative;background:white;color:black;aspect-ratio:{width}/{height}">{still}{moving}'
            f'<div class="fm-titles" style="position:absolute;inset:0;pointer-events:none;text-align:center;{grid}">'
            f"{titles}</div></div>{below}{note}</figure>"
        )


def _drawable(name: str, mesh: Any) -> Any:
    if not (hasattr(mesh, "vertices") and hasattr(mesh, "faces")):
        raise ValueError(f"{name}: expected a shape, got {type(mesh).__name__}")
    if mesh.faces is None:
        raise ValueError(f"{name} is a point cloud: only shapes with faces can be drawn")
    return mesh


@checks.checked(meshes=_drawable, points="K < V")
def scene(
    meshes: Sequence[Shape],
    scalars: Sequence[ArrayLike] | None = None,
    titles: Sequence[str] | None = None,
    *,
    alt: str,
    cmap: str = "viridis",
    clim: Limits = None,
    label: str = "",
    points: Sequence[ArrayLike] | None = None,
    flat: bool = False,
    columns: int = 2,
) -> Scene:
    """Shapes side by side at equal scale, upright (z is up); turning one turns them all.

    * ``meshes``: K shapes, or other objects with ``vertices`` (V, 3) and ``faces`` (F, 3), in one common unit. A scene
      shows at most 10,000 vertices, and every one of them takes the colour of the nearest given vertex.
    * ``scalars``: K arrays, each (V,) for ``cmap`` or (V, 3) red-green-blue in [0, 1]; None draws plain grey shapes.
    * ``titles``, ``alt``: K strings, by default the ``name`` of each mesh, and a sentence or two on what is shown.
    * ``cmap``, ``clim``, ``label``: colour map, its limits (by default the range of all scalars), and what the colours
      mean, in words below.
    * ``points``: K arrays of vertex numbers to mark; the k-th mark has the same colour on every shape.
    * ``flat``: light evenly, so that a colour means the same everywhere: for uncertainties.
    * ``columns``: shapes in a row. More than two are too small to turn and make an overview, which is a still.

    >>> from types import SimpleNamespace
    >>> tetrahedron = SimpleNamespace(vertices=np.eye(4)[:, :3], faces=[[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]])
    >>> scene([tetrahedron], [[0, 1, 2, 3]], ["tetrahedron"], alt="A tetrahedron.")
    <Scene: A tetrahedron.>
    """
    titles = [getattr(m, "name", "") for m in meshes] if titles is None else list(titles)
    _check(meshes, alt, scalars=scalars, titles=titles, points=points)
    checks.one_of("cmap", cmap, mpl.colormaps)
    count = len(meshes)
    colours, colour_bar = _colours(meshes, scalars, cmap, clim, label)
    marks = [np.empty(0, int)] * count if points is None else [np.asarray(p, int) for p in points]
    panels = [_panel(m, c, p, _MAX_VERTICES // count) for m, c, p in zip(meshes, colours, marks)]
    columns = min(columns, count)
    rows = -(-count // columns)
    across, upward, near = (np.concatenate([v for v, _, _, _ in panels]) @ AXES).T
    aspect = float(np.clip(np.ptp(across) / np.ptp(upward), 0.75, 1.6 if columns < 4 else 1.05))  # of one panel
    # every vertex inside its panel, and room for the title, which is no smaller in a small one
    distance = 1.16 * (near + np.maximum(np.abs(upward), np.abs(across) / aspect) / _TAN).max()
    size = (_PIXELS, round(_PIXELS / columns / aspect) * rows)
    png, data = (_draw_vtk if can_render() else _draw_still)(panels, rows, columns, size, distance, flat)
    return Scene(png, alt, data, rows, columns, tuple(titles), colour_bar)


@checks.checked(mesh=_drawable, vertex=">= 0")
def facing(mesh: Shape, vertex: int) -> Shape:
    """The shape turned about its upright axis until one vertex faces the reader.

    >>> facing(Shape(np.eye(3), [[0, 1, 2]], "triangle"), 0).vertices.round(2)[2].tolist()
    [0.0, 0.0, 1.0]
    """
    faces = np.asarray(_drawable("mesh", mesh).faces)
    corners = mesh.vertices[faces[np.any(faces == vertex, axis=1)]]  # (k, 3, 3)
    x, y, _ = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)  # outward normal
    turn = np.arctan2(_VIEW[1], _VIEW[0]) - np.arctan2(y, x)
    c, s = np.cos(turn), np.sin(turn)
    return Shape(mesh.vertices @ [[c, s, 0], [-s, c, 0], [0, 0, 1]], mesh.faces, mesh.name)


def _check(meshes: Sequence[Shape], alt: str, **given: Sequence[object] | None) -> None:
    if not len(meshes) or not alt.strip():
        raise ValueError("meshes or alt is empty: give at least one shape, and a sentence that says what is shown")
    for k, mesh in enumerate(meshes):
        _drawable(f"meshes[{k}]", mesh)  # the checks ask only what is no Shape
    for name, values in given.items():
        if values is not None and len(values) != len(meshes):
            raise ValueError(f"{name} has {len(values)} entries for {len(meshes)} meshes: give one each")


@functools.cache
def can_render() -> bool:
    """Whether VTK finds OpenGL here; tried once, in another process, because VTK aborts without it."""
    _choose_egl()
    return subprocess.run([sys.executable, "-c", _PROBE], capture_output=True).returncode == 0


def _choose_egl() -> None:
    if sys.platform == "linux":  # EGL needs no display; VTK reads this when it is first imported
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")


def _colours(
    meshes: Sequence[Shape], scalars: Sequence[ArrayLike] | None, cmap: str, clim: Limits, label: str
) -> tuple[list[np.ndarray], str]:
    """One (V, 3) array a mesh, and in HTML the colour bar, when there are values to read off, and its words."""
    caption = f'<div style="text-align:center">{html.escape(label)}</div>' if label else ""
    if scalars is None:
        return [np.tile(_GREY, (len(m.vertices), 1)) for m in meshes], caption
    given = [np.asarray(s, dtype=float) for s in scalars]
    for k, (m, s) in enumerate(zip(meshes, given)):
        if s.shape not in ((len(m.vertices),), (len(m.vertices), 3)):
            raise ValueError(f"scalars[{k}] has shape {s.shape}: give (V,) or (V, 3) with V = {len(m.vertices)}")
    values = [s.ravel() for s in given if s.ndim == 1]
    if not values:
        return [np.clip(s, 0, 1) for s in given], caption
    if clim is None:
        clim = (min(v.min() for v in values), max(v.max() for v in values))
    norm, table = Normalize(clim[0], clim[1], clip=True), mpl.colormaps[cmap]
    colours = [table(norm(s))[:, :3] if s.ndim == 1 else np.clip(s, 0, 1) for s in given]
    stops = ",".join(mpl.colors.to_hex(table(t)) for t in np.linspace(0, 1, 12))
    bar = f'<span style="flex:1;height:.7em;background:linear-gradient(90deg,{stops})"></span>'
    ends = [f"{c:.3g}".replace("-", "−") for c in clim]
    return colours, f'<div style="display:flex;gap:.6em;align-items:center">{ends[0]}{bar}{ends[1]}</div>{caption}'


def _panel(mesh: Shape, colours: np.ndarray, marks: np.ndarray, limit: int) -> Panel:
    """Centred upright display mesh: vertices (v, 3), faces (f, 3), colours (v, 3), marked positions (m, 3)."""
    given = centred(mesh.vertices)
    vertices, faces, nearest = display_mesh(given, mesh.faces, limit)
    return vertices, faces, colours[nearest], given[marks]


def centred(vertices: ArrayLike) -> np.ndarray:
    """Vertices (V, 3) in single precision, the middle of their box at the origin."""
    given = np.asarray(vertices, dtype=np.float32)
    return given - (given.max(axis=0) + given.min(axis=0)) / 2


def display_mesh(given: np.ndarray, faces: ArrayLike | None, limit: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (v, 3) and faces (f, 3) of a copy of at most ``limit`` vertices, and the nearest given ones."""
    triangles = np.asarray(faces, dtype=np.int64)
    if len(given) <= limit:
        return given, triangles, np.arange(len(given))
    _choose_egl()
    pv = require("pyvista", "viz")
    shown = pv.PolyData.from_regular_faces(given, triangles).decimate(1 - limit / len(given))
    points = np.asarray(shown.points, dtype=np.float32)
    return points, shown.regular_faces, cKDTree(given).query(points)[1]


def _draw_vtk(
    panels: list[Panel], rows: int, columns: int, size: tuple[int, int], distance: float, flat: bool
) -> tuple[bytes, bytes | None]:
    pv = require("pyvista", "viz")
    plotter = pv.Plotter(shape=(rows, columns), window_size=size, off_screen=True, border=False)
    plotter.set_background("white", all_renderers=True)
    light = {"lighting": False} if flat else {"ambient": 0.25, "diffuse": 0.85, "smooth_shading": True}
    for k, (vertices, faces, colours, marks) in enumerate(panels):
        plotter.subplot(k // columns, k % columns)
        mesh = pv.PolyData.from_regular_faces(vertices, faces)
        mesh["colour"] = np.round(255 * colours).astype(np.uint8)
        plotter.add_mesh(mesh, scalars="colour", rgb=True, **light)
        for j, mark in enumerate(marks):
            ball = pv.Sphere(radius=0.011 * distance, center=mark, theta_resolution=14, phi_resolution=10)
            plotter.add_mesh(ball, color=PALETTE[j % len(PALETTE)], smooth_shading=True)
    plotter.link_views()
    camera = plotter.camera
    camera.position, camera.focal_point, camera.up = distance * _VIEW, (0, 0, 0), (0, 0, 1)
    camera.reset_clipping_range()
    png = io.BytesIO()
    plotter.screenshot(png)
    data = _export(plotter.render_window) if columns <= 2 else None
    plotter.close()
    return png.getvalue(), data


def _export(window: Any) -> bytes:
    """Zipped vtk.js scene of a render window, without the web server (and its downloads) PyVista starts for it."""
    serializers = require("trame_vtk.modules.vtk.serializers", "viz")
    serializers.initialize_serializers()
    context = serializers.SynchronizationContext()
    context.set_ignore_last_dependencies(True)
    state = serializers.serialize(None, window, serializers.reference_id(window), context, 1)
    camera = window.GetRenderers().GetFirstRenderer().GetActiveCamera()
    state["extra"] = {
        "vtkRefId": serializers.reference_id(window),
        "centerOfRotation": camera.GetFocalPoint(),
        "camera": serializers.reference_id(camera),
    }
    arrays = {a["hash"]: a for a in serializers.extract_array_hash(state)}
    arrays = {key: a | {"content": context.get_cached_data_array(key)} for key, a in arrays.items()}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        entry = zipfile.ZipInfo("index.json")  # with a fixed date: same scene, same bytes
        archive.writestr(entry, json.dumps({"hashes": arrays, "scene": state}), zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def _draw_still(
    panels: list[Panel], rows: int, columns: int, size: tuple[int, int], distance: float, flat: bool
) -> tuple[bytes, bytes | None]:
    """The same view by matplotlib: triangles shaded and painted from the back."""
    fig, axes = plt.subplots(rows, columns, figsize=(size[0] / 100, size[1] / 100), squeeze=False, layout="none")
    fig.subplots_adjust(0, 0, 1, 1, 0, 0)
    edge = _TAN * size[0] * rows / (columns * size[1])  # half the width of a panel at unit distance
    light = AXES @ [-0.3, 0.4, 1.0] / np.linalg.norm([-0.3, 0.4, 1.0])
    for ax in axes.flat:
        ax.set_axis_off()
        ax.set(xlim=(-edge, edge), ylim=(-_TAN, _TAN))
    for ax, (vertices, faces, colours, marks) in zip(axes.flat, panels):
        corners = vertices[faces]  # (f, 3, 3)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        shade = 1.0 if flat else 0.3 + 0.7 * np.abs(normals @ light)[:, None]
        order = np.argsort(corners.mean(axis=1) @ _VIEW)
        paint = np.clip(colours[faces].mean(axis=1) * shade, 0, 1)[order]
        triangles = _project(corners[order], distance)  # (f, 3, 2)
        painted = PolyCollection(triangles, facecolors=paint, edgecolors=paint, linewidths=0.3)  # type: ignore[arg-type]
        ax.add_collection(painted)
        for j, mark in enumerate(marks):
            ax.plot(*_project(mark, distance), "o", ms=8, color=PALETTE[j % len(PALETTE)], mec="white")
    png = io.BytesIO()
    fig.savefig(png, format="png", dpi=100, facecolor="white")
    plt.close(fig)
    return png.getvalue(), None


def _project(positions: np.ndarray, distance: float) -> np.ndarray:
    seen = positions @ AXES
    return seen[..., :2] / (distance - seen[..., 2:])
