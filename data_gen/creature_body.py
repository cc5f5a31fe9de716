"""Creatures at rest: a seed draws a body plan, its bones, the flesh around them and how far each joint turns.

Every plan is a trunk with up to three pairs of limbs, a neck or two with a head each, and perhaps a tail, ears or fins.
"""

import numpy as np

from data_gen.body import THIN, Body, Bone


def towards(pitch: float, out: float = 0.0) -> np.ndarray:
    """Unit vector that rises ``pitch`` degrees from forward, then turns ``out`` degrees to the left."""
    pitch, out = np.deg2rad(pitch), np.deg2rad(out)
    return np.array([np.cos(pitch) * np.cos(out), np.sin(out) + 0 * pitch, np.sin(pitch) * np.cos(out)])


def draw_body(rng: np.random.Generator) -> Body:
    """A random body plan."""
    plan = rng.choice(["quadruped", "sprawling", "upright", "biped", "hexapod", "swimmer"], p=_SHARES)
    body = Body(blend=rng.uniform(0.014, 0.028))
    rise = {"upright": (68, 88), "biped": (10, 45), "swimmer": (-4, 6)}.get(plan, (-6, 14))
    trunk = _trunk(body, rng, rng.uniform(*rise), rng.uniform(*((0.34, 0.46) if plan == "upright" else (0.38, 0.62))))
    _limbs(body, rng, plan, trunk)
    _necks(body, rng, plan, trunk)
    _tail(body, rng, plan, trunk)
    body.mirror()
    return body


_SHARES = [0.28, 0.14, 0.18, 0.16, 0.12, 0.12]


def _trunk(body, rng, rise, length):
    """Three bones from the hips to the chest: ends (4, 3), radii (4,) and the direction in degrees."""
    arch = rng.uniform(-12, 12)
    girth = length * rng.uniform(0.18, 0.33)
    radii = girth * rng.uniform([0.8, 0.8, 0.9, 0.8], [1.0, 1.15, 1.2, 1.0])
    directions = [towards(rise + arch), towards(rise), towards(rise - arch)]
    turns = [[0, 0, 0, 0], [8, 14, 13, 0], [8, 14, 13, 0]]
    flat = (1.0, rng.uniform(0.82, 1.12), 1.0)
    points = body.chain("trunk", None, np.zeros(3), directions, [length / 3] * 3, radii, turns, flat)
    if rng.random() < 0.22:  # a hump, or a sail along the back
        up, high = towards(rise + 90), rng.uniform(0.9, 1.35) * girth
        ridge = points[1:3] + up * high * 0.75
        wide = rng.choice([0.5, 0.9])
        body.bones.append(Bone("ridge0", "trunk1", tuple(points[1])))
        body.turns["ridge0"] = np.zeros((2, 3))
        body.flesh(["ridge0"], ridge, np.maximum([0.55 * girth] * 2, THIN / wide), (1.0, wide, 1.0))
    return points, radii * flat[1], rise


def _limbs(body, rng, plan, trunk):
    points, radii, _ = trunk
    length = rng.uniform(0.3, 0.62) * (0.75 if plan == "sprawling" else 1)
    thick = rng.uniform(0.34, 0.6)
    knee = rng.choice([-1, 1]) * rng.uniform(8, 30)
    if plan == "swimmer":
        for k in (2, 0)[: rng.integers(1, 3)]:
            at = points[k] * 0.6 + points[k + 1] * 0.4
            _fin(body, rng, f"left fin{k} ", f"trunk{k}", at, radii[k], 1 + 0.3 * (k - 2))
        return
    places = {"upright": [0], "biped": [0], "hexapod": [0, 1, 2]}.get(plan, [0, 2])
    splay = {"sprawling": (35, 65), "hexapod": (15, 60), "upright": (3, 12)}.get(plan, (0, 10))
    splay = rng.uniform(*splay)
    for k in places:
        hind = k == 0
        at = points[0] * 0.8 + points[1] * 0.2 if hind else points[k + 1] if k == 2 else points[1:3].mean(axis=0)
        _leg(body, rng, f"left leg{k} ", f"trunk{k}", at, radii[k], length * (1 + 0.1 * hind), thick, knee, splay)
        knee = -knee if rng.random() < 0.5 else knee
    if plan == "upright" or (plan == "biped" and rng.random() < 0.6):
        _arm(body, rng, points[3], radii[3], length * rng.uniform(0.6, 1.1) * (1 if plan == "upright" else 0.6), thick)


def _leg(body, rng, name, parent, at, girth, length, thick, knee, splay):
    """Thigh, shin and a foot that points forward."""
    top = max(thick * girth, 1.25 * THIN)
    start = at + np.array([0, max(0.62 * girth, top + 0.016), -0.25 * girth])
    foot = rng.uniform(0.14, 0.26) * length
    directions = [towards(-90 + knee, splay), towards(-90 - knee, 0.15 * splay), towards(-8, 0.3 * splay)]
    radii = top * np.array([1.25, 0.85, rng.uniform(0.55, 0.8), rng.uniform(0.6, 0.85)])
    turns = [[8, 30, 7, 0], [2, 24, 2, np.sign(knee) * 12], [2, 18, 4, 0]]
    body.chain(name, parent, start, directions, [0.5 * length, 0.5 * length, foot], radii, turns)


