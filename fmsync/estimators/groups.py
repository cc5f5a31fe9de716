"""The groups that estimators answer in: rotations, or all orthogonal matrices."""

import numpy as np

from fmsync import so

GROUPS = ("SO", "O")
_ROUNDING = 1e-8  # how far from orthogonal one Newton–Schulz step brings back to machine precision


def check_group(group: str) -> None:
    """Raise a ValueError for anything but "SO" and "O"."""
    if group not in GROUPS:
        raise ValueError(f"group: 'SO' (rotations) or 'O' (orthogonal matrices), not {group!r}")


def nearest(a: np.ndarray, group: str) -> np.ndarray:
    """Nearest member of the group to every (..., n, n): for "O" the polar factor, whatever its determinant."""
    rest = so.transpose(a) @ a - np.eye(a.shape[-1])
    if np.abs(rest).max(initial=0) < _ROUNDING and (group == "O" or (np.linalg.det(a) > 0).all()):
        return a - a @ rest / 2
    if group == "SO":
        return so.project(a)
    u, _, vt = np.linalg.svd(a)
    return u @ vt
