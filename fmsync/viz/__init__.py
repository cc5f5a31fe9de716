"""Figures of the book: turnable scenes of shapes, heat maps, one style. Nothing here computes a result."""

from fmsync.viz.figures import PALETTE, Picture, heatmaps, picture, style
from fmsync.viz.loops import Loop, loop, walk_on_sphere
from fmsync.viz.scenes import Scene, colours_from_coordinates, scene

__all__ = [
    "PALETTE",
    "Loop",
    "Picture",
    "Scene",
    "colours_from_coordinates",
    "heatmaps",
    "loop",
    "picture",
    "scene",
    "style",
    "walk_on_sphere",
]
