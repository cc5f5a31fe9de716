"""Fingerprints: is this copy of a collection the one that results were made with? The meshes need not be shipped.

A fingerprint holds the numbers of vertices and faces and two SHA-256 digests: of the vertex positions, rounded to six
digits of the largest coordinate so that a change of file format does not matter, and of the triangles as a set,
whatever their order and orientation. Known collections are in ``fingerprints.json``.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fmsync.shape import Shape


def fingerprint(shape: Shape) -> dict[str, int | str]:
    """Counts and digests of one shape.

    >>> one = Shape([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> turned = Shape(one.vertices, [[2, 1, 0]])
    >>> fingerprint(one) == fingerprint(turned)
    True
    """
    faces = np.empty((0, 3), dtype=np.int64) if shape.faces is None else shape.faces
    scale = np.abs(shape.vertices).max()
    return {
        "vertices": shape.n_vertices,
        "faces": len(faces),
        "positions": hashlib.sha256(np.round(shape.vertices / scale * 1e6).astype("<i8").tobytes()).hexdigest(),
        "triangles": hashlib.sha256(_unoriented(faces).tobytes()).hexdigest(),
    }


def same_triangulation(first: Shape, second: Shape) -> str | None:
    """How the triangles of two shapes agree: ``"identical"``, ``"reoriented"`` or None.

    ``"reoriented"`` says that they are the same triples of vertices, listed in another order or facing another way, as
    in the TOSCA horses: maps between the shapes are not touched by that, signed quantities are.

    >>> one = Shape([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> same_triangulation(one, Shape(one.vertices, [[1, 0, 2]]))
    'reoriented'
    """
    if first.faces is None or second.faces is None or first.faces.shape != second.faces.shape:
        return None
    if np.array_equal(first.faces, second.faces):
        return "identical"
    return "reoriented" if np.array_equal(_unoriented(first.faces), _unoriented(second.faces)) else None


def known_collections() -> Mapping[str, Mapping[str, Mapping[str, int | str]]]:
    """Collection name -> shape name -> fingerprint, for the collections whose fingerprints come with the project."""
    return json.loads(Path(__file__).with_name("fingerprints.json").read_text())


def verify(shapes: Sequence[Shape], expected: Mapping[str, Mapping[str, int | str]]) -> dict[str, str]:
    """Compare shapes with a table of fingerprints; shape name -> ``"ok"`` or what differs."""
    verdicts = {name: "missing" for name in expected}
    for shape in shapes:
        if shape.name not in expected:
            verdicts[shape.name] = "not in the table"
            continue
        found, wanted = fingerprint(shape), expected[shape.name]
        differs = [key for key in wanted if found[key] != wanted[key]]
        counts = [f"{key} {found[key]} instead of {wanted[key]}" for key in differs if key in ("vertices", "faces")]
        verdicts[shape.name] = ", ".join(counts or [f"other {key}" for key in differs]) or "ok"
    return verdicts


def _unoriented(faces):
    faces = np.sort(faces, axis=1)
    return faces[np.lexsort(faces.T[::-1])].astype("<i8")
