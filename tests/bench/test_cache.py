"""Records on disk: whole or not there."""

import errno
import os

import pytest

from bench.cache import ResultCache, key_of

KEY = key_of({"a": 1})


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
