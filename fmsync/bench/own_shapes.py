"""How far the pipeline for own shapes can be trusted, on collections with one vertex order.

The order is used to judge, never to map. ``python -m fmsync.bench.own_shapes FOLDER [OTHER]`` writes the geodesic
errors of every stage beside pyFM, the coverage of credible regions before and after a recalibration fitted on one
folder and judged on the other, and the error that is left when the least certain vertices are dropped.
"""

import argparse
import json
import os
import platform
import time
from pathlib import Path

import numpy as np
import potpourri3d as pp3d

import fmsync
from fmsync import so
from fmsync._threads import single_threaded_blas
from fmsync.functional_map import _nearest
from fmsync.pipeline import SyncedShapes, fit_recalibration
from fmsync.pipeline.confidence import Confidence, spread_out
from fmsync.pipeline.pairwise import match, zoomout
from fmsync.pipeline.reading import mesh_files, read_mesh
from fmsync.pipeline.signs import rotation_signs

LEVELS = (0.5, 0.8, 0.9, 0.95)
_KEPT = (1.0, 0.9, 0.8, 0.7, 0.5, 0.3, 0.1)


def measure(folder: str | Path, n_judged: int = 100, n_pairs: int = 22, peers: bool = True, **options) -> dict:
    """All measurements of one collection; lengths in square roots of the area."""
    shapes = [read_mesh(file) for file in mesh_files([folder])]
    count = len(shapes)
    began, cpu = time.perf_counter(), time.process_time()
    synced = fmsync.synchronize_shapes(shapes, rng=0, **options)
    seconds = {"wall": time.perf_counter() - began, "cpu": time.process_time() - cpu}
    judge = Judge(synced, n_judged)
    ordered = [(i, j) for i in range(count) for j in range(count) if i != j]
    pairs = [ordered[k] for k in np.linspace(0, len(ordered) - 1, min(n_pairs, len(ordered))).astype(int)]
    errors, more = stages(synced, judge, pairs)
    seconds |= more
    if peers:
        more, cost = pyfm_stages(synced, judge, pairs)
        errors |= more
        seconds |= cost
    known = {level: [synced.confidence(i, j, level) for i, j in pairs] for level in LEVELS}
    images = [judge.errors(i, j, synced.functional_map(i, j)) for i, j in pairs]
    return {
        "n_shapes": count,
        "n_vertices": [s.n_vertices for s in shapes],
        "violating_edges": len(synced.violating),
        "edges_given_up": int((synced.estimate.edge_weights < 0.5).sum()),
        "kappa": float(synced.posterior.kappa.mean()),
        "seconds": seconds,
        "mean_geodesic_error": errors,
        "_known": known,
        "_errors": images,
        "_judge": judge,
        "_pairs": pairs,
        "selective": selective(synced, judge, pairs, known[0.9], images),
    }


class Judge:
    """Geodesic distances from the true images of some vertices, by the heat method on the full meshes."""

    def __init__(self, synced: SyncedShapes, n_judged: int):
        self.shapes = synced.shapes
        n_vertices = self.shapes[0].shape.n_vertices
        self.vertices = np.random.default_rng(0).choice(n_vertices, min(n_judged, n_vertices), replace=False)
        self.distances = []
        for s in self.shapes:
            solver = pp3d.MeshHeatMethodDistanceSolver(s.shape.vertices, s.shape.faces)
            self.distances.append(np.array([solver.compute_distance(int(v)) for v in self.vertices], dtype=np.float32))

    def errors(self, i: int, j: int, c_ij: np.ndarray) -> np.ndarray:
        """(P,) distance on shape j from where the map sends the judged vertices of i to where they belong."""
        at_i = self.shapes[i].basis.eigenfunctions[self.vertices, : len(c_ij)]
        at_j = self.shapes[j].basis.eigenfunctions[:, : c_ij.shape[1]]
        return self.distances[j][np.arange(len(self.vertices)), _nearest(at_i @ c_ij, at_j)]

    def mean(self, pairs, maps) -> float:
        """Mean error over pairs of the maps that ``maps(i, j)`` gives."""
        return float(np.mean([self.errors(i, j, maps(i, j)) for i, j in pairs]))

    def at(self, i: int, values: np.ndarray) -> np.ndarray:
        """Values at the samples of shape i carried to the judged vertices."""
        return spread_out(self.shapes[i], values)[self.vertices]


