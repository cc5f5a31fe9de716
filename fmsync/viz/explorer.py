"""Two shapes that answer a click: choose a vertex on one, and its images light up on the other."""

import base64
import html
import json
import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from fmsync import checks
from fmsync.shape import Shape
from fmsync.viz.figures import Shown, image_tag
from fmsync.viz.scenes import AXES, centred, display_mesh, scene

SCRIPT = Path(__file__).with_suffix(".js")
_MAX_VERTICES = 5000  # of each drawn shape
_MOST_BYTES = 1_000_000
_GLOW = 0.03  # width of the light about an image in square roots of the area; half of it for a single image
_RAMP = LinearSegmentedColormap.from_list("glow", ["#c3cbd3", "#f0b43c", "#dd6a1b", "#9c1f45"])  # lightness falls

Both = Sequence[np.ndarray]  # of the vertices chosen on the first shape, and on the second


@dataclass(frozen=True, eq=False)
class State:
    """One answer to where vertices go, at one position of the controls.

    * ``view``: what the switch calls it, e.g. ``"posterior"``.
    * ``images``: for the S vertices to choose from on the first shape (S, K) vertices of the second: one of a map, K of
      draws; and the same from the second shape to the first.
    * ``radius``: radii (S,) of the regions about the synchronised images, in the unit of the vertices, both ways.
    * ``centres``: vertices (S,) at the centres of these regions, both ways; with one image it is the centre itself.
    * ``noise``, ``temperature``: positions of the sliders, a variance, and words such as ``"β = 1"``; ``""`` for a view
      without temperatures.
    """

    view: str
    images: Both
    radius: Both | None = None
    centres: Both | None = None
    noise: float = 0.0
    temperature: str = ""


@dataclass(frozen=True, repr=False)
class Explorer(Shown):
    """A still, and ``data`` for the script: a line of JSON, then arrays; deflated, in base64."""

    data: str

    def html(self) -> str:
        """The built book holds one script for all explorers; elsewhere (JupyterLab) each brings its own."""
        script = "" if os.environ.get("FMSYNC_SHARED_VIEWER") else SCRIPT.read_text(encoding="utf-8")
        return (
            f'<div class="fm-explorer" role="group" aria-label="{html.escape(self.alt)}">'
            f'{image_tag(self.png, self.alt, 720)}<script type="text/plain">{self.data}</script></div>'
            + (f"<script>{script}</script>" if script else "")
        )


