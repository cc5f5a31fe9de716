r"""Ours to and from the objects of other libraries: ArviZ, pyFM, geomstats, pymanopt, NetworkX, pandas, and meshes.

Each library is imported when its function is called. What is converted is copied, but not the draws, nor the problem
of :func:`to_pymanopt`. Vertices keep their order, because maps refer to it: a mesh that :class:`fmsync.Shape` refuses
is not repaired.
"""

import importlib
import json
import os
from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

import networkx as nx
import numpy as np
from scipy.sparse import diags_array

from fmsync import checks
from fmsync.diagnostics import Draws, scalars
from fmsync.energy import neighbour_sums
from fmsync.estimators.base import Estimate
from fmsync.extras import require
from fmsync.problem import SyncProblem
from fmsync.shape import Basis, Shape


def to_arviz(post: Draws, edges: np.ndarray | None = None) -> Any:
    """Gauge-invariant scalars of every draw as ArviZ's DataTree, or InferenceData where only ArviZ before 1.0 is there.

    The group ``posterior`` holds the numbers of :func:`fmsync.diagnostics.scalars` for the pairs ``edges`` (E, 2):
    ``energy`` and, where it was inferred, ``log_kappa`` (chain, draw); ``trace`` and ``first_entry`` of the relative
    maps (chain, draw, pair). Tail ESS is that of :func:`fmsync.diagnostics.summary` with ``prob=(0.05, 0.95)``. The
    group ``maps`` holds the draws, ``absolute`` (chain, draw, N, n, n), which :func:`from_arviz` reads.
    """
    values = scalars(post, edges)
    pairs = [name[5:-1] for name in values if name.startswith("tr ")]
    chosen = {name.replace(" ", "_"): x for name, x in values.items() if "[" not in name}
    chosen["trace"] = np.stack([values[f"tr C[{pair}]"] for pair in pairs], axis=-1)
    chosen["first_entry"] = np.stack([values[f"C[{pair}][0,0]"] for pair in pairs], axis=-1)
    named = {"coords": {"pair": pairs}, "dims": {"trace": ["pair"], "first_entry": ["pair"]}}
    kept = {"absolute": post.absolute, "energy": post.energy, "kappa": post.kappa}
    attrs = {"method": post.method, "settings": json.dumps(dict(post.settings))}
    if find_spec("arviz_base") is None and find_spec("arviz") is not None:
        az = importlib.import_module("arviz")
        data = az.from_dict(posterior=chosen, **named)
        data.add_groups(maps=az.dict_to_dataset(kept, attrs=attrs))
        return data
    groups = {"posterior": chosen, "maps": kept}
    return require("arviz_base", "adapters").from_dict(groups, **named, attrs={"maps": attrs})


def from_arviz(data: Mapping[str, Any], problem: SyncProblem) -> Draws:
    """The draws in an object of :func:`to_arviz`; :meth:`fmsync.Posterior.from_arviz` makes a posterior of them.

    Draws of another sampler need a group ``maps`` with rotations ``absolute`` (chain, draw, N, n, n), ``energy`` and
    ``kappa`` (chain, draw). A ValueError says what is missing or does not fit ``problem``.
    """
    group: Any = data.get("maps", {})
    if missing := [name for name in ("absolute", "energy", "kappa") if name not in group]:
        raise ValueError(f"data: its group 'maps' has no {', '.join(missing)}; to_arviz writes them")
    absolute, energy, kappa = (np.array(group[name], dtype=float) for name in ("absolute", "energy", "kappa"))
    if absolute.shape != (*energy.shape, problem.n_nodes, problem.n, problem.n):
        expected = f"(chain, draw, {problem.n_nodes}, {problem.n}, {problem.n})"
        raise ValueError(f"data: absolute is {absolute.shape}, expected {expected}; give the problem that was sampled")
    checks.rotations("data", absolute, "absolute map")
    settings = json.loads(group.attrs.get("settings", "{}"))
    return Draws(problem, group.attrs.get("method", "ArviZ"), absolute, energy, kappa, False, settings)