def stages(synced: SyncedShapes, judge: Judge, pairs) -> tuple[dict, dict]:
    """Errors and seconds of the pipeline's stages from descriptors to the final maps."""
    shapes, edges, n = synced.shapes, synced.edges, synced.problem.n
    began = time.perf_counter()
    raw = {(i, j): match(shapes[i], shapes[j]).c_ij for i, j in edges.tolist()}
    seconds = {"pairwise": time.perf_counter() - began}
    maps = np.array([c[:n, :n] for c in raw.values()])
    signs, _ = rotation_signs(len(shapes), edges, maps)
    turn = np.ones((len(shapes), n))
    turn[:, -1] = signs
    maps = so.project(turn[edges[:, 0]][:, :, None] * maps * turn[edges[:, 1]][:, None])
    problem = fmsync.SyncProblem(len(shapes), edges, maps)

    def relative(absolute):
        return lambda i, j: turn[i][:, None] * (absolute[i].T @ absolute[j]) * turn[j]

    def upsampled(maps):
        return lambda i, j: zoomout(shapes[i], shapes[j], maps(i, j)[None], synced.refined.shape[-1], 4)[0][0]

    plain, robust = (relative(fmsync.solve(problem, m, tolerance=1e-3).absolute) for m in ("mle", "robust"))

    def pairwise(i, j):
        return raw[i, j] if (i, j) in raw else raw[j, i].T

    errors = {
        "pairwise (with its own ZoomOut)": judge.mean(pairs, pairwise),
        "synchronised": judge.mean(pairs, plain),
        "robustly synchronised": judge.mean(pairs, robust),
        "robustly synchronised, upsampled": judge.mean(pairs, upsampled(robust)),
        "pipeline (upsampled together)": judge.mean(pairs, synced.functional_map),
        "pipeline at n basis functions": judge.mean(pairs, relative_of(synced)),
    }
    return errors, seconds


def relative_of(synced: SyncedShapes):
    """The pipeline's n x n answer as maps in the bases of the shapes."""
    turn = np.ones((len(synced.shapes), synced.problem.n))
    turn[:, -1] = synced.signs
    absolute = synced.estimate.absolute
    return lambda i, j: turn[i][:, None] * (absolute[i].T @ absolute[j]) * turn[j]


