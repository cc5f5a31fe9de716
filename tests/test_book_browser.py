"""Open every built page in a real browser, from disk: wide and narrow, light and dark."""

import base64
import io
import os
import re
import shutil
import tempfile
from dataclasses import replace
from functools import cache
from importlib import util
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
from PIL import Image

from fmsync import viz
from fmsync.viz.scenes import can_render
from tests.test_viz import sphere

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
    "--disable-gpu-compositing",  # scenes in software OpenGL, but not every page around them
]
WIDE, PHONE = {"width": 1200, "height": 900}, {"width": 390, "height": 844}
SMALL = {"width": 520, "height": 600}  # drawing in software costs by the pixel
SHEET = {"width": 718, "height": 1047}  # A4 at 96 dots an inch, without margins of 1 cm
AXE = next(Path(util.find_spec("axe_playwright_python").origin).parent.glob("axe.min.js")).as_uri()
PAGES = sorted(
    p.relative_to(HTML).as_posix() for p in HTML.rglob("*.html") if "_static" not in p.parts and p.name != "index.html"
)
_HOLDS = {
    mark: [p for p in PAGES if mark in (HTML / p).read_text(encoding="utf-8")]
    for mark in ('class="fm-scene"', "fm-moving", '<div class="fm-explorer"')
}
SCENES, PLAYERS, EXPLORERS = _HOLDS.values()

pytestmark = pytest.mark.browser


def _absent(reason: str) -> None:
    """Skip, or fail where the browser tests are required (CI)."""
    (pytest.fail if REQUIRED else pytest.skip)(reason)


@pytest.fixture(scope="module")
def browser():
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        _absent("no playwright: make setup")
    if not CHROME:
        _absent("no chromium: apt-get install chromium, or name one in CHROME")
    with sync_playwright() as p:
        profile = tempfile.mkdtemp()
        context = p.chromium.launch_persistent_context(profile, executable_path=CHROME, headless=True, args=ARGS)
        yield context
        context.close()
        shutil.rmtree(profile, ignore_errors=True)


@pytest.fixture
def opened(browser):
    """Opens a page; whatever it asks of the network or complains about fails the test."""
    go = _watched(browser.new_page())
    yield go
    go.page.close()
    assert not go.wrong


@pytest.fixture(scope="module")
def tab(browser):
    return _watched(browser.new_page())


@pytest.fixture
def visited(tab):
    """As ``opened``, one page after another in one tab, so that the scripts they share are compiled once."""
    tab.wrong.clear()
    yield tab
    tab.page.unroute_all()
    assert not tab.wrong


def _watched(page):
    wrong = []
    page.on("pageerror", lambda e: wrong.append(f"page error: {e}"))
    page.on("console", lambda m: wrong.append(f"console: {m.text}") if m.type == "error" else None)
    page.on("requestfailed", lambda r: _note_failure(r, wrong))
    page.on(
        "request", lambda r: None if r.url.startswith(("file:", "data:", "blob:", "about:")) else wrong.append(r.url)
    )

    def go(name, viewport, theme, *, alive=False):
        if name in SCENES and not alive:  # scenes have their own test
            page.route("**/_static/viewer.html", lambda route: route.fulfill(body=""))
        page.set_viewport_size(viewport)
        page.emulate_media(color_scheme=theme)
        page.goto((HTML / name).as_uri(), wait_until="load")
        page.evaluate("window.MathJax?.startup?.promise")
        return page

    go.page, go.wrong = page, wrong
    return go


def _note_failure(request, wrong: list[str]) -> None:
    if request.failure != "net::ERR_ABORTED":  # the test itself left the page
        wrong.append(f"failed request: {request.url[:120]} {request.failure}")


def test_the_book_is_built():
    if not PAGES:
        _absent("the book is not built: make book")
    assert "intro.html" in PAGES
    assert (HTML / "index.html").exists()


