"""Checks of arguments that several modules make; each raises a ValueError that names the argument."""

from collections.abc import Collection

import networkx as nx
import numpy as np
from numpy.typing import ArrayLike

_ORTHOGONALITY_TOLERANCE = 1e-6


def count(name: str, value: float, least: int = 1) -> int:
    """A whole number >= ``least``."""
    if isinstance(value, bool | str) or not np.isfinite(value) or int(value) != value or value < least:
        raise ValueError(f"{name}: an integer >= {least}, got {value}")
    return int(value)


def one_of(name: str, value: object, choices: Collection[str]) -> None:
    """One of some names."""
    if value not in choices:
        raise ValueError(f"{name}: {' or '.join(map(repr, choices))}, not {value!r}")


def positive(name: str, value: float) -> float:
    """A finite number > 0."""
    if not (np.isfinite(value) and value > 0):
        raise ValueError(f"{name}: must be finite and > 0, got {value}")
    return float(value)


def not_negative(name: str, value: float) -> float:
    """A finite number >= 0."""
    if not (np.isfinite(value) and value >= 0):
        raise ValueError(f"{name}: must be finite and >= 0, got {value}")
    return float(value)


def probability(name: str, value: float) -> float:
    """A number strictly between 0 and 1."""
    if not 0 < value < 1:
        raise ValueError(f"{name}: must lie strictly between 0 and 1, got {value}")
    return float(value)


def indices(name: str, values: ArrayLike, size: int, what: str = "vertices") -> np.ndarray:
    """Integers (K,) from 0 to ``size`` - 1."""
    array = np.asarray(values)
    if array.ndim != 1 or (array.size and not np.issubdtype(array.dtype, np.integer)):
        raise ValueError(f"{name}: must be a row of integers, got {array.dtype} of shape {array.shape}")
    bad = np.flatnonzero((array < 0) | (array >= size))
    if bad.size:
        raise ValueError(f"{name}[{bad[0]}] = {array[bad[0]]} is outside the {what} 0..{size - 1}")
    return array


def edge_weights(weights: ArrayLike | None, edges: np.ndarray) -> np.ndarray:
    """Positive numbers (E,), a copy; ones by default."""
    array = np.ones(len(edges)) if weights is None else np.array(weights, dtype=float)
    if array.shape != (len(edges),):
        raise ValueError(f"weights: expected ({len(edges)},), got {array.shape}")
    bad = np.flatnonzero(~((array > 0) & np.isfinite(array)))
    if bad.size:
        raise ValueError(f"weights: {edge_name(edges, bad[0])} has weight {array[bad[0]]}; must be > 0")
    return array


def edge_name(edges: np.ndarray, e: int) -> str:
    """What messages call an edge: its number and its ends."""
    return f"edge {e} ({edges[e, 0]}, {edges[e, 1]})"


def rotations(name: str, c: np.ndarray) -> None:
    """Rotations (N, n, n), up to an error of 1e-6 in every entry of CᵀC."""
    if not np.isfinite(c).all():
        raise ValueError(f"{name}: node {np.flatnonzero(~np.isfinite(c).all((1, 2)))[0]} holds NaN or infinity")
    rest = np.abs(np.swapaxes(c, -1, -2) @ c - np.eye(c.shape[-1])).max((1, 2))
    bad = np.flatnonzero((rest > _ORTHOGONALITY_TOLERANCE) | (np.linalg.det(c) < 0))
    if bad.size:
        raise ValueError(f"{name}: node {bad[0]} is not a rotation; project it first with fmsync.so.project")


def connected_edges(n_nodes: int, edges: ArrayLike) -> np.ndarray:
    """Edges (E, 2) of a connected graph without self-loops, a copy as int64."""
    count("n_nodes", n_nodes, least=2)
    raw = np.asarray(edges)
    if raw.ndim != 2 or raw.shape[1] != 2 or len(raw) == 0:
        raise ValueError(f"edges: expected (E, 2) with E >= 1, got shape {raw.shape}")
    if not np.issubdtype(raw.dtype, np.integer):
        raise ValueError(f"edges: node numbers must be integers, got {raw.dtype}")
    array = raw.astype(np.int64)
    bad = np.flatnonzero(((array < 0) | (array >= n_nodes)).any(axis=1))
    if bad.size:
        raise ValueError(f"edges: {edge_name(array, bad[0])} is out of range for {n_nodes} nodes")
    bad = np.flatnonzero(array[:, 0] == array[:, 1])
    if bad.size:
        raise ValueError(f"edges: {edge_name(array, bad[0])} is a self-loop; remove it")
    graph = nx.empty_graph(n_nodes)
    graph.add_edges_from(array.tolist())
    if not nx.is_connected(graph):
        parts = [sorted(part) for part in nx.connected_components(graph)]
        shown = "; ".join(str(part[:8])[1:-1] + (" ..." if len(part) > 8 else "") for part in parts[:6])
        raise ValueError(
            f"edges: the graph falls into {len(parts)} components ({shown}{' ...' if len(parts) > 6 else ''}); "
            "add edges between them or solve each on its own"
        )
    return array
