"""Random species: near-isometric poses of an articulated body that a seed draws, on one triangulation or on many."""

import re
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array, eye_array, vstack
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from data_gen import mesher
from data_gen.body import Bone, Cone
from data_gen.cache import cached, recipe
from data_gen.cat_pose import Rig
from data_gen.cats import SOURCES, grow_right_half
from data_gen.creature_body import draw_body
from data_gen.mesher import half_skin, is_sphere, self_intersections
from fmsync import checks
from fmsync.shape import Shape, edges_of_faces, vertex_areas, vertex_normals

_STEP = 0.014  # of the grid on which a body is contoured
_CLEARANCE = 0.012  # thickening by which no limbs grow together
_LLOYD_STEPS = 10
_EASE = 0.9  # share of the joint angles that is kept from one try to the next
_DRAWS = 40  # tries to find a body, a mesh or a pose
_ARRAYS = ("vertices", "faces", "common", "opposite", "located", "part")
_TONE = 0.12  # thickness of tense and slack flesh differs this much from rest


@dataclass(frozen=True, eq=False)
class Creature(Shape):
    """A shape that knows where its vertices lie on the body that its whole species shares.

    ``common`` (V,) is the point of the body, of K, at each vertex; ``opposite`` (V,) the point on the other side of it;
    ``located`` (K,) the vertex nearest to each point of the body. The true map from ``a`` to ``b`` is
    ``b.located[a.common]``, and that of left and right ``b.located[a.opposite]``. ``part`` (V,) is ``"limb"``,
    ``"tail"`` or ``"trunk"``, with neck and head, by the bone that moves the vertex most.
    """

    common: np.ndarray = None
    opposite: np.ndarray = None
    located: np.ndarray = None
    part: np.ndarray = None


@checks.checked(species=">= 0", seed=">= 0")
def creatures(
    species: int,
    count: int = 11,
    n_vertices: int = 5000,
    seed: int = 0,
    symmetric: bool = False,
    remeshed: bool = False,
) -> list[Creature]:
    """Poses of a random species, the same for the same arguments, bit by bit.

    Closed surfaces of genus zero, named ``creature0``, ``creature1``, ...; trunks are about half a unit long. The seed
    ``species`` draws the body plan: two to six limbs, girths, neck, head, tail, ears, horns, fins; ``seed`` draws the
    poses, of which number k depends neither on ``count`` nor on ``remeshed``. Each has ``n_vertices``, 1000 to 30000,
    and vertex v of one corresponds to vertex v of another, unless they are ``remeshed``: then each has a triangulation
    of its own with 0.8 to 1.2 times as many vertices in random order. The right half is larger by 2 to 6 %, and in
    every third species one limb of it by 15 to 35 %, unless ``symmetric``.

    >>> first, second = creatures(species=3, count=2, n_vertices=1000)
    >>> first.name, first.vertices.shape, (first.faces == second.faces).all()
    ('creature0', (1000, 3), np.True_)
    """
    mesher.check_resolution(n_vertices)
    kind = f"{'symmetric' if symmetric else 'asymmetric'}{'-remeshed' * remeshed}"
    made_by = recipe(*SOURCES, "creature_body.py", "creatures.py")
    key = f"creatures-{species}-{count}-{n_vertices}-{seed}-{kind}-{made_by}"
    made = cached(key, lambda: _build(species, count, n_vertices, seed, symmetric, remeshed))
    return [Creature(name=f"creature{k}", **{field: made[f"{field}{k}"] for field in _ARRAYS}) for k in range(count)]


def _build(species, count, n_vertices, seed, symmetric, remeshed):
    body, vertices, faces, mirror = _at_rest(species, n_vertices)
    resting = vertices, body.bones, body.cones()
    if not symmetric:
        resting = _lopsided(vertices, faces, body, np.random.default_rng([species, _DRAWS]))
    rig = Rig(resting[0], faces, *resting[1:])
    levels = _subdivisions(faces, mirror)
    own = np.arange(n_vertices)
    corners = eye_array(n_vertices, format="csr")
    for edges, _, _ in levels:
        corners = vstack([corners, corners[edges[:, 0]] + corners[edges[:, 1]]], format="csr")
    located = np.asarray(corners.argmax(axis=1), dtype=np.int64).ravel()  # the nearest vertex, of equals the first
    arrays, stems = {}, [bone.name.rstrip("0123456789") for bone in body.bones]
    kinds = ["tail" if s == "tail" else "limb" if re.search("leg|arm|fin", s) else "trunk" for s in stems]
    part = np.array(kinds)[rig.weights.argmax(axis=1)]
    for k in range(count):
        rng = np.random.default_rng([seed, species, k])
        signs = {stem: rng.choice([-1.0, 1.0]) for stem in sorted(set(stems))}
        tone = _TONE * np.array([0.0 if "head" in stem else signs[stem] for stem in stems])  # ears would fold
        eases = (_EASE**attempt for attempt in range(_DRAWS))  # each draw a little less than the one before
        draws = ((body.pose(rng, ease), ease * tone) for ease in eases)
        fields = rig.first_free(draws, f"species {species}, creature{k}"), faces, own, mirror, located, part
        if remeshed:
            fields = _remeshed(*fields[:2], levels, n_vertices, rng)
            fields = *fields, part[located[fields[2]]]
        arrays |= {f"{name}{k}": a for name, a in zip(_ARRAYS, fields)}
    return arrays


