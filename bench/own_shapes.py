"""How far the pipeline for own shapes can be trusted, on collections with one vertex order.

The order is used to judge, never to map. A part of the measurements is one command, and adds to one file of results:

``python -m bench.own_shapes collections tosca_cat cats``
    geodesic errors and CPU seconds of every stage, for the first beside pyFM on the same bases and samples; coverage of
    regions, as they come and recalibrated on the other collection; errors of the vertices that are kept
``... remeshed tosca_cat`` and ``... landmarks tosca_cat``
    errors on copies with triangulations and vertex counts of their own, without and with four landmarks
``... costs tosca_cat``
    time of a vertex's images, price of computing on samples
``... planted cats``
    regions where the model is right; flags of two modes where flips were planted
``... refit cats uneven_cats --out fmsync/matching/conformal.json``
    the recalibration that the package ships

A collection is a folder, the name of one in FMSYNC_DATA, ``cats``, or ``uneven_cats``, which are not isometric. Lengths
are in square roots of the area.
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
from bench.suites import generator_function
from fmsync.functional_maps import nearest_rows
from fmsync.matching import SyncedShapes, synchronize
from fmsync.matching.confidence import samples_to_vertices
from fmsync.matching.latent import sizes, upsample
from fmsync.matching.pairwise import FINE, improve, match, zoomout
from fmsync.matching.samples import farthest_points
from fmsync.shape import Shape
from fmsync.threads import single_threaded_blas

N_LANDMARKS = 4
_SYNTHETIC = {"count": 11, "n_vertices": 4000}


class Judge:
    """Geodesic distances from the true images of some vertices, by the heat method on the full meshes.

    ``places`` (N, P) are the judged vertices on every shape: the same point of the surface in every column.
    """

    def __init__(self, synced: SyncedShapes, places: np.ndarray):
        self.shapes, self.places, self.distances = synced.shapes, places, []
        for s, own in zip(self.shapes, places):
            solver = pp3d.MeshHeatMethodDistanceSolver(s.shape.vertices, s.shape.faces)
            self.distances.append(np.array([solver.compute_distance(int(v)) for v in own], dtype=np.float32))

    def errors(self, i: int, j: int, c_ij: np.ndarray) -> np.ndarray:
        """(P,) distance on shape j from where the map sends the judged vertices of i to where they belong."""
        at_i = self.shapes[i].basis.eigenfunctions[self.places[i], : len(c_ij)]
        return self._missed(j, at_i @ c_ij, self.shapes[j].basis.eigenfunctions[:, : c_ij.shape[1]])

    def shared(self, i: int, j: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """The same for vertices matched by functions that both share: maps (M, m_i) and (M, m_j) to those."""
        at_i = self.shapes[i].basis.eigenfunctions[self.places[i], : first.shape[1]] @ first.T
        at_j = self.shapes[j].basis.eigenfunctions[:, : second.shape[1]] @ second.T
        return self._missed(j, at_i, at_j)

    def _missed(self, j: int, at_i: np.ndarray, at_j: np.ndarray) -> np.ndarray:
        return self.distances[j][np.arange(len(at_i)), nearest_rows(at_i, at_j)]

    def mean(self, pairs, maps) -> float:
        """Mean error over pairs of the maps that ``maps(i, j)`` gives."""
        return float(np.mean([self.errors(i, j, maps(i, j)) for i, j in pairs]))

    def at(self, i: int, values: np.ndarray) -> np.ndarray:
        """Values at the samples of shape i carried to the judged vertices."""
        return samples_to_vertices(self.shapes[i], values)[self.places[i]]


def collection(name: str) -> list[Shape]:
    """Shapes of one vertex order."""
    load = generator_function("data_gen:load_collection")
    if name == "uneven_cats":
        return uneven(load("cats", seed=2, **_SYNTHETIC))
    return load(name, **(_SYNTHETIC if name == "cats" else {}))


def uneven(shapes: list[Shape], amount: float = 0.0075) -> list[Shape]:
    """Shapes that are not isometric: each moved by a smooth field of its own, of this size in square roots of area."""
    smooth = fmsync.laplace_beltrami(shapes[0].vertices, shapes[0].faces, 12).eigenfunctions[:, 1:]
    moved = []
    for k, shape in enumerate(shapes):
        field = smooth @ np.random.default_rng([2, k]).standard_normal((11, 3))
        moved.append(
            Shape(shape.vertices + amount * np.sqrt(shape.area) * field / field.std(), shape.faces, shape.name)
        )
    return moved


def judged(shapes: list[Shape], count: int = 80) -> np.ndarray:
    """(N, P) vertices by which shapes of one order are judged."""
    chosen = np.random.default_rng(0).choice(shapes[0].n_vertices, min(count, shapes[0].n_vertices), replace=False)
    return np.tile(chosen, (len(shapes), 1))


def remeshed(shapes: list[Shape], places: np.ndarray, share: float = 0.2) -> tuple[list[Shape], np.ndarray]:
    """Copies with triangulations of their own, of about ``share`` of the vertices, and the nearest vertices to places.

    Quadric decimation, to another number of vertices for each shape.
    """
    import pyvista as pv

    copies, moved = [], []
    for k, (shape, own) in enumerate(zip(shapes, places)):
        mesh = pv.PolyData.from_regular_faces(shape.vertices, shape.faces)
        mesh = mesh.decimate(1 - share * (0.9 + 0.2 * (k % 5) / 4))
        points = np.asarray(mesh.points, dtype=float)
        copies.append(Shape(points, mesh.regular_faces, shape.name))
        moved.append(nearest_rows(shape.vertices[own] - points.mean(axis=0), points - points.mean(axis=0)))
    return copies, np.array(moved)


def some_pairs(count: int, most: int = 22) -> list[tuple[int, int]]:
    """Ordered pairs of ``count`` shapes, evenly from all."""
    ordered = [(i, j) for i in range(count) for j in range(count) if i != j]
    return [ordered[k] for k in np.linspace(0, len(ordered) - 1, min(most, len(ordered))).astype(int)]


def accuracy(synced: SyncedShapes, judge: Judge, peers: bool) -> dict:
    """Errors and CPU seconds of every stage, ours and pyFM's, after the bases and descriptors that all share."""
    pairs = some_pairs(len(synced.shapes))
    errors, seconds, matches = stages(synced, judge, pairs)
    if peers:
        from bench.own_shapes_peers import pyfm_stages

        theirs, more = pyfm_stages(synced, judge, pairs, matches)
        errors |= theirs
        seconds |= more
    return {
        "n_shapes": len(synced.shapes),
        "n_vertices": [s.shape.n_vertices for s in synced.shapes],
        "n_landmarks": synced.shapes[0].n_landmarks,
        "n_basis": synced.problem.n,
        "n_refined": synced.refined.shape[-1],
        "n_samples": len(synced.shapes[0].samples),
        "violating_edges": len(synced.violating),
        "edges_given_up": int((synced.estimate.edge_weights < 0.5).sum()),
        "mean_geodesic_error": errors,
        "cpu_seconds": seconds,
    }


