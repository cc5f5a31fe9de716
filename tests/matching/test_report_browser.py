"""The report in a real browser, from disk: every pair can be chosen, and it turns when dragged."""

import base64
import io

import numpy as np
import pytest
from PIL import Image

from tests.test_book_browser import ARGS, CHROME, _absent, drag

pytestmark = pytest.mark.browser


def pixels(canvas) -> np.ndarray:
    drawn = canvas.evaluate("(c) => c.toDataURL()").split(",", 1)[1]
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(drawn))).convert("RGB"), dtype=int)


def test_the_report_shows_every_pair_and_turns(written, tmp_path):
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
        carried = page.locator("#carried")
        said, seen = set(), set()
        for i in range(3):
            for j in range(3):
                page.select_option("#from", str(i))
                page.select_option("#to", str(j))
                said.add(page.locator("#words").inner_text())
                seen.add(pixels(carried).tobytes())
        assert len(said) == 7  # six pairs, and a shape and itself
        assert len(seen) == 9
        before = pixels(carried)
        assert len(np.unique(before.reshape(-1, 3), axis=0)) > 50, "blank"
        drag(page, carried)
        assert np.abs(pixels(carried) - before).mean() > 1, "it did not turn"
        context.set_offline(True)
        page.set_viewport_size({"width": 390, "height": 844})
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        context.close()
    assert not wrong
