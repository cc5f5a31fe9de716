"""Arrays that are dear to make, kept in the user's cache folder and never trusted without their checksum."""

import contextlib
import hashlib
import os
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from platformdirs import user_cache_path

Arrays = Mapping[str, np.ndarray]


def cached(key: str, build: Callable[[], Arrays]) -> Arrays:
    """The arrays that ``build`` makes, from the cache when they were made before.

    A file that is damaged, truncated or does not match its checksum is built again; a folder that cannot be written
    to costs the time of building, nothing else. The folder is ``fmsync`` in the platform's cache folder
    (``XDG_CACHE_HOME`` on Linux).
    """
    path = user_cache_path("fmsync", appauthor=False) / f"{key}.npz"
    arrays = _read(path)
    if arrays is None:
        arrays = build()
        _write(path, arrays)
    return arrays


def checksum(arrays: Arrays) -> str:
    """SHA-256 of names, types, shapes and bytes."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _read(path: Path) -> Arrays | None:
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        return None
    stored = arrays.pop("checksum", None)
    return arrays if stored is not None and str(stored) == checksum(arrays) else None


def _write(path: Path, arrays: Arrays) -> None:
    """Under a temporary name first: another process never sees half a file."""
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
            temporary = file.name
            np.savez(file, checksum=np.array(checksum(arrays)), **arrays)
        os.replace(temporary, path)
    except OSError:
        if temporary is not None:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
