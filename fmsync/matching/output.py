"""What ``fmsync sync`` leaves behind: point maps, functional maps, meshes with scalars, a report."""

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from tqdm import tqdm

from fmsync.adapters import to_pyvista
from fmsync.estimators import Estimate
from fmsync.matching.confidence import Confidence, samples_to_vertices
from fmsync.matching.conformal import ConformalCalibration
from fmsync.matching.network import inlier_weights, trusted_part
from fmsync.matching.pairwise import PairMatch
from fmsync.matching.report import quality_flags, report
from fmsync.matching.samples import sample_shape
from fmsync.matching.synchronize import SyncedShapes
from fmsync.matching.transferred import transfer, transfer_landmarks
from fmsync.memory import give_back
from fmsync.problem import SyncProblem
from fmsync.samplers import Posterior
from fmsync.shape import Basis, Shape
from fmsync.threads import single_threaded_blas

_OF_SHAPES = ("vertices", "faces", "eigenvalues", "eigenfunctions", "mass")
_ROW = "%d,%d" + ",%.5g" * 5 + ",%s"  # vertex, image, lengths, two_modes
_README = Path(__file__).with_name("readme.txt")


def write_all(
    synced: SyncedShapes, folder: Path, level: float, calibration: ConformalCalibration, jobs: int, progress: bool
) -> None:
    """Write every file into an empty folder; scalars on meshes are those of the maps to the first shape."""
    reference, names = 0, synced.names
    for part in ("point_maps", "meshes"):
        (folder / part).mkdir()

    def write_pair(i: int, j: int) -> tuple[Confidence, pd.DataFrame | None]:
        point_map = synced.point_map(i, j)
        known = synced.confidence(i, j, level, point_map)
        at_samples = {"region": calibration.radius(known), "expected": calibration.expected(known)}
        at_samples |= {name: getattr(known, name) for name in ("radius", "spread", "entropy", "two_modes")}
        values = samples_to_vertices(synced.shapes[i], np.column_stack([*at_samples.values()]).astype(float))
        table = pd.DataFrame({"image": point_map} | dict(zip(at_samples, values.T)))
        table["two_modes"] = table["two_modes"] > 0.5
        stem = folder / "point_maps" / f"{names[i]}_to_{names[j]}"
        np.save(f"{stem}.npy", table["image"].to_numpy(np.int32))
        # four times as fast as DataFrame.to_csv
        rows = zip(range(len(table)), *(table[name].tolist() for name in table))
        lines = [",".join(["vertex", *table]), *(_ROW % row for row in rows), ""]
        Path(f"{stem}.csv").write_text("\n".join(lines), encoding="utf-8")
        give_back()
        return known, table if j == reference else None

    pairs = list(itertools.permutations(range(len(names)), 2))
    with single_threaded_blas():
        run = Parallel(jobs, "threading", return_as="generator")(delayed(write_pair)(i, j) for i, j in pairs)
        written = dict(zip(pairs, tqdm(run, "point maps", len(pairs), disable=not progress)))
    known = {pair: confidence for pair, (confidence, _) in written.items()}
    tables = {i: table for (i, _), (_, table) in written.items() if table is not None}
    for i, name in enumerate(names):
        _write_mesh(synced.shapes[i].shape, tables.get(i), folder / "meshes" / name)
    with ZipFile(folder / "maps.npz", "w") as packed:  # as numpy.savez, which would hold all arrays at once
        for name, array in _packed(synced):
            with packed.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.asarray(array))
    edges = edge_table(synced)
    edges.to_csv(folder / "edges.csv", index=False, float_format="%.4g")
    flags = "".join(f"\nWARNING: {line}\n" for line in quality_flags(synced))
    told = {"reference": names[reference], "level": level, "fitted_on": calibration.fitted_on, "flags": flags}
    text = _README.read_text(encoding="utf-8").format(**told)
    (folder / "README.txt").write_text(text, encoding="utf-8")
    page = report(synced, known, edges, calibration, level, jobs)
    (folder / "report.html").write_text(page, encoding="utf-8")


def _packed(synced: SyncedShapes) -> Iterator[tuple[str, Any]]:
    assert synced.posterior is not None, "confidence, above, has refused to go without draws"
    draws = synced.posterior.absolute
    packed: dict[str, Any] = {name: getattr(synced, name) for name in ("refined", "edges", "signs", "used", "names")}
    packed |= {name: getattr(synced.posterior, name) for name in ("energy", "kappa")}
    packed |= {"draws": draws.reshape(-1, *draws.shape[2:]).astype(np.float32), "absolute": synced.estimate.absolute}
    packed |= {"weights": inlier_weights(synced.estimate), "observed": synced.problem.maps}
    packed |= {name: np.array(getattr(synced, name), dtype=str) for name in ("map_names", "outliers")}
    packed["scores"] = [(m.distortion, m.orientation, m.mirrored_distortion, m.missed) for m in synced.matches]
    packed |= {f"c_ij_{e}": m.c_ij for e, m in enumerate(synced.matches)}
    yield from packed.items()
    del packed
    for k, s in enumerate(synced.shapes):
        faces = np.empty((0, 3), int) if s.shape.faces is None else s.shape.faces
        parts = s.shape.vertices, faces, s.basis.eigenvalues, s.basis.eigenfunctions, s.basis.mass
        yield from ((f"{name}_{k}", part) for name, part in zip(_OF_SHAPES, parts))
        yield from ((f"samples_{k}", s.samples), (f"landmarks_{k}", s.samples[: s.n_landmarks]))


