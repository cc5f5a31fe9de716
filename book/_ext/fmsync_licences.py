"""Sphinx extension of this book: the table of what the project depends on, and under which licences."""

import re
import tomllib
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

from docutils.nodes import Node
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).resolve().parents[2]


class Licences(SphinxDirective):
    """Packages that pyproject.toml names, by extra, with version and licence as their own metadata tells them."""

    def run(self) -> list[Node]:
        project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        self.env.note_dependency(str(ROOT / "pyproject.toml"))
        return self.parse_text_to_nodes("\n".join(licence_table(project)))


def licence_table(project: dict) -> list[str]:
    """Lines of Markdown: a row for each package, in the first extra that asks for it."""
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


def setup(app):
    app.add_directive("fm-licences", Licences)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