def to_pyfm(shape: Shape, basis: Basis | None = None) -> Any:
    """A pyFM ``TriMesh`` of unit area; its spectrum is ``basis``, if given, so that maps are in our basis."""
    faces, options = shape.faces, {"area_normalize": shape.faces is not None, "name": shape.name}
    tri_mesh = require("pyFM.mesh", "bench").TriMesh
    mesh = tri_mesh(shape.vertices.copy(), None if faces is None else faces.copy(), **options)
    if basis is not None:
        mesh.eigenvalues, mesh.eigenvectors = basis.eigenvalues.copy(), basis.eigenfunctions.copy()
        mesh.mass = diags_array(basis.mass).tocsc()
    return mesh


def from_pyfm(mesh: Any) -> tuple[Shape, Basis]:
    """Shape and basis, scaled to unit area, of a pyFM ``TriMesh`` after its ``process``."""
    if mesh.eigenvectors is None:
        raise ValueError(f"mesh: {mesh.name or 'the TriMesh'} has no spectrum yet; call its process(k) first")
    area, mass = mesh.area, np.asarray(mesh.vertex_areas) / mesh.area
    basis = Basis(mesh.eigenvalues * area, mesh.eigenvectors * np.sqrt(area), mass)
    return Shape(mesh.vertices, mesh.faces, mesh.name or "shape"), basis


def to_pyfm_maps(problem: SyncProblem) -> dict[tuple[int, int], np.ndarray]:
    r"""Maps of a problem as pyFM's ``FMN.set_maps`` takes them: key (i, j) holds ``FM_ij`` (n, n), our :math:`C_{ji}`.

    pyFM's ``FM_12`` takes coefficients on mesh 1 to mesh 2, our :math:`C_{ij}` those on j to i, so the matrices are the
    same and the names reversed: :math:`C_{21}` is ``FM_12``, and ``p2p_21`` our point map from 2 to 1. Both directions
    are given, one the transpose of the other; of repeats the mean.
    """
    maps: dict[tuple[int, int], list[np.ndarray]] = {}
    for (i, j), c in zip(problem.edges.tolist(), problem.maps):
        maps.setdefault((j, i), []).append(c)
        maps.setdefault((i, j), []).append(c.T)
    return {pair: np.mean(observed, axis=0) for pair, observed in maps.items()}


def from_pyfm_maps(maps: Mapping[tuple[int, int], np.ndarray]) -> SyncProblem:
    """The problem of some pyFM maps: ``FM_ij`` (n, n) under the key (i, j), meshes counted from zero.

    The edge of ``FM_ij`` is (j, i): see :func:`to_pyfm_maps`. Maps are near rotations only between meshes of one area
    (``TriMesh(..., area_normalize=True)``); a ValueError names the first map that is not square or of another size.

    >>> from_pyfm_maps({(0, 1): np.eye(3), (1, 2): np.eye(3)}).edges.tolist()
    [[1, 0], [2, 1]]
    """
    arrays = {pair: np.asarray(c, dtype=float) for pair, c in maps.items()}
    if not arrays:
        raise ValueError("maps: none given; use {(i, j): FM_ij}")
    size = len(next(iter(arrays.values())))
    for pair, c in arrays.items():
        if c.shape != (size, size):
            raise ValueError(f"maps: FM of {pair} is {c.shape}, expected {(size, size)}; cut all to one size [:n, :n]")
    edges = np.array([(j, i) for i, j in arrays])
    return SyncProblem(int(edges.max()) + 1, edges, np.stack(list(arrays.values())))


