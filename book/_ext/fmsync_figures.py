"""Directive ``figures``: a list of the numbered figures of the book, each with the first sentence of its caption."""

import re

from docutils import nodes
from sphinx.util.docutils import SphinxDirective
from sphinx.util.nodes import make_refnode


class figure_list(nodes.General, nodes.Element):
    """Stands where the list will be, until all pages are read and numbered."""


class Figures(SphinxDirective):
    def run(self):
        return [figure_list()]


def _pages(env, page):
    """A page and those below it, in the order of the contents."""
    yield page
    for below in env.toctree_includes.get(page, ()):
        yield from _pages(env, below)


def _fill(app, doctree, docname):
    for place in doctree.findall(figure_list):
        rows = nodes.bullet_list()
        for page in _pages(app.env, app.config.root_doc):
            numbers = app.env.toc_fignumbers.get(page, {}).get("figure", {})
            for figure in app.env.get_doctree(page).findall(nodes.figure):
                label = next((i for i in figure["ids"] if i in numbers), None)
                caption = next(iter(figure.findall(nodes.caption)), None)
                if label and caption is not None:
                    number = ".".join(map(str, numbers[label]))
                    first = re.match(r".*?[.:](?=\s|$)|.*", caption.astext().replace("\n", " "))[0].rstrip(":")
                    row = nodes.paragraph("", "")
                    row += make_refnode(app.builder, docname, page, label, nodes.Text(f"Fig. {number}"))
                    row += nodes.Text(f" {first}")
                    rows += nodes.list_item("", row)
        place.replace_self(rows if len(rows) else [])


def setup(app):
    app.add_node(figure_list)
    app.add_directive("figures", Figures)
    app.connect("doctree-resolved", _fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
