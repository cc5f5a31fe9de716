"""This book for Sphinx: executable pages, a cache that goes stale, no network, links to notebooks, and directives.

``stages`` draws those of the method; ``fm-status`` and ``fm-worlds`` tell of the cache and of results/worlds.json,
``fm-licences`` of what the project depends on; ``figures`` lists figures and tables with the first sentences of their
captions. What a cell prints under a label that begins with ``tab-`` is numbered as a table.
"""

import hashlib
import importlib.util
import json
import os
import platform
import re
import shutil
import tomllib
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, metadata, version
from pathlib import Path

import yaml
from docutils import nodes
from jupyter_cache import get_cache
from myst_nb.core.read import read_myst_markdown_notebook
from nbformat import NotebookNode
from sphinx.application import Sphinx
from sphinx.errors import SphinxError
from sphinx.transforms import SphinxTransform
from sphinx.util.docutils import SphinxDirective
from sphinx.util.fileutil import copy_asset_file
from sphinx.util.nodes import make_refnode

from bench.provenance import machine

ROOT = Path(__file__).resolve().parents[2]
_DRAWN = tomllib.loads(Path(__file__).with_name("stages.toml").read_text(encoding="utf-8"))
_LIBRARIES = ("fmsync", "numpy", "scipy", "numba", "pymanopt", "geomstats", "pyvista", "pyfmaps", "jupyter-book")
_STAGES = _DRAWN.pop("stages")  # of the method, by name; what is left are outlines of cats


def cache_folder() -> Path:
    """Execution cache named by everything a page depends on besides its own cells.

    The library, the problem generator, the committed results, the lock file, the collection in use, and whether
    scenes can be drawn: jupyter-cache itself looks at the text of the cells only.
    """
    from fmsync.viz.scenes import can_render

    digest = hashlib.sha256(f"turnable scenes: {can_render()}".encode())
    files = [ROOT / "requirements.txt"]
    for package in ("fmsync", "data_gen", "bench", "results"):
        files += sorted(p for p in (ROOT / package).rglob("*") if p.is_file() and "__pycache__" not in p.parts)
    files = [file for file in files if file.name != "worlds.json"]  # of which the status page alone speaks
    for file in files:
        digest.update(f"{file.relative_to(ROOT)}\0".encode() + file.read_bytes())
    collection = Path(os.environ.get("FMSYNC_DATA") or os.devnull) / "tosca_cat"
    if collection.is_dir():
        for file in sorted(collection.iterdir()):
            stat = file.stat()
            digest.update(f"{file.name} {stat.st_size} {stat.st_mtime_ns}\n".encode())
    return ROOT / "_build" / ".jupyter_cache" / digest.hexdigest()[:12]


def pages() -> list[Path]:
    """Executable pages of the table of contents, in its order."""
    toc = yaml.safe_load((ROOT / "book" / "_toc.yml").read_text(encoding="utf-8"))
    files = [ROOT / "book" / f"{entry['file']}.md" for part in toc["parts"] for entry in part["chapters"]]
    return [f for f in files if "kernelspec:" in f.read_text(encoding="utf-8")[:600]]


def surroundings() -> dict[str, str]:
    """Where a page is executed; kept beside its outputs."""
    shapes = Path(os.environ.get("FMSYNC_DATA") or os.devnull) / "tosca_cat"
    return {
        "machine": machine(),
        "system": f"{platform.system()} {platform.release()}, Python {platform.python_version()}",
        "shapes": "the TOSCA cats" if shapes.is_dir() else "the cats that come with the project",
    }


def notebook_of(page: Path) -> NotebookNode:
    """The cells of a page; what the execution cache finds its outputs by."""
    return read_myst_markdown_notebook(page.read_text(encoding="utf-8"), path=str(page))


def _configure(app, config):
    os.environ["FMSYNC_SHARED_VIEWER"] = "1"  # read by the kernels this build starts
    config.nb_execution_cache_path = str(cache_folder())
    if config.html_theme_options.get("repository_url"):
        config.html_theme_options |= {"use_repository_button": True, "use_issues_button": True}


def _copy_assets(app):
    if app.builder.format != "html":
        return
    static = Path(app.outdir) / "_static"
    (static / "mathjax").mkdir(parents=True, exist_ok=True)
    mathjax = Path(importlib.util.find_spec("sphinx-mathjax-offline").submodule_search_locations[0])
    copy_asset_file(str(mathjax / "static/mathjax/tex-svg-full.js"), str(static / "mathjax"))
    viewer = Path(importlib.util.find_spec("trame_vtk").origin).with_name("tools") / "static_viewer.html"
    script = Path(__file__).with_name("viewer_script.html").read_text(encoding="utf-8")
    page = viewer.read_text(encoding="utf-8").replace("</body>", script + "</body>")
    (static / "viewer.html").write_text(page, encoding="utf-8")
    copy_asset_file(str(ROOT / "fmsync" / "viz" / "explorer.js"), str(static))
    app.add_js_file("explorer.js")
    shutil.copytree(ROOT / "book" / "notebooks", Path(app.outdir) / "notebooks", dirs_exist_ok=True)