def stages(synced: SyncedShapes, judge: Judge, pairs) -> tuple[dict, dict, list]:
    """Errors and CPU seconds of the pipeline's stages from descriptors to the final maps; the pairwise matches."""
    shapes, edges, n, m = synced.shapes, synced.edges, synced.problem.n, synced.refined.shape[-1]
    rng, light, clock = np.random.default_rng(0), [s.light(FINE) for s in synced.shapes], time.process_time
    began = clock()
    matches = [match(light[i], light[j]) for i, j in edges]
    seconds = {"pairwise": clock() - began}

    def pairwise(i, j):
        found = {tuple(e): k for k, e in enumerate(edges.tolist())}
        return matches[found[i, j]].c_ij if (i, j) in found else matches[found[j, i]].c_ij.T

    def absolute_of(estimate, signs):
        return estimate.absolute * synchronize.basis_signs(signs, n)[:, None]

    def relative(absolute):
        return lambda i, j: absolute[i].T @ absolute[j]

    def upsampled(maps):
        return lambda i, j: zoomout(shapes[i], shapes[j], maps(i, j)[None], m, 5)[0][0]

    began = clock()
    estimate, signs, _, problem = synchronize.robust_maps(len(shapes), edges, matches, n, rng)
    robust = absolute_of(estimate, signs)
    seconds["robust synchronisation"] = clock() - began
    plain = absolute_of(fmsync.solve(problem, "mle", tolerance=1e-3), signs)

    began = clock()
    proposed = matches
    for _ in range(synchronize.ROUNDS):
        estimate, signs, _, _ = synchronize.robust_maps(len(shapes), edges, proposed, n, rng)
        better = relative(absolute_of(estimate, signs))
        tried = [improve(light[i], light[j], better(i, j)) for i, j in edges]
        proposed = [min(old, new, key=lambda x: x.cost) for old, new in zip(proposed, tried)]
    estimate, signs, _, _ = synchronize.robust_maps(len(shapes), edges, proposed, n, rng)
    start = absolute_of(estimate, signs)
    seconds["synchronised maps proposed to the pairs"] = clock() - began
    errors = {
        "pairwise (with its own ZoomOut)": judge.mean(pairs, pairwise),
        "synchronised": judge.mean(pairs, relative(plain)),
        "robustly synchronised": judge.mean(pairs, relative(robust)),
        "robustly synchronised, upsampled": judge.mean(pairs, upsampled(relative(robust))),
        "proposed to the pairs, synchronised": judge.mean(pairs, relative(start)),
    }
    maps = np.array([x.c_ij[:n, :n] for x in proposed])
    for size in sorted({FINE, min(80, m), m}):
        began = clock()
        latent = upsample(shapes, edges, maps, sizes(n, size))
        seconds[f"upsampled together to {size}"] = clock() - began
        errors[f"pipeline (upsampled together to {size})"] = float(
            np.mean([judge.shared(i, j, latent[i], latent[j]) for i, j in pairs])
        )
    return errors, seconds, matches


