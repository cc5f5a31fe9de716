"""Synthetic cats: near-isometric poses of one quadruped with one triangulation, made here and nowhere else."""

import hashlib
import itertools
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from data_gen.cache import cached
from data_gen.cat_mesh import check_resolution, rest_mesh
from data_gen.cat_pose import POSES, Pose, Rig, muscle_tone
from data_gen.self_intersection import self_intersections
from fmsync.checks import checked
from fmsync.shape import Shape

_GROWTH = 0.04  # how much larger the right half is when the symmetry is broken
_JITTER = 1.5  # degrees, of every joint of every cat
_EASE = 0.96  # share of the joint angles that is kept from one try to the next
_DRAWS = 30  # tries to find a pose that does not pass through itself


@checked(seed=">= 0")
def cats(count: int = 11, n_vertices: int = 5000, seed: int = 0, symmetric: bool = False) -> list[Shape]:
    """Poses of the synthetic cat, the same for the same arguments, bit by bit.

    Parameters
    ----------
    count, n_vertices
        Number of cats, of which the first 11 take the poses of ``cat_pose.POSES`` in order and the others are drawn
        between them, and of the vertices of each, 1000 to 30000; vertex v of one corresponds to vertex v of another.
    seed
        Turns every joint a little (standard deviation 1.5 degrees) and draws the poses past the eleventh.
        Cat k does not depend on ``count``.
    symmetric
        Keep the left–right symmetry of the resting cat exact; otherwise its right half is 4 % larger.

    Returns
    -------
    list[Shape]
        Closed surfaces of genus zero, named ``cat0``, ``cat1``, ...; the unit is about the length of trunk and head.

    Examples
    --------
    >>> first, second = cats(count=2, n_vertices=1000)
    >>> first.name, first.vertices.shape, (first.faces == second.faces).all()
    ('cat0', (1000, 3), np.True_)
    """
    key = f"cats-{count}-{n_vertices}-{seed}-{'symmetric' if symmetric else 'asymmetric'}-{_recipe()}"
    made = cached(key, lambda: _build(count, n_vertices, seed, symmetric))
    return [Shape(vertices, made["faces"], f"cat{k}") for k, vertices in enumerate(made["vertices"])]


@checked()
def left_right_flip(n_vertices: int = 5000) -> np.ndarray:
    """The vertex opposite to each vertex (V,) on the cats of ``load_collection("cats", n_vertices=...)``.

    Examples
    --------
    >>> flip = left_right_flip(1000)
    >>> bool((flip[flip] == range(1000)).all())
    True
    """
    return _rest(n_vertices)["mirror"]


def _recipe() -> str:
    """Changes whenever the code that makes cats does, so that an old cache is not read by a new version."""
    folder = Path(__file__).parent
    sources = ("cat_body.py", "cat_mesh.py", "cat_pose.py", "cats.py")
    return hashlib.sha256(b"".join((folder / name).read_bytes() for name in sources)).hexdigest()[:12]


def _rest(n_vertices):
    check_resolution(n_vertices)
    names = ("vertices", "faces", "mirror")
    return cached(f"cat-at-rest-{n_vertices}-{_recipe()}", lambda: dict(zip(names, rest_mesh(n_vertices))))


def _build(count, n_vertices, seed, symmetric):
    rest = _rest(n_vertices)
    rig = Rig(
        rest["vertices"] if symmetric else grow_right_half(rest["vertices"], _GROWTH, np.array([0, 0, 0.42])),
        rest["faces"],
    )
    posed = []
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        candidates = (rig.pose(pose, muscle_tone(k)) for pose in itertools.islice(_candidates(k, rng), _DRAWS))
        free = (vertices for vertices in candidates if len(self_intersections(vertices, rest["faces"])) == 0)
        vertices = next(free, None)
        if vertices is None:
            raise ValueError(f"cat{k}: {_DRAWS} draws of its pose all pass through themselves; try another seed")
        posed.append(vertices)
    return {"vertices": np.stack(posed), "faces": rest["faces"]}


def grow_right_half(vertices: np.ndarray, growth: float, centre: np.ndarray) -> np.ndarray:
    """Scale y < 0 about the middle of the trunk, growing smoothly from the mirror plane on."""
    step = np.clip(-vertices[:, 1] / 0.06, 0, 1)
    return vertices + (growth * step**2 * (3 - 2 * step))[:, None] * (vertices - centre)


def _candidates(k: int, rng) -> Iterable[Pose]:
    """Endless draws of the k-th pose, each bent a little less than the one before.

    The first that does not pass through itself is taken; a fine mesh resolves creases that a coarse one steps over.
    """
    named = list(POSES.values())
    for attempt in itertools.count():
        ease = _EASE**attempt
        if k < len(named):
            pose, spread = named[k], _JITTER
        else:
            first, second = (named[index] for index in rng.choice(len(named), 2, replace=False))
            pose, spread = _between(first, second, rng.uniform(0.25, 0.75)), 3 * _JITTER
        yield {joint: tuple(ease * np.array(a) + spread * rng.standard_normal(3)) for joint, a in pose.items()}


def _between(first: Pose, second: Pose, share: float) -> Pose:
    """Joint angles on the way from one pose to another."""
    still = np.zeros(3)
    joints = sorted({*first, *second})
    return {j: (1 - share) * np.array(first.get(j, still)) + share * np.array(second.get(j, still)) for j in joints}
