"""The generated notebooks equal their chapters, and the generator notices when they do not."""

import importlib.util
import re
from pathlib import Path

import nbformat
import pytest

ROOT = Path(__file__).resolve().parents[1]
_spec = importlib.util.spec_from_file_location("sync_notebooks", ROOT / "scripts" / "sync_notebooks.py")
sync = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(sync)

CHAPTER = """---
jupytext:
  text_representation:
    extension: .md
    format_name: myst
kernelspec:
  display_name: Python 3
  language: python
  name: python3
---

(ch-one)=
# One

:::{prf:theorem} Nearest rotation
:label: near

Take the SVD, as in {eq}`eq-svd`.
:::

::::{admonition} You will learn
:class: tip
:::{note}
Everything.
:::
::::

$$
A = U S V
$$ (eq-svd)

```{stages} maps
```

See {numref}`fig-sum`.

```{code-cell} ipython3
---
tags: [hide-input]
mystnb:
  figure:
    name: fig-sum
    caption: A sum.
---
1 + 1
```
"""


@pytest.fixture
def book(tmp_path):
    (tmp_path / "chapters").mkdir()
    (tmp_path / "chapters" / "01_one.md").write_text(CHAPTER, encoding="utf-8")
    sync.write(tmp_path)
    return tmp_path


def test_committed_notebooks_equal_their_chapters():
    assert sync.stale() == []


def test_no_role_is_left_in_the_committed_notebooks():
    for path in (ROOT / "book" / "notebooks").glob("*.ipynb"):
        prose = "\n".join(c.source for c in nbformat.read(path, as_version=4).cells if c.cell_type == "markdown")
        assert not re.search(r"\{[a-z:]+\}`", prose), path


def test_an_edited_missing_or_orphaned_notebook_is_stale(book):
    notebook = book / "notebooks" / "01_one.ipynb"
    assert sync.stale(book) == []
    notebook.write_text(notebook.read_text(encoding="utf-8").replace("1 + 1", "1 + 2"), encoding="utf-8")
    assert sync.stale(book) == ["01_one.ipynb"]
    notebook.unlink()
    assert sync.stale(book) == ["01_one.ipynb"]
    sync.write(book)
    (book / "notebooks" / "02_gone.ipynb").write_text("{}", encoding="utf-8")
    assert sync.stale(book) == ["02_gone.ipynb"]
    sync.write(book)
    assert sync.stale(book) == []


def test_notebook_has_stable_ids_no_outputs_and_the_tags(book):
    notebook = nbformat.read(book / "notebooks" / "01_one.ipynb", as_version=4)
    assert [c.id for c in notebook.cells] == [f"01_one-{k:03d}" for k in range(len(notebook.cells))]
    (code,) = [c for c in notebook.cells if c.cell_type == "code"]
    assert code.outputs == []
    assert code.metadata.tags == ["hide-input"]
    assert code.metadata.jupyter.source_hidden


def test_prose_reads_well_without_myst(book):
    notebook = nbformat.read(book / "notebooks" / "01_one.ipynb", as_version=4)
    prose = "\n".join(c.source for c in notebook.cells if c.cell_type == "markdown")
    assert "**Theorem (Nearest rotation).**" in prose
    assert "**You will learn.**" in prose
    assert "as in (svd)" in prose
    assert "shapes → **maps** → synchronised" in prose
    assert "See Fig. 1.1." in prose
    assert notebook.cells[-1].source == "*Fig. 1.1.* A sum."
    assert "\\tag{svd}\n$$" in prose
    assert r"\renewcommand{\SO}[1]" in notebook.cells[0].source
    for leftover in (":::", ":label:", ":class:", "{prf:", "(ch-one)=", "$$ ("):
        assert leftover not in prose


def test_tables_and_exercises_are_numbered_and_other_chapters_named(tmp_path):
    cell = "```{code-cell} ipython3\n---\nmystnb:\n  figure:\n    name: %s\n    caption: No. %s\n---\n1\n```\n"
    cells = [cell % (f"{kind}-x{k}", k) for k, kind in enumerate(("fig", "tab", "fig"))]
    asked = "```{exercise}\n:label: ex-one\nSee {numref}`tab-x1`, {numref}`fig-mle-bound`.\n```\n"
    asked += "\n````{solution-start} ex-one\n````\n"
    page = tmp_path / "one.md"
    page.write_text("# One\n\n" + "\n".join(cells) + "\n" + asked, encoding="utf-8")
    text = [c.source for c in nbformat.reads(sync.render(page), 4).cells]
    assert [t for t in text if t.startswith("*Fig") or t.startswith("*Table")] == [
        "*Fig. 1.* No. 0",
        "*Table 1.* No. 1",
        "*Fig. 2.* No. 2",
    ]
    assert "**Exercise 1.**" in text[-1]
    assert "See Table 1, Fig. 3." in text[-1]
    assert "of *Many maps, one answer" in text[-1]
    assert "**Solution (Exercise 1).**" in text[-1]