def _fin(body, rng, name, parent, at, girth, size):
    """A broad blade of two bones, held out to the side and back."""
    back, out, size = rng.uniform(165, 195), rng.uniform(50, 80), size * rng.uniform(0.28, 0.5)
    start = at + np.array([0, 0.6 * girth, -0.3 * girth])
    radii = np.array([0.07, 0.1, 0.05]) * rng.uniform(0.8, 1.1)
    turns = [[34, 18, 34, 0], [24, 14, 24, 0]]
    directions = [towards(back, out), towards(back, out - 15)]
    body.chain(name, parent, start, directions, [0.55 * size, 0.45 * size], radii, turns, (1.2, 1.0, 0.5))


def _arm(body, rng, at, girth, length, thick):
    """Upper arm, forearm and a hand, hanging away from the trunk."""
    top = max(0.8 * thick * girth, 1.15 * THIN)
    start = at + np.array([0, max(0.75 * girth, top), -0.1 * girth])
    out = rng.uniform(25, 60)
    directions = [towards(-95, out), towards(-75, out - 10), towards(-70, out - 15)]
    radii = top * np.array([1.1, 0.8, rng.uniform(0.6, 0.8), rng.uniform(0.75, 1.1)])
    turns = [[28, 34, 20, 0], [14, 30, 14, -20], [8, 16, 12, 0]]
    body.chain("left arm", "trunk2", start, directions, [0.45 * length, 0.4 * length, 0.15 * length], radii, turns)


def _necks(body, rng, plan, trunk):
    points, radii, rise = trunk
    twins = rng.random() < 0.08
    steep = rng.uniform(80, 95) if plan == "upright" else rise + rng.uniform(0, 20 if plan == "swimmer" else 70)
    length = rng.uniform(0.07, 0.12) if plan in ("upright", "swimmer") else rng.uniform(0.08, 0.4)
    n_bones = 1 if length < 0.17 else 2 if length < 0.28 else 3
    skull = rng.uniform(0.07, 0.105)
    out = rng.uniform(25, 38) if twins else 0.0
    start = points[3] + (np.array([0, 0.55 * radii[3], 0]) if twins else 0)
    name = "left neck" if twins else "neck"
    directions = [towards(steep * (1 - 0.1 * k), out) for k in range(n_bones)]
    thick = np.linspace(rng.uniform(0.5, 0.8) * radii[3], 0.6 * skull, n_bones + 1)
    turns = np.array([14, 24, 22, 0]) / n_bones**0.6
    ends = body.chain(name, "trunk2", start, directions, [length / n_bones] * n_bones, thick, turns)
    _head(body, rng, name.replace("neck", "head"), f"{name}{n_bones - 1}", ends[-1], skull, twins)


def _head(body, rng, name, parent, at, skull, twins):
    """Skull, muzzle and, on one head, ears or horns."""
    centre = at + skull * np.array([0.45, 0, 0.5])
    body.bones.append(Bone(f"{name}0", parent, tuple(at)))
    body.turns[f"{name}0"] = np.array([[-9, -16, -18], [9, 16, 18]])
    wide = (1.0, rng.uniform(0.85, 1.1), rng.uniform(0.85, 1.0))
    body.flesh([f"{name}0"], np.stack([centre, centre + np.array([0.1 * skull, 0, 0])]), [skull, 0.95 * skull], wide)
    face = centre + skull * np.array([0.3, 0, -0.2])
    tip = face + rng.uniform(0.9, 2.2) * skull * towards(rng.uniform(-35, -5))
    body.flesh([f"{name}0"], np.stack([face, tip]), [0.62 * skull, max(skull * rng.uniform(0.35, 0.55), THIN)])
    kind = rng.choice(["none", "ears", "horns"], p=[0.25, 0.45, 0.3])
    if twins or kind == "none":
        return
    root = centre + skull * np.array([-0.15, 0.5, 0.7])
    if kind == "ears":
        tip = root + rng.uniform(0.6, 2.0) * skull * towards(rng.uniform(70, 115), rng.uniform(15, 50))
        body.flesh([f"{name}0"], np.stack([root, tip]), [0.046, THIN], (0.75, 1.0, 1.0))
    else:
        middle = root + rng.uniform(0.6, 1.1) * skull * towards(95, rng.uniform(20, 45))
        tip = middle + rng.uniform(0.6, 1.3) * skull * towards(rng.uniform(50, 130), rng.uniform(-10, 15))
        body.flesh([f"{name}0"] * 2, np.stack([root, middle, tip]), [0.036, 0.031, 0.026])


def _tail(body, rng, plan, trunk):
    """None, a stump or a long one; that of a swimmer is thick."""
    points, radii, rise = trunk
    if rng.random() < {"upright": 0.8, "quadruped": 0.2, "hexapod": 0.2}.get(plan, 0.0):
        return
    heavy = plan in ("biped", "swimmer", "sprawling")
    length = rng.uniform(0.35, 0.7) if heavy else rng.uniform(0.12, 0.65)
    thick = radii[0] * (rng.uniform(0.6, 0.85) if heavy else rng.uniform(0.3, 0.45))
    n_bones = 3 + int(length / 0.15)
    start = points[0] + towards(rise) * (-0.5 * radii[0])
    pitch, curl = (180 if plan == "upright" else 180 + 0.5 * rise) + rng.uniform(-15, 30), rng.uniform(-40, 20)
    directions = [towards(pitch + curl * k / n_bones) for k in range(n_bones)]
    radii = np.linspace(thick, thick * rng.uniform(0.2, 0.7), n_bones + 1)
    turns = np.array([0, 50, 60, 0]) / n_bones
    body.chain("tail", "trunk0", start, directions, [length / n_bones] * n_bones, radii, turns)
