"""Errors, regions and warnings of the pipeline and its peers against the truth, on species that nothing was chosen on.

Four poses of each species in five variants: with one triangulation; triangulated anew; these with noise along the
normals, of a fifth of the mean edge; these without three geodesic discs, a twentieth of the area; and these stretched:
swollen and sunken smoothly, each pose elsewhere.
"""

import itertools
import warnings
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from bench.own_shapes.confidence import Observed, observe
from bench.own_shapes.stages import Evaluation, Pyfm, both_ways, some_pairs
from bench.problems import geodesics_from
from bench.studies import cpu_seconds, kept_results
from data_gen import Creature, load_collection
from fmsync.matching.conformal import default_calibration
from fmsync.matching.latent import upsample
from fmsync.matching.network import inlier_weights
from fmsync.matching.pairwise import FINE, match
from fmsync.matching.report import quality_flags
from fmsync.matching.synchronize import synchronize_matches
from fmsync.shape import edges_of_faces, laplace_beltrami, triangle_areas, vertex_normals
from fmsync.threads import single_threaded_blas

TEST = range(8)
VARIANTS = ("one triangulation", "triangulated anew", "noise", "holes", "stretched")
_NOISE = 0.2  # standard deviation, in mean edges
_HOLES, _CUT = 3, 0.05  # discs of each shape, and their share of its area
_SWOLLEN, _WAVES = 0.01, 15  # root mean square height in √area, of so many eigenfunctions
_WRONG = 0.08  # larger mean errors of maps and shapes are faults, in square roots of the area
_HELD = 0.8  # and so is a smaller share of true images in regions of 90 %
_FIT = {"K": 30, "w_descr": 1.0, "w_lap": 0.1, "w_dcomm": 1.0, "w_orient": 1.0}  # of the example in pyFM's readme
SAID = {  # what the report says, by kind, and of whom
    "left and right hardly apart": ("hardly keep left and right apart", "pairs"),
    "no cycle checks the map": ("No cycle of trusted maps", "pairs"),
    "no majority agrees": ("No majority of the maps", "shapes"),
    "unlike the rest": ("Unlike the rest", "shapes"),
    "surface of revolution": ("nearly equal eigenvalues", "shapes"),
    "nothing connects": ("No map that agrees", "collections"),
    "more ways than one": ("in more ways than one", "collections"),
    "chains do not agree": ("do not agree", "collections"),
    "few effective draws": ("are worth only", "collections"),
}


def varied(number: int, variant: str) -> list[Creature]:
    """Four poses of a species, of about two thousand vertices."""
    options = {"species": number, "count": 4, "n_vertices": 2000, "remeshed": variant != VARIANTS[0]}
    change = {"noise": noisy, "holes": with_holes, "stretched": stretched}.get(variant, lambda shape, rng: shape)
    rng = np.random.default_rng(number)
    return [change(shape, rng) for shape in load_collection("creatures", **options)]


def noisy(shape: Creature, rng: np.random.Generator) -> Creature:
    """Its vertices moved along the normals."""
    a, b = shape.vertices[edges_of_faces(shape.faces)].swapaxes(0, 1)
    height = _NOISE * np.linalg.norm(a - b, axis=1).mean() * rng.standard_normal((shape.n_vertices, 1))
    return replace(shape, vertices=shape.vertices + height * vertex_normals(shape.vertices, shape.faces))


def stretched(shape: Creature, rng: np.random.Generator) -> Creature:
    """Its skin moved along the normals by a smooth height, so that distances along it change."""
    basis = laplace_beltrami(shape.vertices, shape.faces, 1 + _WAVES)
    height = basis.eigenfunctions[:, 1:] @ (rng.standard_normal(_WAVES) / np.sqrt(basis.eigenvalues[1:]))
    height *= _SWOLLEN * np.sqrt(shape.area / (basis.mass @ height**2))
    return replace(shape, vertices=shape.vertices + height[:, None] * vertex_normals(shape.vertices, shape.faces))


def with_holes(shape: Creature, rng: np.random.Generator) -> Creature:
    """The largest piece without some discs, which cut off little else; ``located`` is -1 where the vertex is gone."""
    areas = triangle_areas(shape.vertices, shape.faces) / shape.area
    left, each = np.ones(len(areas), dtype=bool), _CUT / _HOLES
    for hole in range(1, _HOLES + 1):
        lost = np.inf
        while abs(lost - hole * each) > 0.1 * each:
            order = geodesics_from(shape, [rng.integers(shape.n_vertices)])[0][shape.faces].mean(axis=1).argsort()
            rest = left.copy()
            rest[order[areas[order].cumsum() <= each]] = False
            ends = edges_of_faces(shape.faces[rest]).T
            links = coo_array((np.ones(ends.shape[1]), ends), shape=(shape.n_vertices,) * 2)
            piece = connected_components(links, directed=False)[1]
            keep = piece == np.bincount(piece).argmax()
            rest &= keep[shape.faces].all(axis=1)
            lost = areas[~rest].sum()
        left = rest
    number = np.where(keep, keep.cumsum() - 1, -1)
    of_vertices = {name: getattr(shape, name)[keep] for name in ("vertices", "common", "opposite", "part")}
    return replace(shape, faces=number[shape.faces[left]], located=number[shape.located], **of_vertices)