def to_geomstats(rotations: np.ndarray) -> tuple[Any, Any]:
    """The space ``SpecialOrthogonal(n)`` and rotations (..., n, n) as its points, in the backend that geomstats uses.

    Its metric is half the Frobenius product, so distances there are :func:`fmsync.so.dist` divided by the root of 2.
    """
    os.environ.setdefault("GEOMSTATS_BACKEND", "numpy")
    space = require("geomstats.geometry.special_orthogonal", "bench").SpecialOrthogonal(n=rotations.shape[-1])
    return space, require("geomstats.backend", "bench").array(np.array(rotations))


def from_geomstats(points: Any) -> np.ndarray:
    """Rotations (N, n, n) of points of ``SpecialOrthogonal``; a ValueError names one that is none."""
    rotations = np.array(require("geomstats.backend", "bench").to_numpy(points), dtype=float)
    checks.rotations("points", rotations)
    return rotations


def to_pymanopt(problem: SyncProblem) -> Any:
    r"""A ``pymanopt.Problem``: the Euclidean energy on :math:`SO(n)^N` with its gradient and Hessian.

    A point is (N, n, n), the cost :math:`U_E = \mathrm{const} - \sum_j\operatorname{tr}(C_j^\top S_j)`. The manifold is
    ``SpecialOrthogonalGroup(n, k=N)``: the Riemannian Hessian of a ``Product`` is wrong (pymanopt issue 219).
    """
    pymanopt = require("pymanopt", "bench")
    manifold = require("pymanopt.manifolds", "bench").SpecialOrthogonalGroup(problem.n, k=problem.n_nodes)
    ambient = pymanopt.function.numpy(manifold)
    return pymanopt.Problem(
        manifold,
        ambient(lambda c: problem.constant - np.vdot(c, neighbour_sums(problem, c))),
        euclidean_gradient=ambient(lambda c: -2 * neighbour_sums(problem, c)),
        euclidean_hessian=ambient(lambda c, v: -2 * neighbour_sums(problem, v)),
    )


def from_pymanopt(point: Any, problem: SyncProblem) -> Estimate:
    """The estimate of a point (N, n, n) of the manifold of :func:`to_pymanopt`, such as ``result.point`` of a solver.

    Then :func:`fmsync.certify` can say whether it is the best one. A ValueError names a matrix that is no rotation.
    """
    rotations = np.array(point, dtype=float)
    checks.rotations("point", rotations)
    return Estimate.from_absolute(problem, rotations, "pymanopt")


def to_networkx(problem: SyncProblem) -> nx.MultiDiGraph:
    """Nodes 0..N-1 and an edge i → j with ``map`` (n, n) and ``weight`` for every observation of C_ij."""
    graph = nx.MultiDiGraph()
    graph.add_nodes_from(range(problem.n_nodes))
    data = ({"map": c.copy(), "weight": weight} for c, weight in zip(problem.maps, problem.weights.tolist()))
    graph.add_edges_from((*edge, told) for edge, told in zip(problem.edges.tolist(), data))
    return graph


def from_networkx(graph: nx.DiGraph) -> SyncProblem:
    """The problem of a directed graph whose edge i → j holds C_ij as ``map``, and a ``weight`` unless it is one.

    Nodes may have any names; shape k is the k-th of ``graph.nodes``. A ValueError names an edge without a map.

    >>> graph = nx.DiGraph()
    >>> graph.add_edge("cat", "dog", map=np.eye(3))
    >>> from_networkx(graph).n_nodes
    2
    """
    if not graph.is_directed():
        raise ValueError("graph: it is undirected, so nobody knows which way its maps go; use a DiGraph")
    number = {node: k for k, node in enumerate(graph)}
    for i, j, data in graph.edges(data=True):
        if "map" not in data:
            raise ValueError(f"graph: the edge {i!r} -> {j!r} has no map; add_edge({i!r}, {j!r}, map=C)")
    edges = [(number[i], number[j]) for i, j in graph.edges()]
    maps = [c for _, _, c in graph.edges(data="map")]
    return SyncProblem(len(number), edges, maps, [weight for *_, weight in graph.edges(data="weight", default=1.0)])


