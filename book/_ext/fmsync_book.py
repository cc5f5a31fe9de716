"""This book for Sphinx: executable pages, a cache that goes stale, no network, links to notebooks, a row of stages."""

import hashlib
import importlib.util
import os
import platform
import shutil
import tomllib
from pathlib import Path

import yaml
from docutils import nodes
from myst_nb.core.read import read_myst_markdown_notebook
from nbformat import NotebookNode
from sphinx.application import Sphinx
from sphinx.errors import SphinxError
from sphinx.util.docutils import SphinxDirective
from sphinx.util.fileutil import copy_asset_file

from bench.provenance import machine

ROOT = Path(__file__).resolve().parents[2]
_DRAWN = tomllib.loads(Path(__file__).with_name("stages.toml").read_text(encoding="utf-8"))
_STAGES = _DRAWN.pop("stages")  # of the method, by name; what is left are outlines of cats


def cache_folder() -> Path:
    """Execution cache named by everything a page depends on besides its own cells.

    The library, the problem generator, the committed results, the lock file, the collection in use, and whether
    scenes can be drawn: jupyter-cache itself looks at the text of the cells only.
    """
    from fmsync.viz.scenes import can_render

    digest = hashlib.sha256(f"turnable scenes: {can_render()}".encode())
    files = [ROOT / "requirements.txt"]
    for package, pattern in (("fmsync", "*.py"), ("data_gen", "*"), ("bench", "*"), ("results", "*")):
        files += sorted(p for p in (ROOT / package).rglob(pattern) if p.is_file() and "__pycache__" not in p.parts)
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


def setup(app: Sphinx):
    app.add_directive("stages", Stages)
    app.connect("config-inited", _configure)
    app.connect("builder-inited", _copy_assets)
    app.connect("html-page-context", _finish_page, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
