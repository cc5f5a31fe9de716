"""The result cache: a small file for each run, named by what went into it; failures are kept apart."""

import contextlib
import hashlib
import json
import os
import secrets
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path


class CorruptRecordError(ValueError):
    """A file of the result cache cannot be trusted."""


def key_of(content: Mapping[str, object]) -> str:
    """SHA-256 of plain JSON values; the order of the keys does not matter.

    Examples
    --------
    >>> from bench.cache import key_of
    >>> key_of({"a": 1, "b": 2}) == key_of({"b": 2, "a": 1})
    True
    """
    return hashlib.sha256(_dump(content)).hexdigest()


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A file to write, which takes the place of ``path`` if all goes well.

    Its name is unique: whoever is killed, or writes at the same time, leaves a whole file or none.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f"{path.name}.{os.getpid()}-{secrets.token_hex(4)}.part")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@dataclass(frozen=True)
class ResultCache:
    """A folder of records."""

    folder: Path

    def path(self, key: str, suffix: str = "json") -> Path:
        """File of a finished run; that of a failure has the suffix ``"failed"``."""
        return self.folder / key[:2] / f"{key}.{suffix}"

    def write(self, key: str, record: Mapping[str, object]) -> None:
        """Keep a record: a failure is never read as a result, so that the next run tries again."""
        finished = record["status"] == "ok"
        text = _dump({"sha256": hashlib.sha256(_dump(record)).hexdigest(), "record": record})
        with replacing(self.path(key, "json" if finished else "failed")) as temporary:
            temporary.write_bytes(text)  # not synced: after a power cut the checksum fails
        if finished:
            self.path(key, "failed").unlink(missing_ok=True)

    def read(self, key: str, suffix: str = "json") -> dict | None:
        """The record of a finished run or, with the suffix ``"failed"``, of its last failure; None if there is none.

        Raises
        ------
        CorruptRecordError
            The file is there but damaged.
        """
        path = self.path(key, suffix)
        try:
            wrapped = json.loads(path.read_bytes())
            if wrapped["sha256"] != hashlib.sha256(_dump(wrapped["record"])).hexdigest():
                raise ValueError("checksum")
        except FileNotFoundError:
            return None
        except (ValueError, KeyError, TypeError) as error:
            raise CorruptRecordError(f"{path}: damaged record; the run will be repeated") from error
        return wrapped["record"]


def _dump(value: object) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=True).encode()