def explorer(
    shapes: Sequence[Shape],
    vertices: Both,
    states: Sequence[State],
    *,
    alt: str,
    truth: Both | None = None,
    level: float = 0.9,
    start: int = 0,
    vertex: int | None = None,
) -> Explorer:
    """Two shapes side by side, upright (z is up), with all that is known of where some of their vertices go.

    A switch offers the views, sliders the noise and the temperature, as far as the states differ in them. A click, a
    tap or the arrow keys choose a vertex on either shape.

    * ``shapes``: two with faces, in one unit; more than 5,000 vertices are thinned out for display.
    * ``vertices``: (S_0,) and (S_1,) to choose from, a few hundred, evenly spread.
    * ``states``: what the controls choose among, one for each combination that can be set.
    * ``alt``: a sentence or two that say what is shown.
    * ``truth``: for every vertex to choose from, where it belongs on the other shape, (S_0,) and (S_1,): is marked.
    * ``level``, ``start``: what share the regions are to hold; number of the state that is shown first.
    * ``vertex``: number, among the vertices to choose from, of the one chosen first; by default one in front.

    A ValueError for other shapes, arrays of other sizes, or more than a megabyte.

    >>> ball = Shape(np.eye(4)[:, :3], [[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]], "a")
    >>> every = np.arange(4)
    >>> explorer([ball, ball], (every, every), [State("map", (every[:, None], every[:, None]))], alt="Twice the same.")
    <Explorer: Twice the same.>
    """
    _check(shapes, vertices, states, alt, truth)
    given = [centred(s.vertices) for s in shapes]
    drawn = [display_mesh(g, s.faces, _MAX_VERTICES) for g, s in zip(given, shapes)]
    near = [cKDTree(points).query(g)[1] for g, (points, _, _) in zip(given, drawn)]  # the drawn one of each vertex
    scale = float(max(np.abs(g).max() for g in given)) / 32000
    unit = float(np.sqrt(shapes[0].area))
    across, upward, towards = AXES.T @ given[0][vertices[0]].T
    row = int((towards - 2 * np.hypot(across, upward)).argmax())  # in front, and in the middle of the picture
    if vertex is not None:
        row = int(checks.indices("vertex", [vertex], len(vertices[0]), "vertices to choose from")[0])
    arrays: list[tuple[np.ndarray, str]] = []
    for k, (points, faces, _) in enumerate(drawn):
        arrays += [(np.rint(points / scale), "<i2"), (faces, "<u2"), (near[k][vertices[k]], "<u2")]
        if truth is not None:
            arrays.append((near[1 - k][truth[k]], "<u2"))
    for state in states:
        for k in (0, 1):
            images = np.sort(near[1 - k][state.images[k]], axis=1)
            arrays.append((np.diff(images, axis=1, prepend=0), "<u2"))  # small steps pack better
            if state.radius is not None:
                centres = state.images[k][:, 0] if state.centres is None else state.centres[k]
                arrays += [(near[1 - k][centres], "<u2"), (state.radius[k], "<f4")]
    told = [(s.view, float(s.noise), s.temperature, s.images[0].shape[1], s.radius is not None) for s in states]
    head = {
        "shapes": [{"name": s.name, "points": len(p), "faces": len(f)} for s, (p, f, _) in zip(shapes, drawn)],
        "vertices": [np.asarray(v).tolist() for v in vertices],
        "states": [dict(zip(("view", "noise", "temperature", "images", "region"), state)) for state in told],
        "scale": scale,
        "unit": unit,
        "glow": _GLOW,
        "truth": truth is not None,
        "level": level,
        "start": [start, row],
    }
    raw = json.dumps(head).encode() + b"\n" + b"".join(np.ascontiguousarray(a, kind).tobytes() for a, kind in arrays)
    data = base64.b64encode(zlib.compress(raw, 9)).decode()
    if len(data) > _MOST_BYTES:
        raise ValueError(f"the explorer has {len(data)} bytes: give fewer vertices or states, {_MOST_BYTES} at most")
    mark, images = vertices[0][row], states[start].images[0][row]
    titles = [f"{shapes[0].name}: vertex {mark}", f"{shapes[1].name}: {states[start].view}"]
    thin = [Shape(points, faces, s.name) for s, (points, faces, _) in zip(shapes, drawn)]
    lit = [glow(thin[0], []), glow(thin[1], near[1][images], _GLOW / 2 if len(images) == 1 else _GLOW)]
    still = scene(thin, lit, titles, points=[[near[0][mark]], []], alt=alt)
    return Explorer(still.png, alt, data)


@checks.checked(images="K < V", width=checks.positive)
def glow(shape: Shape, images: ArrayLike, width: float = _GLOW) -> np.ndarray:
    """Colours (V, 3) that show where the images (K,) of one vertex fall on a shape, e.g. under K draws.

    The light of one image falls off as a Gaussian of standard deviation ``width`` in square roots of the area. The
    colour shows the square root of the light, so that places of few images are seen as well.

    >>> ball = Shape(np.eye(4)[:, :3], [[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]])
    >>> glow(ball, [2, 2]).argmin(axis=0)[2]  # blue is least where the images are
    np.int64(2)
    """
    points = np.asarray(shape.vertices, dtype=float) / np.sqrt(shape.area)
    light = np.exp(-(cdist(points, points[images]) ** 2) / (2 * width**2)).sum(axis=1)
    return _RAMP(np.sqrt(light / max(light.max(), 1e-12)))[:, :3]


def _check(shapes: Sequence[Shape], vertices: Both, states: Sequence[State], alt: str, truth: Both | None) -> None:
    if len(shapes) != 2 or any(s.faces is None for s in shapes):
        raise ValueError(f"shapes: give two shapes with faces, not {len(shapes)} or point clouds")
    if not len(states) or not alt.strip():
        raise ValueError("states or alt is empty: give at least one state, and a sentence that says what is shown")
    sizes = [len(checks.indices(f"vertices[{k}]", vertices[k], len(shapes[k].vertices))) for k in (0, 1)]
    given = [(f"states[{n}].images", s.images) for n, s in enumerate(states)]
    given += [(f"states[{n}].centres", s.centres) for n, s in enumerate(states) if s.centres is not None]
    given += [] if truth is None else [("truth", truth)]
    for name, pair in given:
        for k in (0, 1):
            if len(pair[k]) != sizes[k]:
                raise ValueError(f"{name}[{k}] has {len(pair[k])} rows for {sizes[k]} vertices: give one each")
            checks.indices(f"{name}[{k}]", np.ravel(pair[k]), len(shapes[1 - k].vertices))
