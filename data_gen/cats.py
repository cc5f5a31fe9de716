"""Synthetic cats: near-isometric poses of one quadruped with one triangulation, made here and nowhere else."""

import itertools
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from data_gen.body import Pose
from data_gen.cache import cached, recipe
from data_gen.cat_pose import POSES, Rig, cat_body, muscle_tone
from data_gen.mesher import check_resolution, half_skin, is_sphere, mirrored_mesh, onto_skin, refined, skin_gradient
from fmsync import checks
from fmsync.shape import Shape

SOURCES = ("cat_body.toml", "cat_poses.toml", "body.py", "cat_pose.py", "cats.py", "mesher.py")
_LOW, _HIGH = np.array([-1.0, 0.0, -0.05]), np.array([0.58, 0.22, 0.78])  # of a box around the left half
_LLOYD_STEPS = 60
_GROWTH = 0.04  # how much larger the right half is when the symmetry is broken
_JITTER = 1.5  # degrees, of every joint of every cat
_EASE = 0.96  # share of the joint angles that is kept from one try to the next
_DRAWS = 30  # tries to find a pose that does not pass through itself


@checks.checked(seed=">= 0")
def cats(count: int = 11, n_vertices: int = 5000, seed: int = 0, symmetric: bool = False) -> list[Shape]:
    """Poses of the synthetic cat, the same for the same arguments, bit by bit.

    Closed surfaces of genus zero, named ``cat0``, ``cat1``, ...; the unit is about the length of trunk and head. The
    first 11 of ``count`` take the poses of ``cat_pose.POSES`` in order, the others are drawn between them; each has
    ``n_vertices``, 1000 to 30000, and vertex v of one corresponds to vertex v of another. The ``seed`` turns every
    joint a little (standard deviation 1.5 degrees) and draws the poses past the eleventh; cat k does not depend on
    ``count``. The right half is 4 % larger unless ``symmetric``.

    >>> first, second = cats(count=2, n_vertices=1000)
    >>> first.name, first.vertices.shape, (first.faces == second.faces).all()
    ('cat0', (1000, 3), np.True_)
    """
    key = f"cats-{count}-{n_vertices}-{seed}-{'symmetric' if symmetric else 'asymmetric'}-{recipe(*SOURCES)}"
    made = cached(key, lambda: _build(count, n_vertices, seed, symmetric))
    return [Shape(vertices, made["faces"], f"cat{k}") for k, vertices in enumerate(made["vertices"])]


@checks.checked()
def left_right_flip(n_vertices: int = 5000) -> np.ndarray:
    """The vertex opposite to each vertex (V,) on the cats of ``load_collection("cats", n_vertices=...)``.

    >>> flip = left_right_flip(1000)
    >>> bool((flip[flip] == range(1000)).all())
    True
    """
    return _rest(n_vertices)["mirror"]


def _rest(n_vertices):
    check_resolution(n_vertices)
    names = ("vertices", "faces", "mirror")
    return cached(f"cat-at-rest-{n_vertices}-{recipe(*SOURCES)}", lambda: dict(zip(names, rest_mesh(n_vertices))))


def rest_mesh(n_vertices: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangulate the cat at rest, see :func:`data_gen.mesher.mirrored_mesh`."""
    skin = cat_body().skin
    surface = half_skin(lambda grid: skin(grid.reshape(-1, 3)), _LOW, _HIGH, 0.008)
    points, triangles = refined(surface, 7 * n_vertices)
    points = onto_skin(skin, points)
    samples = points, triangles, skin_gradient(skin, points)
    vertices, faces, mirror = mirrored_mesh(skin, samples, n_vertices, _LLOYD_STEPS, np.random.default_rng(0))
    if not is_sphere(faces, n_vertices):
        raise ValueError(f"n_vertices = {n_vertices} does not give a closed cat: ask for 1000 vertices or more")
    return vertices, faces, mirror


def _build(count, n_vertices, seed, symmetric):
    rest = _rest(n_vertices)
    vertices, faces, body = rest["vertices"], rest["faces"], cat_body()
    grown = vertices if symmetric else grow_right_half(vertices, _GROWTH, [0, 0, 0.42])
    rig = Rig(grown, faces, body.bones, body.cones())
    posed = []
    for k in range(count):
        poses, tone = _candidates(k, np.random.default_rng([seed, k])), muscle_tone(k)
        posed.append(rig.first_free(((pose, tone) for pose in itertools.islice(poses, _DRAWS)), f"cat{k}"))
    return {"vertices": np.stack(posed), "faces": faces}


def grow_right_half(vertices: np.ndarray, growth: float, centre: ArrayLike) -> np.ndarray:
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
            pose, spread, share, still = {}, 3 * _JITTER, rng.uniform(0.25, 0.75), np.zeros(3)
            for joint in sorted({*first, *second}):
                a, b = (np.array(end.get(joint, still)) for end in (first, second))
                pose[joint] = (1 - share) * a + share * b
        yield {joint: tuple(ease * np.array(a) + spread * rng.standard_normal(3)) for joint, a in pose.items()}
