"""Draw six pictures for a talk into book/images/gallery, each from a real run or from the files in results."""

import io
import json
from pathlib import Path

import draw_overview
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pyvista as pv
from matplotlib.figure import Figure
from PIL import Image

import data_gen
import fmsync
from fmsync import diagnostics, viz
from fmsync.matching.samples import farthest_points
from fmsync.viz.scenes import AXES, centred

ROOT = Path(__file__).resolve().parents[1]
GALLERY = ROOT / "book" / "images" / "gallery"
RIGHT, WRONG = "#2f6f9f", "#d95f02"
FIRST, OTHER = 0, 10  # of eleven cats


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
            draw_overview.draw_cat(ax, shapes[k], values, (0.5, 0.5), 0.95, cmap="RdBu_r", clim=(-2, 2))
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
    viz.style()
    shapes = [s.normalised() for s in data_gen.load_collection("cats")]
    truth = data_gen.ground_truth(shapes)
    noisy, pair = data_gen.perturb(truth, sigma2=0.1, rng=6), [FIRST, OTHER]
    with diagnostics.short_run():  # a hundred draws will do
        options = {"n_chains": 2, "n_draws": 50, "thin": 3, "warmup": 300, "likelihood": "projected-gaussian"}
        draws = fmsync.sample(noisy, "heat-bath", **options).relative([pair]).reshape(-1, truth.n, truth.n)
    bases, two, paw = [truth.bases[k] for k in pair], [shapes[k] for k in pair], data_gen.front_paw(shapes[0])
    maps = {"observed": noisy.maps[noisy.edges.tolist().index(pair)]}
    maps["synchronised"] = fmsync.solve(noisy).relative([pair])[0]
    solves = pd.DataFrame(json.loads((ROOT / "results" / "speed.json").read_text())["speed"]["solves"])
    figures = {
        "overview": draw_overview.three_panels(draw_overview.compute()),
        "sign_trap": sign_trap(shapes),
        "synchronisation": matched(two, {name: fmsync.point_map(c, *bases) for name, c in maps.items()}),
        "posterior": posterior(two, paw, fmsync.functional_maps.vertex_images(draws, *bases, paw)),
        "calibration": calibration(pd.read_csv(ROOT / "results" / "calibration_coverage.csv")),
        "scale": scale(solves),
    }
    GALLERY.mkdir(exist_ok=True)
    for name, figure in figures.items():
        figure.set_dpi(192)  # twice that of a screen
        draw_overview.save(figure, GALLERY / f"{name}.png")


if __name__ == "__main__":
    main()
