"""Arrays that are expensive to make, kept in the user's cache folder and never trusted without their checksum."""

import contextlib
import hashlib
import os
import platform
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import numpy as np
import scipy
import scipy.linalg  # loads the BLAS of SciPy, which arithmetic() asks for its name
from threadpoolctl import threadpool_info

from fmsync.files import replacing

Arrays = Mapping[str, np.ndarray]


def cached(key: str, build: Callable[[], Arrays]) -> Arrays:
    """The arrays that ``build`` makes, from the cache when they were made before in the same :func:`arithmetic`.

    A file that is damaged, truncated or does not match its checksum is built again; a folder that cannot be written
    to costs the time of building, nothing else. The file is ``fmsync/<arithmetic>/<key>.npz`` in the folder that the
    environment variable ``XDG_CACHE_HOME`` names, by default ``~/.cache``.
    """
    named = os.environ.get("XDG_CACHE_HOME", "")  # ignored if not absolute, as its specification says
    folder = Path(named) if os.path.isabs(named) else Path.home() / ".cache"
    path = folder / "fmsync" / arithmetic() / f"{key}.npz"
    arrays = _read(path)
    if arrays is None:
        arrays = build()
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as file:
                np.savez(file, checksum=np.array(checksum(arrays)), **arrays)
    return arrays


def recipe(*files: str) -> str:
    """Changes with these files, of this package or anywhere, so that an old cache is not read by a new version."""
    sources = [(Path(__file__).parent / name).read_bytes() for name in files]
    return hashlib.sha256(b"".join(sources)).hexdigest()[:12]


@cache
def arithmetic() -> str:
    """Name of what the last bits of a floating-point result depend on, besides the program and its input.

    The order of the terms of a sum, for instance, depends on the kernels that OpenBLAS chose (for NumPy and for SciPy),
    on the processor features that NumPy uses (without those in ``NPY_DISABLE_CPU_FEATURES``), on ``NUMBA_CPU_NAME`` and
    ``NUMBA_CPU_FEATURES``, on the versions of NumPy and SciPy, and on the machine's architecture and C library.
    Results with the same name, such as ``"Haswell-3f2a91c04b7e"``, are expected to agree bit by bit. The environment
    variables that change it (``OPENBLAS_CORETYPE`` as well) must be set before Python starts.
    """
    libraries = [library for library in threadpool_info() if library["user_api"] == "blas"]
    blas = sorted({f"{b['internal_api']} {b['version']} {b.get('architecture', 'unknown')}" for b in libraries})
    everything = {
        "blas": blas,
        "features": sorted(np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])),
        "numba": [os.environ.get(name, "") for name in ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES")],
        "versions": [np.__version__, scipy.__version__],
        "machine": [platform.machine(), *platform.libc_ver()],
    }
    kernels = sorted({b.rpartition(" ")[2] for b in blas}) or ["unknown"]
    return f"{'-'.join(kernels)}-{hashlib.sha256(repr(everything).encode()).hexdigest()[:12]}"


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
    except Exception:  # of many kinds, by where the damage is
        return None
    stored = arrays.pop("checksum", None)
    return arrays if stored is not None and str(stored) == checksum(arrays) else None