def pyfm_stages(synced: SyncedShapes, judge: Judge, pairs, n: int = 20) -> tuple[dict, dict]:
    """pyFM on the same bases and samples: pairwise fit, ZoomOut of it, and Consistent ZoomOut of either start."""
    from pyFM.FMN import FMN
    from pyFM.functional import FunctionalMapping
    from pyFM.mesh import TriMesh
    from scipy import sparse

    meshes = []
    for s in synced.shapes:
        mesh = TriMesh(s.shape.vertices, s.shape.faces)
        mesh.eigenvalues, mesh.eigenvectors = np.array(s.basis.eigenvalues), np.array(s.basis.eigenfunctions)
        mesh.A = sparse.dia_matrix((s.basis.mass[None], [0]), shape=(len(s.basis.mass),) * 2).tocsc()
        meshes.append(mesh)
    size = synced.refined.shape[-1]
    samples = np.array([s.samples for s in synced.shapes])
    fitted, refined = {}, {}
    began = time.perf_counter()
    both_ways = [(int(i), int(j)) for i, j in np.concatenate([synced.edges, synced.edges[:, ::-1]])]
    with single_threaded_blas():
        for i, j in both_ways:  # pyFM maps functions from its first mesh to its second: our C_ij has j first
            model = FunctionalMapping(meshes[j], meshes[i])
            model.add_descriptors(synced.shapes[j].descriptors, synced.shapes[i].descriptors)
            model.fit(K=(n, n))  # its own default weights
            fitted[i, j] = model.FM_12
        middle = time.perf_counter()
        from pyFM.refine.zoomout import zoomout_refine

        for i, j in pairs:
            refined[i, j] = zoomout_refine(
                fitted[i, j],
                synced.shapes[j].basis.eigenfunctions,
                synced.shapes[i].basis.eigenfunctions,
                nit=(size - n) // 5,
                step=5,
                subsample=(samples[j], samples[i]),
            )
        after = time.perf_counter()
        ours = {(i, j): m.c_ij[:n, :n] for (i, j), m in zip(synced.edges.tolist(), matches_of(synced))}
        ours |= {(j, i): c.T for (i, j), c in ours.items()}
        results, seconds = {}, {"pyFM fit": middle - began, "pyFM ZoomOut a pair": (after - middle) / len(pairs)}
        for name, start in (("its own fit", fitted), ("our pairwise maps", ours)):
            began = time.perf_counter()
            network = FMN(meshes)
            network.set_maps({(j, i): c.copy() for (i, j), c in start.items()})
            network.set_subsample(samples)
            network.M = n
            for _ in range((size - n) // 5):
                network.zoomout_iteration(int(0.9 * network.M), network.M, network.M + 5, weight_type="icsm")
            seconds[f"pyFM Consistent ZoomOut from {name}"] = time.perf_counter() - began
            results[name] = {(i, j): np.array(c) for (j, i), c in network.maps.items()}
    errors = {
        "pyFM pairwise": judge.mean(pairs, lambda i, j: fitted[i, j]),
        "pyFM pairwise + ZoomOut": judge.mean(pairs, lambda i, j: refined[i, j]),
    }
    for name, maps in results.items():
        errors[f"pyFM Consistent ZoomOut from {name}"] = judge.mean(pairs, lambda i, j, maps=maps: maps[i, j])
    return errors, seconds


def matches_of(synced: SyncedShapes):
    """Pairwise maps before synchronised ones were proposed to them."""
    return [match(synced.shapes[i], synced.shapes[j]) for i, j in synced.edges]


def coverage(result: dict, recalibrations: dict | None = None) -> dict:
    """Share of judged vertices whose true image lies in the region, for every level."""
    covered = {}
    for level in LEVELS:
        inside = []
        for (i, _), known, errors in zip(result["_pairs"], result["_known"][level], result["_errors"]):
            radius = known.radius if recalibrations is None else recalibrations[level].radius(known)
            inside.append(errors <= result["_judge"].at(i, radius))
        covered[str(level)] = float(np.mean(inside))
    return covered


def recalibrate(result: dict) -> dict:
    """A recalibration for every level, fitted to one collection."""
    judge = result["_judge"]
    fitted = {}
    for level in LEVELS:
        known = [
            Confidence(k.mode, k.image, judge.at(i, k.radius), judge.at(i, k.spread), k.entropy, k.two_modes, level)
            for (i, _), k in zip(result["_pairs"], result["_known"][level])
        ]
        fitted[level] = fit_recalibration(known, result["_errors"])
    return fitted


def selective(synced, judge, pairs, known, errors) -> dict:
    """Mean error of the vertices kept, by several scores of certainty, at falling shares kept."""
    scores = {
        "radius + spread": [],
        "radius": [],
        "spread": [],
        "entropy": [],
        "embedding distance": [],
        "cycle error": [],
    }
    cycle = cycle_errors(synced)
    for (i, j), k in zip(pairs, known):
        scores["radius + spread"].append(judge.at(i, k.radius + k.spread))
        scores["radius"].append(judge.at(i, k.radius))
        scores["spread"].append(judge.at(i, k.spread))
        scores["entropy"].append(judge.at(i, k.entropy))
        a, b, m = synced.shapes[i], synced.shapes[j], synced.refined.shape[-1]
        moved = a.basis.eigenfunctions[judge.vertices, :m] @ synced.functional_map(i, j)
        at_j = b.basis.eigenfunctions[:, :m]
        scores["embedding distance"].append(np.linalg.norm(moved - at_j[_nearest(moved, at_j)], axis=1))
        scores["cycle error"].append(np.full(len(judge.vertices), cycle[i, j]))
    flat = np.concatenate(errors)
    curves = {"kept": list(_KEPT)}
    for name, values in {**scores, "oracle": errors}.items():
        order = np.argsort(np.concatenate(values), kind="stable")
        curves[name] = [float(flat[order[: max(1, round(share * len(flat)))]].mean()) for share in _KEPT]
    return curves


def cycle_errors(synced: SyncedShapes) -> np.ndarray:
    """(N, N) mean Frobenius distance of an observed map from its detours through every third shape."""
    count, n = len(synced.shapes), synced.problem.n
    maps = np.full((count, count, n, n), np.nan)
    for (i, j), c in zip(synced.edges, synced.problem.maps):
        maps[i, j], maps[j, i] = c, c.T
    detours = np.einsum("ikab,kjbc->ijkac", maps, maps)
    gaps = np.linalg.norm(detours - maps[:, :, None], axis=(3, 4))
    return np.nan_to_num(np.nanmean(np.where(np.isfinite(gaps), gaps, np.nan), axis=2), nan=np.inf)


def main(arguments: list[str] | None = None) -> None:
    """Measure one or two collections and write a table of results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("other", nargs="?")
    parser.add_argument("--out", type=Path, default=Path("results/own_shapes.json"))
    parser.add_argument("--no-peers", action="store_true")
    options = parser.parse_args(arguments)
    folders = [f for f in (options.folder, options.other) if f]
    results = {Path(f).name: measure(f, peers=not options.no_peers and f == options.folder) for f in folders}
    recalibrations = {name: recalibrate(r) for name, r in results.items()}
    table = {"command": "python -m fmsync.bench.own_shapes " + " ".join(Path(f).name for f in folders)}
    table |= {"machine": f"{platform.machine()}, {os.cpu_count()} cores", "collections": {}}
    for name, result in results.items():
        shown = {key: value for key, value in result.items() if not key.startswith("_")}
        shown["coverage"] = coverage(result)
        shown["recalibration_scale"] = {str(level): r.scale for level, r in recalibrations[name].items()}
        for fitted_on, r in recalibrations.items():
            shown[f"coverage, recalibrated on {fitted_on}"] = coverage(result, r)
        table["collections"][name] = shown
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(table, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
