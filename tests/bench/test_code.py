"""Which edits make a cell stale."""

import sys

import pytest

from bench import code


@pytest.fixture
def package(tmp_path, monkeypatch):
    folder = tmp_path / "stale_package"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "a.py").write_text("from stale_package import b\nfrom .c import f\n")
    (folder / "b.py").write_text("import numpy\n")
    (folder / "c.py").write_text("def f(): import stale_package.d\n")
    (folder / "d.py").write_text("METHOD = 'robust'\n")
    (folder / "e.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    yield folder
    for name in [name for name in sys.modules if name.startswith("stale_package")]:
        del sys.modules[name]
    code._code.cache_clear(), code._tree.cache_clear(), code._imports.cache_clear(), code._file.cache_clear()


def test_imports_are_followed_and_strangers_are_not(package):
    found = code.used_modules(["stale_package.a"])
    assert {f"stale_package.{name}" for name in "abcd"} <= set(found)
    assert "stale_package.e" not in found
    assert "numpy" not in found
    assert "fmsync.estimators.robust" in found  # by its name
    assert "fmsync.langevin" in found


@pytest.mark.parametrize(
    ("edited", "text", "stale"),
    [
        ("b", "X = 1\n", True),
        ("d", "X = 1\n", True),
        ("e", "X = 1\n", False),
        ("b", '"""What it is."""\nimport numpy  # why\n', False),
        ("c", 'def f():\n    "What it does."\n    import stale_package.d\n', False),
        ("c", 'def f():\n    "What it does."\n    return import_module("stale_package.d")\n', True),
    ],
)
def test_an_edit_shows_where_it_matters(package, edited, text, stale):
    before = code.fingerprint(["stale_package.a"])
    (package / f"{edited}.py").write_text(text)
    code._code.cache_clear(), code._tree.cache_clear(), code._imports.cache_clear()
    assert (code.fingerprint(["stale_package.a"]) != before) == stale


def test_methods_do_not_depend_on_their_rivals():
    assert "fmsync.estimators.robust" not in code.used_modules(code.method_modules("spectral"))
    assert "fmsync.estimators.mle" in code.used_modules(code.method_modules("mean-of-starts"))
    assert "fmsync.samplers.rlfm" in code.used_modules(code.method_modules("rlfm"))


def test_problems_depend_on_what_makes_their_data():
    found = set(code.used_modules(["bench.problems"]))
    assert {"fmsync.bounds", "data_gen.noise", "data_gen.cats", "data_gen.cache"} <= found
