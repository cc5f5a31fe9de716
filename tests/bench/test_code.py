"""Which edits make a result stale."""

import sys

import pytest

from bench import code


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package in the place of the project's own, with a method's file outside of it."""
    folder = tmp_path / "stale_package"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "a.py").write_text("def f():\n    return 1\n")
    (tmp_path / "stale_method.py").write_text("X = 1\n")
    (tmp_path / "stale_rival.py").write_text("X = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(code, "fmsync", __import__("stale_package"))
    yield tmp_path
    for name in [name for name in sys.modules if name.startswith("stale_")]:
        del sys.modules[name]
    forget()


def forget():
    """What a new process does not know."""
    code.code_hash.cache_clear(), code._hash_of_code.cache_clear()


@pytest.mark.parametrize(
    ("edited", "text", "stale"),
    [
        ("stale_package/a.py", "def f():\n    return 2\n", True),
        ("stale_package/a.py", '"""What it is."""\n\n\ndef f():\n    "What it does."\n    return 1  # why\n', False),
        ("stale_package/new.py", "", True),
        ("stale_method.py", "X = 2\n", True),
        ("stale_rival.py", "X = 2\n", False),
    ],
)
def test_an_edit_shows_where_it_matters(package, edited, text, stale):
    forget()
    before = code.code_hash("bench.problems", "stale_method")
    (package / edited).write_text(text)
    forget()
    assert (code.code_hash("bench.problems", "stale_method") != before) == stale


def test_methods_do_not_depend_on_their_rivals_but_on_what_they_take_from_them(monkeypatch):
    read = []
    monkeypatch.setattr(code, "_hash_of_code", lambda file: read.append(file.name) or file.name)
    code.code_hash.__wrapped__("bench.problems", "bench.methods.consistent_zoomout")
    assert {"consistent_zoomout.py", "pyfm_network.py", "problems.py", "measure.py", "metrics.py"} <= set(read)
    assert not {"convergence.py", "scipy_eigh.py"} & set(read)
