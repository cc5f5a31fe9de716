"""Finished cells on disk, one small file each, named by what went in; and failures, apart from them."""

import contextlib
import hashlib
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

Record = Mapping[str, object]


def key_of(content: Mapping[str, object]) -> str:
    """SHA-256 of plain JSON values; the order of the keys does not matter.

    Examples
    --------
    >>> from bench.store import key_of
    >>> key_of({"a": 1, "b": 2}) == key_of({"b": 2, "a": 1})
    True
    """
    return hashlib.sha256(_dump(content)).hexdigest()


@dataclass(frozen=True)
class Store:
    """A folder of cells.

    Every file is written under a temporary name and renamed: whoever is killed leaves a whole file or none.
    """

    folder: Path

    def write(self, key: str, record: Record) -> None:
        """Keep the record of a finished cell; an OSError, for instance of a full disk, leaves nothing half-written."""
        self._write(self.path(key), record)
        self.failure_path(key).unlink(missing_ok=True)

    def write_failure(self, key: str, record: Record) -> None:
        """Note down a failure. It is never read as a result: the next run tries the cell again."""
        self._write(self.failure_path(key), record)

    def read(self, key: str) -> dict | None:
        """The record of a finished cell, or None.

        Raises
        ------
        CorruptCellError
            The file is there but damaged.
        """
        path = self.path(key)
        try:
            text = path.read_bytes()
        except FileNotFoundError:
            return None
        try:
            wrapped = json.loads(text)
            record = wrapped["record"]
            if wrapped["sha256"] != hashlib.sha256(_dump(record)).hexdigest():
                raise ValueError("checksum")
        except (ValueError, KeyError, TypeError) as error:
            raise CorruptCellError(f"{path}: damaged cell; it will be computed again") from error
        return record

    def failure(self, key: str) -> dict | None:
        """What was noted down about the last failure of a cell, or None."""
        try:
            return json.loads(self.failure_path(key).read_bytes())["record"]
        except (OSError, ValueError, KeyError):
            return None

    def path(self, key: str) -> Path:
        """File of a finished cell."""
        return self.folder / key[:2] / f"{key}.json"

    def failure_path(self, key: str) -> Path:
        """File of a failure."""
        return self.folder / key[:2] / f"{key}.failed"

    def mark_started(self, key: str) -> None:
        """Say that this process works on a cell, so that it is known what it worked on if it dies."""
        _in_folder(self._mark(key), Path.touch)

    def unmark(self, key: str) -> None:
        """Take the mark of :meth:`mark_started` away."""
        self._mark(key).unlink(missing_ok=True)

    def take_started(self) -> set[str]:
        """Keys that are marked; takes the marks away."""
        marks = list((self.folder / "started").glob("*"))
        for mark in marks:
            mark.unlink(missing_ok=True)
        return {mark.name for mark in marks}

    def _mark(self, key: str) -> Path:
        return self.folder / "started" / key

    def _write(self, path: Path, record: Record) -> None:
        text = _dump({"sha256": hashlib.sha256(_dump(record)).hexdigest(), "record": record})
        temporary = path.with_name(f"{path.name}.{os.getpid()}.part")
        try:
            _in_folder(temporary, lambda part: part.write_bytes(text))  # not synced: a power cut fails the checksum
            os.replace(temporary, path)
        except OSError:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            raise


def _in_folder(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file into a folder that is made if it is not there: as a rule it is, and to ask every time is dear."""
    try:
        write(path)
    except FileNotFoundError:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(path)


class CorruptCellError(ValueError):
    """A cell on disk cannot be trusted."""


def _dump(value: object) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=True).encode()
