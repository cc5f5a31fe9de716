"""Directives of the reference pages: ``fm-status`` and ``fm-worlds``, from the cache and from results/worlds.json,
``fm-licences`` of what the project depends on, and ``figures``: figures and tables, each with the first sentence of its
caption. What a cell prints under a label that begins with ``tab-`` is numbered as a table.
"""

import json
import re
import tomllib
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, metadata, version
from pathlib import Path

from docutils import nodes
from fmsync_book import ROOT, cache_folder, notebook_of, pages
from jupyter_cache import get_cache
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform
from sphinx.util.docutils import SphinxDirective
from sphinx.util.nodes import make_refnode

_LIBRARIES = ("fmsync", "numpy", "scipy", "numba", "pymanopt", "geomstats", "pyvista", "pyfmaps", "jupyter-book")


def table_of(lines: Callable[[str], list[str]], file: str) -> type[SphinxDirective]:
    """A directive that stands for lines of Markdown, made from the text of a file of the project."""

    class Table(SphinxDirective):
        def run(self) -> list[nodes.Node]:
            self.env.note_dependency(str(ROOT / file))
            return self.parse_text_to_nodes("\n".join(lines((ROOT / file).read_text(encoding="utf-8"))))

    return Table


def worlds_table(told: dict) -> list[str]:
    """Chapters by worlds, whether every claim held or which one failed, from the table of ``scripts/worlds.py``.

    >>> lines = worlds_table({"worlds": ["native +7"], "machine": "m", "shapes": "s", "command": "c", "chapters":
    ...     {"05_oracle": {"closest": "a < b", "margin": 5.2, "failures": [["a < b: 3 and 2"]]}}})
    >>> print(lines[2])
    | {doc}`/chapters/05_oracle` | ✗ | 5.2 |
    >>> print(lines[-2])
    - {doc}`/chapters/05_oracle`: in world 1 `a < b: 3 and 2` failed; closest `a < b`
    """
    folders = {page.stem: page.parent.name for page in pages()}
    titles = ["chapter", *map(str, range(1, len(told["worlds"]) + 1)), "margin"]
    lines = [f"| {' | '.join(titles)} |", "|" + " --- |" * len(titles)]
    notes = []
    for chapter, row in told["chapters"].items():
        name = f"{{doc}}`/{folders[chapter]}/{chapter}`"
        cells = ["✗" if failed else "✓" for failed in row["failures"]]
        margin = f"{min(row['margin'], 99):.1f}" if row["margin"] else "–"
        lines.append(f"| {name} | {' | '.join(cells)} | {margin} |")
        said = [f"in world {k} {_code('; '.join(f))} failed" for k, f in enumerate(row["failures"], 1) if f]
        said += [f"closest {_code(row['closest'])}"] if row["closest"] else []
        notes += [f"- {name}: {'; '.join(said)}"] if said else []
    worlds = ", ".join(f"{k} {world}" for k, world in enumerate(told["worlds"], 1))
    made = f"Worlds: {worlds}. Made by `{told['command']}` on {told['machine']}, with {told['shapes']}."
    return [*lines, "", made, "", *notes, ""]


def _code(text: str) -> str:
    """Text in a cell of a table, as it stands in the code."""
    return "`" + text.replace("`", "'").replace("|", "\\|") + "`"


def records() -> dict[Path, dict]:
    """What the execution cache knows of each page; pages that it does not hold are left out."""
    cache, found = get_cache(str(cache_folder())), {}
    for page in pages():
        with suppress(KeyError):
            found[page] = cache.match_cache_notebook(notebook_of(page)).data
    return found


def status_table(files: list[Path], found: dict[Path, dict]) -> list[str]:
    """Chapters with seconds and result, then versions, machine and shapes, from :func:`pages` and :func:`records`."""
    lines = ["| chapter | seconds | CPU seconds | result |", "| --- | ---: | ---: | --- |"]
    for page in files:
        data = found.get(page, {})
        told = [f"{data[key]:.0f}" if key in data else "–" for key in ("execution_seconds", "cpu_seconds")]
        told.append("passed" if page in found else "not run")
        lines.append(f"| {{doc}}`/{page.parent.name}/{page.stem}` | {' | '.join(told)} |")
    total = sum(data.get("cpu_seconds", 0) for data in found.values())  # what another tool executed has no such entry
    lines += ["", f"Together {total / 60:.1f} CPU-minutes.", ""]
    for name in ("machine", "system", "shapes"):
        values = sorted({data[name] for data in found.values() if name in data}) or ["not known"]
        lines.append(f"- **{name.capitalize()}:** {'; '.join(values)}")
    return [*lines, f"- **Versions:** {', '.join(f'{library} {version(library)}' for library in _LIBRARIES)}"]


