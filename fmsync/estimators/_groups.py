"""The groups that estimators answer in: rotations, or all orthogonal matrices."""

import numpy as np

from fmsync import so

GROUPS = ("SO", "O")


def check_group(group: str) -> None:
    """Raise a ValueError for anything but "SO" and "O"."""
    if group not in GROUPS:
        raise ValueError(f"group: 'SO' (rotations) or 'O' (orthogonal matrices), not {group!r}")


def nearest(a: np.ndarray, group: str) -> np.ndarray:
    """Nearest member of the group to every (..., n, n): for "O" the polar factor, whatever its determinant."""
    if group == "SO":
        return so.project(a)
    u, _, vt = np.linalg.svd(a)
    return u @ vt
