"""Small cats, matched once for all files of this folder."""

import hashlib
import pickle
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import data_gen
import fmsync
from fmsync.cli import main
from fmsync.matching import add, synchronize

OPTIONS = {"n_basis": 12, "n_refined": 30, "n_samples": 200, "rng": 0}
QUICK = ["--basis", "10", "--refined", "20", "--samples", "120", "--draws", "40", "--jobs", "1"]


_FOUND: dict[bytes, Any] = {}


def remembered(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, called once with the same arguments."""

    @wraps(function)
    def call(*arguments: Any) -> Any:
        key = hashlib.sha256(pickle.dumps((function.__name__, arguments))).digest()
        if key not in _FOUND:
            _FOUND[key] = function(*arguments)
        return _FOUND[key]

    return call


@pytest.fixture(scope="module", autouse=True)
def each_shape_and_pair_once():
    """Many tests synchronise the same shapes: sampling one and matching two depend on nothing but these."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (synchronize, add):
            for name in ("sample_shape", "match"):
                patch.setattr(module, name, remembered(getattr(module, name)))
        yield


@pytest.fixture(scope="session")
def cats():
    return data_gen.load_collection("cats", count=4, n_vertices=1000)


@pytest.fixture(scope="session")
def synced(cats):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # few draws: what is tested here is where they go
        return fmsync.synchronize_shapes(cats, n_draws=200, **OPTIONS)


def write_off(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    with path.open("w") as stream:
        stream.write(f"OFF\n{len(vertices)} {len(faces)} 0\n")
        np.savetxt(stream, vertices, fmt="%.9g")
        np.savetxt(stream, np.column_stack([np.full(len(faces), 3), faces]), fmt="%d")
    return path


@pytest.fixture(scope="session")
def folder(tmp_path_factory, cats):
    place = tmp_path_factory.mktemp("meshes")
    for shape in cats[:3]:
        write_off(place / f"{shape.name}.off", shape.vertices, shape.faces)
    return place


@dataclass
class Written:
    folder: Path
    said: str


@pytest.fixture(scope="session")
def written(folder, tmp_path_factory):
    """What the command leaves behind and says, for three cats."""
    import contextlib
    import io

    out, said = tmp_path_factory.mktemp("run") / "out", io.StringIO()
    with contextlib.redirect_stderr(said):
        assert main(["sync", str(folder), "-o", str(out), *QUICK]) == 0
    return Written(out, said.getvalue())