def licence_table(project: dict) -> list[str]:
    """A row for each package that pyproject.toml names, in the first extra that asks for it: version and licence."""
    lines, seen = ["| package | needed by | version | licence |", "| --- | --- | --- | --- |"], {"fmsync"}
    for extra, wanted in {"core": project["dependencies"], **project["optional-dependencies"]}.items():
        for name in sorted(re.match(r"[\w.-]+", requirement)[0] for requirement in wanted):
            if name not in seen:
                seen.add(name)
                lines.append(f"| {name} | {extra} | {' | '.join(version_and_licence(name))} |")
    return lines


def version_and_licence(name: str) -> tuple[str, str]:
    """From the metadata of an installed package: its licence expression, else its classifiers, else a short text."""
    try:
        told = metadata(name)
    except PackageNotFoundError:
        return "–", "–"
    classifiers = [c.rpartition(" :: ")[2] for c in told.get_all("Classifier") or [] if c.startswith("License ::")]
    text = (told.get("License") or "").strip().partition("\n")[0]
    return told["Version"], told.get("License-Expression") or ", ".join(classifiers) or text or "not stated"


class captioned_table(nodes.figure):
    """A table that a cell prints, with its caption."""


class Tables(SphinxTransform):
    """Makes tables of the figures that are labelled so, before anything is numbered."""

    default_priority = 800

    def apply(self, **kwargs):
        for node in self.document.findall(nodes.figure):
            if any(name.startswith("tab-") for name in node["names"]):
                node.__class__ = captioned_table
                node["classes"].append("fm-table")


def _open_table(writer, node):
    writer.body.append(writer.starttag(node, "figure", tabindex=0))  # keys reach what scrolls


class figure_list(nodes.General, nodes.Element):
    """Stands where the list will be, until all pages are read and numbered."""


class Figures(SphinxDirective):
    def run(self):
        return [figure_list()]


def _fill(app, doctree, docname):
    for place in doctree.findall(figure_list):
        rows = nodes.bullet_list()
        for page in app.env.collect_relations():  # in the order of the contents
            numbers = app.env.toc_fignumbers.get(page, {})
            for figure in app.env.get_doctree(page).findall(nodes.figure):
                kind = "table" if isinstance(figure, captioned_table) else "figure"
                label = next((i for i in figure["ids"] if i in numbers.get(kind, {})), None)
                caption = next(iter(figure.findall(nodes.caption)), None)
                if label and caption is not None:
                    number = app.config.numfig_format[kind] % ".".join(map(str, numbers[kind][label]))
                    first = re.match(r".*?[.:](?=\s|$)|.*", caption.astext().replace("\n", " "))[0].rstrip(":")
                    row = nodes.paragraph("", "")
                    row += make_refnode(app.builder, docname, page, label, nodes.Text(number))
                    row += nodes.Text(f" {first}")
                    rows += nodes.list_item("", row)
        place.replace_self(rows if len(rows) else [])


def setup(app: Sphinx):
    app.add_directive("fm-status", table_of(lambda contents: status_table(pages(), records()), "book/_toc.yml"))
    app.add_directive("fm-worlds", table_of(lambda told: worlds_table(json.loads(told)), "results/worlds.json"))
    app.add_directive("fm-licences", table_of(lambda t: licence_table(tomllib.loads(t)["project"]), "pyproject.toml"))
    app.add_directive("figures", Figures)
    app.add_node(figure_list)
    app.add_transform(Tables)
    app.add_enumerable_node(
        captioned_table, "table", html=(_open_table, lambda writer, node: writer.depart_figure(node))
    )
    app.connect("doctree-resolved", _fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