def _at_rest(species, n_vertices):
    """Body, vertices, faces and mirror of the first plan whose limbs keep clear of each other."""
    for attempt in range(_DRAWS):
        body = draw_body(np.random.default_rng([species, attempt]))
        if _is_disc(half_skin(body.rough_skin, *body.box(), 2 * _STEP, _CLEARANCE)):
            half = half_skin(body.rough_skin, *body.box(), _STEP)
            if _is_disc(half):
                break
    else:
        raise ValueError(f"species = {species}: none of {_DRAWS} body plans is a sphere; try another seed")
    for attempt in range(_DRAWS):
        points, triangles = mesher.refined(half, 4 * (1 + attempt // 4) * n_vertices)
        normals = vertex_normals(points, triangles)
        normals[points[:, 1] == 0, 1] = 0
        rng = np.random.default_rng([species, attempt])
        samples = points, triangles, normals
        vertices, faces, mirror = mesher.mirrored_mesh(body.skin, samples, n_vertices, _LLOYD_STEPS, rng)
        if is_sphere(faces, n_vertices) and not _has_folds(vertices, faces):
            return body, vertices, faces, mirror
    raise ValueError(f"species = {species}: no closed mesh of {n_vertices} vertices; ask for more")


def _is_disc(surface):
    """Whether the left half of a body is one piece without holes between its limbs."""
    n = surface.n_points
    codes = np.unique(edges_of_faces(surface.regular_faces) @ [n, 1])
    links = coo_array((np.ones(len(codes)), np.divmod(codes, n)), shape=(n, n))
    return n - len(codes) + surface.n_cells == 1 and connected_components(links)[0] == 1


def _has_folds(vertices, faces):
    """Whether a face looks away from the normal at a corner: a little motion makes it cut its neighbours."""
    a, b, c = vertices[faces].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    return bool((vertex_normals(vertices, faces)[faces] @ normals[:, :, None] < 0).any())


def _lopsided(vertices, faces, body, rng):
    """Vertices, bones and cones of a body whose right half is larger, growing smoothly from the mirror plane on."""
    bones, cones = body.bones, body.cones()
    growth = rng.uniform(0.02, 0.06)
    if rng.random() < 1 / 3:
        roots = [bone for bone in bones if bone.name.startswith("right ") and bone.parent.startswith("trunk")]
        root, excess = roots[rng.integers(len(roots))], rng.uniform(0.15, 0.35)
        joint, stem = np.array(root.joint), root.name.rstrip("0")
        limb = np.array([bone.name.startswith(stem) for bone in bones])
        share = Rig(vertices, faces, bones, cones).weights[:, limb].sum(axis=1, keepdims=True)
        vertices = vertices + excess * share * (vertices - joint)

        def grown(part: Bone | Cone, *ends: str) -> Bone | Cone:
            places = {end: np.array(getattr(part, end)) for end in ends}
            return replace(part, **{end: tuple(at + excess * (at - joint)) for end, at in places.items()})

        bones = [grown(bone, "joint") if bone.name.startswith(stem) else bone for bone in bones]
        cones = [grown(cone, "start", "end") if cone.bone.startswith(stem) else cone for cone in cones]
    return grow_right_half(vertices, growth, np.zeros(3)), bones, cones


def _subdivisions(faces, mirror):
    """Two levels of halved edges: for each its edges (E, 2), faces (4 F, 3) and mirror (V + E,)."""
    levels = []
    for _ in range(2):
        n = len(mirror)
        codes, index = np.unique(edges_of_faces(faces) @ [n, 1], return_inverse=True)
        edges = np.stack(np.divmod(codes, n), axis=1)
        a, b, c = faces.T
        z, x, y = n + index.reshape(-1, 3).T  # midpoints opposite to c, a and b
        faces = np.vstack([np.stack(t, axis=1) for t in ((a, z, y), (b, x, z), (c, y, x), (x, y, z))])
        mirror = np.r_[mirror, n + np.searchsorted(codes, np.sort(mirror[edges], axis=1) @ [n, 1])]
        levels.append((edges, faces, mirror))
    return levels


def _remeshed(vertices, faces, levels, n_vertices, rng):
    """A posed body triangulated anew, with vertices among the points of its finer mesh: the fields of a creature."""
    for edges, finer, _ in levels:
        a, b = vertices[edges].swapaxes(0, 1)
        normals = vertex_normals(vertices, faces)[edges]
        lift = ((a - b)[:, None] * normals).sum(axis=2, keepdims=True) * normals
        midpoints = (a + b) / 2 + (lift[:, 0] - lift[:, 1]) / 8  # of curved PN triangles
        vertices, faces = np.vstack([vertices, midpoints]), finer
    areas, normals = vertex_areas(vertices, faces), vertex_normals(vertices, faces)
    none = np.zeros(len(vertices), dtype=bool)
    for _ in range(_DRAWS):
        n = round(n_vertices * rng.uniform(0.8, 1.2))
        edge = np.sqrt(areas.sum() / n * 2 / np.sqrt(3))
        features = mesher.with_normals(vertices, normals, edge)
        labels, sites = mesher.voronoi(features, areas, none, (0, n), _LLOYD_STEPS, rng)
        away = np.lexsort((np.linalg.norm(vertices - sites[labels], axis=1), labels))
        common = rng.permutation(away[np.unique(labels[away], return_index=True)[1]])  # in each cell the point nearest
        located = cKDTree(features[common]).query(features)[1]
        own = vertices[common]
        triangles = rng.permutation(mesher.dual_triangles(located[faces]))
        if is_sphere(triangles, n) and len(self_intersections(own, triangles)) == 0:
            return own, triangles, common, levels[-1][2][common], located
    raise ValueError(f"no closed mesh of {n_vertices} vertices for a pose; ask for more")
