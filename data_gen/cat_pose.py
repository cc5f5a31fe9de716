"""The cat and its poses: joint angles bend the skeleton, the skin follows rigidly, muscles swell and slacken.

The joint angles of a pose are a mapping ``joint name -> (roll, pitch, yaw)`` in degrees about the x, y and z axes of
the resting cat, applied at the joint and inherited by everything beyond it. Positive pitch turns the nose down and a
hanging leg backwards; positive yaw turns the nose to the cat's left. A name without a side ("thigh") moves both legs
as mirror images. Its muscle tone is one number a bone: how much thicker than at rest the flesh around it is.
"""

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import splu

from data_gen.body import Body, Bone, Cone, Pose, cone_distance
from data_gen.mesher import self_intersections
from fmsync.shape import triangle_areas, vertex_areas, vertex_normals

_SMOOTHING = 0.022  # length over which skinning weights blend at a joint
_ARAP_STEPS = 12
_TONE = 0.142  # thickness of tense and slack flesh differs this much from rest
_ANCHOR = 0.02  # pull of the skinned position on vertices that belong to one bone alone
_LIMBS = {"fore": ("upper arm", "forearm", "hand"), "hind": ("thigh", "shin", "foot", "toes")}


def _read(name: str) -> dict:
    return tomllib.loads(Path(__file__).with_name(name).read_text(encoding="utf-8"))


@cache
def cat_body() -> Body:
    """Both sides of the cat at rest, see ``cat_body.toml``; trunk and head together are about one unit long."""
    told = _read("cat_body.toml")
    bones = [Bone(name, parent or None, tuple(joint)) for name, parent, joint in told["bones"]]
    body = Body(told["blend"], bones, [[Cone(*cone) for cone in part] for part in told["parts"]])
    body.mirror()
    return body


def _angles(told: Mapping[str, list[float]]) -> Pose:
    """Angles of every joint of a pose as ``cat_poses.toml`` tells it."""
    pose: dict[str, tuple[float, float, float]] = {}
    for part, values in told.items():
        limb = part.split()[-1]
        if part == "tail":
            pitch, yaw, curl = values
            pose |= {f"tail{k}": (0, pitch + curl * (k - 3), yaw) for k in range(7)}
        elif part == "spine":
            pelvis, loin, chest, yaw = values
            pose |= {"pelvis": (0, pelvis, 0), "loin": (0, loin, yaw), "chest": (0, chest, yaw)}
        elif limb in _LIMBS:
            joints = [part.replace(limb, joint) for joint in _LIMBS[limb]]
            *directions, roll = values
            pitches = np.diff(directions)
            pose |= {joint: (0 if k else roll, pitches[k], 0) for k, joint in enumerate(joints[: len(pitches)])}
        else:
            pose[part] = tuple(values)
    return pose


POSES = {name: _angles(told) for name, told in _read("cat_poses.toml").items()}


def muscle_tone(k: int) -> np.ndarray:
    """Tone (B,) of the k-th cat: flesh is tense or slack, on the tail as one and on the ears never; for every seed."""
    names = [bone.name for bone in cat_body().bones]
    fleshy = [name for name in names if not name.endswith("ear")]
    signs = dict(zip(fleshy, np.random.default_rng([1, k]).choice([1.0, -1.0], len(fleshy))))
    signs |= {name: signs["tail0"] for name in fleshy if name.startswith("tail")}
    return _TONE * np.array([signs.get(name, 0.0) for name in names])


