"""Open every built page in a real browser, from disk: wide and narrow, light and dark."""

import base64
import io
import os
import re
import shutil
import tempfile
from functools import cache
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
from PIL import Image

from fmsync.viz.scenes import can_render

HTML = Path(__file__).resolve().parents[1] / "_build" / "html"
CHROME = os.environ.get("CHROME") or next(
    filter(None, map(shutil.which, ("chromium", "google-chrome", "chromium-browser"))), None
)
REQUIRED = bool(os.environ.get("CI") or os.environ.get("FMSYNC_REQUIRE_BROWSER"))
ARGS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
WIDE, PHONE = {"width": 1200, "height": 900}, {"width": 390, "height": 844}
PAGES = sorted(
    p.relative_to(HTML).as_posix() for p in HTML.rglob("*.html") if "_static" not in p.parts and p.name != "index.html"
)
SCENES = [p for p in PAGES if 'class="fm-scene"' in (HTML / p).read_text(encoding="utf-8")]

pytestmark = pytest.mark.browser


def _absent(reason: str) -> None:
    """Skip, or fail where the browser tests are required (CI)."""
    (pytest.fail if REQUIRED else pytest.skip)(reason)


@pytest.fixture(scope="module")
def browser():
    sync_api = pytest.importorskip("playwright.sync_api")
    if not CHROME:
        _absent("no chromium: apt-get install chromium, or name one in CHROME")
    with sync_api.sync_playwright() as p:
        profile = tempfile.mkdtemp()
        context = p.chromium.launch_persistent_context(profile, executable_path=CHROME, headless=True, args=ARGS)
        yield context
        context.close()
        shutil.rmtree(profile, ignore_errors=True)


@pytest.fixture
def opened(browser):
    """Opens a page; whatever it asks of the network or complains about fails the test."""
    page, wrong = browser.new_page(), []
    page.on("pageerror", lambda e: wrong.append(f"page error: {e}"))
    page.on("console", lambda m: wrong.append(f"console: {m.text}") if m.type == "error" else None)
    page.on("requestfailed", lambda r: _note_failure(r, wrong))
    page.on(
        "request", lambda r: None if r.url.startswith(("file:", "data:", "blob:", "about:")) else wrong.append(r.url)
    )

    def go(name, viewport, theme):
        page.set_viewport_size(viewport)
        page.emulate_media(color_scheme=theme)
        page.goto((HTML / name).as_uri(), wait_until="load")
        page.evaluate("window.MathJax?.startup?.promise")
        return page

    go.page = page
    yield go
    page.close()
    assert not wrong


def _note_failure(request, wrong: list[str]) -> None:
    if request.failure != "net::ERR_ABORTED":  # the test itself left the page
        wrong.append(f"failed request: {request.url[:120]} {request.failure}")


def test_the_book_is_built():
    if not PAGES:
        _absent("the book is not built: make book")
    assert "intro.html" in PAGES
    assert (HTML / "index.html").exists()


@pytest.mark.parametrize("name", PAGES)
def test_page_reads_well_at_both_widths_and_themes(opened, name):
    opened.page.route("**/_static/viewer.html", lambda route: route.fulfill(body=""))  # scenes have their own test
    for viewport, theme, other_viewport in ((WIDE, "light", PHONE), (PHONE, "dark", WIDE)):
        page = opened(name, viewport, theme)
        assert page.evaluate("document.documentElement.dataset.theme") == theme
        for size in (viewport, other_viewport):
            page.set_viewport_size(size)
            assert page.evaluate("document.documentElement.scrollWidth") <= size["width"], (
                f"the page scrolls sideways at {size['width']} px, {theme}: {page.evaluate(_WIDEST)}"
            )
        ink, paper = page.evaluate(_COLOURS)
        assert _contrast(ink, paper) > 4.5, f"{theme}: text {ink} on {paper}"
    assert page.locator("span.math, div.math").count() == page.locator(".math mjx-container > svg").count()
    assert page.locator("mjx-container [data-mml-node='merror']").count() == 0
    assert page.locator("mjx-container [fill='red']").count() == 0  # how an unknown macro is drawn
    for image in page.evaluate(_IMAGES):
        assert image["alt"].strip(), f"no alt text: {image['src'][:80]}"
        assert image["width"] > 0, f"not loaded: {image['src'][:80]}"
        pixels = _read(image["src"])
        assert pixels is None or pixels.std() > 3, f"blank: {image['alt']}"


