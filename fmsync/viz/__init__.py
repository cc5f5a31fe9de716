"""Figures of the book: turnable scenes of shapes, heat maps, one style. Nothing here computes a result."""

from fmsync.viz.figures import PALETTE, Picture, heatmaps, picture, style
from fmsync.viz.scenes import Scene, colours_from_coordinates, scene

__all__ = ["PALETTE", "Picture", "Scene", "colours_from_coordinates", "heatmaps", "picture", "scene", "style"]
