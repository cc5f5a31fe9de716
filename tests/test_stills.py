"""Stills of scenes look as they did: structural similarity to committed references, of generated cats.

``python -m tests.test_stills`` draws the references anew, where a change of their look is meant.
"""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

import data_gen
from fmsync import viz
from fmsync.viz import scenes
from tests.test_viz import pixels

REFERENCES = Path(__file__).with_name("stills")
SIZE = 240  # pixels across, to which stills are reduced
KINDS = ("turnable", "painted")  # by VTK, and by matplotlib where there is no OpenGL
LEAST = 0.9


def cats(first=0):
    return data_gen.load_collection("cats", count=first + 2, n_vertices=1000)[first:]


def marked(shapes, points=True):
    """Two cats coloured by position, with a paw marked on each."""
    paw = data_gen.front_paw(cats()[0])
    colours = viz.colours_from_coordinates(shapes[0].vertices)
    return viz.scene(shapes, [colours] * 2, alt="Two cats.", points=[[paw]] * 2 if points else None)


def explored(shapes):
    """The still of an explorer: a chosen vertex, and the light of twenty images around it."""
    paw = data_gen.front_paw(cats()[0])
    near = np.argsort(np.linalg.norm(shapes[1].vertices - shapes[1].vertices[paw], axis=1))[None, :20]
    state = viz.State("posterior", (near, near))
    return viz.explorer(shapes, ([paw], [paw]), [state], alt="Two cats.")


SCENES = {"marked": marked, "explored": explored}


def reduced(png):
    image = Image.fromarray(pixels(png).astype(np.uint8))
    return image.resize((SIZE, round(SIZE * image.height / image.width)), Image.Resampling.LANCZOS)


def similarity(a, b):
    """Mean structural similarity (Wang et al. 2004) of two pictures (h, w, 3), where either of them is not white."""
    a, b = (np.asarray(x, dtype=float) for x in (a, b))
    if a.shape != b.shape:
        return 0.0

    def mean(x):
        return gaussian_filter(x, (1.5, 1.5, 0), truncate=3.5)

    of_a, of_b = mean(a), mean(b)
    var_a, var_b, both = mean(a**2) - of_a**2, mean(b**2) - of_b**2, mean(a * b) - of_a * of_b
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    local = (2 * of_a * of_b + c1) * (2 * both + c2) / ((of_a**2 + of_b**2 + c1) * (var_a + var_b + c2))
    return float(local[(np.minimum(a, b) < 250).any(axis=2)].mean())


def reference(name, kind):
    return Image.open(REFERENCES / f"{name}_{kind}.png").convert("RGB")


@pytest.fixture(params=KINDS)
def kind(request, monkeypatch):
    if request.param == "turnable" and not scenes.can_render():
        pytest.skip("no OpenGL here")
    monkeypatch.setattr(scenes, "can_render", lambda: request.param == "turnable")
    return request.param


@pytest.mark.parametrize("name", SCENES)
def test_stills_look_as_they_did(name, kind):
    assert similarity(reduced(SCENES[name](cats()).png), reference(name, kind)) > LEAST


def test_other_stills_are_told_apart(kind):
    """Another pose, the back of the cat, colours of another kind: each falls far below what is asked for."""
    wanted, shapes = reference("marked", kind), cats()
    turned = [viz.facing(s, int(s.vertices[:, 0].argmin())) for s in shapes]
    for other in (marked(cats(first=1)), marked(turned), viz.scene(shapes, alt="Two grey cats.")):
        assert similarity(reduced(other.png), wanted) < LEAST - 0.1


def test_a_lost_mark_is_seen(kind):
    """Around the marked paw, which is small in the whole picture."""
    wanted, shapes = np.asarray(reference("marked", kind)), cats()
    kept, lost = (np.asarray(reduced(marked(shapes, points).png)) for points in (True, False))
    rows, columns, _ = np.nonzero(np.abs(kept.astype(int) - lost) > 30)
    around = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    assert similarity(kept[around], wanted[around]) > LEAST > similarity(lost[around], wanted[around])


if __name__ == "__main__":
    for kind in KINDS:
        scenes.can_render = lambda kind=kind: kind == "turnable"
        for name, draw in SCENES.items():
            reduced(draw(cats()).png).save(REFERENCES / f"{name}_{kind}.png", optimize=True)
