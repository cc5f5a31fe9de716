"""Colours of the points of a shape, as numbers: no drawing package is needed for them."""

import numpy as np
from numpy.typing import ArrayLike

from fmsync import checks


@checks.checked(vertices="V 3")
def colours_from_coordinates(vertices: ArrayLike) -> np.ndarray:
    """Red-green-blue in [0, 1] by position, (V, 3): colours to carry from one shape to another along a point map."""
    vertices = np.asarray(vertices, dtype=float)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return 0.1 + 0.9 * (vertices - low) / np.where(high > low, high - low, 1)