def to_pandas(problem: SyncProblem, estimate: Estimate | None = None) -> Any:
    r"""A table of the edges: ``i``, ``j``, ``weight`` and how far from orthogonal each map is.

    With an estimate also the ``residual`` :math:`\lVert C_{ij}-\hat C_{ij}\rVert_F` and, of ``"robust"``, the
    ``inlier_weight``.
    """
    columns = {"i": problem.edges[:, 0], "j": problem.edges[:, 1], "weight": problem.weights}
    columns["orthogonality_error"] = problem.orthogonality_error
    if estimate is not None:
        columns["residual"] = np.linalg.norm(problem.maps - estimate.relative(problem.edges), axis=(1, 2))
        if estimate.edge_weights is not None:
            columns["inlier_weight"] = estimate.edge_weights
    return require("pandas", "shapes").DataFrame(columns)


def from_pandas(table: Any) -> SyncProblem:
    """The problem of a table with a row for each map: ``i`` and ``j`` from zero, ``map`` (n, n), ``weight`` if not one.

    For the rows of :func:`to_pandas` ``map`` is ``list(problem.maps)``. A ValueError names a column that is missing.

    >>> import pandas as pd
    >>> from_pandas(pd.DataFrame({"i": [0, 1], "j": [1, 2], "map": [np.eye(3), np.eye(3)]})).n_nodes
    3
    """
    if missing := [name for name in ("i", "j", "map") if name not in table]:
        raise ValueError(f"table: no column {', '.join(missing)}; it has {', '.join(map(str, table))}")
    edges = table[["i", "j"]].to_numpy()
    return SyncProblem(edges.max() + 1, edges, np.stack(list(table["map"])), table.get("weight"))


def to_pyvista(shape: Shape) -> Any:
    """``pyvista.PolyData`` of a mesh or point cloud."""
    poly = require("pyvista", "shapes").PolyData
    return poly(shape.vertices.copy()) if shape.faces is None else poly.from_regular_faces(shape.vertices, shape.faces)


def from_pyvista(mesh: Any, name: str = "shape") -> Shape:
    """The shape of a ``PolyData``, polygons cut into triangles; a point cloud if it has none."""
    faces = mesh.triangulate().regular_faces if mesh.n_faces else None
    return Shape(mesh.points, faces, name)


def to_trimesh(shape: Shape) -> Any:
    """``trimesh.Trimesh``, or ``trimesh.PointCloud`` of a shape without faces; vertices are not merged."""
    trimesh = require("trimesh", "adapters")
    if shape.faces is None:
        return trimesh.PointCloud(shape.vertices.copy())
    return trimesh.Trimesh(shape.vertices.copy(), shape.faces.copy(), process=False)


def from_trimesh(mesh: Any, name: str = "shape") -> Shape:
    """The shape of a ``Trimesh`` or ``PointCloud``."""
    return Shape(mesh.vertices, getattr(mesh, "faces", None), name)


def to_meshio(shape: Shape) -> Any:
    """``meshio.Mesh`` of triangles, or of vertices for a point cloud."""
    faces = [("vertex", np.arange(shape.n_vertices)[:, None])] if shape.faces is None else [("triangle", shape.faces)]
    return require("meshio", "adapters").Mesh(shape.vertices.copy(), faces)


def from_meshio(mesh: Any, name: str = "shape") -> Shape:
    """The shape of a ``meshio.Mesh`` of triangles, or of vertices alone; a ValueError names cells of another kind."""
    if others := sorted(set(mesh.cells_dict) - {"triangle", "vertex", "line"}):
        raise ValueError(f"mesh: it has cells of type {', '.join(others)}; a surface of triangles is wanted")
    return Shape(mesh.points, mesh.cells_dict.get("triangle"), name)
