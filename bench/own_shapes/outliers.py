"""Are shapes that do not belong found, and are the others left alone? Mixed folders of random species.

The limits of :mod:`fmsync.matching.outliers` were chosen on species 1000, 1001, ...; 0, 1, ... are for testing alone.
"""

import itertools
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd

from bench.studies import kept_results
from data_gen import load_collection
from fmsync.adapters import from_pyvista, to_pyvista
from fmsync.matching.outliers import BOTH, SPECTRUM, differences, groups, spectral_distances
from fmsync.matching.pairwise import FINE, match
from fmsync.matching.samples import sample_shape
from fmsync.shape import Shape

DEVELOPMENT, TEST = range(1000, 1012), range(32)
_OPTIONS = {"n_vertices": 1000, "remeshed": True}
_OTHER = 5000  # numbers of species from one to another
_SAMPLES = 300  # as many as a match looks at


def mixed(number: int) -> tuple[list[Shape], np.ndarray]:
    """Five to eight poses of a species, a sphere, and one or two of another species, half a body or a cat; their kinds.

    Which of the last there are, and how many poses, goes with the number of the species.
    """
    import pyvista as pv

    count, kind = 5 + number // 4 % 4, ("another", "two others", "half", "cat")[number % 4]
    *own, whole = load_collection("creatures", species=number, count=count + 1, **_OPTIONS)
    sphere = from_pyvista(pv.Icosphere(nsub=3), "sphere")
    if kind == "half":
        strange = [half(whole)]
    elif kind == "cat":
        strange = load_collection("cats", count=11, n_vertices=1000)[number // 4 % 11 :][:1]
    else:
        strange = load_collection("creatures", species=number + _OTHER, count=1 + (kind == "two others"), **_OPTIONS)
    return [*own, *strange, sphere], np.array(["own"] * count + [kind] * len(strange) + ["sphere"])


def half(shape: Shape) -> Shape:
    """The larger piece in front of a plane across the longest axis, through the middle."""
    centred = Shape(shape.vertices - shape.vertices.mean(axis=0), shape.faces)
    axis = np.linalg.svd(centred.vertices, full_matrices=False)[2][0]
    mesh = to_pyvista(centred).clip(normal=axis, origin=(0, 0, 0)).clean()
    return from_pyvista(mesh.triangulate().connectivity("largest").triangulate().clean(), "half")


def distances(number: int) -> dict[str, np.ndarray]:
    """Spectral distances and distortions (N, N) of the shapes of a folder, and their kinds.

    Spheres are not matched, which are found by their spectra.
    """
    shapes, kinds = mixed(number)
    sampled = [sample_shape(s, FINE, _SAMPLES) for s in shapes]
    light = [s.light(FINE) for s in sampled]
    edges = np.array(list(itertools.combinations(range(len(shapes) - 1), 2)))
    both = differences(sampled[:-1], edges, [match(light[i], light[j]) for i, j in edges])
    return {"kinds": kinds, "spectra": spectral_distances(sampled), "both": both}


def shapes_named(numbers: Iterable[int], folder: Path) -> pd.DataFrame:
    """Whether each shape of the folders, and of each species alone, is called an outlier; what was seen is kept."""
    rows = []
    for number, seen in zip(numbers, kept_results(distances, numbers, folder)):
        own = seen["kinds"] == "own"
        for alone, keep in ((False, np.full(len(own), True)), (True, own)):
            spectra, both = seen["spectra"][np.ix_(keep, keep)], seen["both"][np.ix_(keep[:-1], keep[:-1])]
            apart = {k for group in groups(spectra, SPECTRUM)[1:] + groups(both, BOTH)[1:] for k in group}
            named = [k in apart for k in range(keep.sum())]
            rows.append(pd.DataFrame({"species": number, "kind": seen["kinds"][keep], "named": named, "alone": alone}))
    return pd.concat(rows, ignore_index=True)


def table(folder: Path) -> dict:
    """Shares of outliers that are found and of others that are named, over folders, with standard errors."""
    found = {}
    for name, numbers in (("development", DEVELOPMENT), ("test", TEST)):
        rows = shapes_named(numbers, folder)
        own, mixed = rows["kind"] == "own", ~rows["alone"]
        parts = {"found": rows[~own], "false alarms": rows[own & mixed], "false alarms without outliers": rows[~mixed]}
        parts |= {f"found of {kind}": part for kind, part in rows[~own].groupby("kind")}
        found[name] = {part: _share(chosen) for part, chosen in parts.items()}
    return found


def _share(rows: pd.DataFrame) -> dict[str, float]:
    of_folder, mean = rows.groupby("species")["named"].mean(), float(rows["named"].mean())
    return {"mean": mean, "se": float(of_folder.sem()), "shapes": len(rows), "folders": len(of_folder)}
