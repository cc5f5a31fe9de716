"""Connected random graphs of shapes with a given edge density."""

import networkx as nx
import numpy as np

from fmsync import checks


@checks.checked(n_nodes=">= 2", density=checks.share)
def random_graph(n_nodes: int, density: float = 1.0, rng: int | np.random.Generator = 0) -> nx.Graph:
    r"""Connected graph with ``round(density * N (N - 1) / 2)`` edges: a random labelled tree plus random other pairs.

    The tree is uniform among all labelled trees, so that no edge is favoured; dense graphs are as good as uniform. On
    nodes 0..N-1, N >= 2; ``density`` is a share of all pairs in (0, 1], at least 2 / N to connect them (ValueError).
    ``graph.graph["density"]`` holds it, and ``graph.graph["achieved_density"]`` what rounding left of it.

    >>> import data_gen
    >>> graph = data_gen.random_graph(4, density=5 / 6, rng=0)
    >>> graph.number_of_edges(), round(graph.graph["achieved_density"], 3)
    (5, 0.833)
    """
    n_pairs = n_nodes * (n_nodes - 1) // 2
    n_edges = round(density * n_pairs)
    if n_edges < n_nodes - 1:
        least = f"ask for at least {(n_nodes - 1) / n_pairs:.4g}"
        raise ValueError(f"density: {n_edges} edges, but connecting {n_nodes} nodes takes {n_nodes - 1}; {least}")
    rng = np.random.default_rng(rng)
    graph = nx.complete_graph(n_nodes) if n_edges == n_pairs else nx.empty_graph(n_nodes)
    if n_edges < n_pairs:
        tree = nx.from_prufer_sequence(rng.integers(n_nodes, size=n_nodes - 2).tolist())  # any is as likely
        chosen = {tuple(sorted(edge)) for edge in tree.edges}
        while len(chosen) < n_edges:
            for i, j in rng.integers(n_nodes, size=(2 * (n_edges - len(chosen)), 2)).tolist():
                if i != j and len(chosen) < n_edges:
                    chosen.add((min(i, j), max(i, j)))
        graph.add_edges_from(sorted(chosen))
    graph.graph.update(density=float(density), achieved_density=n_edges / n_pairs)
    return graph


@checks.checked()
def graph_edges(graph: nx.Graph) -> np.ndarray:
    """Edges (E, 2) of a graph on nodes 0..N-1, each as (i, j) with i < j, in lexicographic order.

    Raises a ValueError when the nodes are not 0..N-1 or the graph is disconnected (naming the components).

    >>> import networkx as nx, data_gen
    >>> data_gen.graph_edges(nx.path_graph(3)).tolist()
    [[0, 1], [1, 2]]
    """
    if sorted(graph.nodes) != list(range(graph.number_of_nodes())):
        raise ValueError("graph: nodes must be numbered 0..N-1; relabel with networkx.convert_node_labels_to_integers")
    if not nx.is_connected(graph):
        parts = [sorted(part)[:8] for part in nx.connected_components(graph)]
        raise ValueError(f"graph: falls into {len(parts)} components {parts[:6]}; every shape must be reachable")
    return np.array(sorted(tuple(sorted(edge[:2])) for edge in graph.edges), dtype=np.int64)
