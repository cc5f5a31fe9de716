"""Where problems come from: shape collections, graphs, ground truth and noise. fmsync never imports this package."""

from data_gen.collections import load_collection
from data_gen.graphs import graph_edges, random_graph
from data_gen.noise import perturb
from data_gen.truth import GroundTruth, absolute_maps, fix_signs, ground_truth, measure_maps, planted

__all__ = [
    "GroundTruth",
    "absolute_maps",
    "fix_signs",
    "graph_edges",
    "ground_truth",
    "load_collection",
    "measure_maps",
    "perturb",
    "planted",
    "random_graph",
]
