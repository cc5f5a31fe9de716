"""Figures of the book: turnable scenes of shapes, heat maps, one style; needs the extra ``viz``.

Nothing here computes a result.
"""

from fmsync.extras import require_all

require_all(__name__, "viz", "PIL", "matplotlib", "pyvista", "trame_vtk")

from fmsync.shape import colours_from_coordinates  # noqa: E402
from fmsync.viz.explorer import Explorer, State, explorer, glow  # noqa: E402
from fmsync.viz.figures import PALETTE, Picture, heatmaps, picture, style, subplots  # noqa: E402
from fmsync.viz.players import Player, player, walk_on_sphere  # noqa: E402
from fmsync.viz.scenes import Scene, facing, scene  # noqa: E402

__all__ = [
    "PALETTE",
    "Explorer",
    "Picture",
    "Player",
    "Scene",
    "State",
    "colours_from_coordinates",
    "explorer",
    "facing",
    "glow",
    "heatmaps",
    "picture",
    "player",
    "scene",
    "style",
    "subplots",
    "walk_on_sphere",
]