def joint_transforms(pose: Pose, skeleton: Sequence[Bone]) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (B, 3, 3) and translations (B, 3) that carry every bone into the pose."""
    names, angles = [bone.name for bone in skeleton], {}
    for name, (roll, pitch, yaw) in pose.items():
        if name in names:
            angles[name] = (roll, pitch, yaw)
        elif f"left {name}" in names:
            angles[f"left {name}"], angles[f"right {name}"] = (roll, pitch, yaw), (-roll, pitch, -yaw)
        else:
            raise ValueError(f"pose: no joint {name!r}; the joints are {', '.join(names)}")
    rotations, translations = np.empty((len(names), 3, 3)), np.empty((len(names), 3))
    for k, bone in enumerate(skeleton):
        joint = np.array(bone.joint)
        local = _rotation(*angles.get(bone.name, (0, 0, 0)))
        turn, shift = np.eye(3), np.zeros(3)  # of the parent
        if bone.parent is not None:
            turn, shift = (of_bone[names.index(bone.parent)] for of_bone in (rotations, translations))
        rotations[k], translations[k] = turn @ local, turn @ (joint - local @ joint) + shift
    return rotations, translations


def _rotation(roll, pitch, yaw):
    x, y, z = np.deg2rad([roll, pitch, yaw])
    about_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    about_z = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


class Rig:
    """A resting mesh ready to be posed: skinning weights and a factorised as-rigid-as-possible system.

    The skin is first carried by blended bone transforms, then relaxed by as-rigid-as-possible iterations (Sorkine and
    Alexa 2007) in which vertices that clearly belong to one bone are pulled towards their place: joints bend without
    collapsing and edges keep their lengths.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, skeleton: Sequence[Bone], flesh: Sequence[Cone]):
        self.vertices, self.faces, self._skeleton = vertices, faces, skeleton
        stiffness, areas = _cotangents(vertices, faces)
        self._normals = vertex_normals(vertices, faces)
        names = [bone.name for bone in self._skeleton]
        self.weights = _skinning_weights(vertices, stiffness, areas, names, flesh)  # (V, B)
        # mean radius of the cones on each bone
        self._radii = np.array([np.mean([cone.radius_start for cone in flesh if cone.bone == name]) for name in names])
        off = stiffness.tocoo()
        keep = off.row != off.col
        self._from, self._to = off.row[keep], off.col[keep]  # every edge in both directions
        self._stiffness = -off.data[keep]
        n_ends = len(self._from)
        links = np.ones(n_ends), (self._from, np.arange(n_ends))
        self._gather = coo_array(links, shape=(len(vertices), n_ends)).tocsr()
        certainty = np.clip((self.weights.max(axis=1) - 0.6) / 0.4, 0, 1) ** 2
        self._anchor = _ANCHOR * certainty * stiffness.diagonal()
        self._solve = _factorised(stiffness + diags_array(self._anchor)).solve

    def pose(self, pose: Pose, tone: np.ndarray) -> np.ndarray:
        """Vertices (V, 3) for joint angles and a muscle tone (B,)."""
        rotations, translations = joint_transforms(pose, self._skeleton)
        rest = self.vertices + (self.weights @ (tone * self._radii))[:, None] * self._normals
        carried = np.einsum("bij,vj->vbi", rotations, rest) + translations
        skinned = np.einsum("vb,vbi->vi", self.weights, carried)
        posed, edges = skinned, rest[self._to] - rest[self._from]
        for _ in range(_ARAP_STEPS):
            now = posed[self._to] - posed[self._from]
            outer = (self._stiffness[:, None] * now)[:, :, None] * edges[:, None, :]
            u, _, vt = np.linalg.svd((self._gather @ outer.reshape(-1, 9)).reshape(-1, 3, 3))
            u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
            turns = u @ vt  # those that best carry the resting edges around each vertex to the posed ones
            both = 0.5 * (turns[self._from] + turns[self._to])
            pull = self._stiffness[:, None] * np.einsum("eij,ej->ei", both, -edges)
            posed = self._solve(self._gather @ pull + self._anchor[:, None] * skinned)
        return posed

    def first_free(self, poses: Iterable[tuple[Pose, np.ndarray]], name: str) -> np.ndarray:
        """Vertices (V, 3) in the first of some poses and tones that does not pass through itself, else a ValueError."""
        for pose, tone in poses:
            vertices = self.pose(pose, tone)
            if len(self_intersections(vertices, self.faces)) == 0:
                return vertices
        raise ValueError(f"{name}: all draws of its pose pass through themselves; try another seed")


def _factorised(matrix):
    """Sparse factors of a symmetric positive definite matrix: without pivoting they fill in far less."""
    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def _cotangents(vertices, faces):
    """Stiffness matrix with non-negative weights (V, V), and vertex areas (V,)."""
    corners, i, j = vertices[faces], [1, 2, 0], [2, 0, 1]
    cosines = ((corners[:, i] - corners) * (corners[:, j] - corners)).sum(axis=2)  # (F, 3)
    values = 0.25 * cosines.T / triangle_areas(vertices, faces)
    half = coo_array((values.ravel(), (faces.T[i].ravel(), faces.T[j].ravel())), shape=(len(vertices),) * 2)
    weights = (half + half.T).tocsr()
    weights.data = np.maximum(weights.data, 1e-3)  # obtuse pairs would make the energy indefinite
    return (diags_array(weights.sum(axis=1)) - weights).tocsc(), vertex_areas(vertices, faces)


def _skinning_weights(vertices, stiffness, areas, names, flesh):
    """Each vertex starts with the bone of its nearest cone; two heat steps along the surface blend them (V, B)."""
    nearest = np.argmin([cone_distance(vertices, cone) for cone in flesh], axis=0)
    owner = np.array([names.index(cone.bone) for cone in flesh])[nearest]
    weights = np.eye(len(names))[owner]
    heat = _factorised(diags_array(areas) + _SMOOTHING**2 * stiffness)
    for _ in range(2):
        weights = heat.solve(areas[:, None] * weights)
    return weights
