r"""Ground truth: relative maps of a shape collection, or random rotations, with their absolute maps.

Protocol for shapes, in this order: bases; signs of eigenfunctions fixed; maps of the edges measured from the common
vertex order and projected to SO(n); absolute maps multiplied along a spanning tree from shape 0. The tree is part of
the protocol because measured maps are not exactly consistent: another tree gives another truth.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import networkx as nx
import numpy as np

import fmsync.shape
from data_gen.cache import cached, checksum, recipe
from data_gen.collections import require_common_order
from data_gen.fingerprints import fingerprint
from data_gen.graphs import graph_edges
from fmsync import block_krylov, checks, functional_map, laplace_beltrami, so
from fmsync.problem import relative_maps
from fmsync.shape import Basis, Shape

TREES = ("depth-first", "breadth-first", "minimum-distortion")


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """What a problem was planted with. Estimators never see it.

    ``absolute`` (N, n, n) are rotations with C_1 = I; ``measured_maps`` (E, n, n), of the ``edges`` (E, 2), the
    rotations nearest to the maps measured on the shapes after sign fixing, not exactly consistent, without shapes equal
    to ``maps``; ``bases`` the N sign-fixed Laplace–Beltrami bases, or (); ``flip`` (n, n) the left–right mirror map F
    in the universe, an orthogonal involution up to discretisation, or None: mirrored maps are C_i^T F C_j;
    ``provenance`` plain JSON values that say how it was made.
    """

    absolute: np.ndarray
    edges: np.ndarray
    measured_maps: np.ndarray
    bases: tuple[Basis, ...] = ()
    provenance: Mapping[str, object] = field(default_factory=dict)
    flip: np.ndarray | None = None

    @property
    def n_nodes(self) -> int:
        """Number of shapes."""
        return len(self.absolute)

    @property
    def n(self) -> int:
        """Size of every map."""
        return self.absolute.shape[-1]

    @property
    def maps(self) -> np.ndarray:
        """Consistent relative maps C_i^T C_j of the edges, (E, n, n)."""
        return self.relative(self.edges)

    @checks.checked(edges="K 2 < N")
    def relative(self, edges: np.ndarray) -> np.ndarray:
        """Consistent relative maps of any pairs (K, 2)."""
        return relative_maps(self.absolute, edges)


@checks.checked(flip="V < W", tree=TREES)
def ground_truth(
    shapes: Sequence[Shape],
    graph: nx.Graph | None = None,
    n_basis: int = 20,
    *,
    tree: str = "depth-first",
    bases: Sequence[Basis] | None = None,
    point_maps: Mapping[tuple[int, int], np.ndarray] | None = None,
    flip: np.ndarray | None = None,
) -> GroundTruth:
    """Ground-truth maps of N shapes in one vertex order, on a connected ``graph`` of 0..N-1, complete by default.

    * ``n_basis``, ``bases``: number n of Laplace–Beltrami eigenfunctions, and bases of at least as many to be used
      instead of those computed here, which stay in the cache of this machine.
    * ``tree``: ``"depth-first"`` (the paper), ``"breadth-first"`` or ``"minimum-distortion"`` (edges that projection
      changed least): the spanning tree from shape 0 along which absolute maps are multiplied; neighbours are visited in
      the order of their numbers.
    * ``point_maps``: for every edge (i, j) the vertex of j for each vertex of i, (V_i,), of shapes without a common
      vertex order.
    * ``flip``: (V,) the mirror image of every vertex of the first shape, where there is a left–right symmetry.

    >>> import pyvista as pv, data_gen, fmsync
    >>> ball = pv.ParametricEllipsoid(1.0, 0.8, 0.6, u_res=20, v_res=20, w_res=20).triangulate().clean()
    >>> shape = fmsync.Shape(ball.points, ball.regular_faces, "ellipsoid")
    >>> truth = data_gen.ground_truth([shape, shape, shape], n_basis=6)
    >>> bool(abs(truth.maps - truth.measured_maps).max() < 1e-8)
    True
    """
    graph = nx.complete_graph(len(shapes)) if graph is None else graph
    edges = graph_edges(graph)
    if len(shapes) != graph.number_of_nodes():
        raise ValueError(f"graph: has {graph.number_of_nodes()} nodes for {len(shapes)} shapes")
    if point_maps is None:
        require_common_order(shapes)
    if bases is None:
        bases = [_basis(shape, n_basis) for shape in shapes]
    bases = fix_signs([basis.truncated(n_basis) for basis in bases], point_maps)
    raw = measure_maps(bases, edges, point_maps)
    measured = so.project(raw)
    provenance = {
        "protocol": "ground truth of shapes",
        "shapes": [shape.name for shape in shapes],
        "positions": [fingerprint(shape)["positions"][:16] for shape in shapes],
        "n_vertices": [len(shape.vertices) for shape in shapes],
        "n_basis": int(n_basis),
        "tree": tree,
        "density": graph.graph.get("density"),
        "achieved_density": len(edges) / (len(shapes) * (len(shapes) - 1) / 2),
    }
    distortion = np.linalg.norm(raw - measured, axis=(1, 2))
    absolute = absolute_maps(len(shapes), edges, measured, tree=tree, distortion=distortion)
    mirror = None
    if flip is not None:  # the nearest orthogonal map, of either determinant: odd functions may be odd in number
        u, _, vt = np.linalg.svd(functional_map(bases[0], bases[0], checks.indices("flip", flip, bases[0].n_vertices)))
        mirror = u @ vt
    return GroundTruth(absolute, edges, measured, tuple(bases), provenance, mirror)


def _basis(shape: Shape, n_basis: int) -> Basis:
    """From the cache where the same functions were computed of the same mesh before."""
    mesh = {"vertices": shape.vertices} | ({} if shape.faces is None else {"faces": shape.faces})
    key = f"basis-{n_basis}-{checksum(mesh)[:24]}-{recipe(fmsync.shape.__file__, block_krylov.__file__)}"
    return Basis(**cached(key, lambda: vars(laplace_beltrami(shape.vertices, shape.faces, n_basis))))


@checks.checked(edges="E 2 < N")
def measure_maps(
    bases: Sequence[Basis], edges: np.ndarray, point_maps: Mapping[tuple[int, int], np.ndarray] | None = None
) -> np.ndarray:
    """Raw functional maps (E, n, n) of the edges from the common vertex order, or from point maps; not projected."""
    checks.indices("edges", np.ravel(edges), len(bases), "bases")
    order = np.arange(bases[0].n_vertices)
    maps = [functional_map(bases[i], bases[j], order if point_maps is None else point_maps[i, j]) for i, j in edges]
    return np.stack(maps)


@checks.checked()
def fix_signs(bases: Sequence[Basis], point_maps: Mapping[tuple[int, int], np.ndarray] | None = None) -> list[Basis]:
    """Flip one eigenfunction on each shape whose map to the first has a negative determinant.

    Signs of eigenfunctions are arbitrary, so that a third to a half of all raw maps are nearer to a reflection than to
    a rotation. One flip a shape, made before any map is formed, repairs nearly all of them at once and keeps the maps
    consistent; projecting each map to SO(n) on its own tears the cycles apart.

    Without a common vertex order the shapes are reached along the edges that ``point_maps`` offers, breadth first.
    """
    offered = [(0, i) for i in range(1, len(bases))] if point_maps is None else list(point_maps)
    fixed = list(bases)
    for known, new in nx.bfs_edges(nx.Graph(offered), 0) if len(bases) > 1 else ():
        pair = (known, new) if point_maps is None or (known, new) in point_maps else (new, known)
        if np.linalg.det(measure_maps(fixed, [pair], point_maps)[0]) < 0:
            fixed[new] = fixed[new].with_flipped(bases[new].n - 1)
    return fixed


@checks.checked(n_nodes="N >= 1", edges="E 2 < N", maps="E n n", distortion="E", tree=TREES)
def absolute_maps(
    n_nodes: int, edges: np.ndarray, maps: np.ndarray, tree: str = "depth-first", distortion: np.ndarray | None = None
) -> np.ndarray:
    """Absolute maps (N, n, n) with C_1 = I, multiplied along a spanning tree from node 0: C_j = C_i C_ij.

    ``distortion`` (E,) weighs the edges of the ``"minimum-distortion"`` tree.
    """
    lookup = {}
    graph = nx.empty_graph(n_nodes)
    for e, (i, j) in enumerate(np.asarray(edges).tolist()):
        lookup[i, j], lookup[j, i] = maps[e], maps[e].T
        graph.add_edge(i, j, weight=0.0 if distortion is None else distortion[e])
    if tree == "minimum-distortion":
        graph = nx.minimum_spanning_tree(graph)
    walk = nx.dfs_edges if tree == "depth-first" else nx.bfs_edges
    absolute = np.zeros((n_nodes, *maps.shape[1:]))
    absolute[0] = np.eye(maps.shape[-1])
    for i, j in walk(graph, 0, sort_neighbors=sorted):
        absolute[j] = absolute[i] @ lookup[i, j]
    return so.project(absolute)


@checks.checked(n_nodes=">= 2")
def planted(n_nodes: int, n: int, graph: nx.Graph | None = None, rng: int | np.random.Generator = 0) -> GroundTruth:
    """A truth without shapes: Haar-uniform absolute maps on a graph (complete by default), gauge C_1 = I.

    Scales to thousands of nodes: give a sparse graph. Its mirror map ``flip`` flips the sign of half of the functions.

    >>> import data_gen
    >>> data_gen.planted(5, 3, rng=0).maps.shape
    (10, 3, 3)
    """
    if graph is not None and graph.number_of_nodes() != n_nodes:
        raise ValueError(f"graph: has {graph.number_of_nodes()} nodes, n_nodes says {n_nodes}")
    edges = graph_edges(nx.complete_graph(n_nodes) if graph is None else graph)
    absolute = so.random_uniform(n, n_nodes, rng)
    absolute[0] = np.eye(n)
    provenance = {"protocol": "planted Haar rotations", "n_nodes": int(n_nodes), "n": int(n)}
    signs = np.where(np.arange(n) < 2 * (n // 4), -1.0, 1.0)  # an even number of odd functions: F is a rotation
    truth = GroundTruth(absolute, edges, np.empty(0), (), provenance, np.diag(signs))
    return replace(truth, measured_maps=truth.maps)