def costs(shapes: list[Shape], places: np.ndarray) -> dict:
    """Seconds of a vertex's images over 100 draws, and what computing regions on samples costs in accuracy."""
    synced = fmsync.synchronize_shapes(shapes[:4], rng=0)
    clock = time.process_time
    i, j = 0, 1
    synced.vertex_images(i, j, 0)
    began = clock()
    for v in places[i][:10]:
        synced.vertex_images(i, j, int(v))
    seconds = {"images of one vertex over 100 draws": (clock() - began) / 10}
    began = clock()
    known = synced.confidence(i, j)
    seconds["confidence of a pair on samples"] = clock() - began
    first, second = synced.shapes[i], synced.shapes[j]
    on_samples = samples_to_vertices(first, known.radius)[places[i]]
    solver = pp3d.MeshHeatMethodDistanceSolver(second.shape.vertices, second.shape.faces)
    began, exact = clock(), []
    with single_threaded_blas():
        image = nearest_rows(synced.shared_functions(i, places[i]), synced.shared_functions(j))
        for v, y in zip(places[i], image):
            exact.append(np.quantile(solver.compute_distance(int(y))[synced.vertex_images(i, j, int(v))], 0.9))
    exact = np.array(exact)
    seconds["confidence of a pair on all vertices"] = (clock() - began) * first.shape.n_vertices / len(exact)
    return {
        "n_vertices": first.shape.n_vertices,
        "n_samples": len(first.samples),
        "cpu_seconds": seconds,
        "mean radius": float(exact.mean()),
        "mean |radius on samples - on all vertices|": float(np.abs(on_samples - exact).mean()),
        "mean (radius on samples - on all vertices)": float((on_samples - exact).mean()),
        "rank correlation": float(np.corrcoef(on_samples.argsort().argsort(), exact.argsort().argsort())[0, 1]),
    }


def merge(path: Path, part: str, found: dict, command: str) -> None:
    """Put ``found`` under ``part`` of a file of results, and say how it was made."""
    table = json.loads(path.read_text()) if path.is_file() else {}
    machine = f"{platform.machine()}, {os.cpu_count()} cores"
    table[part] = {"command": command, "machine": machine} | found
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(table, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def main(arguments: list[str] | None = None) -> None:
    """Measure one part and add it to the table of results."""
    from bench import own_shapes_confidence as certainty

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=["collections", "remeshed", "landmarks", "costs", "planted", "refit"])
    parser.add_argument("collections", nargs="+")
    parser.add_argument("--out", type=Path, default=Path("results/own_shapes.json"))
    options = parser.parse_args(arguments)
    names = [Path(name).name for name in options.collections]
    command = " ".join(["python -m bench.own_shapes", options.part, *names])
    loaded = {name: collection(c) for name, c in zip(names, options.collections)}
    if options.part == "refit":
        return certainty.refit(loaded).save(options.out)
    if options.part in ("collections", "planted"):
        found = getattr(certainty, options.part)(loaded)
    else:
        found = {name: _measured(options.part, shapes) for name, shapes in loaded.items()}
    merge(options.out, options.part, found, command)


def _measured(part: str, shapes: list[Shape]) -> dict:
    places = judged(shapes)
    if part == "costs":
        return costs(shapes, places)
    marks = farthest_points(shapes[0].vertices, N_LANDMARKS)
    copies, places = remeshed(shapes, np.column_stack([np.tile(marks, (len(shapes), 1)), places]))
    landmarks = places[:, :N_LANDMARKS] if part == "landmarks" else None
    synced = fmsync.synchronize_shapes(copies, rng=0, n_draws=0, landmarks=landmarks)
    return accuracy(synced, Judge(synced, places[:, N_LANDMARKS:]), peers=True)


if __name__ == "__main__":
    main()
