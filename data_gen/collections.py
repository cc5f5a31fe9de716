"""Collections of shapes: the synthetic cats, a random species, or any folder of meshes."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from data_gen.cats import cats
from data_gen.creatures import creatures
from fmsync import checks
from fmsync.mesh_io import mesh_files, read_shape
from fmsync.shape import Shape

_TO_THE_READER = np.array([0.74, -0.61, 0.28])  # the direction from which the pictures of the book look at shapes


@checks.checked(seed=">= 0", species=">= 0")
def load_collection(
    source: str | Path | Sequence[str | Path] | None = None,
    *,
    count: int = 11,
    n_vertices: int = 5000,
    seed: int = 0,
    symmetric: bool = False,
    species: int = 0,
    remeshed: bool = False,
) -> list[Shape]:
    """Shapes of a collection, in natural order of their names (``cat2`` before ``cat10``).

    The ``source`` is ``"cats"`` for the synthetic cats, ``"creatures"`` for a random species, which knows its true
    correspondences; a folder of meshes; the name of a folder inside the one that the environment variable
    ``FMSYNC_DATA`` names, such as ``"tosca_cat"``; or a list of files, whose order is kept. Left out, the TOSCA cats
    where ``FMSYNC_DATA`` has them, the synthetic cats otherwise. A ValueError where there is no such collection, or one
    of its files cannot be read.

    ``count``, ``n_vertices``, ``seed`` and ``symmetric`` are of the synthetic cats and creatures, see
    ``data_gen.cats.cats``; ``species`` and ``remeshed`` of the creatures alone, see
    ``data_gen.creatures.creatures``.

    >>> [shape.name for shape in load_collection("cats", count=3, n_vertices=1000)]
    ['cat0', 'cat1', 'cat2']
    """
    if source is None:
        source = "tosca_cat" if _data_folder("tosca_cat") else "cats"
    of_creatures = {"species": (species, 0), "remeshed": (remeshed, False)}
    sizes = {"count": (count, 11), "n_vertices": (n_vertices, 5000), "seed": (seed, 0), "symmetric": (symmetric, False)}
    chosen = {name: value for name, (value, _) in sizes.items()}
    if source == "creatures":
        return [*creatures(species, remeshed=remeshed, **chosen)]
    if source == "cats":
        checks.unused("for cats", **of_creatures)
        return cats(**chosen)
    checks.unused("for files", **sizes, **of_creatures)
    return [read_shape(file) for file in collection_files(source)]


def collection_files(source: str | Path | Sequence[str | Path]) -> list[Path]:
    """The mesh files of a folder, a named collection or a list, in the order in which they are loaded."""
    if not isinstance(source, str | Path):
        return [Path(file) for file in source]
    folder = Path(source) if Path(source).is_dir() else _data_folder(str(source))
    if folder is None:
        where = os.environ.get("FMSYNC_DATA")
        looked = f"nor a folder of that name in FMSYNC_DATA={where}" if where else "and FMSYNC_DATA is not set"
        raise ValueError(f"{source}: neither 'cats' nor 'creatures' nor a folder, {looked}")
    return mesh_files([folder])


def require_common_order(shapes: Sequence[Shape]) -> None:
    """Refuse shapes that cannot share one vertex order (ValueError that names them)."""
    expected = shapes[0].n_vertices
    different = [f"{shape.name} ({shape.n_vertices})" for shape in shapes if shape.n_vertices != expected]
    if different:
        told = f"{shapes[0].name} has {expected}, not so {', '.join(different)}; give correspondence files instead"
        raise ValueError(f"a common vertex order needs equal vertex counts: {told}")


@checks.checked()
def load_correspondences(folder: str | Path, shapes: Sequence[Shape]) -> list[np.ndarray]:
    """Vertices (K,) of each shape at the points of a common template, from the files ``<name>.vts`` or ``<name>.txt``.

    Line k holds the vertex at point k, counted from one in ``.vts`` (as in the remeshed benchmarks of Ren et al. 2018),
    from zero in ``.txt``. A file that is missing, no list of vertices of its shape, or longer than others is a
    ValueError.
    """
    found = [_read_correspondence(Path(folder), shape) for shape in shapes]
    for shape, points in zip(shapes, found):
        if len(points) != len(found[0]):
            raise ValueError(f"{shape.name}: {len(points)} template points, {shapes[0].name} has {len(found[0])}")
    return found


@checks.checked()
def front_paw(shape: Shape) -> int:
    """The vertex in the middle of a front paw, on a cat that stands on its feet as the first of each collection does.

    Of the four paws it is the one nearest to the reader in the pictures of the book.

    >>> cat = load_collection("cats", count=1, n_vertices=1000)[0]
    >>> bool(cat.vertices[front_paw(cat), 2] < 0.1)  # of a cat 0.8 high
    True
    """
    vertices = shape.normalised().vertices
    feet = vertices[vertices[:, 2] < vertices[:, 2].min() + 0.06]
    nearest = feet[np.argmax(feet @ _TO_THE_READER)]
    paw = feet[np.linalg.norm(feet - nearest, axis=1) < 0.12].mean(axis=0)
    return int(np.linalg.norm(vertices - paw - 0.06 * _TO_THE_READER - [0, 0, 0.02], axis=1).argmin())


@checks.checked(correspondences="K < V", edges="E 2 < N")
def correspondence_maps(
    shapes: Sequence[Shape], correspondences: Sequence[np.ndarray], edges: np.ndarray
) -> dict[tuple[int, int], np.ndarray]:
    """Point maps (V_i,) of ``edges`` (E, 2) by (i, j), for ``ground_truth(..., point_maps=...)``.

    N shapes of any vertex counts know the vertices (K,) of a common template (:func:`load_correspondences`). A vertex
    of shape i goes where its nearest template point, in a straight line, lies on shape j: it should be dense.

    >>> shape = load_collection("cats", count=1, n_vertices=1000)[0]
    >>> maps = correspondence_maps([shape, shape], [np.arange(1000)] * 2, [[0, 1]])
    >>> bool((maps[0, 1] == np.arange(1000)).all())
    True
    """
    checks.indices("edges", np.ravel(edges), len(shapes), "shapes")
    edges = [(int(i), int(j)) for i, j in np.asarray(edges)]
    nearest = {}  # template point for every vertex of a shape
    for i in {i for i, _ in edges}:
        nearest[i] = cKDTree(shapes[i].vertices[correspondences[i]]).query(shapes[i].vertices)[1]
    return {(i, j): correspondences[j][nearest[i]] for i, j in edges}


def _read_correspondence(folder, shape):
    path, base = folder / f"{shape.name}.vts", 1
    if not path.is_file():
        path, base = folder / f"{shape.name}.txt", 0
    if not path.is_file():
        raise ValueError(f"{folder}: there is neither {shape.name}.vts nor {shape.name}.txt")
    try:
        points = np.array(path.read_text().split(), dtype=np.int64) - base
    except ValueError:
        raise ValueError(f"{path}: every line must hold one vertex number") from None
    if len(points) == 0:
        raise ValueError(f"{path}: the file is empty")
    outside = (points < 0) | (points >= shape.n_vertices)
    if outside.any():
        k = int(np.argmax(outside))
        raise ValueError(f"{path}: line {k + 1} names vertex {points[k] + base}; {shape.name} has {shape.n_vertices}")
    return points


def _data_folder(name: str) -> Path | None:
    root = os.environ.get("FMSYNC_DATA")
    if not root:
        return None
    if not Path(root).is_dir():
        raise ValueError(f"FMSYNC_DATA={root}: there is no such folder; unset it to use the generated cats")
    folder = Path(root) / name
    return folder if folder.is_dir() else None