def _finish_page(app, pagename, templatename, context, doctree):
    if "script_files" in context:  # sphinx-thebe declares its constants twice (a page error) and would call a CDN
        context["script_files"][:] = [script for script in context["script_files"] if "thebe" not in str(script)]
    body = context.get("body", "")
    for role in (' role="list"', ' role="doc-biblioentry"'):  # a list may hold items only; these hold links as well
        body = body.replace(role, "")
    name = pagename.rsplit("/", 1)[-1]
    if (ROOT / "book" / "notebooks" / f"{name}.ipynb").exists():
        href = context["pathto"](f"notebooks/{name}.ipynb", resource=True)
        links = [f'<a href="{href}" download>Download this page as a notebook</a>']
        options = app.config.html_theme_options
        for where, address in launch_links(options.get("repository_url"), options.get("repository_branch"), name):
            links.append(f'<a href="{address}">run it on {where}</a>')
        told = ", ".join(links)
        if "load_collection()" in Path(app.env.doc2path(pagename)).read_text(encoding="utf-8"):
            told += f" · the cats here are {surroundings()['shapes']}"
        body = body.replace("</h1>", f'</h1>\n<p class="fm-download">{told}</p>', 1)
    context["body"] = body


def launch_links(url: str | None, branch: str | None, name: str) -> list[tuple[str, str]]:
    """Where a page's notebook runs without an installation; nothing while the project has no address on GitHub.

    >>> for where, address in launch_links("https://github.com/someone/fmsync", "main", "03_mle"):
    ...     print(where, address)
    Binder https://mybinder.org/v2/gh/someone/fmsync/main?urlpath=lab/tree/book/notebooks/03_mle.ipynb
    Colab https://colab.research.google.com/github/someone/fmsync/blob/main/book/notebooks/03_mle.ipynb
    """
    host, _, project = (url or "").removesuffix("/").removesuffix(".git").partition("github.com/")
    if host != "https://" or not project:
        return []
    branch, notebook = branch or "main", f"book/notebooks/{name}.ipynb"
    return [
        ("Binder", f"https://mybinder.org/v2/gh/{project}/{branch}?urlpath=lab/tree/{notebook}"),
        ("Colab", f"https://colab.research.google.com/github/{project}/blob/{branch}/{notebook}"),
    ]


class Stages(SphinxDirective):
    """``{stages} maps``: a row of small drawings, which lead to chapters; the stage *maps*, if named, is highlighted.

    They are drawn in the colour of the text, so that the row suits both themes.
    """

    optional_arguments = 1

    def run(self):
        here = self.arguments[0] if self.arguments else None
        if here not in (None, *_STAGES):
            raise SphinxError(f"{self.env.docname}: no stage {here!r} of the method; there are {', '.join(_STAGES)}")
        folder, items = "" if self.env.docname.startswith("chapters/") else "chapters/", []
        for name, stage in _STAGES.items():
            current = ' aria-current="step"' if name == here else ""
            drawing = stage["drawing"].format(**_DRAWN)
            items.append(
                f'<li><a href="{folder}{stage["chapter"]}.html"{current}>'
                f'<svg viewBox="0 0 120 94" aria-hidden="true" focusable="false">{drawing}</svg>{name}</a></li>'
            )
        row = f'<ol class="fm-stages" aria-label="The stages of the method">{"".join(items)}</ol>'
        return [nodes.raw("", row, format="html")]


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
    lines += ["", f"Together {total / 60:.1f} CPU-minutes, without the imports that all share.", ""]
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
                    words = re.sub(r"\\(S?O)\{(\w)\}", r"\1(\2)", caption.astext().replace("\n", " "))
                    first = re.match(r".*?\.(?=\s|$)|.*", words)[0]
                    row = nodes.paragraph("", "")
                    row += make_refnode(app.builder, docname, page, label, nodes.Text(number))
                    row += nodes.Text(f" {first}")
                    rows += nodes.list_item("", row)
        place.replace_self(rows if len(rows) else [])


def setup(app: Sphinx):
    app.add_directive("stages", Stages)
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
    app.connect("config-inited", _configure)
    app.connect("builder-inited", _copy_assets)
    app.connect("html-page-context", _finish_page, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
