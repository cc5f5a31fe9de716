"""The cat at rest: a skeleton of joints, and the skin around it as the zero set of one smooth function.

Axes: x towards the nose, y to the cat's left, z up; the trunk and head together are about one unit long. The skin is a
smooth union of round cones strung along the bones (a metaball surface), so it has no seams where limbs meet the trunk,
and it is mirror symmetric in the plane y = 0 by construction.
"""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

BLEND = 0.016  # length over which neighbouring cones melt into each other


@dataclass(frozen=True)
class Bone:
    """A rigid piece of the skeleton that turns about ``joint`` (3,) with its ``parent``."""

    name: str
    parent: str | None
    joint: tuple[float, float, float]


@dataclass(frozen=True)
class Cone:
    """A round cone from ``start`` to ``end``, carried by ``bone``; ``scale`` widens it along x, y, z."""

    bone: str
    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius_start: float
    radius_end: float
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)


_TAIL = [(-0.36 - 0.0802 * k, 0, z) for k, z in enumerate([0.47, 0.475, 0.465, 0.45, 0.44, 0.44, 0.45, 0.465])]

_MIDDLE_BONES = [
    Bone("pelvis", None, (-0.20, 0, 0.43)),
    Bone("loin", "pelvis", (-0.14, 0, 0.44)),
    Bone("chest", "loin", (0.03, 0, 0.44)),
    Bone("neck", "chest", (0.23, 0, 0.47)),
    Bone("head", "neck", (0.35, 0, 0.565)),
    *(Bone(f"tail{k}", f"tail{k - 1}" if k else "pelvis", point) for k, point in enumerate(_TAIL[:-1])),
]
_LEFT_BONES = [
    Bone("upper arm", "chest", (0.19, 0.075, 0.37)),
    Bone("forearm", "upper arm", (0.155, 0.085, 0.235)),
    Bone("hand", "forearm", (0.185, 0.085, 0.07)),
    Bone("thigh", "pelvis", (-0.26, 0.07, 0.40)),
    Bone("shin", "thigh", (-0.205, 0.09, 0.235)),
    Bone("foot", "shin", (-0.33, 0.085, 0.135)),
    Bone("toes", "foot", (-0.305, 0.085, 0.03)),
    Bone("ear", "head", (0.355, 0.058, 0.66)),
]

_MIDDLE_CONES = [
    Cone("pelvis", (-0.27, 0, 0.415), (-0.18, 0, 0.415), 0.100, 0.104, (1, 0.88, 1)),
    Cone("loin", (-0.18, 0, 0.415), (0.02, 0, 0.405), 0.104, 0.112, (1, 0.88, 1)),
    Cone("chest", (0.02, 0, 0.405), (0.18, 0, 0.40), 0.112, 0.118, (1, 0.88, 1)),
    Cone("neck", (0.20, 0, 0.43), (0.32, 0, 0.545), 0.088, 0.072, (1, 0.95, 1)),
    Cone("head", (0.370, 0, 0.595), (0.390, 0, 0.595), 0.098, 0.096, (0.95, 1.08, 0.92)),
    Cone("head", (0.448, 0, 0.568), (0.462, 0, 0.563), 0.044, 0.036, (1, 1.25, 0.85)),  # muzzle
    *(Cone(f"tail{k}", _TAIL[k], _TAIL[k + 1], 0.040 - 0.0015 * k, 0.0385 - 0.0015 * k) for k in range(len(_TAIL) - 1)),
]
_LEFT_CONES = [
    Cone("upper arm", (0.19, 0.070, 0.38), (0.155, 0.085, 0.235), 0.066, 0.043, (1.1, 0.8, 1)),
    Cone("forearm", (0.155, 0.085, 0.235), (0.185, 0.085, 0.07), 0.043, 0.031),
    Cone("hand", (0.185, 0.085, 0.07), (0.195, 0.085, 0.035), 0.031, 0.032),
    Cone("hand", (0.195, 0.085, 0.032), (0.235, 0.085, 0.030), 0.034, 0.034, (1.05, 1.05, 0.9)),
    Cone("thigh", (-0.26, 0.060, 0.40), (-0.205, 0.090, 0.235), 0.092, 0.050, (1.05, 0.72, 1)),
    Cone("shin", (-0.205, 0.090, 0.235), (-0.33, 0.085, 0.135), 0.050, 0.032),
    Cone("foot", (-0.33, 0.085, 0.135), (-0.310, 0.085, 0.035), 0.031, 0.031),
    Cone("toes", (-0.305, 0.085, 0.031), (-0.260, 0.085, 0.030), 0.033, 0.034, (1.05, 1.05, 0.9)),
    Cone("ear", (0.355, 0.058, 0.650), (0.345, 0.083, 0.752), 0.050, 0.014, (0.58, 1, 1)),
    Cone("head", (0.405, 0.045, 0.570), (0.405, 0.045, 0.570), 0.050, 0.050),  # cheek
]


def bones() -> list[Bone]:
    """All bones, parents before children; paired bones are named ``"left ..."`` and ``"right ..."``."""
    sides = []
    for side, sign in (("left", 1), ("right", -1)):
        for bone in _LEFT_BONES:
            x, y, z = bone.joint
            sides.append(Bone(f"{side} {bone.name}", _on_side(side, bone.parent), (x, sign * y, z)))
    return _MIDDLE_BONES + sides


def cones() -> list[Cone]:
    """All round cones of the skin, left and right."""
    sides = []
    for side, sign in (("left", 1), ("right", -1)):
        for cone in _LEFT_CONES:
            start, end = ((x, sign * y, z) for x, y, z in (cone.start, cone.end))
            sides.append(replace(cone, bone=_on_side(side, cone.bone), start=start, end=end))
    return _MIDDLE_CONES + sides


def _on_side(side, bone):
    return bone if bone in {b.name for b in _MIDDLE_BONES} else f"{side} {bone}"


def cone_distance(points: np.ndarray, cone: Cone) -> np.ndarray:
    """Signed distance (up to the scale) of points (..., 3) from one round cone, negative inside."""
    scale = np.array(cone.scale)
    start, end = np.array(cone.start) / scale, np.array(cone.end) / scale
    offset, axis = points / scale - start, end - start
    length2 = axis @ axis
    along = np.clip(offset @ axis / length2, 0, 1) if length2 > 0 else np.zeros(points.shape[:-1])
    radius = cone.radius_start + along * (cone.radius_end - cone.radius_start)
    return (np.linalg.norm(offset - along[..., None] * axis, axis=-1) - radius) * scale.min()


def skin(points: np.ndarray) -> np.ndarray:
    """The implicit function (...,) of the cat at points (..., 3): zero on the skin, negative inside.

    Within the trunk and within the tail the plain minimum is taken: melted in a row, cones look like a string of beads.
    """
    trunk = {"pelvis", "loin", "chest"}
    parts = defaultdict(list)
    for k, cone in enumerate(cones()):
        parts["tail" if cone.bone.startswith("tail") else "trunk" if cone.bone in trunk else k].append(cone)
    return melted(points, parts.values(), BLEND)


def melted(points: np.ndarray, parts: Iterable[Iterable[Cone]], blend: float) -> np.ndarray:
    """f(x) = -b log sum_p exp(-d_p(x) / b), the smooth minimum of the distances d_p of points (..., 3) to all parts."""
    total = np.zeros(points.shape[:-1])
    for part in parts:
        distance = np.min([cone_distance(points, cone) for cone in part], axis=0)
        total += np.exp(-np.minimum(distance, 0.5) / blend)
    return -blend * np.log(total)
