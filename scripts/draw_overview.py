"""Draw the picture of the introduction from a real run: maps that disagree, maps that agree, and how sure they are.

Writes three panels as one picture, for the first page and the README, into book/images. Eleven synthetic cats,
every pair observed once with the noise of the paper at σ² = 0.1; three cats are shown. And two smaller cats to explore.
"""

import io
import os
from pathlib import Path
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

import data_gen
import fmsync
from fmsync import diagnostics, viz
from fmsync.functional_maps import images_both_ways
from fmsync.matching.samples import farthest_points

IMAGES = Path(__file__).resolve().parents[1] / "book" / "images"
SHOWN = (0, 6, 9)  # of eleven poses; their colours are carried from the first
_PLACES = ((0.5, 0.82), (0.19, 0.2), (0.81, 0.2))  # of the cats in a panel of unit size
_INK = "#3b4652"
_CAPTIONS = (
    "1  Maps between pairs\ncontradict each other",
    "2  Synchronised,\nthey agree",
    "3  Draws of the posterior:\nwhere can it be trusted?",
)


def compute(n_vertices: int = 5000, n_draws: int = 600, warmup: int = 400) -> SimpleNamespace:
    """Plant, observe, solve and sample: the shown ``shapes``; by "observed" and "synchronised" the ``matrices`` of the
    pairs (0, 1), (1, 2), (2, 0) and the ``colours`` (V, 3) of each shape; the ``spread`` (V,) on the last one, √area.
    """
    shapes = data_gen.load_collection("cats", n_vertices=n_vertices)
    truth = data_gen.ground_truth(shapes)
    problem = data_gen.perturb(truth, sigma2=0.1, rng=1)
    observed = {tuple(edge): c for edge, c in zip(problem.edges.tolist(), problem.maps)}
    observed |= {(j, i): c.T for (i, j), c in observed.items()}
    a, b, c = SHOWN
    loop, to_first, estimate = [(a, b), (b, c), (c, a)], [(b, a), (c, a)], fmsync.solve(problem)
    maps = {
        "observed": lambda pairs: [observed[pair] for pair in pairs],
        "synchronised": lambda pairs: list(estimate.relative(np.array(pairs))),
    }
    home = viz.colours_from_coordinates(shapes[a].vertices)
    colours = {
        name: [home] + [home[fmsync.point_map(m, truth.bases[k], truth.bases[a])] for k, m in zip((b, c), of(to_first))]
        for name, of in maps.items()
    }
    options = {"n_chains": 2, "n_draws": n_draws, "thin": 3, "warmup": warmup}
    posterior = fmsync.sample(problem, "heat-bath", likelihood="projected-gaussian", **options)
    draws = posterior.relative([[c, a]])[:, :: max(1, n_draws // 50)].reshape(-1, 20, 20)  # a hundred will do
    there = shapes[a].normalised().vertices
    images = np.stack([there[fmsync.point_map(d, truth.bases[c], truth.bases[a])] for d in draws])  # (T, V, 3)
    spread = np.sqrt(((images - images.mean(axis=0)) ** 2).sum(axis=2).mean(axis=0))
    told = {"matrices": {name: of(loop) for name, of in maps.items()}, "colours": colours, "spread": spread}
    return SimpleNamespace(shapes=[shapes[k] for k in SHOWN], **told)


def explorer(n_vertices: int = 2000, n_draws: int = 100, warmup: int = 300) -> viz.Explorer:
    """Two of eleven cats, and where their vertices go at three levels of the noise."""
    shapes = [shape.normalised() for shape in data_gen.load_collection("cats", n_vertices=n_vertices)]
    truth = data_gen.ground_truth(shapes)
    pair, chosen = [0, 10], farthest_points(shapes[0].vertices, min(n_vertices, 200))
    chosen = np.append(chosen, data_gen.front_paw(shapes[0]))  # which the chapters follow
    states: dict[str, list[viz.State]] = {"observed": [], "synchronised": [], "posterior": []}
    for sigma2 in (0.03, 0.1, 0.3):
        problem = data_gen.perturb(truth, sigma2=sigma2, rng=6)
        at = problem.edges.tolist().index(pair)
        options = {"n_chains": 2, "n_draws": n_draws // 2, "thin": 3, "warmup": warmup}
        with diagnostics.short_run():  # a hundred draws, no more
            posterior = fmsync.sample(problem, "heat-bath", likelihood="projected-gaussian", **options)
        maps = {
            "observed": problem.maps[at : at + 1],
            "synchronised": fmsync.solve(problem).relative(np.array([pair])),
            "posterior": posterior.relative([pair]).reshape(-1, truth.n, truth.n),
        }
        bases = [truth.bases[k] for k in pair]
        for view, c in maps.items():
            states[view].append(viz.State(view, images_both_ways(c, bases, (chosen, chosen)), noise=sigma2))
    return viz.explorer(
        [shapes[k] for k in pair],
        (chosen, chosen),
        [state for view in states.values() for state in view],
        truth=(chosen, chosen),
        start=7,
        vertex=len(chosen) - 1,
        alt="Two cats: a chosen vertex of one, and on the other the light of its images under a hundred draws.",
    )


def draw_cat(ax: Axes, shape: fmsync.Shape, values: np.ndarray, centre: tuple, size: float, **options) -> None:
    """Draw a shape around a point, its longer side ``size``, white turned into transparent."""
    png = viz.scene([shape], [values], [""], alt="a cat", **options).png
    picture = np.asarray(Image.open(io.BytesIO(png)).convert("RGBA")).copy()
    white = (picture[..., :3] > 250).all(axis=2)
    picture[white, 3] = 0
    rows, columns = np.flatnonzero(~white.all(axis=1)), np.flatnonzero(~white.all(axis=0))
    picture = picture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    height, width = size * np.array(picture.shape[:2]) / max(picture.shape[:2]) / 2
    x, y = centre
    extent = (x - width, x + width, y - height, y + height)
    ax.imshow(picture, extent=extent, interpolation="antialiased", zorder=3)


def triangle(ax: Axes, story: SimpleNamespace, name: str) -> None:
    """Three cats, the maps between them, and whether their product around the triangle is the identity."""
    for shape, colours, centre in zip(story.shapes, story.colours[name], _PLACES):
        draw_cat(ax, shape, colours, centre, 0.4)
    for k, matrix in enumerate(story.matrices[name]):
        (x0, y0), (x1, y1) = _PLACES[k], _PLACES[(k + 1) % 3]
        ax.plot((x0, x1), (y0, y1), color="#c3cad1", lw=1.5, zorder=1)
        x, y, half = (x0 + x1) / 2, (y0 + y1) / 2, 0.085
        ax.imshow(matrix, cmap="RdBu", clim=(-1, 1), extent=(x - half, x + half, y - half, y + half), zorder=4)
        ax.add_patch(plt.Rectangle((x - half, y - half), 2 * half, 2 * half, fill=False, ec=_INK, lw=0.8, zorder=5))
    closes = r"$= I$" if name == "synchronised" else r"$\neq I$"
    ax.text(0.5, 0.46, "↻", ha="center", va="center", fontsize=32, color=_INK, family="DejaVu Sans")
    ax.text(0.5, 0.355, closes, ha="center", va="center", fontsize=20, color=_INK)


def certainty(ax: Axes, story: SimpleNamespace) -> None:
    """A cat coloured by how far the draws send each vertex apart."""
    limit = float(np.quantile(story.spread, 0.98))
    draw_cat(ax, story.shapes[-1], story.spread, (0.5, 0.56), 0.8, clim=(0, limit), flat=True)
    ax.imshow(np.linspace(0, 1, 256)[None], cmap="viridis", extent=(0.24, 0.72, 0.075, 0.105), zorder=3)
    ax.text(0.23, 0.09, "sure", ha="right", va="center", fontsize=14, color=_INK)
    ax.text(0.73, 0.09, "unsure", ha="left", va="center", fontsize=14, color=_INK)


def save(fig: Figure, path: Path) -> None:
    """A PNG without dates, so that the same drawing gives the same bytes."""
    raw = io.BytesIO()
    fig.savefig(raw, format="png", dpi=fig.dpi, facecolor="white", metadata={"Software": None})
    plt.close(fig)
    Image.open(raw).convert("RGB").save(path, optimize=True)


def three_panels(story: SimpleNamespace) -> Figure:
    """The whole picture, with a caption under each panel."""
    fig, axes = plt.subplots(1, 3, figsize=(9.6, 3.7), dpi=96, layout="none")
    fig.subplots_adjust(0, 0.12, 1, 1, 0.02, 0)
    triangle(axes[0], story, "observed")
    triangle(axes[1], story, "synchronised")
    certainty(axes[2], story)
    for axis, caption in zip(axes, _CAPTIONS):
        axis.set_axis_off()
        axis.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03), aspect="equal")
        axis.text(0.5, -0.08, caption, ha="center", va="center", fontsize=12, color=_INK)
    return fig


if __name__ == "__main__":
    save(three_panels(compute()), IMAGES / "overview.png")
    os.environ["FMSYNC_SHARED_VIEWER"] = "1"  # the page brings the script
    (IMAGES / "explorer.html").write_text(explorer().html() + "\n", encoding="utf-8")
