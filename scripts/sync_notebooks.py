"""Write book/notebooks/*.ipynb, without outputs, from the MyST chapters; --check fails if any differs.

One direction only: the chapters are the source. Cell ids are stable. What Jupyter does not render becomes plain
Markdown that reads well there: directives and roles, links to other chapters (their titles) and to publications (author
and year). A first cell says how to install, and defines the macros of the formulas.
"""

import argparse
import re
import sys
import tomllib
from collections import Counter
from functools import cache
from pathlib import Path

import jupytext
import nbformat
import yaml

ROOT = Path(__file__).resolve().parents[1]
BOOK = ROOT / "book"
_CELLS = tomllib.loads(Path(__file__).with_name("first_cells.toml").read_text(encoding="utf-8"))
_FENCE = re.compile(r"^(?P<fence>:{3,}|`{3,})\{(?P<name>[\w:-]+)\}[ ]*(?P<title>[^\n]*)$")
_OPTION = re.compile(r"^:[\w-]+:.*$")
_ROLES = re.compile(r"\{(?P<role>[a-z:]+)\}`(?:(?P<text>[^`<]+?)\s*<[^`>]+>|(?P<target>[^`]+))`")
_NUMBERED = re.compile(r"\{(?:numref|prf:ref)\}`([\w-]+)`")
_EXERCISE = re.compile(r"(\{exercise\}(?=\n:)|\{solution-start\})(?:\n:label:)? ([\w-]+)")
_KINDS = {"fig": "Fig.", "tab": "Table", "thm": "Theorem", "def": "Definition", "rem": "Remark", "ex": "Exercise"}
_LABELS = re.compile(rf"(?:name|label): (({'|'.join(_KINDS)})-[\w-]+)$", re.MULTILINE)
_STAGES = tuple(tomllib.loads((BOOK / "_ext" / "stages.toml").read_text(encoding="utf-8"))["stages"])  # of the method


def chapters(book: Path = BOOK) -> dict[str, Path]:
    """The executable pages, MyST files with a kernel, by the name of their notebook."""
    files = sorted(book.rglob("*.md"))
    return {f"{md.stem}.ipynb": md for md in files if "kernelspec:" in md.read_text(encoding="utf-8")[:600]}


def readable(text: str) -> str:
    """Markdown that Jupyter shows well: a directive becomes its bold name and its body, options and labels go.

    >>> readable(":::{prf:theorem} Nearest rotation\\n:label: near\\nTake the SVD.\\n:::")
    '**Theorem (Nearest rotation).**\\n\\nTake the SVD.'
    >>> readable("(here)=\\n# A title")
    '# A title'
    >>> readable("See {eq}`eq-geo` and {doc}`the next chapter <02_so_n>`.")
    'See (geo) and the next chapter.'
    >>> readable("{py:func}`~fmsync.so.log`, {math}`n`, {doc}`02_so_n`, {cite}`boumal2014cramer`")
    '`so.log`, $n$, *Rotations*, Boumal et al. (2014)'
    """
    out, open_fences, in_options = [], [], False
    for line in text.split("\n"):
        if start := _FENCE.match(line):
            open_fences.append(start["fence"])
            out += _heading(start["name"], start["title"].strip())
            in_options = True
        elif open_fences and line.strip() == open_fences[-1]:
            open_fences.pop()
            in_options = False
        elif not (in_options and _OPTION.match(line)) and not re.fullmatch(r"\([\w:-]+\)=", line.strip()):
            in_options = False
            out.append(re.sub(r"^\$\$ \((?:eq-)?([\w:-]+)\)$", r"\\tag{\1}\n$$", line))
    return _ROLES.sub(_plain, "\n".join(out)).strip("\n")


def _heading(directive: str, title: str) -> list[str]:
    name = directive.split(":")[-1].split("-")[0].capitalize()
    if directive == "stages":
        return [" → ".join(f"**{s}**" if s == title else s for s in _STAGES), ""]
    if directive == "admonition" or title.startswith(name + " "):  # an exercise with its number
        name, title = title, ""
    if directive == "math" or directive.endswith("-end") or not name:
        return []
    return [f"**{name} ({title}).**" if title else f"**{name}.**", ""]


def _plain(found: re.Match) -> str:
    role, text, target = found["role"], found["text"], found["target"]
    if text or role in ("term", "ref", "prf:ref", "numref"):
        return text or target
    if role == "math":
        return f"${target}$"
    if role == "eq":
        return f"({target.removeprefix('eq-')})"
    if role == "doc":
        return f"*{_titles()[target.rpartition('/')[2]]}*"
    if role.startswith("cite"):
        return ", ".join(_publications()[key.strip()] for key in target.split(","))
    return f"`{'.'.join(target[1:].split('.')[-2:]) if target[0] == '~' else target}`"  # of the library


