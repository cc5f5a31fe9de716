"""The report in a real browser, from disk: pairs can be chosen, shapes turned, vertices asked where they go."""

import base64
import io

import numpy as np
import pytest
from PIL import Image

from tests.test_book_browser import _SERIOUS, ARGS, AXE, CHROME, PHONE, WIDE, _absent, _blue, _drawn, _lit, _ready, drag

pytestmark = pytest.mark.browser


def pixels(canvas) -> np.ndarray:
    drawn = canvas.evaluate("(c) => c.toDataURL()").split(",", 1)[1]
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(drawn))).convert("RGB"), dtype=int)


@pytest.fixture
def report(written, tmp_path):
    """The page; whatever it asks of the network or complains about fails the test."""
    sync_api = pytest.importorskip("playwright.sync_api")
    if not CHROME:
        _absent("no chromium: apt-get install chromium, or name one in CHROME")
    wrong = []
    with sync_api.sync_playwright() as p:
        context = p.chromium.launch_persistent_context(tmp_path, executable_path=CHROME, headless=True, args=ARGS)
        page = context.new_page()
        page.on("pageerror", lambda e: wrong.append(f"page error: {e}"))
        page.on("console", lambda m: wrong.append(m.text) if m.type == "error" else None)
        page.on("request", lambda r: None if r.url.startswith(("file:", "data:")) else wrong.append(r.url))
        page.goto((written.folder / "report.html").as_uri(), wait_until="load")
        yield page
        context.close()
    assert not wrong


def test_the_report_shows_every_pair_and_turns(report):
    carried = report.locator("#carried")
    said, seen = set(), set()
    for i in range(3):
        for j in range(3):
            report.select_option("#from", str(i))
            report.select_option("#to", str(j))
            said.add(report.locator("#words").inner_text())
            seen.add(pixels(carried).tobytes())
    assert len(said) == 7  # six pairs, and a shape and itself
    assert len(seen) == 9
    report.select_option("#to", "0")
    assert len(np.unique(pixels(carried).reshape(-1, 3), axis=0)) > 50, "blank"
    carried.scroll_into_view_if_needed()
    before = pixels(carried)
    drag(report, carried)
    assert np.abs(pixels(carried) - before).mean() > 1, "it did not turn"
    report.context.set_offline(True)
    report.set_viewport_size(PHONE)
    assert report.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize(("size", "theme"), [(WIDE, "light"), (PHONE, "dark")], ids=["wide", "phone"])
def test_a_vertex_of_the_report_says_where_it_goes(report, written, size, theme):
    report.set_viewport_size(size)
    report.emulate_media(color_scheme=theme)
    first = _ready(report)
    assert (first["view"], first["from"]) == ("calibrated", "0")
    report.locator("label", has_text="posterior").click()
    canvases, words = report.locator("#explorer canvas"), report.locator("#explorer").get_by_role("status")
    canvases.nth(0).scroll_into_view_if_needed()
    box, body = canvases.nth(0).bounding_box(), _drawn(report, 0)[..., 3] == 255
    down, across = (np.argwhere(body).mean(axis=0) + 0.5) / body.shape
    canvases.nth(0).click(position={"x": across * box["width"], "y": down * box["height"]})
    clicked = _ready(report)
    assert clicked["vertex"] != first["vertex"]
    assert words.inner_text().startswith(f"Vertex {clicked['vertex']} of cat1, posterior: 40 images at ")
    assert len(_lit(report, 0)) == 0
    assert len(_lit(report, 1)) > 20
    canvases.nth(0).focus()
    report.keyboard.press("ArrowRight")
    moved = _ready(report)
    assert moved["vertex"] != clicked["vertex"]
    assert "cat1" in words.inner_text()
    radii = []
    for view in ("posterior", "calibrated"):
        report.locator("label", has_text=view).click()
        assert _ready(report)["view"] == view
        radii.append(words.inner_text().split("region ")[1])
    assert _blue(report, 1) > 40  # the region, small on a phone; without one there are fewer than 20
    table = np.genfromtxt(written.folder / "point_maps" / "cat1_to_cat0.csv", delimiter=",", names=True)
    row = table[int(moved["vertex"])]
    for said, radius in zip(radii, (row["radius"], row["region"])):
        if said.startswith("below"):  # the draws can agree on one vertex
            assert radius < float(said.split()[1].removesuffix("."))
        else:
            assert float(said.split()[0].removesuffix(".")) == pytest.approx(radius, abs=0.006)
    report.locator("label", has_text="observed").click()
    assert "one image on cat0" in words.inner_text()
    assert _blue(report, 1) < 20
    report.select_option("#to", "2")  # another pair
    report.locator("h4", has_text="cat2").wait_for(timeout=10_000)
    assert _ready(report)["view"] == "observed"  # as before
    report.add_script_tag(url=AXE)
    assert report.evaluate(_SERIOUS, ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"]) == []
    assert report.evaluate(_SERIOUS, "color-contrast") == []
    assert report.evaluate("document.documentElement.scrollWidth") <= size["width"]