_IMAGES = """() => Promise.all([...document.images].map(async (i) => {
  i.loading = "eager";
  await i.decode().catch(() => {});
  return { alt: i.alt, src: i.src, width: i.naturalWidth };
}))"""
_COLOURS = """() => {
  const text = document.querySelector("article p") || document.querySelector("article") || document.body;
  return [getComputedStyle(text).color, getComputedStyle(document.body).backgroundColor];
}"""


_WIDEST = """() => [...document.querySelectorAll("article *")]
  .filter((e) => e.getBoundingClientRect().right > innerWidth + 1)
  .slice(0, 3).map((e) => e.outerHTML.slice(0, 120))"""


def _contrast(ink: str, paper: str) -> float:
    """Ratio of relative luminances (WCAG 2)."""

    def luminance(css):
        c = np.array([float(v) for v in re.findall(r"[\d.]+", css)[:3]]) / 255
        return np.where(c <= 0.03928, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722]

    low, high = sorted((luminance(ink), luminance(paper)))
    return (high + 0.05) / (low + 0.05)


def _read(source: str) -> np.ndarray | None:
    """Pixels of an image of the page; None for drawings (SVG)."""
    if "image/svg" in source[:30] or source.endswith(".svg"):
        return None
    if source.startswith("data:"):
        data = base64.b64decode(source.split(",", 1)[1])
    else:
        data = Path(unquote(urlsplit(source).path)).read_bytes()
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), dtype=float)


@cache
def _anchors(page: Path) -> frozenset[str]:
    if not page.is_file():
        return frozenset()
    return frozenset(re.findall(r'\bid="([^"]+)"', page.read_text(encoding="utf-8")))


@pytest.mark.parametrize("name", PAGES)
def test_internal_links_and_anchors_exist(name):
    source = HTML / name
    text = re.sub(r"<script.*?</script>", "", source.read_text(encoding="utf-8"), flags=re.S)
    broken = []
    for href in set(re.findall(r'<(?:a|link)\b[^>]*?\bhref="([^"]*)"', text)):
        url = urlsplit(href.replace("&amp;", "&"))
        if url.scheme or url.netloc:
            continue
        target = (source.parent / unquote(url.path)).resolve() if url.path else source
        anchored = not url.fragment or target.suffix != ".html" or unquote(url.fragment) in _anchors(target)
        if href != "#" and not (target.is_file() and anchored):
            broken.append(href)
    assert not broken


@pytest.mark.parametrize("name", PAGES)
def test_page_is_light(name):
    assert (HTML / name).stat().st_size <= 3_000_000


def test_scenes_are_alive_wherever_they_can_be():
    if not SCENES:
        _absent("no page has a scene")
    for name in SCENES:
        text = (HTML / name).read_text(encoding="utf-8")
        assert ('<script type="text/plain">' in text) == can_render(), name


@pytest.mark.parametrize("name", SCENES)
def test_scenes_draw_and_turn_when_dragged(opened, name):
    if not can_render():
        _absent("no OpenGL here, so the book has still pictures: apt-get install libegl1 libgl1")
    page = opened(name, WIDE, "light")
    stages = page.locator(".fm-stage:has(> script)")
    for k in range(stages.count()):
        stages.nth(k).scroll_into_view_if_needed()
        stages.nth(k).locator("iframe.fm-drawn").wait_for(timeout=30_000)
        assert page.locator("iframe.fm-live").count() <= 6
    stage = stages.first
    stage.scroll_into_view_if_needed()
    stage.locator("iframe.fm-drawn").wait_for(timeout=30_000)
    before = _settled(page, stage)
    assert len(np.unique(before.reshape(-1, 3), axis=0)) > 50, "blank scene"
    box = stage.bounding_box()
    x, y = box["x"] + box["width"] / 4, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 90, y + 20, steps=6)
    page.mouse.up()
    assert np.abs(_settled(page, stage) - before).mean() > 1, "the scene did not turn"


def _settled(page, element) -> np.ndarray:
    """Screenshot of an element once two in a row agree."""
    last = None
    for _ in range(20):
        page.wait_for_timeout(200)
        shot = np.asarray(Image.open(io.BytesIO(element.screenshot())).convert("RGB"), dtype=int)
        if last is not None and np.array_equal(shot, last):
            break
        last = shot
    return shot
