"""Flat figures: one colour-blind safe style, heat maps of functional maps, and pictures that carry their alt text."""

import base64
import html
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler
from numpy.typing import ArrayLike
from PIL import Image

from fmsync import checks

# Okabe & Ito: told apart under every common colour blindness
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442")

Limits = tuple[float, float] | None  # of a colour scale
_LEAST_TYPE = 10  # points: 9 pixels on a phone, where a figure of the usual width is shown at three fifths

_SHEET = Path(__file__).with_suffix(".mplstyle")
STYLE: list[Path | dict[str, Any]] = [_SHEET, {"axes.prop_cycle": cycler(color=PALETTE)}]


def style() -> None:
    """Set the look of every later matplotlib figure: Okabe–Ito colours, white paper, 12 pt type.

    >>> style()
    """
    mpl.style.use(STYLE)


def subplots(*args: Any, **options: Any) -> tuple[Figure, Any]:
    """``matplotlib.pyplot.subplots`` in the look of :func:`style`; labels, limits and scales go to the axes.

    >>> fig, ax = subplots(figsize=(5.2, 3), xlabel="noise", yscale="log")
    """
    style()
    chosen = [name for name in options if name[1:] in ("label", "lim", "scale") or name == "title"]
    of_axes = {name: options.pop(name) for name in chosen}
    return plt.subplots(*args, subplot_kw=of_axes, **options)


@dataclass(frozen=True, repr=False)
class Shown:
    """What a page shows: a still for paper, PNG bytes, and one or two sentences for those who cannot see it."""

    png: bytes
    alt: str

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.alt}>"

    def _repr_mimebundle_(self, include: object = None, exclude: object = None) -> dict[str, str]:
        return {"image/png": base64.b64encode(self.png).decode(), "text/html": self.html(), "text/plain": repr(self)}

    def html(self) -> str:
        """The figure in HTML."""
        raise NotImplementedError


@dataclass(frozen=True, repr=False)
class Picture(Shown):
    """A finished figure; ``width`` is its natural width on the page in CSS pixels."""

    width: int

    def html(self) -> str:
        return f'<figure class="fm-figure">{image_tag(self.png, self.alt, self.width)}</figure>'


def image_tag(png: bytes, alt: str, width: int) -> str:
    """HTML image of PNG bytes, held in the page itself as lossless WebP (a third smaller)."""
    with Image.open(io.BytesIO(png)) as image:
        buffer = io.BytesIO()
        image.save(buffer, "WEBP", lossless=True, method=4)
        height = round(width * image.height / image.width)
    data = base64.b64encode(buffer.getvalue()).decode()
    return (
        f'<img alt="{html.escape(alt)}" width="{width}" height="{height}" loading="lazy" '
        f'src="data:image/webp;base64,{data}">'
    )


@checks.checked()
def picture(fig: Figure, alt: str) -> Picture:
    """Freeze a matplotlib figure as a ``Picture``, and close it; ``alt`` says in a sentence or two what it shows.

    Type smaller than 10 points is raised to that: it could not be read on a phone. Where there is no legend,
    axes with labels get one.

    >>> fig, ax = plt.subplots()
    >>> picture(fig, alt="An empty pair of axes.")
    <Picture: An empty pair of axes.>
    """
    if not alt.strip():
        raise ValueError("alt is empty: say in a sentence what the figure shows")
    if not fig.legends and not any(ax.get_legend() for ax in fig.axes):
        for ax in fig.axes:
            if ax.get_legend_handles_labels()[1]:
                ax.legend()
    return Picture(freeze(fig, 2), alt, round(fig.get_figwidth() * fig.dpi))


def freeze(fig: Figure, scale: float, *, laid_out: bool = False) -> bytes:
    """PNG of a figure with ``scale`` device pixels for each CSS pixel, no type too small; the figure is closed.

    One that was frozen before, and has changed since, is ``laid_out``: everything stays in its place.
    """
    if not laid_out:
        fig.draw_without_rendering()  # the numbers at the axes exist only now
        small = [text for text in fig.findobj(mpl.text.Text) if float(text.get_fontsize()) < _LEAST_TYPE]
        for text in small:
            text.set_fontsize(_LEAST_TYPE)
        if small:
            fig.draw_without_rendering()
        fig.set_layout_engine("none")  # laid out above, which takes as long as drawing
    buffer = io.BytesIO()
    fig.savefig(buffer, format="png", dpi=scale * fig.dpi)
    plt.close(fig)
    return buffer.getvalue()


@checks.checked(matrices="n m")
def heatmaps(
    matrices: Sequence[ArrayLike], titles: Sequence[str] | None = None, *, alt: str, clim: Limits = None
) -> Picture:
    """Matrices side by side, three in a row, under one colour scale.

    * ``matrices``: K arrays of shape (n, m), e.g. functional maps.
    * ``titles``, ``alt``: K strings, and what the figure shows.
    * ``clim``: limits shared by all panels; by default symmetric about zero and wide enough for every entry.

    >>> heatmaps([np.eye(3), -np.eye(3)], ["plus", "minus"], alt="The identity and its negative.")
    <Picture: The identity and its negative.>
    """
    arrays = [np.asarray(m, dtype=float) for m in matrices]
    if not arrays:
        raise ValueError("matrices is empty: give at least one (n, m) array")
    titles = [""] * len(arrays) if titles is None else list(titles)
    if len(titles) != len(arrays):
        raise ValueError(f"{len(titles)} titles for {len(arrays)} matrices: give one each")
    if clim is None:
        top = max(float(np.abs(m).max()) for m in arrays)
        clim = (-top, top)

    columns = min(3, len(arrays))
    rows = -(-len(arrays) // columns)
    with mpl.style.context(STYLE):
        fig, axes = plt.subplots(rows, columns, figsize=(1.55 * columns + 0.8, 1.9 * rows), squeeze=False)
        for ax in axes.flat[len(arrays) :]:
            ax.set_visible(False)
        for ax, m, title in zip(axes.flat, arrays, titles):
            image = ax.imshow(m, cmap="RdBu_r", vmin=clim[0], vmax=clim[1], interpolation="nearest")
            ax.set(title=title, xticks=[], yticks=[])
            ax.grid(False)
            ax.spines[:].set_visible(False)
        fig.colorbar(image, ax=axes, shrink=0.8, label="entry")
        return picture(fig, alt)
