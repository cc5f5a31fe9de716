"""One self-contained page: what was found, in plain words and pictures of every pair that turn when dragged."""

import base64
import html
import json
import zlib
from pathlib import Path

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from scipy.spatial import cKDTree

from fmsync.functional_maps import nearest_rows_unchecked as nearest_rows
from fmsync.matching.confidence import Confidence, draw_images, has_continuous_symmetry
from fmsync.matching.conformal import ConformalCalibration
from fmsync.matching.network import doubts_of_draws, unchecked_maps
from fmsync.matching.samples import decimated
from fmsync.matching.synchronize import SyncedShapes
from fmsync.shape import Shape, colours_from_coordinates
from fmsync.threads import single_threaded_blas

_ORIENTED = 0.5  # orientation of maps that keep left and right apart
_DRAWN = 1500  # vertices of a drawn shape
_CHOICE = 160  # of which so many can be chosen, to see where they go
_MOST_DRAWS, _ALL_DRAWS = 100, 11_000  # that send the vertices of a pair, and of all pairs
_STEP = 1e-4  # of radii, in square roots of the area
_VIEWER = Path(__file__).with_name("viewer.js")
_EXPLORER = Path(__file__).parents[1] / "viz" / "explorer.js"  # read, not imported: it needs none of the extra viz
_PAGE = Path(__file__).with_name("report.html")
Pairs = dict[tuple[int, int], Confidence]
Radii = dict[tuple[int, int], np.ndarray]
_RAMP = np.array([[0.94, 0.93, 0.86], [0.96, 0.73, 0.36], [0.82, 0.30, 0.24], [0.29, 0.05, 0.28]])


def quality_flags(synced: SyncedShapes) -> list[str]:
    """Sentences about what went wrong or is thin, each with what to do; none if nothing is.

    Watches energy, concentration and modes of the chains, maps that mix left and right, outliers, and symmetries.
    """
    said = []
    for what, among in (("left out", False), ("doubtful, as are their maps: leave them out", True)):
        if outliers := [name for name in synced.outliers if (name in synced.names) == among]:
            said.append(f"Unlike the rest and {what}: {', '.join(outliers)}.")
    if synced.posterior is not None:
        said += doubts_of_draws(synced.posterior, bool(synced.map_names))
    meshes = np.array([s.orientation is not None for s in synced.shapes])[synced.edges].all(axis=1)
    known = zip(synced.edge_names, synced.matches, meshes)
    if (doubtful := [name for name, m, told in known if told and m.orientation < _ORIENTED]) and not synced.map_names:
        said.append(f"{len(doubtful)} maps hardly keep left and right apart: doubt {', '.join(doubtful)}.")
    if turned := [name for name, m in zip(synced.map_names, synced.matches) if m.orientation < 0]:
        said.append(f"{len(turned)} given maps turn left into right; if many, so may the answer: {', '.join(turned)}.")
    if turning := [s.shape.name for s in synced.shapes if has_continuous_symmetry(s)]:
        text = f"{', '.join(turning)}: nearly equal eigenvalues, as on a surface of revolution. It does not tell "
        text += "how far a vertex is turned about the axis; regions there are as wide as its circle. Give landmarks."
        said.append(text)
    if any(s.orientation is None and s.n_landmarks < 2 for s in synced.shapes):
        text = "Point clouds do not tell left from right: the answer for a symmetric body may be its mirror image. "
        said.append(text + "Give meshes or landmarks.")
    maps = synced.names, synced.edge_names, bool(synced.map_names)
    return said + unchecked_maps(synced.problem, synced.estimate, *maps)


def report(
    synced: SyncedShapes,
    known: Pairs,
    edges: pd.DataFrame,
    calibration: ConformalCalibration,
    level: float,
    jobs: int = 1,
) -> str:
    """HTML of the report; ``known`` holds the confidence of every ordered pair, ``jobs`` threads share the work."""
    radii = {pair: calibration.radius(k, level) for pair, k in known.items()}
    top = float(np.quantile(np.concatenate(list(radii.values())), 0.98))
    ramp = ", ".join("rgb({:.0f} {:.0f} {:.0f})".format(*(255 * colour)) for colour in _RAMP)
    return _PAGE.read_text(encoding="utf-8").format(
        count=len(synced.shapes),
        flags=_list(quality_flags(synced), "flags"),
        summary=_list(_summary(synced, known, radii, edges, calibration.fitted_on, level)),
        level=level,
        top=top,
        ramp=ramp,
        edges=edges.rename(columns=lambda name: name.replace("_", " ")).to_html(
            index=False, float_format="%.3f", border=0
        ),
        data=json.dumps(_data(synced, known, radii, edges, top, level, jobs)).replace("<", "\\u003c"),
        explorer=_EXPLORER.read_text(encoding="utf-8"),
        viewer=_VIEWER.read_text(encoding="utf-8"),
    )


