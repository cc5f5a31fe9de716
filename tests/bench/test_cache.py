"""Records on disk: whole or not there; and which edits make a result stale."""

import errno
import os
import sys

import pytest

from bench import cache as caching
from bench.cache import ResultCache, key_of

KEY = key_of({"a": 1})


def test_the_order_of_keys_does_not_matter():
    assert key_of({"a": 1, "b": 2}) == key_of({"b": 2, "a": 1})


def test_round_trip_with_numbers_that_json_does_not_know(tmp_path):
    cache = ResultCache(tmp_path)
    assert cache.read(KEY) is None
    cache.write(KEY, {"status": "ok", "metrics": [["x", None, 0.1 + 0.2], ["y", 3.0, float("inf")]]})
    assert cache.read(KEY)["metrics"] == [["x", None, 0.1 + 0.2], ["y", 3.0, float("inf")]]


@pytest.mark.parametrize("damage", [b"", b"{", b"[]", b'{"record": {"status": "ok"}, "sha256": "0"}'])
def test_damage_is_noticed(tmp_path, damage):
    cache = ResultCache(tmp_path)
    cache.write(KEY, {"status": "ok"})
    cache.path(KEY).write_bytes(damage)
    with pytest.raises(ValueError, match="will be repeated"):
        cache.read(KEY)


def test_a_changed_number_is_noticed(tmp_path):
    cache = ResultCache(tmp_path)
    cache.write(KEY, {"status": "ok", "value": 1.25})
    cache.path(KEY).write_bytes(cache.path(KEY).read_bytes().replace(b"1.25", b"1.35"))
    with pytest.raises(ValueError, match="damaged"):
        cache.read(KEY)


def test_failures_are_not_results_and_end_with_success(tmp_path):
    cache = ResultCache(tmp_path)
    cache.write(KEY, {"status": "error"})
    assert cache.read(KEY) is None
    assert cache.read(KEY, "failed") == {"status": "error"}
    cache.write(KEY, {"status": "ok"})
    assert cache.read(KEY, "failed") is None


def test_a_full_disk_leaves_no_half_file(tmp_path, monkeypatch):
    cache = ResultCache(tmp_path)
    cache.write(KEY, {"status": "ok", "value": 1})

    def full(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="No space"):
        cache.write(KEY, {"status": "ok", "value": 2})
    assert cache.read(KEY) == {"status": "ok", "value": 1}
    assert not list(tmp_path.rglob("*.part"))


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
    monkeypatch.setattr(caching, "fmsync", __import__("stale_package"))
    yield tmp_path
    for name in [name for name in sys.modules if name.startswith("stale_")]:
        del sys.modules[name]
    forget()


def forget():
    """What a new process does not know."""
    caching.code_hash.cache_clear(), caching._hash_of_code.cache_clear(), caching.HASHES.clear()


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
    before = caching.code_hash("bench.problems", "stale_method")
    (package / edited).write_text(text)
    forget()
    assert (caching.code_hash("bench.problems", "stale_method") != before) == stale


def test_methods_do_not_depend_on_their_rivals_but_on_what_they_take_from_them(monkeypatch):
    read = []
    monkeypatch.setattr(caching, "_hash_of_code", lambda file: read.append(file.name) or file.name)
    caching.code_hash.__wrapped__("bench.problems", "bench.methods.consistent_zoomout")
    assert {"consistent_zoomout.py", "pyfm_network.py", "problems.py", "metrics.py"} <= set(read)
    assert not {"protocols.py", "scipy_eigh.py"} & set(read)
