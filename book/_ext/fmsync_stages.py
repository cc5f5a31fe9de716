"""Directive ``stages``: the five stages of the method as a row of small drawings, the stage of the page highlighted.

Drawn in the colour of the text, so that the row suits both themes; every stage leads to its chapter.
"""

from docutils import nodes
from sphinx.errors import SphinxError
from sphinx.util.docutils import SphinxDirective

# silhouettes of the generated cats 0 and 10, 100 wide
_STANDING = (
    "M2 0L5 1L11 10L16 13L31 18L41 19L44 20L48 24L64 28L68 27L71 25L75 5L76 3L78 4L83 10L85 8L88 2L90 3L93 13L96 17"
    "L99 22L100 30L98 33L94 35L86 37L82 37L80 38L81 44L77 52L75 62L76 69L80 76L80 80L78 81L75 82L71 81L68 79L67 75"
    "L68 69L68 64L66 58L63 66L63 73L67 85L67 87L64 88L58 87L55 84L55 71L52 60L53 51L53 48L52 47L49 51L44 51L42 53"
    "L42 57L46 61L44 65L41 65L36 63L35 61L35 54L30 56L29 57L29 61L33 66L33 69L32 70L29 71L23 69L22 67L22 61L21 55"
    "L25 51L27 46L26 40L24 32L25 25L13 20L7 14z"
)
_LEAPING = (
    "M62 0L64 1L70 7L72 6L74 1L76 1L79 9L83 11L87 15L88 20L87 25L83 29L77 32L73 35L73 37L75 43L78 47L85 53L95 63"
    "L99 67L100 69L98 72L96 73L91 73L88 71L85 64L83 61L81 60L75 59L70 57L76 66L82 83L81 87L77 87L72 86L69 83L68 73"
    "L66 69L60 64L58 59L52 59L50 60L50 69L49 71L46 74L38 74L37 76L38 81L36 83L33 83L29 78L28 79L28 87L26 89L23 89"
    "L20 83L22 73L24 72L27 72L28 69L28 65L26 58L19 68L11 77L4 82L1 82L0 80L1 78L8 71L13 65L24 48L28 45L33 44L40 44"
    "L44 41L47 37L57 27L60 22L62 10z"
)
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


def setup(app):
    app.add_directive("stages", Stages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