@pytest.mark.parametrize("name", sorted(PAGES, key=lambda p: -(HTML / p).stat().st_size))  # the longest first
def test_page_is_seen_read_printed_and_used_by_everyone(visited, name):
    """One visit, because a visit costs more than what is checked."""
    page = visited(name, WIDE, "light")
    assert _first_view(page) <= 2000, "milliseconds until something is seen"
    _fits_both_widths_and_themes(page)
    written, drawn, *faulty = page.evaluate(_FORMULAS)
    assert written == drawn
    assert faulty == [0, 0]
    for image in page.evaluate(_IMAGES):
        assert image["alt"].strip(), f"no alt text: {image['src'][:80]}"
        assert image["width"] > 0, f"not loaded: {image['src'][:80]}"
        pixels = _read(image["src"])
        assert pixels is None or pixels.std() > 3, f"blank: {image['alt']}"
    page.set_viewport_size(SHEET)
    page.emulate_media(media="print")
    assert page.evaluate(_ON_PAPER, SHEET) == []
    page.evaluate(_UNFOLD)  # before the page takes its width again, which costs less without formulas
    page.emulate_media(media="screen")
    page.set_viewport_size(WIDE)
    _serious_violations_of_axe(page)


def _first_view(page) -> float:
    """Milliseconds until something is seen: the best of three, for a machine that does other things as well."""
    seen = []
    while len(seen) < 3 and min(seen, default=np.inf) > 2000:
        if seen:
            page.reload(wait_until="load")
        seen.append(page.evaluate(_FIRST_VIEW))
    return min(seen)


_FIRST_VIEW = """() => new Promise((done) => new PerformanceObserver((list) => {
  for (const e of list.getEntriesByName("first-contentful-paint")) done(e.startTime);
}).observe({ type: "paint", buffered: true }))"""


def _fits_both_widths_and_themes(page) -> None:
    for size in (WIDE, PHONE):
        page.set_viewport_size(size)
        for theme in ("dark", "light"):
            width, ink, paper = page.evaluate(_PAINTED, theme)
            assert width <= size["width"], (
                f"the page scrolls sideways at {size['width']} px, {theme}: {page.evaluate(_WIDEST)}"
            )
            assert _contrast(ink, paper) > 4.5, f"{theme}: text {ink} on {paper}"


_WIDEST = """() => [...document.querySelectorAll("article *")]
  .filter((e) => e.getBoundingClientRect().right > innerWidth + 1)
  .slice(0, 3).map((e) => e.outerHTML.slice(0, 120))"""
_PAINTED = """(theme) => {
  document.documentElement.dataset.theme = theme;
  const text = document.querySelector("article p") || document.querySelector("article") || document.body;
  const ink = getComputedStyle(text).color, paper = getComputedStyle(document.body).backgroundColor;
  return [document.documentElement.scrollWidth, ink, paper];
}"""
# written, drawn, wrong, and red, which is how an unknown macro is drawn
_FORMULAS = """() => [
  "span.math, div.math", ".math mjx-container > svg", "mjx-container [data-mml-node='merror']",
  "mjx-container [fill='red']",
].map((kind) => document.querySelectorAll(kind).length)"""
_IMAGES = """() => Promise.all([...document.images].map(async (i) => {
  i.loading = "eager";
  await i.decode().catch(() => {});
  return { alt: i.alt, src: i.src, width: i.naturalWidth };
}))"""
# what would be lost on a sheet of this size: white text, live scenes, folded solutions, what is too wide or too tall
_ON_PAPER = """({ width, height }) => {
  dispatchEvent(new Event("beforeprint"));
  const lost = [], seen = (e) => e.checkVisibility();
  if (document.documentElement.dataset.theme !== "light") lost.push("dark paper");
  for (const e of document.querySelectorAll("iframe, .bd-sidebar, .bd-header")) if (seen(e)) lost.push(e.outerHTML);
  for (const e of document.querySelectorAll(".solution p, .solution pre, .solution img"))
    if (!seen(e)) lost.push(e.outerHTML);
  for (const e of document.querySelectorAll("article :is(pre, img, mjx-container)")) {
    const box = e.getBoundingClientRect();
    if (seen(e) && (e.scrollWidth > e.clientWidth + 1 && e.tagName === "PRE" || box.right > width + 1))
      lost.push(`wide: ${e.outerHTML}`);
    if (e.tagName === "IMG" && box.height > height) lost.push(`tall: ${e.outerHTML}`);
  }
  dispatchEvent(new Event("afterprint"));
  return lost.map((html) => html.slice(0, 160));
}"""


