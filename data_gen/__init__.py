"""Where problems come from: shape collections, graphs, ground truth and noise. fmsync never imports this package."""

from data_gen.cats import left_right_flip
from data_gen.collections import correspondence_maps, front_paw, load_collection, load_correspondences
from data_gen.creatures import Creature
from data_gen.graphs import graph_edges, random_graph
from data_gen.noise import perturb
from data_gen.seeds import seed
from data_gen.truth import GroundTruth, absolute_maps, fix_signs, ground_truth, measure_maps, planted

__all__ = [name for name, value in globals().items() if callable(value)]  # all that is imported here
