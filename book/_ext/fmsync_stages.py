"""Directive ``stages``: the five stages of the method as a row of small drawings, the stage of the page highlighted.

Drawn in the colour of the text, so that the row suits both themes; every stage leads to its chapter.
"""

import tomllib
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.errors import SphinxError
from sphinx.util.docutils import SphinxDirective

_OUTLINES = tomllib.loads(Path(__file__).with_name("silhouettes.toml").read_text(encoding="utf-8"))
_STANDING, _LEAPING = _OUTLINES["standing"], _OUTLINES["leaping"]
_CAT = f'<path transform="translate(18 2)" d="{_LEAPING}"/>'
_TWO = (
    f'<path transform="translate(0 20) scale(.56)" d="{_STANDING}"/>'
    f'<path transform="translate(63 20) scale(.56)" d="{_LEAPING}"/>'
    '<circle class="fm-home" cx="35" cy="66" r="5"/>'
)
_NODES = "".join(f'<circle cx="{x}" cy="{y}" r="10"/>' for x, y in ((60, 14), (22, 78), (98, 78)))
_WOBBLES = (
    '<g class="fm-line fm-paw-line"><path d="M53 24L58 38L40 36L46 54L25 51L27 68"/>'
    '<path d="M67 24L81 29L74 44L93 45L86 60L95 67"/><path d="M33 78L44 66L52 88L64 68L74 89L87 78"/></g>'
)
_STRAIGHT = '<g class="fm-line"><path d="M55 23L28 68M65 23L92 68M33 78L87 78"/></g>'
_AROUND = ((0, 0), (7, -4), (-8, 3), (3, 7), (-3, -9), (11, 4), (-13, -5), (6, -13), (-5, 13), (15, -8), (-17, 6))
_CLOUD = "".join(f'<circle class="fm-paw" cx="{95 + x}" cy="{78 + y * 0.8:g}" r="2.6"/>' for x, y in _AROUND)
_REGION = '<ellipse class="fm-region" cx="95" cy="78" rx="21" ry="13"/><circle class="fm-home" cx="97" cy="80" r="4"/>'
STAGES = {  # name: drawing, chapter
    "shapes": (_TWO, "01_functional_maps"),
    "maps": (_WOBBLES + _NODES, "02_so_n"),
    "synchronised": (_STRAIGHT + _NODES, "03_mle"),
    "draws": (_CAT + _CLOUD, "04_rlfm"),
    "regions": (_CAT + _REGION, "06_uncertainty"),
}


class Stages(SphinxDirective):
    """``{stages} maps`` highlights the stage *maps*; without an argument none is highlighted."""

    optional_arguments = 1

    def run(self):
        here = self.arguments[0] if self.arguments else None
        if here not in (None, *STAGES):
            raise SphinxError(f"{self.env.docname}: no stage {here!r} of the method; there are {', '.join(STAGES)}")
        folder = "" if self.env.docname.startswith("chapters/") else "chapters/"
        items = []
        for name, (drawing, chapter) in STAGES.items():
            current = ' aria-current="step"' if name == here else ""
            items.append(
                f'<li><a href="{folder}{chapter}.html"{current}>'
                f'<svg viewBox="0 0 120 94" aria-hidden="true" focusable="false">{drawing}</svg>{name}</a></li>'
            )
        row = f'<ol class="fm-stages" aria-label="The stages of the method">{"".join(items)}</ol>'
        return [nodes.raw("", row, format="html")]


def setup(app: Sphinx):
    app.add_directive("stages", Stages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
