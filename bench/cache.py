"""The result cache: a small file for each run, named by what went into it; failures are kept apart."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fmsync.files import replacing


def key_of(content: Mapping[str, object]) -> str:
    """SHA-256 of plain JSON values; the order of the keys does not matter.

    >>> key_of({"a": 1, "b": 2}) == key_of({"b": 2, "a": 1})
    True
    """
    return hashlib.sha256(_dump(content)).hexdigest()


@dataclass(frozen=True)
class ResultCache:
    """A folder of records."""

    folder: Path

    def path(self, key: str, suffix: str = "json") -> Path:
        """File of a finished run; that of a failure has the suffix ``"failed"``."""
        return self.folder / key[:2] / f"{key}.{suffix}"

    def write(self, key: str, record: Mapping[str, object]) -> None:
        """Keep a record: a failure is never read as a result, so that the next run tries again."""
        path = self.path(key, "json" if record["status"] == "ok" else "failed")
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as file:  # not synced: after a power cut the checksum fails
            file.write(_dump({"sha256": key_of(record), "record": record}))
        if record["status"] == "ok":
            self.path(key, "failed").unlink(missing_ok=True)

    def read(self, key: str, suffix: str = "json") -> dict | None:
        """Record of a finished run, or of its last failure ("failed"); None if there is none, ValueError if damaged."""
        path = self.path(key, suffix)
        try:
            wrapped = json.loads(path.read_bytes())
            if wrapped["sha256"] != key_of(wrapped["record"]):
                raise ValueError("checksum")
        except FileNotFoundError:
            return None
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path}: damaged record; the run will be repeated") from error
        return wrapped["record"]


def _dump(value: object) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=True).encode()
