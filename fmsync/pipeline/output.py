"""What ``fmsync sync`` leaves behind: point maps, functional maps, meshes with scalars, a report."""

from pathlib import Path

import numpy as np
import pandas as pd

from fmsync.pipeline.confidence import Confidence, spread_out
from fmsync.pipeline.report import report
from fmsync.pipeline.synchronise import SyncedShapes

_README = """\
report.html         pictures and a summary; everything is in the one file
maps.npz            refined (N, m, m) absolute maps, C_ij = refined[i].T @ refined[j]; draws (T, N, n, n); edges; names
point_maps/*.npy    NAME_to_{reference}.npy: for each vertex of NAME its vertex of {reference}
point_maps/*.csv    the same, with radius, spread, entropy and two_modes of every vertex
meshes/*.vtp, *.ply every shape with these numbers on its vertices, for ParaView and MeshLab
edges.csv           every pair: how well distances and orientation are kept, how far the edge was believed

Lengths are in units of the square root of a shape's surface area. radius: the region about the image that holds
{level:.0%} of the posterior draws. It knows the noise of the maps, not every error of the model: where spread, the mean
distance to where detours through other shapes lead, is larger, believe the spread. two_modes: two distant places have
support, as on a left-right symmetric body.
Any other pair: fmsync.synchronize_shapes(...).point_map(i, j).
"""


def write_all(synced: SyncedShapes, folder: Path, level: float = 0.9) -> None:
    """Write every file into an existing empty folder; point maps lead to the first shape."""
    reference, names = 0, synced.names
    for part in ("point_maps", "meshes"):
        (folder / part).mkdir()
    known, tables = {}, {}
    for i, name in enumerate(names):
        if i == reference:
            continue
        known[i] = synced.confidence(i, reference, level)
        tables[i] = vertex_table(synced, i, reference, known[i])
        stem = folder / "point_maps" / f"{name}_to_{names[reference]}"
        np.save(stem.with_suffix(".npy"), tables[i]["image"].to_numpy())
        tables[i].to_csv(stem.with_suffix(".csv"), index_label="vertex", float_format="%.5g")
    for i, name in enumerate(names):
        _write_mesh(synced.shapes[i].shape, tables.get(i), folder / "meshes" / name)
    draws = synced.posterior.absolute
    np.savez_compressed(
        folder / "maps.npz",
        refined=synced.refined,
        draws=draws.reshape(-1, *draws.shape[2:]).astype(np.float32),
        edges=synced.edges,
        signs=synced.signs,
        names=names,
    )
    edge_table(synced).to_csv(folder / "edges.csv", index=False, float_format="%.4g")
    (folder / "README.txt").write_text(_README.format(reference=names[reference], level=level), encoding="utf-8")
    page = report(synced, tables, edge_table(synced), reference, level)
    (folder / "report.html").write_text(page, encoding="utf-8")


def vertex_table(synced: SyncedShapes, i: int, j: int, known: Confidence) -> pd.DataFrame:
    """Image on shape j and confidence of every vertex of shape i."""
    shape = synced.shapes[i]
    return pd.DataFrame(
        {
            "image": synced.point_map(i, j),
            "radius": spread_out(shape, known.radius),
            "spread": spread_out(shape, known.spread),
            "entropy": spread_out(shape, known.entropy),
            "two_modes": spread_out(shape, known.two_modes.astype(float)) > 0.5,
        }
    )


def edge_table(synced: SyncedShapes) -> pd.DataFrame:
    """Consistency of every pair."""
    weights = synced.estimate.edge_weights
    names = np.array(synced.names)
    disagree = np.zeros(len(synced.edges), dtype=bool)
    disagree[synced.violating] = True
    return pd.DataFrame(
        {
            "first": names[synced.edges[:, 0]],
            "second": names[synced.edges[:, 1]],
            "distortion": [m.distortion for m in synced.matches],
            "orientation": [m.orientation for m in synced.matches],
            "residual": np.linalg.norm(synced.estimate.relative() - synced.problem.maps, axis=(1, 2)),
            "believed": np.ones(len(names[synced.edges])) if weights is None else weights,
            "sign_disagrees": disagree,
        }
    )


def _write_mesh(shape, table, stem) -> None:
    import pyvista as pv

    if shape.faces is None:
        mesh = pv.PolyData(shape.vertices)
    else:
        mesh = pv.PolyData.from_regular_faces(shape.vertices, shape.faces)
    if table is not None:
        for column in table:
            mesh.point_data[column] = table[column].to_numpy().astype(np.float32)
    mesh.save(stem.with_name(stem.name + ".vtp"))
    _write_ply(stem.with_name(stem.name + ".ply"), shape, table)


def _write_ply(path, shape, table) -> None:
    """Binary PLY with the scalars as vertex properties; MeshLab colours by ``quality``, which is the radius."""
    fields = [(axis, "<f4") for axis in "xyz"] + ([] if table is None else [("quality", "<f4"), ("spread", "<f4")])
    rows = np.empty(shape.n_vertices, dtype=fields)
    for k, axis in enumerate("xyz"):
        rows[axis] = shape.vertices[:, k]
    if table is not None:
        rows["quality"], rows["spread"] = table["radius"], table["spread"]
    n_faces = 0 if shape.faces is None else len(shape.faces)
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {shape.n_vertices}"]
    header += [f"property float {name}" for name, _ in fields]
    header += [f"element face {n_faces}", "property list uchar int vertex_indices", "end_header\n"]
    with path.open("wb") as stream:
        stream.write("\n".join(header).encode())
        stream.write(rows.tobytes())
        if n_faces:
            corners = np.empty(n_faces, dtype=[("count", "u1"), ("corners", "<i4", 3)])
            corners["count"], corners["corners"] = 3, shape.faces
            stream.write(corners.tobytes())
