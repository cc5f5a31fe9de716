"""Cells on disk: whole or not there."""

import errno
import os

import pytest

from bench.store import CorruptCellError, Store, key_of

KEY = key_of({"a": 1})


def test_round_trip_with_numbers_that_json_does_not_know(tmp_path):
    store = Store(tmp_path)
    assert store.read(KEY) is None
    store.write(KEY, {"status": "ok", "metrics": [["x", None, 0.1 + 0.2], ["y", 3.0, float("inf")]]})
    assert store.read(KEY)["metrics"] == [["x", None, 0.1 + 0.2], ["y", 3.0, float("inf")]]


@pytest.mark.parametrize("damage", [b"", b"{", b"[]", b'{"record": {"status": "ok"}, "sha256": "0"}'])
def test_damage_is_noticed(tmp_path, damage):
    store = Store(tmp_path)
    store.write(KEY, {"status": "ok"})
    store.path(KEY).write_bytes(damage)
    with pytest.raises(CorruptCellError, match="computed again"):
        store.read(KEY)


def test_a_changed_number_is_noticed(tmp_path):
    store = Store(tmp_path)
    store.write(KEY, {"value": 1.25})
    store.path(KEY).write_bytes(store.path(KEY).read_bytes().replace(b"1.25", b"1.35"))
    with pytest.raises(CorruptCellError):
        store.read(KEY)


def test_failures_are_not_results_and_end_with_success(tmp_path):
    store = Store(tmp_path)
    store.write_failure(KEY, {"status": "error"})
    assert store.read(KEY) is None
    assert store.failure(KEY) == {"status": "error"}
    store.write(KEY, {"status": "ok"})
    assert store.failure(KEY) is None


def test_a_full_disk_leaves_no_half_file(tmp_path, monkeypatch):
    store = Store(tmp_path)
    store.write(KEY, {"value": 1})

    def full(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="No space"):
        store.write(KEY, {"value": 2})
    assert store.read(KEY) == {"value": 1}
    assert not list(tmp_path.rglob("*.part"))


def test_marks(tmp_path):
    store = Store(tmp_path)
    store.mark_started(KEY)
    store.mark_started("other")
    store.unmark("other")
    assert store.take_started() == {KEY}
    assert store.take_started() == set()
