"""Draw the pictures of book/images from real runs on eleven synthetic cats and from the files in results.

The overview of the first page and the README: maps that disagree, maps that agree, and how sure they are, at the noise
of the paper, σ² = 0.1; three cats are shown. Six pictures for a talk. And two smaller cats to explore.
"""

import io
import json
import os
from pathlib import Path
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pyvista as pv
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

import data_gen
import fmsync
from fmsync import diagnostics, viz
from fmsync.functional_maps import images_both_ways
from fmsync.matching.samples import farthest_points
from fmsync.viz.scenes import AXES, centred

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "book" / "images"
RIGHT, WRONG = "#2f6f9f", "#d95f02"
PAIR = [0, 10]  # of eleven poses
SHOWN = (0, 6, 9)  # of eleven poses; their colours are carried from the first
_PLACES = ((0.5, 0.82), (0.19, 0.2), (0.81, 0.2))  # of the cats in a panel of unit size
_INK = "#3b4652"
_CAPTIONS = (
    "1  Maps between pairs\ncontradict each other",
    "2  Synchronised,\nthey agree",
    "3  Draws of the posterior:\nwhere does noise leave doubt?",
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
    pair, chosen = PAIR, farthest_points(shapes[0].vertices, min(n_vertices, 200))
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


def sign_trap(shapes: list[fmsync.Shape]) -> Figure:
    """The same eigenfunction with opposite signs on two cats, and with signs fixed; the map beside them."""
    bases = [fmsync.laplace_beltrami(s.vertices, s.faces, 10) for s in shapes]
    fixed, every = data_gen.fix_signs(bases), np.arange(shapes[0].n_vertices)
    maps = [fmsync.functional_map(bases[0], other, every) for other in bases]
    turned = [np.argmin((f.eigenfunctions * b.eigenfunctions).sum(axis=0)) for b, f in zip(bases, fixed)]
    a = min(range(1, len(shapes)), key=lambda k: maps[k][turned[k], turned[k]])  # where it is clearest
    at = turned[a]
    fig, axes = plt.subplots(2, 3, figsize=(8, 5.2))
    for row, some, name in zip(axes, (bases, fixed), ("as computed", "signs fixed")):
        for ax, k in zip(row, (0, a)):
            values = some[k].eigenfunctions[:, at] * np.sqrt(shapes[k].area)
            draw_cat(ax, shapes[k], values, (0.5, 0.5), 0.95, cmap="RdBu_r", clim=(-2, 2))
            ax.set(xlim=(0, 1), ylim=(0, 1), aspect="equal")
            ax.set_axis_off()
        c = fmsync.functional_map(some[0], some[a], every)
        row[2].imshow(c, cmap="RdBu", clim=(-1, 1))
        row[2].set(xticks=[], yticks=[], title=f"{name}: det {'−' if np.linalg.det(c) < 0 else '+'}")
    axes[0, 0].set_title(f"eigenfunction {at + 1} of one cat")
    axes[0, 1].set_title("and of another")
    return fig


def matched(shapes: list[fmsync.Shape], images: dict[str, np.ndarray]) -> Figure:
    """Lines from vertices of one cat to their images on another: blue where they are right."""
    left, right = (centred(s.vertices) for s in shapes)
    right = right + 1.4 * np.ptp(left @ AXES[:, 0]) * AXES[:, 0]
    across, up, _ = (np.concatenate([left, right]) @ AXES).T
    middle = AXES[:, :2] @ [(across.max() + across.min()) / 2, (up.max() + up.min()) / 2]
    outward = pv.PolyData.from_regular_faces(left, shapes[0].faces).point_normals @ AXES[:, 2]
    seen = [v for v in farthest_points(shapes[0].vertices, 90) if outward[v] > 0.2]
    fig, axes = plt.subplots(len(images), 1, figsize=(6.4, 2.4 * len(images)))
    for ax, (name, image) in zip(axes, images.items()):
        off = np.linalg.norm(shapes[1].vertices[image[seen]] - shapes[1].vertices[seen], axis=1)
        wrong = off > 0.15 * np.sqrt(shapes[1].area)
        plotter = pv.Plotter(off_screen=True, window_size=(2100, round(2100 * np.ptp(up) / np.ptp(across))))
        plotter.set_background("white")
        for points, shape in zip((left, right), shapes):
            mesh = pv.PolyData.from_regular_faces(points, shape.faces)
            plotter.add_mesh(mesh, color="#c3cbd3", smooth_shading=True, ambient=0.25, diffuse=0.85)
        for v, bad in zip(seen, wrong):
            line = pv.Line(left[v], right[image[v]]).tube(radius=0.003 * np.ptp(right))
            plotter.add_mesh(line, color=WRONG if bad else RIGHT)
        plotter.camera_position = (middle + 10 * AXES[:, 2], middle, (0, 0, 1))
        plotter.enable_parallel_projection()
        plotter.camera.parallel_scale = 0.52 * np.ptp(up)
        plotter.camera.reset_clipping_range()
        ax.imshow(plotter.screenshot(return_img=True))
        plotter.close()
        ax.set_axis_off()
        told = f"{name}: {np.mean(~wrong):.0%} of the lines end near their place"
        ax.set_title(told, color=WRONG if wrong.any() else RIGHT)
    return fig


def posterior(shapes: list[fmsync.Shape], vertex: int, images: np.ndarray) -> Figure:
    """A vertex of one cat, and on another the light of where draws send it."""
    turned = [viz.facing(s, vertex) for s in shapes]
    lit = [viz.glow(turned[0], []), viz.glow(turned[1], images)]
    png = viz.scene(turned, lit, ["", ""], points=[[vertex], []], alt="two cats").png
    fig, ax = plt.subplots(figsize=(7, 3.6))
    ax.imshow(Image.open(io.BytesIO(png)))
    ax.set_axis_off()
    for x, words in ((0.25, "a vertex"), (0.75, f"where {len(images)} draws send it")):
        ax.text(x, 0.98, words, transform=ax.transAxes, ha="center", va="top", fontsize=13)
    return fig


def calibration(coverage: pd.DataFrame) -> Figure:
    """What regions promise and what they hold, for the noise of the paper."""
    fig, ax = plt.subplots(figsize=(5, 4))
    promised, rows = (0.5, 0.8, 0.9, 0.95), coverage[coverage.noise == "projected-gaussian"]
    models = ("projected-gaussian", "langevin", "beta = 1")
    labels = ("the exact likelihood", "Langevin likelihood, κ inferred", "β = 1")
    for model, label, colour in zip(models, labels, ("C2", "C0", "C1")):
        held = rows[rows.model == model][[f"{q:g}" for q in promised]]
        ax.plot(promised, held.T, "o-", color=colour, label=[label] + [None] * (len(held) - 1))
    ax.plot((0.45, 1), (0.45, 1), "k--")
    ax.set(xlabel="promised", ylabel="share of true maps held", ylim=(0.4, 1.03))
    ax.set_title("Do regions hold what they promise?")
    ax.legend(loc="lower right")
    return fig


def scale(solves: pd.DataFrame) -> Figure:
    """CPU seconds of maximum likelihood against the number of shapes."""
    fig, ax = plt.subplots(figsize=(5, 4))
    ax.loglog(solves.n_nodes, solves.seconds, "o-")
    for n, seconds in zip(solves.n_nodes, solves.seconds):
        ax.annotate(f"{seconds:.2g} s", (n, seconds), (8, -12), textcoords="offset points")
    ax.set(xlabel="shapes, twenty neighbours each", ylabel="CPU seconds", title="Maximum likelihood for many shapes")
    ax.set_xticks(solves.n_nodes, solves.n_nodes.map("{:,}".format))
    ax.set_yticks([0.3, 1, 3, 10], ["0.3", "1", "3", "10"])
    ax.margins(0.14)
    ax.minorticks_off()
    return fig


def main() -> None:
    """Plant, observe, solve, sample and draw."""
    os.environ["FMSYNC_SHARED_VIEWER"] = "1"  # the page brings the script
    (IMAGES / "explorer.html").write_text(explorer().html() + "\n", encoding="utf-8")
    viz.style()
    shapes = [s.normalised() for s in data_gen.load_collection("cats")]
    truth = data_gen.ground_truth(shapes)
    noisy, pair = data_gen.perturb(truth, sigma2=0.1, rng=6), PAIR
    with diagnostics.short_run():  # a hundred draws will do
        options = {"n_chains": 2, "n_draws": 50, "thin": 3, "warmup": 300, "likelihood": "projected-gaussian"}
        draws = fmsync.sample(noisy, "heat-bath", **options).relative([pair]).reshape(-1, truth.n, truth.n)
    bases, two, paw = [truth.bases[k] for k in pair], [shapes[k] for k in pair], data_gen.front_paw(shapes[0])
    maps = {"observed": noisy.maps[noisy.edges.tolist().index(pair)]}
    maps["synchronised"] = fmsync.solve(noisy).relative([pair])[0]
    solves = pd.DataFrame(json.loads((ROOT / "results" / "speed.json").read_text())["speed"]["solves"])
    figures = {
        "overview": three_panels(compute()),
        "sign_trap": sign_trap(shapes),
        "synchronisation": matched(two, {name: fmsync.point_map(c, *bases) for name, c in maps.items()}),
        "posterior": posterior(two, paw, fmsync.functional_maps.vertex_images(draws, *bases, paw)),
        "calibration": calibration(pd.read_csv(ROOT / "results" / "calibration_coverage.csv")),
        "scale": scale(solves),
    }
    for name, figure in figures.items():
        figure.set_dpi(192)  # twice that of a screen
        save(figure, IMAGES / "gallery" / f"{name}.png")


if __name__ == "__main__":
    main()