def _data(
    synced: SyncedShapes, known: Pairs, radii: Radii, edges: pd.DataFrame, top: float, level: float, jobs: int
) -> dict[str, object]:
    """Everything the viewer draws: arrays of small integers in base64."""
    each = Parallel(jobs, "threading")
    drawn = each(delayed(_drawn)(s.shape) for s in synced.shapes)
    shapes, nearest = [], []
    n_draws = max(10, min(_MOST_DRAWS, _ALL_DRAWS // len(known)))
    for s, (vertices, faces) in zip(synced.shapes, drawn):
        at = s.shape.vertices[vertices]
        centred = at - (at.max(axis=0) + at.min(axis=0)) / 2
        size = float(np.linalg.norm(centred, axis=1).max())
        points, colours = 32000 * centred / size, 255 * colours_from_coordinates(at)[:, :3]
        picks = cKDTree(at).query(s.shape.vertices[s.samples])[1]  # the drawn vertex of each sample
        nearest.append(picks)
        named = {"name": s.shape.name, "choice": s.samples[:_CHOICE].tolist(), "picks": _packed(picks[:_CHOICE], "<u2")}
        drawing = {"points": _packed(points, "<i2"), "faces": _packed(faces, "<u2"), "colours": _packed(colours, "u1")}
        shapes.append(named | {"size": size} | drawing)
    costs = {frozenset(e): d for e, d in zip(synced.edges.tolist(), edges["distortion"])}

    def pair_data(i: int, j: int, k: Confidence) -> dict[str, object]:
        first, (own, _), (there, _) = synced.shapes[i], drawn[i], drawn[j]
        image = nearest_rows(synced.shared_functions(i, own), synced.shared_functions(j, there))
        at = cKDTree(first.shape.vertices[first.samples]).query(first.shape.vertices[own])[1]
        return {
            "image": _packed(image, "<u2"),
            "unsure": _packed(254 * np.clip(radii[i, j] / max(top, 1e-9), 0, 1)[at], "u1"),
            "double": _packed(k.two_modes[at], "u1"),
            "median": float(np.median(radii[i, j])),
            "distortion": costs.get(frozenset((i, j))),
        } | _explored(synced, i, j, k, radii[i, j], nearest[j], n_draws)

    with single_threaded_blas():
        found = each(delayed(pair_data)(i, j, k) for (i, j), k in known.items())
    pairs = {f"{i},{j}": data for (i, j), data in zip(known, found)}
    return {"shapes": shapes, "pairs": pairs, "ramp": _RAMP.tolist(), "step": _STEP, "level": level}


def _explored(
    synced: SyncedShapes, i: int, j: int, known: Confidence, radius: np.ndarray, nearest: np.ndarray, n_draws: int
) -> dict[str, object]:
    """Where the vertices to choose from go, as drawn vertices of j, the ``nearest`` (S_j,) of its samples."""
    way, observed = (synced.shapes[i], synced.shapes[j]), None
    if (i, j) in synced.observed:
        observed = _packed(nearest[draw_images(*way, synced.observed[i, j][None], _CHOICE)[0]], "<u2")
    images = np.sort(nearest[draw_images(*way, synced.draws(i, j, n_draws), _CHOICE)].T, axis=1)
    steps = np.diff(images, axis=1, prepend=0)  # pack better
    return {
        "draws": base64.b64encode(zlib.compress(steps.astype("<u2").tobytes(), 9)).decode(),
        "count": images.shape[1],
        "centres": _packed(nearest[known.image[:_CHOICE]], "<u2"),
        "radius": _packed(np.minimum(known.radius[:_CHOICE] / _STEP, 65535), "<u2"),
        "region": _packed(np.minimum(radius[:_CHOICE] / _STEP, 65535), "<u2"),
        "observed": observed,
    }


def _drawn(shape: Shape) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of a coarse copy, as indices into the shape, and its faces (none for a point cloud)."""
    if shape.faces is None:
        return np.linspace(0, shape.n_vertices - 1, min(_DRAWN, shape.n_vertices)).astype(int), np.empty((0, 3), int)
    if shape.n_vertices <= _DRAWN:
        return np.arange(shape.n_vertices), shape.faces
    vertices, faces = decimated(shape, _DRAWN)
    return cKDTree(shape.vertices).query(vertices)[1], faces


def _packed(values: np.ndarray, kind: str) -> str:
    return base64.b64encode(np.rint(values).astype(kind).tobytes()).decode()


def _list(lines: list[str], kind: str = "") -> str:
    items = "".join(f"<li>{html.escape(line)}</li>" for line in lines)
    return f'<ul class="{kind}">{items}</ul>' if lines else ""


def _summary(
    synced: SyncedShapes, known: Pairs, radii: Radii, edges: pd.DataFrame, fitted_on: str, level: float
) -> list[str]:
    every = np.concatenate(list(radii.values()))
    double = float(np.mean([k.two_modes.mean() for k in known.values()]))
    dropped = [synced.edge_names[e] for e in np.flatnonzero(edges["inlier_weight"] < 0.5)]
    named = ": " + ", ".join(dropped) if dropped else ""
    how = f"by {len(edges)} given maps" if synced.map_names else f"in {len(edges)} pairs from their geometry alone"
    unsure = [np.median([np.median(r) for pair, r in radii.items() if k in pair]) for k in range(len(synced.shapes))]
    return [
        f"{len(synced.shapes)} shapes were matched {how}.",
        f"Half of all vertices have a {level:.0%} region of radius below {np.median(every):.3f}, nine in ten below "
        f"{np.quantile(every, 0.9):.3f} (a whole shape has area 1).",
        f"How large a region must be was learnt from: {fitted_on}. Shapes of another kind may need their "
        "own calibration.",
        f"{double:.1%} of the vertices have two candidate places, usually the left and the right of a symmetric part.",
        f"{len(dropped) or 'No'} maps were given up because the others contradict them{named}.",
        f"Least certain of all shapes: {synced.names[int(np.argmax(unsure))]}.",
    ]
