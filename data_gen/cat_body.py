"""The cat at rest: the trunk and head together are about one unit long."""

from functools import cache

from data_gen.body import Body, Bone, Cone

BLEND = 0.016  # length over which neighbouring cones melt into each other

_TAIL = [(-0.36 - 0.0802 * k, 0, z) for k, z in enumerate([0.47, 0.475, 0.465, 0.45, 0.44, 0.44, 0.45, 0.465])]

_BONES = [
    Bone("pelvis", None, (-0.20, 0, 0.43)),
    Bone("loin", "pelvis", (-0.14, 0, 0.44)),
    Bone("chest", "loin", (0.03, 0, 0.44)),
    Bone("neck", "chest", (0.23, 0, 0.47)),
    Bone("head", "neck", (0.35, 0, 0.565)),
    *(Bone(f"tail{k}", f"tail{k - 1}" if k else "pelvis", point) for k, point in enumerate(_TAIL[:-1])),
    Bone("left upper arm", "chest", (0.19, 0.075, 0.37)),
    Bone("left forearm", "left upper arm", (0.155, 0.085, 0.235)),
    Bone("left hand", "left forearm", (0.185, 0.085, 0.07)),
    Bone("left thigh", "pelvis", (-0.26, 0.07, 0.40)),
    Bone("left shin", "left thigh", (-0.205, 0.09, 0.235)),
    Bone("left foot", "left shin", (-0.33, 0.085, 0.135)),
    Bone("left toes", "left foot", (-0.305, 0.085, 0.03)),
    Bone("left ear", "head", (0.355, 0.058, 0.66)),
]

_CONES = [
    Cone("pelvis", (-0.27, 0, 0.415), (-0.18, 0, 0.415), 0.100, 0.104, (1, 0.88, 1)),
    Cone("loin", (-0.18, 0, 0.415), (0.02, 0, 0.405), 0.104, 0.112, (1, 0.88, 1)),
    Cone("chest", (0.02, 0, 0.405), (0.18, 0, 0.40), 0.112, 0.118, (1, 0.88, 1)),
    Cone("neck", (0.20, 0, 0.43), (0.32, 0, 0.545), 0.088, 0.072, (1, 0.95, 1)),
    Cone("head", (0.370, 0, 0.595), (0.390, 0, 0.595), 0.098, 0.096, (0.95, 1.08, 0.92)),
    Cone("head", (0.448, 0, 0.568), (0.462, 0, 0.563), 0.044, 0.036, (1, 1.25, 0.85)),  # muzzle
    *(Cone(f"tail{k}", _TAIL[k], _TAIL[k + 1], 0.040 - 0.0015 * k, 0.0385 - 0.0015 * k) for k in range(len(_TAIL) - 1)),
    Cone("left upper arm", (0.19, 0.070, 0.38), (0.155, 0.085, 0.235), 0.066, 0.043, (1.1, 0.8, 1)),
    Cone("left forearm", (0.155, 0.085, 0.235), (0.185, 0.085, 0.07), 0.043, 0.031),
    Cone("left hand", (0.185, 0.085, 0.07), (0.195, 0.085, 0.035), 0.031, 0.032),
    Cone("left hand", (0.195, 0.085, 0.032), (0.235, 0.085, 0.030), 0.034, 0.034, (1.05, 1.05, 0.9)),
    Cone("left thigh", (-0.26, 0.060, 0.40), (-0.205, 0.090, 0.235), 0.092, 0.050, (1.05, 0.72, 1)),
    Cone("left shin", (-0.205, 0.090, 0.235), (-0.33, 0.085, 0.135), 0.050, 0.032),
    Cone("left foot", (-0.33, 0.085, 0.135), (-0.310, 0.085, 0.035), 0.031, 0.031),
    Cone("left toes", (-0.305, 0.085, 0.031), (-0.260, 0.085, 0.030), 0.033, 0.034, (1.05, 1.05, 0.9)),
    Cone("left ear", (0.355, 0.058, 0.650), (0.345, 0.083, 0.752), 0.050, 0.014, (0.58, 1, 1)),
    Cone("head", (0.405, 0.045, 0.570), (0.405, 0.045, 0.570), 0.050, 0.050),  # cheek
]


@cache
def cat_body() -> Body:
    """The body. Trunk and tail are one part each: melted in a row, cones look like a string of beads."""
    trunk, head, tail, left = _CONES[:3], _CONES[3:6], _CONES[6:13], _CONES[13:]
    body = Body(BLEND, _BONES.copy(), [trunk, *([cone] for cone in head), tail, *([cone] for cone in left)])
    body.mirror()
    return body
