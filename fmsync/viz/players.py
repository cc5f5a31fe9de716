"""Small players: a row of pictures to run through by a slider or a button, with a still for paper."""

import base64
import html
import io
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import ArrayLike
from PIL import Image

from fmsync import checks
from fmsync.viz.figures import PALETTE, STYLE, Picture, freeze, image_tag

_SCALE = 1.5  # device pixels for each CSS pixel of a frame: sharp enough on a phone, and half the bytes of two
_MOST_BYTES = 300_000
_COLOURS = 64  # of the frames
_SCRIPT = Path(__file__).with_suffix(".js")


@dataclass(frozen=True, repr=False)
class Player(Picture):
    """Frames to run through, joined into one WebP; ``png`` is the last one, for paper and where no script runs.

    ``webp`` holds ``count`` frames row by row, ``columns`` in a row; one is seen for ``seconds`` when they run.
    """

    webp: bytes
    count: int
    columns: int
    seconds: float

    def html(self) -> str:
        """The frame that is shown, a button that plays and pauses, a slider, and the still of print, in HTML."""
        last, rows = self.count - 1, -(-self.count // self.columns)
        with Image.open(io.BytesIO(self.png)) as still:
            shape = f"width:{self.width}px;max-width:100%;aspect-ratio:{still.width}/{still.height}"
        place = f"{100 * (last % self.columns) / max(self.columns - 1, 1):.3f}% 100%"
        image = f"url(data:image/webp;base64,{base64.b64encode(self.webp).decode()})"
        paper = image_tag(self.png, self.alt, self.width).replace("lazy", "eager")
        paper = paper.replace("<img ", '<img class="fm-still" style="display:none" ', 1)
        return (
            f'<figure class="fm-figure fm-moving" data-columns="{self.columns}" data-rows="{rows}" '
            f'data-time="{1000 * self.seconds:g}">'
            f'<div class="fm-frame" role="img" aria-label="{html.escape(self.alt)}" '
            f'style="{shape};background:{image} {place}/{100 * self.columns}% {100 * rows}%"></div>{paper}'
            '<div class="fm-controls"><button type="button">Play</button> '
            f'<input type="range" min="0" max="{last}" value="{last}" autocomplete="off" '
            'aria-label="frame"></div>'
            f"<script>{_SCRIPT.read_text(encoding='utf-8')}</script></figure>"
        )


@checks.checked(seconds=checks.positive)
def player(figures: Iterable[Figure], alt: str, *, seconds: float = 0.15) -> Player:
    """Join matplotlib figures of one size into a ``Player``, and close them.

    At least two ``figures``, e.g. a generator that draws them one by one, or one anew; ``alt`` says in one or two
    sentences what is shown and how it moves; ``seconds`` is the time of one frame. The last one is also the still. A
    ValueError for figures of unequal size, or more than 300 kB.

    >>> def frames():
    ...     for k in range(3):
    ...         fig, ax = plt.subplots()
    ...         ax.set(xlim=(0, k + 1))
    ...         yield fig
    >>> player(frames(), alt="An axis that grows.")
    <Player: An axis that grows.>
    """
    if not alt.strip():
        raise ValueError("alt is empty: say in a sentence what the player shows")
    stills, width, last = [], 0, None
    for figure in figures:
        width = round(figure.get_figwidth() * figure.dpi)
        stills.append(freeze(figure, _SCALE, laid_out=figure is last))
        last = figure
    images = [Image.open(io.BytesIO(still)).convert("RGB") for still in stills]
    if len(images) < 2 or len({image.size for image in images}) > 1:
        raise ValueError(f"{len(images)} figures of sizes {[i.size for i in images]}: give at least two of one size")
    columns = int(np.ceil(np.sqrt(len(images))))
    across, down = images[0].size
    sheet = Image.new("RGB", (columns * across, -(-len(images) // columns) * down), "white")
    for k, image in enumerate(images):
        sheet.paste(image, (k % columns * across, k // columns * down))
    buffer = io.BytesIO()  # without loss, as frames that repeat each other pack to little
    sheet.quantize(_COLOURS, dither=Image.Dither.NONE).convert("RGB").save(buffer, "WEBP", lossless=True, method=2)
    if buffer.tell() > _MOST_BYTES:
        raise ValueError(f"the player has {buffer.tell()} bytes: draw fewer or smaller frames, {_MOST_BYTES} at most")
    return Player(freeze(figure, 2, laid_out=True), alt, width, buffer.getvalue(), len(images), columns, seconds)


@checks.checked(points="T 3")
def walk_on_sphere(points: ArrayLike, alt: str, *, frames: int = 20) -> Player:
    """A chain of unit vectors (T, 3), T >= ``frames``, drawn as it goes: what is near is dark, what is behind is pale.

    For a chain of rotations of space, give the places to which they turn one vector, e.g. ``rotations[:, :, 2]``.

    >>> angles = np.linspace(0, 6, 50)
    >>> walk_on_sphere(np.stack([np.cos(angles), np.sin(angles), 0 * angles], 1), "Along the equator.", frames=5)
    <Player: Along the equator.>
    """
    points = np.asarray(points, dtype=float)
    if not np.allclose(np.linalg.norm(points, axis=1), 1, atol=1e-6):
        raise ValueError(f"points has shape {points.shape}: give (T, 3) unit vectors")
    if len(points) < frames:
        raise ValueError(f"{len(points)} points for {frames} frames: give at least one for each")
    ends = np.linspace(len(points) / frames, len(points), frames).round().astype(int)
    return player((_sphere(points[:end], len(points)) for end in ends), alt)


def _sphere(points: np.ndarray, total: int) -> Figure:
    x, y, depth = _seen(points)
    with mpl.style.context(STYLE):
        fig, ax = plt.subplots(figsize=(3.4, 3.6), subplot_kw={"xlim": (-1.08, 1.08), "ylim": (-1.08, 1.08)})
    told = f"step {len(points)} of {total} by random rotations:\nthe last 15 orange, those before blue"
    ax.set(aspect=1, title=told)
    ax.set_axis_off()
    ax.add_patch(Circle((0, 0), 1, facecolor="#f2f5f8", edgecolor="#8a97a5"))
    turn = np.linspace(0, 2 * np.pi, 90)
    c, s, zero = np.cos(turn), np.sin(turn), 0 * turn  # three parallels and two meridians show the roundness
    rings = [np.stack([c, s, zero], 1) * np.sqrt(1 - height**2) + [0, 0, height] for height in (-0.5, 0.0, 0.5)]
    for ring in [*rings, np.stack([c, zero, s], 1), np.stack([zero, c, s], 1)]:
        right, up, near = _seen(ring)
        ax.plot(np.where(near >= 0, right, np.nan), up, color="#c6d0da", lw=1)
        ax.plot(np.where(near < 0, right, np.nan), up, color="#c6d0da", lw=0.5, ls=":")
    for behind, size, alpha in ((True, 5, 0.25), (False, 9, 0.6)):
        chosen = (depth < 0) == behind
        ax.scatter(x[chosen], y[chosen], s=size, color=PALETTE[0], alpha=alpha, lw=0, zorder=3)
    ax.plot(x[-15:], y[-15:], "-", color=PALETTE[1], lw=1.5, alpha=0.9, zorder=4)
    ax.plot(x[-1], y[-1], "o", color=PALETTE[1], ms=9, mec="white", zorder=6)
    return fig


def _seen(points: np.ndarray) -> np.ndarray:
    """Coordinates across, up and towards the eye, each (T,), from a little above the equator."""
    eye = np.array([0.78, -0.45, 0.43]) / np.linalg.norm([0.78, -0.45, 0.43])
    across = np.cross([0, 0, 1], eye) / np.linalg.norm(np.cross([0, 0, 1], eye))
    return np.stack([across, np.cross(eye, across), eye]) @ points.T