def _contrast(ink: str, paper: str) -> float:
    """Ratio of relative luminances (WCAG 2)."""

    def luminance(css):
        c = np.array([float(v) for v in re.findall(r"[\d.]+", css)[:3]]) / 255
        return np.where(c <= 0.03928, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722]

    low, high = sorted((luminance(ink), luminance(paper)))
    return (high + 0.05) / (low + 0.05)


def _read(source: str) -> np.ndarray | None:
    """Grey levels of an image of the page (of its first frame, if it moves); None for drawings (SVG)."""
    if "image/svg" in source[:30] or source.endswith(".svg"):
        return None
    if source.startswith("data:"):
        data = base64.b64decode(source.split(",", 1)[1])
    else:
        data = Path(unquote(urlsplit(source).path)).read_bytes()
    return np.asarray(Image.open(io.BytesIO(data)).convert("L"))


def _serious_violations_of_axe(page) -> None:
    """None by axe-core, with everything unfolded and in both themes."""
    page.add_script_tag(url=AXE)
    page.evaluate(_LET_KEYS_IN)
    assert page.evaluate(_SERIOUS, ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"]) == []
    page.evaluate(_THIN_OUT)
    for theme in ("light", "dark"):
        page.evaluate(_PAINTED, theme)
        assert page.evaluate(_SERIOUS, "color-contrast") == [], theme
    page.evaluate("sessionStorage.passed = passed")


_UNFOLD = """() => {
  const still = document.createElement("style");
  still.textContent = "* { transition: none !important; animation: none !important }";
  document.head.append(still);
  document.querySelectorAll("details").forEach((e) => (e.open = true));
  document.querySelectorAll(".toggle-hidden").forEach((e) => e.classList.remove("toggle-hidden"));
  // formulas take their colour from the text around them; code and signatures repeat a few kinds of words
  document.querySelectorAll("mjx-container").forEach((e) => e.remove());
  const known = new Set();
  for (const e of document.querySelectorAll("pre span, dt.sig span:not([id])")) {
    const kind = e.className + e.parentNode.className + e.closest("div, dt").className;
    if (known.has(kind)) e.replaceWith(...e.childNodes);
    known.add(kind);
  }
  document.body.normalize();
}"""
# the theme lets the keyboard into what scrolls, 300 ms after a resize
_LET_KEYS_IN = """() => new Promise((done) => {
  dispatchEvent(new Event("resize"));
  setTimeout(done, 400);
})"""
# a rule finds what is as serious as the rule says: those that say less need not be run
_SERIOUS = """async (rules) => {
  const mild = axe._audit.rules.filter((r) => ["minor", "moderate"].includes(r.impact)).map((r) => r.id);
  const skipped = rules === "color-contrast" ? [] : [...mild, "color-contrast"];
  const found = await axe.run(
    document,
    {
      resultTypes: ["violations"], iframes: false, preload: false, runOnly: rules,
      rules: Object.fromEntries(skipped.map((id) => [id, { enabled: false }])),
    },
  );
  return found.violations
    .filter((v) => ["serious", "critical"].includes(v.impact))
    .flatMap((v) => v.nodes.map((n) => `${v.id}: ${n.html.slice(0, 160)} ${n.failureSummary}`));
}"""
# colours follow from tag, class and style of an element and of those around it, and from the style sheets: one text
# of each kind is enough, on this page and, once it has passed, on those that the same tab visits afterwards.
# What is thinned is a copy: the theme's scripts go on watching the whole page, and would miss what is taken away.
_THIN_OUT = """() => {
  document.body.replaceWith(document.body.cloneNode(true));
  const numbers = new Map(JSON.parse(sessionStorage.passed ?? "[]"));
  const number = (kind) => numbers.get(kind) ?? numbers.set(kind, numbers.size).size - 1;
  const sheets = [...document.querySelectorAll("link[rel~=stylesheet], style:not([id^=MJX])")];
  (function thin(e, around) {
    const stripe = e.tagName === "TR" ? [...e.parentNode.children].indexOf(e) % 2 : "";
    const kind = number(`${around}>${e.tagName}.${e.className}${e.getAttribute("style") ?? ""}${stripe}`);
    for (const t of [...e.childNodes].filter((t) => t.nodeType === Node.TEXT_NODE && t.data.trim())) {
      if (numbers.has(`text in ${kind}`)) t.remove();
      number(`text in ${kind}`);
    }
    for (const child of [...e.children]) thin(child, kind);
    if (e !== document.body && !e.textContent.trim() && !e.querySelector("img, button, input")) e.remove();
  })(document.body, sheets.map((e) => e.href ?? e.textContent).join());
  window.passed = JSON.stringify([...numbers]);
}"""


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_theme_is_the_readers_own(opened, theme):
    page = opened("intro.html", WIDE, theme)
    assert page.evaluate("document.documentElement.dataset.theme") == theme


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


def test_print_makes_a_pdf_of_many_sheets(opened):
    if "chapters/01_functional_maps.html" not in PAGES:
        _absent("the book is not built: make book")
    page = opened("chapters/01_functional_maps.html", WIDE, "dark")
    pdf = page.pdf(format="A4")
    assert 3 < len(re.findall(rb"/Type\s*/Page\b", pdf)) < 30
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"  # and the screen is as before


def test_players_run_and_rest_and_obey_keys(opened):
    if not PLAYERS:
        _absent("no page has a player")
    page = opened(PLAYERS[0], WIDE, "light")
    figure = page.locator(".fm-moving").first
    frame, still, slider = figure.locator(".fm-frame"), figure.locator(".fm-still"), figure.get_by_label("frame")
    last = slider.get_attribute("max")
    page.emulate_media(reduced_motion="reduce")
    page.reload()
    frame.scroll_into_view_if_needed()
    page.wait_for_timeout(500)
    assert slider.input_value() == last  # it waits to be asked
    end = _settled(page, frame)
    assert np.abs(end - _resized(still.get_attribute("src"), end)).mean() < 6  # what paper shows is the last frame
    slider.focus()
    page.keyboard.press("Home")
    start = _settled(page, frame)
    assert np.abs(start - end).mean() > 0.5
    page.keyboard.press("ArrowRight")
    assert slider.input_value() == "1"
    assert figure.evaluate(_PLAY_AND_PAUSE) == ["Pause", "Play", True]
    page.emulate_media(reduced_motion="no-preference")
    page.add_init_script(_PLAYED)  # on a busy machine it may be over before the page has loaded
    page.reload()
    for _ in range(100):  # formulas that are drawn move it away again
        frame.scroll_into_view_if_needed()
        if page.evaluate("window.played === true"):  # by itself, once
            break
        page.wait_for_timeout(100)
    else:
        pytest.fail("the player did not start when it was seen")
    page.emulate_media(media="print")
    assert still.is_visible()
    assert not frame.is_visible()


@pytest.mark.parametrize("name", PLAYERS)
def test_every_player_has_frames_and_a_still_of_the_last(opened, name):
    opened.page.emulate_media(reduced_motion="reduce")
    opened.page.route("**/mathjax/*", lambda route: route.fulfill(body=""))
    page = opened(name, WIDE, "light")
    figures = page.locator(".fm-moving")
    for k in range(figures.count()):
        frame, slider = figures.nth(k).locator(".fm-frame"), figures.nth(k).get_by_label("frame")
        frame.scroll_into_view_if_needed()
        end = _settled(page, frame)
        still = figures.nth(k).locator(".fm-still").get_attribute("src")
        assert np.abs(_coarse(end) - _coarse(_resized(still, end))).mean() < 6
        slider.focus()
        page.keyboard.press("Home")
        assert np.abs(_settled(page, frame) - end).mean() > 0.5
        caption = figures.nth(k).locator("xpath=ancestor::figure/figcaption")
        assert caption.count() == 0 or caption.first.inner_text().strip()
    page.emulate_media(media="print")
    for k in range(figures.count()):
        assert figures.nth(k).locator(".fm-still").is_visible()


# in the page, because on a busy machine the frames may be over before a second click arrives
_PLAY_AND_PAUSE = """(figure) => new Promise((done) => {
  const [button, slider] = ["button", "input"].map((q) => figure.querySelector(q));
  button.click();
  const playing = button.textContent, poll = setInterval(() => {
    if (+slider.value < 3) return;
    clearInterval(poll);
    button.click();
    const rests = slider.value;
    setTimeout(() => done([playing, button.textContent, slider.value === rests]), 600);
  }, 5);
})"""
_PLAYED = """new MutationObserver(() => {
  if (document.querySelector(".fm-moving button")?.textContent === "Pause") window.played = true;
}).observe(document, { childList: true, subtree: true, characterData: true });"""


def _coarse(image: np.ndarray) -> np.ndarray:
    """Means of blocks of 4 x 4 pixels, in which thin lines do not depend on where they fall."""
    height, width = (4 * (n // 4) for n in image.shape[:2])
    return image[:height, :width].reshape(height // 4, 4, width // 4, 4, 3).mean(axis=(1, 3))


def _resized(source: str, like: np.ndarray) -> np.ndarray:
    image = Image.open(io.BytesIO(base64.b64decode(source.split(",", 1)[1]))).convert("RGB")
    return np.asarray(image.resize(like.shape[1::-1], Image.Resampling.LANCZOS), dtype=int)


def test_search_finds_a_word_from_disk(opened):
    if "search.html" not in PAGES:
        _absent("the book is not built: make book")
    page = opened("search.html", WIDE, "light")
    page.goto((HTML / "search.html").as_uri() + "?q=eigenfunction")
    page.locator("#search-results li a").first.wait_for(timeout=10_000)


@pytest.mark.parametrize("name", PAGES)
def test_page_is_light(name):
    assert (HTML / name).stat().st_size <= 3_000_000


def test_scenes_are_alive_wherever_they_can_be():
    if not SCENES:
        _absent("no page has a scene")
    for name in SCENES:
        text = (HTML / name).read_text(encoding="utf-8")
        alive = text.count('<script type="text/plain">') - text.count('<div class="fm-explorer"')  # needs no OpenGL
        assert (alive > 0) == can_render(), name


@pytest.mark.parametrize("name", SCENES)
def test_scenes_draw_and_turn_when_dragged(opened, name):
    if not can_render():
        _absent("no OpenGL here, so the book has still pictures: apt-get install libegl1 libgl1")
    opened.page.route("**/mathjax/*", lambda route: route.fulfill(body=""))  # costs more than a scene
    page = opened(name, SMALL, "light", alive=True)
    stages = page.locator(".fm-stage:has(> script)")
    for k in range(stages.count()):
        stages.nth(k).scroll_into_view_if_needed()
        stages.nth(k).locator("iframe.fm-drawn").wait_for(timeout=30_000)
        assert page.locator("iframe.fm-live").count() <= 6
        titles = [title.bounding_box() for title in stages.nth(k).locator(".fm-titles > span").all()]
        assert titles == sorted(titles, key=lambda box: (box["y"], box["x"]))  # as the panels of the still
    stage = stages.first
    stage.scroll_into_view_if_needed()
    stage.locator("iframe.fm-drawn").wait_for(timeout=30_000)
    before = _settled(page, stage)
    assert len(np.unique(before.reshape(-1, 3), axis=0)) > 50, "blank scene"
    for _ in range(5):  # a busy machine may lose a drag, or answer late
        drag(page, stage)
        for _ in range(20):
            if np.abs(_picture(stage) - before).mean() > 1:
                return
            page.wait_for_timeout(100)
    pytest.fail("the scene did not turn")


def test_shapes_stand_one_above_the_other_on_a_phone(opened):
    """Once the scene is drawn, and without a viewer, where the still is cut into its panels."""
    if not can_render():
        _absent("no OpenGL here, so the book has still pictures: apt-get install libegl1 libgl1")
    opened.page.route("**/mathjax/*", lambda route: route.fulfill(body=""))
    for alive in (True, False):
        page = opened("chapters/05_oracle.html", PHONE, "light", alive=alive)
        stage = page.locator(".fm-stage").first
        stage.scroll_into_view_if_needed()
        if alive:
            stage.locator("iframe.fm-drawn").wait_for(timeout=30_000)
        boxes = [box.bounding_box() for box in stage.locator(".fm-titles > span").all()]
        assert len(boxes) == 2
        assert boxes[0]["x"] == boxes[1]["x"]
        assert boxes[1]["y"] > boxes[0]["y"] + 150
        upper, lower = np.array_split(_settled(page, stage), 2)
        for panel in (upper, lower):
            ink = (panel[30:-5] < 240).any(axis=2)  # below the title
            assert 0.05 < ink.mean() < 0.6
            assert ink[:, ink.shape[1] // 2 :].any()
        colours = [np.ptp(panel, axis=2).mean() for panel in (upper, lower)]
        assert colours[0] > 1.5 * colours[1]  # images all over the body above, a single spot below


@pytest.mark.parametrize("alive", [True, False])
def test_titles_stand_over_their_shapes_on_a_desktop(opened, alive):
    """Two rows of two: read along the rows in the still picture and in the viewer alike."""
    if not can_render():
        _absent("no OpenGL here, so the book has still pictures: apt-get install libegl1 libgl1")
    opened.page.route("**/mathjax/*", lambda route: route.fulfill(body=""))
    page = opened("chapters/06_uncertainty.html", SMALL, "light", alive=alive)
    stage = page.locator(".fm-stage").first
    stage.scroll_into_view_if_needed()
    if alive:
        stage.locator("iframe.fm-drawn").wait_for(timeout=30_000)
    titles = stage.locator(".fm-titles > span")
    _, hot, inferred, _ = (titles.nth(k).bounding_box() for k in range(4))
    assert ["β = 1" in text for text in titles.all_inner_texts()] == [False, True, False, False]
    assert hot["x"] > inferred["x"]
    assert hot["y"] < inferred["y"]
    top, bottom = np.array_split(_settled(page, stage), 2)
    middle = top.shape[1] // 2
    assert np.ptp(top[:, middle:], axis=2).mean() > 2 * np.ptp(bottom[:, :middle], axis=2).mean()  # all over the body


def drag(page, element) -> None:
    """Pull the mouse across an element, as a reader turns a scene."""
    box = element.bounding_box()
    x, y = box["x"] + box["width"] / 4, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 90, y + 20, steps=6)
    page.mouse.up()


def _picture(element) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(element.screenshot())).convert("RGB"), dtype=int)


def _settled(page, element) -> np.ndarray:
    """Screenshot of an element once two in a row agree."""
    last = None
    for _ in range(20):
        page.wait_for_timeout(200)
        shot = _picture(element)
        if last is not None and np.array_equal(shot, last):
            break
        last = shot
    return shot


@pytest.fixture(scope="module")
def explored(tmp_path_factory):
    """A page with nothing but an explorer of two eggs, where vertices go to themselves, upside down, or astray."""
    ball = sphere(n_rings=24)
    ball = replace(ball, vertices=ball.vertices * [1, 0.6, 1])  # turning a ball would not be seen
    other = replace(ball, name="other")
    chosen = np.arange(0, len(ball.vertices), 9)
    rings = chosen // 24 * 24
    below = np.where(chosen < 48 * 24, rings + 23 - chosen % 24, chosen)  # the same longitude, the other hemisphere
    astray = np.random.default_rng(0).integers(0, len(ball.vertices), (len(chosen), 100))
    near = np.repeat(chosen[:, None], 100, axis=1)
    radius = [np.full(len(chosen), 0.7)] * 2
    states = [
        viz.State("observed", (below[:, None],) * 2, noise=0.1),
        viz.State("observed", (chosen[:, None],) * 2),
        viz.State("posterior", (astray,) * 2, radius, (chosen,) * 2, temperature="β = 1"),
        viz.State("posterior", (near,) * 2, radius, (chosen,) * 2, temperature="κ inferred"),
        viz.State("calibrated", (chosen[:, None],) * 2, radius),
    ]
    shown = viz.explorer([ball, other], (chosen, chosen), states, alt="Two balls.", truth=(chosen, chosen), start=1)
    page = tmp_path_factory.mktemp("explorer") / "page.html"
    page.write_text(
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        "<title>Explorer</title><style>:root { color-scheme: light dark }</style>"
        f"<main><h1>Explorer</h1>{shown.html()}</main></html>",
        encoding="utf-8",
    )
    return page


def _ready(page) -> dict[str, str]:
    """What the explorer says of itself, once it is there."""
    page.locator(".fm-explorer[data-fm=ready]").wait_for(timeout=30_000)
    return page.evaluate("({ ...document.querySelector('.fm-explorer').dataset })")


def _drawn(page, k: int) -> np.ndarray:
    """Pixels (height, width, 4) of one canvas, as they were last drawn."""
    return np.asarray(
        Image.open(io.BytesIO(base64.b64decode(page.evaluate(_CANVAS, k).split(",")[1]))).convert("RGBA"), dtype=int
    )


_CANVAS = "(k) => document.querySelector('.fm-explorer').shadowRoot.querySelectorAll('canvas')[k].toDataURL()"


def _lit(page, k: int) -> np.ndarray:
    """Rows and columns (p, 2) of pixels that shine in the warm colours of images."""
    image = _drawn(page, k)
    return np.argwhere((image[..., 0] > image[..., 2] + 30) & (image[..., 3] == 255))


def _blue(page, k: int) -> int:
    image = _drawn(page, k)
    return int(((image[..., 2] > image[..., 0] + 60) & (image[..., 3] == 255)).sum())


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("size", [WIDE, PHONE], ids=["wide", "phone"])
def test_explorer_answers_clicks_keys_sliders_and_switch(opened, explored, size, theme):
    page = opened(explored, size, theme)
    first = _ready(page)
    canvases, words = page.locator("canvas"), page.get_by_role("status")
    assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
    boxes = [canvases.nth(k).bounding_box() for k in (0, 1)]
    assert (boxes[0]["y"] == boxes[1]["y"]) == (size is WIDE)  # side by side, or one above the other

    def place(x, y):
        return {"x": x * boxes[0]["width"], "y": y * boxes[0]["height"]}

    canvases.nth(0).click(position=place(0.65, 0.35))
    clicked = _ready(page)
    assert clicked["vertex"] != first["vertex"]
    assert (
        words.inner_text() == f"Vertex {clicked['vertex']} of ball, observed: one image on other, below .01 √area off."
    )
    assert len(_lit(page, 0)) == 0
    lit = _lit(page, 1)
    assert len(lit) > 20
    share = lit.mean(axis=0) / _drawn(page, 1).shape[:2]
    assert np.abs(share - [0.35, 0.65]).max() < 0.12  # the ball beside looks the same

    page.get_by_label("noise").fill("1")  # upside down
    assert _ready(page)["noise"] == "0.1"
    assert _lit(page, 1)[:, 0].mean() > lit[:, 0].mean() + 20
    page.get_by_label("noise").fill("0")

    page.locator("label", has_text="posterior").click()
    wide = _ready(page)
    assert (wide["view"], wide["temperature"]) == ("posterior", "β = 1")
    assert int(wide["places"]) > 80
    assert "100 images at" in words.inner_text()
    assert re.search(r"radius of the 90 % region \.2\d √area", words.inner_text())
    spread = _lit(page, 1)
    page.get_by_label("temperature").fill("1")
    assert _ready(page)["places"] == "1"
    assert _lit(page, 1).std(axis=0).max() < 0.6 * spread.std(axis=0).max()
    assert _blue(page, 1) > 5 * _blue(page, 0)
    assert page.get_by_label("temperature").get_attribute("aria-valuetext") == "κ inferred"

    page.get_by_role("radio", name="posterior").focus()
    page.keyboard.press("ArrowRight")
    assert _ready(page)["view"] == "calibrated"
    assert page.get_by_label("temperature").is_disabled()
    canvases.nth(0).focus()
    page.keyboard.press("ArrowRight")
    moved = _ready(page)
    assert moved["vertex"] != clicked["vertex"]
    assert moved["vertex"] in words.inner_text()
    assert _lit(page, 1)[:, 1].mean() > lit[:, 1].mean()
    before = _drawn(page, 0)
    page.keyboard.press("Shift+ArrowLeft")
    assert _ready(page)["vertex"] == moved["vertex"]
    assert np.abs(_drawn(page, 0) - before).mean() > 0.5

    canvases.nth(1).click(position=place(0.5, 0.5))  # and back
    assert _ready(page)["from"] == "1"
    assert len(_lit(page, 0)) > 20
    assert len(_lit(page, 1)) == 0


@pytest.mark.parametrize("name", EXPLORERS)
@pytest.mark.parametrize(("size", "theme"), [(WIDE, "light"), (PHONE, "dark")], ids=["wide", "phone"])
def test_explorers_of_the_book_answer(opened, name, size, theme):
    opened.page.route("**/mathjax/*", lambda route: route.fulfill(body=""))
    page = opened(name, size, theme)
    page.locator(".fm-explorer").scroll_into_view_if_needed()
    first = _ready(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
    canvases = page.locator(".fm-explorer canvas")
    assert len(_lit(page, 1)) > 5
    canvases.nth(0).focus()
    page.keyboard.press("ArrowUp")
    moved = _ready(page)
    assert moved["vertex"] != first["vertex"]
    assert moved["vertex"] in page.get_by_role("status").inner_text()
    box = canvases.nth(0).bounding_box()
    canvases.nth(0).click(position={"x": 0.5 * box["width"], "y": 0.48 * box["height"]})  # the body
    assert _ready(page)["vertex"] not in (moved["vertex"], first["vertex"])
    assert len(_lit(page, 1)) > 5
    for view in page.get_by_role("radio").all():
        view.check(force=True)  # under its label
        assert _ready(page)["view"] == view.get_attribute("value")
        for key in ("noise", "temperature"):
            slider = page.get_by_role("slider", name=key)
            if slider.count() and slider.is_enabled():
                ends = [(slider.fill(at), _ready(page)[key])[1] for at in (slider.get_attribute("max"), "0")]
                assert ends[0] != ends[1]
    page.emulate_media(media="print")
    assert page.locator(".fm-explorer > img").is_visible()


def test_explorer_answers_a_finger_and_turns_when_dragged(opened, explored):
    page = opened(explored, PHONE, "light")
    first, canvas = _ready(page), page.locator("canvas").first
    touch = page.context.new_cdp_session(page)
    touch.send("Emulation.setTouchEmulationEnabled", {"enabled": True})
    box = canvas.bounding_box()
    point = {"x": box["x"] + 0.6 * box["width"], "y": box["y"] + 0.3 * box["height"]}
    touch.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [point]})
    touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    page.wait_for_function(
        "(old) => document.querySelector('.fm-explorer').dataset.vertex !== old", arg=first["vertex"], timeout=5000
    )
    tapped, before = _ready(page), _drawn(page, 0)
    drag(page, canvas)
    assert np.abs(_drawn(page, 0) - before).mean() > 0.5
    assert _ready(page)["vertex"] == tapped["vertex"]


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_explorer_is_usable_by_everyone(opened, explored, theme):
    page = opened(explored, WIDE, theme)
    _ready(page)
    page.add_script_tag(url=AXE)
    assert page.evaluate(_SERIOUS, ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"]) == []
    assert page.evaluate(_SERIOUS, "color-contrast") == []
    page.emulate_media(media="print")
    assert page.locator(".fm-explorer > img").is_visible()
    assert not page.locator("canvas").first.is_visible()


def test_explorer_draws_where_there_is_no_webgl(opened, explored):
    opened.page.add_init_script(
        "const old = HTMLCanvasElement.prototype.getContext;"
        "HTMLCanvasElement.prototype.getContext = function (kind, ...more) {"
        "  return kind.startsWith('webgl') ? null : old.call(this, kind, ...more); }"
    )
    page = opened(explored, PHONE, "light")
    _ready(page)
    page.locator("canvas").first.click()
    assert len(_lit(page, 1)) > 20
    assert len(np.unique(_drawn(page, 0).reshape(-1, 4), axis=0)) > 50
