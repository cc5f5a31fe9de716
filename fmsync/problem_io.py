"""Problems in one file: NumPy arrays and a JSON record in an ``.npz`` without pickle, bit for bit."""

import json
import os
import tempfile
import zipfile
from pathlib import Path

import numpy as np

from fmsync.problem import SyncProblem

_FIELDS = ("n_nodes", "edges", "maps", "weights", "provenance")


def save_problem(problem: SyncProblem, path: str | Path) -> Path:
    """Write a problem; the file appears whole or not at all.

    Parameters
    ----------
    problem
        What to write, its provenance included.
    path
        File name; ``.npz`` is appended if it is missing.

    Returns
    -------
    Path
        The file written.

    Examples
    --------
    >>> import numpy as np, fmsync, pathlib, tempfile
    >>> p = fmsync.SyncProblem(2, [[0, 1]], np.eye(3)[None])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     fmsync.load_problem(fmsync.save_problem(p, pathlib.Path(folder) / "two")).n_nodes
    2
    """
    path = Path(path)
    path = path if path.suffix == ".npz" else path.with_name(path.name + ".npz")
    record = np.frombuffer(json.dumps(dict(problem.provenance)).encode(), dtype=np.uint8)
    arrays = (np.int64(problem.n_nodes), problem.edges, problem.maps, problem.weights, record)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **dict(zip(_FIELDS, arrays)))
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise
    return path


def load_problem(path: str | Path) -> SyncProblem:
    """Read a problem written by :func:`save_problem`; a ValueError names the file when it is not one."""
    try:
        with np.load(path, allow_pickle=False) as file:
            n_nodes, edges, maps, weights, record = (file[name] for name in _FIELDS)
        provenance = json.loads(record.tobytes())
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path}: not a complete problem file ({error}); write it again with save_problem") from error
    return SyncProblem(int(n_nodes), edges, maps, weights, provenance)
