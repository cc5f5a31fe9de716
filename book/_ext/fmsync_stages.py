"""Directive ``stages``: the five stages of the method as a row of small drawings, the stage of the page highlighted.

Drawn in the colour of the text, so that the row suits both themes; every stage leads to its chapter.
"""

import tomllib
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.errors import SphinxError
from sphinx.util.docutils import SphinxDirective

_DRAWN = tomllib.loads(Path(__file__).with_name("stages.toml").read_text(encoding="utf-8"))
STAGES = _DRAWN.pop("stages")  # by name; what is left are outlines of cats


class Stages(SphinxDirective):
    """``{stages} maps`` highlights the stage *maps*; without an argument none is highlighted."""

    optional_arguments = 1

    def run(self):
        here = self.arguments[0] if self.arguments else None
        if here not in (None, *STAGES):
            raise SphinxError(f"{self.env.docname}: no stage {here!r} of the method; there are {', '.join(STAGES)}")
        folder = "" if self.env.docname.startswith("chapters/") else "chapters/"
        items = []
        for name, stage in STAGES.items():
            current = ' aria-current="step"' if name == here else ""
            drawing = stage["drawing"].format(**_DRAWN)
            items.append(
                f'<li><a href="{folder}{stage["chapter"]}.html"{current}>'
                f'<svg viewBox="0 0 120 94" aria-hidden="true" focusable="false">{drawing}</svg>{name}</a></li>'
            )
        row = f'<ol class="fm-stages" aria-label="The stages of the method">{"".join(items)}</ol>'
        return [nodes.raw("", row, format="html")]


def setup(app: Sphinx):
    app.add_directive("stages", Stages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