@cache
def _titles() -> dict[str, str]:
    pages = {md.stem: re.search(r"^# (.+)$", md.read_text(encoding="utf-8"), re.MULTILINE) for md in BOOK.rglob("*.md")}
    return {name: _ROLES.sub(lambda f: f["text"] or f["target"], head[1]) for name, head in pages.items() if head}


@cache
def _publications() -> dict[str, str]:
    entries = re.split(r"^@\w+\{", (BOOK / "references.bib").read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    found = {}
    for entry in entries:
        fields = dict(re.findall(r"^ *(author|year) = \{(.+?)\},?$", entry, re.MULTILINE))
        first, _, others = fields["author"].partition(" and ")
        year = f" ({fields['year']})" if "year" in fields else ""
        found[entry.partition(",")[0]] = f"{first.partition(',')[0]}{' et al.' if others else ''}{year}"
    return found


def _macros() -> str:
    """Definitions that MathJax keeps for all cells."""
    config = yaml.safe_load((ROOT / "_config.yml").read_text(encoding="utf-8"))
    macros = config["sphinx"]["config"]["mathjax3_config"]["tex"]["macros"]
    found = []
    for name, value in macros.items():
        body, count = value if isinstance(value, list) else (value, 0)
        found.append(f"\\renewcommand{{\\{name}}}[{count}]{{{body}}}")
    return f"${''.join(found)}$"


def repository() -> dict[str, str]:
    """``url`` (empty while the project has no address) and ``branch``, from _config.yml."""
    return yaml.safe_load((ROOT / "_config.yml").read_text(encoding="utf-8"))["repository"]


def render(md: Path) -> str:
    """The notebook of one chapter as the text of its .ipynb file."""
    notebook, home = jupytext.read(md), repository()
    notebook.cells.insert(0, nbformat.v4.new_markdown_cell(_CELLS["first"].format(macros=_macros())))
    if home["url"]:
        notebook.cells.insert(0, nbformat.v4.new_code_cell(_CELLS["colab"].format(**home)))
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    notebook.metadata = nbformat.from_dict({"kernelspec": kernel, "language_info": {"name": "python"}})
    called, cells = _called(md), []
    named = _elsewhere() | called
    for cell in notebook.cells:
        cells.append(cell)
        if figure := cell.metadata.get("mystnb", {}).get("figure"):
            caption = f"*{called[figure['name']]}.* {figure['caption'].strip()}"
            cells.append(nbformat.v4.new_markdown_cell(caption))
    notebook.cells = cells
    for k, cell in enumerate(cells):
        cell["id"] = f"{md.stem}-{k:03d}"
        if cell.cell_type == "code":
            if "hide-input" in cell["metadata"].get("tags", ()):
                cell["metadata"]["jupyter"] = {"source_hidden": True}
        else:
            text = _NUMBERED.sub(lambda found: named[found[1]], cell["source"])
            cell["source"] = readable(_EXERCISE.sub(lambda found: f"{found[1]} {named[found[2]]}", text))
    notebook.nbformat, notebook.nbformat_minor = 4, 5
    nbformat.validate(notebook)
    return nbformat.writes(notebook) + "\n"


def _called(md: Path) -> dict[str, str]:
    """What figures, tables, theorems and exercises of a page are called, by their labels."""
    chapter = md.stem[:2].lstrip("0") + "." if md.stem[:2].isdigit() else ""
    count, called = Counter(), {}
    for label, kind in _LABELS.findall(md.read_text(encoding="utf-8")):
        count[kind] += 1
        called[label] = f"{_KINDS[kind]} {chapter}{count[kind]}"
    return called


@cache
def _elsewhere() -> dict[str, str]:
    return {k: f"{v} of *{_titles()[md.stem]}*" for md in chapters().values() for k, v in _called(md).items()}


def stale(book: Path = BOOK) -> list[str]:
    """Names of notebooks that are missing, differ from their chapter, or have lost it."""
    wanted = {name: render(md) for name, md in chapters(book).items()}
    found = {p.name: p.read_text(encoding="utf-8") for p in (book / "notebooks").glob("*.ipynb")}
    return sorted(name for name in wanted.keys() | found.keys() if wanted.get(name) != found.get(name))


def write(book: Path = BOOK) -> None:
    """Make the notebooks equal to the chapters."""
    wanted = {name: render(md) for name, md in chapters(book).items()}
    (book / "notebooks").mkdir(exist_ok=True)
    for old in (book / "notebooks").glob("*.ipynb"):
        old.unlink()
    for name, text in wanted.items():
        (book / "notebooks" / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="change nothing; exit 1 if a notebook is stale")
    if not parser.parse_args().check:
        write()
    elif bad := stale():
        sys.exit(f"stale notebooks (run `make notebooks`): {' '.join(bad)}")