def evaluated(shapes: list[Creature], count: int = 80) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (N, P) of points that all shapes have, and those of the opposite points."""
    own = np.array([s.located for s in shapes])
    other = np.array([s.located[s.opposite[s.located]] for s in shapes])
    known = np.flatnonzero(((own >= 0) & (other >= 0)).all(axis=0))
    chosen = np.random.default_rng(0).choice(known, count, replace=False)
    return own[:, chosen], other[:, chosen]


def run(task: tuple[int, str]) -> dict:
    """Errors, CPU seconds, regions and warnings of one species and variant."""
    shapes = varied(*task)
    vertices, opposite = evaluated(shapes)
    try:
        with warnings.catch_warnings(action="ignore"):  # the report repeats them
            seen = observe(shapes, levels=(), vertices=vertices)
    except ValueError as error:
        return {"refused": str(error)}
    errors, seconds = stage_errors(seen, shapes)
    mirrored = Evaluation(seen.synced.shapes, vertices, opposite)
    return {"errors": errors, "cpu_seconds": seconds, "regions": regions(seen, shapes), "said": said(seen, mirrored)}


def stage_errors(seen: Observed, shapes: list[Creature]) -> tuple[dict[str, float], dict[str, float]]:
    """Mean errors of the pipeline, pyFM and the true maps of as many functions; CPU seconds after the bases."""
    synced, evaluation, seconds = seen.synced, seen.evaluation, {}
    edges, n, m, pairs = synced.edges, synced.problem.n, synced.refined.shape[-1], some_pairs(len(shapes))
    light, pyfm = [s.light(FINE) for s in synced.shapes], Pyfm(synced.shapes)
    with cpu_seconds(seconds, "pairwise"):
        own = both_ways(edges, [match(light[i], light[j]) for i, j in edges])
    with cpu_seconds(seconds, "ours"):
        synchronize_matches(synced.shapes, edges, synced.matches, n, m, 0, 0)
    fits = {}
    with single_threaded_blas():
        with cpu_seconds(seconds, "pyFM fit"):
            for i, j in pairs:
                model = pyfm.model(i, j)
                model.compute_spectral_descriptors(subsample_step=2, k_descr=m)
                model.fit(**_FIT)
                fits[i, j] = model.FM_12
        with cpu_seconds(seconds, "pyFM ZoomOut"):
            zoomed = {(i, j): pyfm.zoomout(i, j, c, m) for (i, j), c in fits.items()}
        with cpu_seconds(seconds, "pyFM Consistent ZoomOut"):
            together = pyfm.consistent(fits, _FIT["K"], m)
        with cpu_seconds(seconds, "pyFM Consistent ZoomOut of our pairs"):
            ours = pyfm.consistent(both_ways(edges, synced.matches), n, m)
    bases = [s.basis.eigenfunctions for s in synced.shapes]
    bound = {(i, j): true_map(shapes[i], shapes[j], bases[i], bases[j]) for i, j in pairs}
    maps = {"pairwise": own, "bound": bound, "pyFM fit": fits, "pyFM ZoomOut": zoomed}
    maps |= {"pyFM Consistent ZoomOut": together, "pyFM Consistent ZoomOut of our pairs": ours}
    start = np.array([bound[i, j][:FINE, :FINE] for i, j in edges.tolist()])  # as good as fifty functions can be
    latent = upsample(synced.shapes, edges, start, m)
    errors = {name: evaluation.mean(pairs, lambda i, j, found=found: found[i, j]) for name, found in maps.items()}
    from_truth = np.mean([evaluation.errors(i, j, latent[i], latent[j]) for i, j in pairs])
    return {"ours": float(np.mean(seen.errors)), **errors, "ours from the true first 50": float(from_truth)}, seconds


def true_map(first: Creature, second: Creature, phi: np.ndarray, psi: np.ndarray) -> np.ndarray:
    """C_ij of basis functions (V_i, m) and (V_j, m) by least squares over the vertices of i that are on j."""
    image = second.located[first.common]
    return np.linalg.lstsq(phi[image >= 0], psi[image[image >= 0]], rcond=None)[0]


def regions(seen: Observed, shapes: list[Creature]) -> dict[str, float]:
    """Share of true images in the regions of 90 %, by part of the body; and errors of the surer half, over the mean."""
    calibration, errors = default_calibration(), np.concatenate(seen.errors)
    inside = errors <= np.concatenate([calibration.radius(known, 0.9) for known in seen.known])
    parts = np.concatenate([shapes[i].part[seen.evaluation.vertices[i]] for i, _ in some_pairs(len(shapes))])
    found = {part: inside[parts == part].mean() for part in np.unique(parts).tolist()}
    score = np.concatenate([calibration.expected(known) for known in seen.known])
    half = len(errors) // 2
    ranked = {"surer half": errors[np.argsort(score, kind="stable")], "surer half of the oracle": np.sort(errors)}
    return {"all": inside.mean()} | found | {k: x[:half].mean() / errors.mean() for k, x in ranked.items()}


def said(seen: Observed, mirrored: Evaluation) -> dict[tuple[str, str], np.ndarray]:
    """How often each kind of warning was given and not, where a fault was (first row) and where not, by kind and fault.

    A map of a pair is mirrored if its errors from the mirrored truth are the smaller ones.
    """
    synced, names = seen.synced, {"pairs": seen.synced.edge_names, "shapes": seen.synced.names, "collections": [""]}
    off, flipped = (
        np.array([e.errors(i, j, m.c_ij.T).mean() for (i, j), m in zip(synced.edges, synced.matches)])
        for e in (seen.evaluation, mirrored)
    )
    pairs, missed = some_pairs(len(synced.shapes)), [e.mean() for e in seen.errors]
    of_shape = [np.mean([e for pair, e in zip(pairs, missed) if k in pair]) for k in range(len(synced.shapes))]
    held = seen.covered(default_calibration())["0.9"]
    faults = {
        "pairs": {"mirrored": flipped < off, "wrong": off > _WRONG},
        "shapes": {"wrong": np.array(of_shape) > _WRONG},
        "collections": {"a pair is wrong": np.array([max(missed) > _WRONG]), "regions fail": np.array([held < _HELD])},
        "vertices": {"wrong": np.concatenate(seen.errors) > _WRONG},
    }
    lines = quality_flags(synced)
    given = {
        kind: (who, np.array([any(phrase in line and name in line for line in lines) for name in names[who]]))
        for kind, (phrase, who) in SAID.items()
    }
    given["given up"] = "pairs", inlier_weights(synced.estimate) < 0.5
    double = [seen.evaluation.at(i, known.two_modes.astype(float)) > 0.5 for (i, _), known in zip(pairs, seen.known)]
    given["two candidate places"] = "vertices", np.concatenate(double)
    return {
        (kind, fault): np.array([[there[among].sum(), among.sum()] for among in (true, ~true)])
        for kind, (who, there) in given.items()
        for fault, true in faults[who].items()
    }


def table(folder: Path, numbers: Iterable[int] = TEST) -> dict:
    """All of it over species, by variant; the error of every run; and collections that the pipeline refused."""
    tasks = list(itertools.product(numbers, VARIANTS))
    runs = dict(zip(tasks, kept_results(run, tasks, folder)))
    refused = {
        f"species {k}, {variant}": found["refused"] for (k, variant), found in runs.items() if "refused" in found
    }
    done = {task: found for task, found in runs.items() if "refused" not in found}
    index = pd.MultiIndex.from_tuples(done, names=["species", "variant"])
    errors, seconds, shares = (
        pd.DataFrame([found[part] for found in done.values()], index) for part in ("errors", "cpu_seconds", "regions")
    )
    found = {"species": len(set(index.get_level_values(0))), "refused": refused, "errors": {}, "regions": {}}
    for variant, own in errors.groupby("variant", sort=False):
        ratio, at = own.div(own["bound"], axis=0), own.quantile([0.25, 0.5, 0.75])
        parts = {"lower quartile": at.loc[0.25], "median": at.loc[0.5], "upper quartile": at.loc[0.75]}
        parts |= {"largest": own.max(), "species of the largest": own.idxmax().str[0]}
        parts |= {"median ratio to the bound": ratio.median(), "largest ratio to the bound": ratio.max()}
        found["errors"][variant] = pd.DataFrame(parts).to_dict(orient="index")
        share = shares.xs(variant, level="variant")
        found["regions"][variant] = pd.DataFrame({"mean": share.mean(), "se": share.sem()}).to_dict(orient="index")
    found["cpu_seconds"] = seconds.median().to_dict()
    found["warnings"] = {}
    for kind, fault in next(iter(done.values()))["said"]:
        counts = np.sum([one["said"][kind, fault] for one in done.values()], axis=0).tolist()
        found["warnings"][f"{kind}: {fault}"] = dict(zip(("with the fault", "without"), counts))
    found["runs"] = {f"species {k}, {variant}": row.round(4).to_dict() for (k, variant), row in errors.iterrows()}
    return found