def load_synced(folder: str | Path) -> SyncedShapes:
    """The collection that ``fmsync sync`` left in a folder, eigenfunctions and draws in single precision.

    Samples, their distances and descriptors are computed again. A ValueError if ``maps.npz`` is missing or damaged.
    """
    path = Path(folder) / "maps.npz"
    if not path.is_file():
        raise ValueError(f"{path}: there is no such file; name a folder that fmsync sync has written")
    try:
        with np.load(path) as kept:
            data = dict(kept)
        problem = SyncProblem(len(data["names"]), data["edges"], data["observed"])
        shapes = []
        for k, name in enumerate(data["names"]):
            vertices, faces, *basis = (data[f"{part}_{k}"] for part in _OF_SHAPES)
            shape = Shape(vertices, faces if len(faces) else None, str(name))
            size, marks = len(data[f"samples_{k}"]), data[f"landmarks_{k}"]
            shapes.append(
                sample_shape(
                    shape, len(basis[0]), size, problem.n, marks, Basis(*basis), fill=not len(data["map_names"])
                )
            )
        matches = tuple(PairMatch(data[f"c_ij_{e}"], *map(float, row)) for e, row in enumerate(data["scores"]))
        estimate = Estimate.from_absolute(problem, data["absolute"], "robust", edge_weights=data["weights"])
        energy, trusted = data["energy"], trusted_part(problem, estimate, data["used"])
        draws = data["draws"].astype(float).reshape(*energy.shape, *data["absolute"].shape)
        posterior = Posterior(trusted, "heat-bath", draws, energy, data["kappa"], False, {"likelihood": "langevin"})
        rest = data["refined"], tuple(map(str, data["map_names"])), data["used"], tuple(map(str, data["outliers"]))
        return SyncedShapes(tuple(shapes), problem.edges, matches, data["signs"], problem, estimate, posterior, *rest)
    except (ValueError, KeyError, OSError, EOFError, BadZipFile, TypeError) as error:
        raise ValueError(f"{path}: damaged, or of another version ({error!r}); run fmsync sync again") from error


def transferred_tables(folder: Path, path: Path, on: str | None) -> dict[str, pd.DataFrame]:
    """What ``fmsync transfer`` writes: a table for every shape but the one named ``on``, or the first."""
    try:
        given = pd.read_csv(path)
    except (ValueError, OSError) as error:
        raise ValueError(f"{path}: cannot be read as a table ({error})") from error
    synced = load_synced(folder)
    if on not in (None, *synced.names):
        raise ValueError(f"--on: {on!r} is none of the shapes {', '.join(synced.names)}")
    i = synced.names.index(on or synced.names[0])
    tables = [pd.DataFrame() for _ in synced.names]
    if list(given) == ["vertex"]:
        for table, (image, region) in zip(tables, transfer_landmarks(synced, i, given["vertex"])):
            table["vertex"], table["image"], table["region"] = given["vertex"], image, region
        given = given.drop(columns="vertex")
    for name, column in given.items():
        values = column.to_numpy()
        values = values.astype(str) if values.dtype == object else values
        for table, carried in zip(tables, transfer(synced, i, values)):
            if carried.labels is None:
                table[name], table[f"{name}_std"] = carried.mean[:, 0], carried.std[:, 0]
            else:
                table[name] = carried.labels[carried.mean.argmax(axis=1)]
                table[f"{name}_probability"] = carried.mean.max(axis=1)
    return {name: table for j, (name, table) in enumerate(zip(synced.names, tables)) if j != i}


def edge_table(synced: SyncedShapes) -> pd.DataFrame:
    """Consistency of every pair, or of every given map."""
    names = np.array(synced.names)
    columns: dict[str, Any] = {"map": synced.map_names} if synced.map_names else {}
    columns |= {"first": names[synced.edges[:, 0]], "second": names[synced.edges[:, 1]]}
    columns |= {name: [getattr(m, name) for m in synced.matches] for name in ("distortion", "orientation")}
    columns["residual"] = np.linalg.norm(synced.estimate.relative() - synced.problem.maps, axis=(1, 2))
    columns["inlier_weight"] = inlier_weights(synced.estimate)
    return pd.DataFrame(columns)


def _write_mesh(shape: Shape, table: pd.DataFrame | None, stem: Path) -> None:
    """VTP with all columns, and binary PLY with some; MeshLab colours by ``quality``, which is the region."""
    mesh, faces = to_pyvista(shape), np.empty((0, 3), int) if shape.faces is None else shape.faces
    columns = dict(zip("xyz", shape.vertices.T))
    if table is not None:
        for column in table:
            mesh.point_data[column] = table[column].to_numpy().astype(np.float32)
        columns |= {"quality": table["region"], "spread": table["spread"]}
    mesh.save(f"{stem}.vtp")
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {shape.n_vertices}"]
    header += [f"property float {name}" for name in columns]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header\n"]
    corners = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    corners["count"], corners["corners"] = 3, faces
    rows = np.column_stack(list(columns.values())).astype("<f4")
    Path(f"{stem}.ply").write_bytes("\n".join(header).encode() + rows.tobytes() + corners.tobytes())
