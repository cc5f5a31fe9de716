"""Bodies of bones in flesh: the skin is the zero set of one smooth function.

Axes: x towards the nose, y to the left, z up. The skin is a smooth union of round cones strung along the bones (a
metaball surface): it has no seams where limbs meet the trunk. Bodies are mirror symmetric in the plane y = 0.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

Triple = tuple[float, float, float]
Pose = Mapping[str, Triple]  # of joints: (roll, pitch, yaw) in degrees

THIN = 0.028  # smallest radius: what a mesh of 1000 vertices still resolves
_FAR = 0.5  # a distance at which flesh is not felt


@dataclass(frozen=True)
class Bone:
    """A rigid piece of the skeleton that turns about ``joint`` (3,) with its ``parent``."""

    name: str
    parent: str | None
    joint: Triple


@dataclass(frozen=True)
class Cone:
    """A round cone from ``start`` to ``end``, carried by ``bone``; ``scale`` widens it along x, y, z."""

    bone: str
    start: Triple
    end: Triple
    radius_start: float
    radius_end: float
    scale: Triple = (1.0, 1.0, 1.0)


def cone_distance(points: np.ndarray, cone: Cone) -> np.ndarray:
    """Signed distance (up to the scale) of points (..., 3) from one round cone, negative inside."""
    scale = np.array(cone.scale)
    start, end = np.array(cone.start) / scale, np.array(cone.end) / scale
    offset, axis = points / scale - start, end - start
    length2 = axis @ axis
    along = np.clip(offset @ axis / length2, 0, 1) if length2 > 0 else np.zeros(points.shape[:-1])
    radius = cone.radius_start + along * (cone.radius_end - cone.radius_start)
    return (np.linalg.norm(offset - along[..., None] * axis, axis=-1) - radius) * scale.min()


@dataclass
class Body:
    """Bones, parents before children, flesh in ``parts`` that melt into each other, and the turns of joints.

    ``turns`` holds for each bone the least and the largest (roll, pitch, yaw) in degrees. Whatever is named
    ``"left ..."`` has its mirror image ``"right ..."``.
    """

    blend: float
    bones: list[Bone] = field(default_factory=list)
    parts: list[list[Cone]] = field(default_factory=list)
    turns: dict[str, np.ndarray] = field(default_factory=dict)

    def skin(self, points: np.ndarray) -> np.ndarray:
        """f(x) = -b log sum_p exp(-d_p(x) / b), the smooth minimum of the distances of points (..., 3) to all parts."""
        total = np.zeros(points.shape[:-1])
        for part in self.parts:
            distance = np.min([cone_distance(points, cone) for cone in part], axis=0)
            total += np.exp(-np.minimum(distance, _FAR) / self.blend)
        return -self.blend * np.log(total)

    def rough_skin(self, grid: np.ndarray) -> np.ndarray:
        """The same on a grid (nz, ny, nx, 3), up to 2 % of ``blend``: each cone is looked at from nearby alone."""
        axes = grid[0, 0, :, 0], grid[0, :, 0, 1], grid[:, 0, 0, 2]
        total = np.full(grid.shape[:3], np.exp(-_FAR / self.blend))
        for part in self.parts:
            distance = np.full(grid.shape[:3], _FAR)
            for cone in part:
                room = 4 * self.blend + max(cone.radius_start, cone.radius_end) * max(cone.scale)
                low, high = np.sort([cone.start, cone.end], axis=0) + np.array([[-room], [room]])
                near = tuple(slice(*axis.searchsorted(ends)) for axis, *ends in zip(axes, low, high))[::-1]
                distance[near] = np.minimum(distance[near], cone_distance(grid[near], cone))
            total += np.exp(-distance / self.blend)
        return -self.blend * np.log(total)

    def cones(self) -> list[Cone]:
        """All flesh."""
        return [cone for part in self.parts for cone in part]

    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner of the half y >= 0, with room for melting."""
        ends = np.array([[cone.start, cone.end] for cone in self.cones()])
        room = max(max(c.radius_start, c.radius_end) * max(c.scale) for c in self.cones()) + 3 * self.blend
        low, high = ends.min(axis=(0, 1)) - room, ends.max(axis=(0, 1)) + room
        return np.array([low[0], 0.0, low[2]]), high

    def pose(self, rng: np.random.Generator, ease: float) -> Pose:
        """Joint angles drawn evenly within a share ``ease`` of what the joints allow."""
        return {name: ease * rng.uniform(low, high) for name, (low, high) in self.turns.items()}

    def chain(
        self,
        name: str,
        parent: str | None,
        start: np.ndarray,
        directions: Sequence[np.ndarray],
        lengths: Sequence[float],
        radii: ArrayLike,
        turns: ArrayLike,
        scale: Triple = (1.0, 1.0, 1.0),
    ) -> np.ndarray:
        """A row of bones ``name0``, ``name1``, ... in flesh with K + 1 radii; their ends (K + 1, 3).

        ``turns`` holds for each bone (or for all) half the range of roll, pitch and yaw and the middle of the pitch.
        """
        steps = np.array(directions) * np.array(lengths)[:, None]
        points = np.vstack([start, start + np.cumsum(steps, axis=0)])
        radii = np.maximum(radii, THIN / min(scale))
        for k, (*half, middle) in enumerate(np.broadcast_to(turns, (len(lengths), 4))):
            self.bones.append(Bone(f"{name}{k}", f"{name}{k - 1}" if k else parent, tuple(points[k])))
            self.turns[f"{name}{k}"] = np.array([0, middle, 0]) + np.multiply.outer([-1, 1], half)
        self.flesh([f"{name}{k}" for k in range(len(lengths))], points, radii, scale)
        return points

    def flesh(self, owners: Sequence[str], points: np.ndarray, radii: Sequence[float], scale: Triple = (1.0, 1.0, 1.0)):
        """One part: a row of cones through points (K + 1, 3), carried by K bones."""
        ends = zip(owners, points[:-1], points[1:], radii[:-1], radii[1:])
        self.parts.append([Cone(owner, tuple(a), tuple(b), r, s, scale) for owner, a, b, r, s in ends])

    def mirror(self):
        """Add the right side to the left one."""
        for bone in [bone for bone in self.bones if bone.name.startswith("left ")]:
            self.bones.append(Bone(_other(bone.name), _other(bone.parent), _opposite(bone.joint)))
        self.turns |= {_other(name): own for name, own in self.turns.items() if name.startswith("left ")}
        for part in [part for part in self.parts if part[0].start[1] > 0 or part[-1].end[1] > 0]:
            changes = ({"bone": _other(c.bone), "start": _opposite(c.start), "end": _opposite(c.end)} for c in part)
            self.parts.append([replace(cone, **change) for cone, change in zip(part, changes)])


def _other(name):
    return name.replace("left ", "right ")


def _opposite(point):
    return (point[0], -point[1], point[2])
