"""Labels, functions and landmarks of one shape carried to all others, with how sure that is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from fmsync import checks
from fmsync.functional_maps import nearest_rows
from fmsync.matching.confidence import draw_images, samples_to_vertices
from fmsync.matching.conformal import ConformalCalibration, default_calibration
from fmsync.matching.synchronize import SyncedShapes

_DRAWS = 100


@dataclass(frozen=True, eq=False)
class Transferred:
    """A function on a shape, ``mean`` (V, K) and ``std`` (V, K) at its vertices.

    Where ``labels`` (L,) were carried, ``mean`` (V, L) is the probability of each, so that the most likely ones are
    ``labels[mean.argmax(axis=1)]``; None where functions were.
    """

    mean: np.ndarray
    std: np.ndarray
    labels: np.ndarray | None


@checks.checked(i="< N", values=checks.plain)
def transfer(
    synced: SyncedShapes, i: int, values: ArrayLike, calibration: ConformalCalibration | None = None
) -> list[Transferred]:
    """Values (V_i,) on shape i, or functions (V_i, K), carried to every shape; on i itself they stay.

    Floating-point numbers are functions, anything else (integers, words, booleans) labels. The images of a vertex on
    shape i follow :func:`image_probabilities`, by the ``calibration`` or the one that comes with the package.

    >>> import data_gen, fmsync
    >>> cats = data_gen.load_collection("cats", count=3, n_vertices=1000)
    >>> small = dict(n_basis=10, n_refined=20, n_samples=150, n_draws=500)
    >>> synced = fmsync.synchronize_shapes(cats, **small)
    >>> front = fmsync.matching.transfer(synced, 0, cats[0].vertices[:, 0] > 0)[2]
    >>> front.labels, front.mean.shape, bool(np.allclose(front.mean.sum(axis=1), 1))
    (array([False,  True]), (1000, 2), True)
    """
    first, given = synced.shapes[i], np.asarray(values)
    if given.dtype.kind not in "fiubUS" or given.ndim == 0:
        raise ValueError(f"values: numbers or words, one for each vertex, not {given.dtype} of shape {given.shape}")
    labels, functions = None, given
    if given.dtype.kind != "f":
        labels, number = np.unique(given, return_inverse=True)
        functions = np.eye(len(labels))[number]
    if functions.ndim != 2:
        functions = functions[:, None]
    if given.ndim not in (1, 2 - (labels is not None)) or len(given) != first.shape.n_vertices:
        raise ValueError(f"values: {given.shape} for the {first.shape.n_vertices} vertices of {first.shape.name}")
    if not np.isfinite(functions).all():
        raise ValueError(f"values: vertex {np.argwhere(~np.isfinite(functions))[0, 0]} is NaN or infinite; mend it")
    points, weights = first.shape.vertices, first.basis.mass[:, None]
    cell = cKDTree(points[first.samples]).query(points)[1]  # a sample stands for the vertices nearest to it
    moments = np.zeros((len(first.samples), 1 + 2 * functions.shape[1]))
    np.add.at(moments, cell, weights * np.column_stack([np.ones(len(cell)), functions, functions**2]))
    moments = moments[:, 1:] / np.maximum(moments[:, :1], 1e-300)
    found = []
    for j, other in enumerate(synced.shapes):
        if j == i:
            found.append(Transferred(functions, np.zeros(functions.shape), labels))
            continue
        at_samples = image_probabilities(synced, j, i, calibration or default_calibration()) @ moments
        mean, square = np.split(samples_to_vertices(other, at_samples), 2, axis=1)
        found.append(Transferred(mean, np.sqrt(np.maximum(square - mean**2, 0)), labels))
    return found


@checks.checked(i="< N", vertices=checks.plain)
def transfer_landmarks(
    synced: SyncedShapes, i: int, vertices: ArrayLike, calibration: ConformalCalibration | None = None
) -> list[tuple[np.ndarray, np.ndarray]]:
    """For every shape the images (L,) of vertices (L,) of shape i and the radii (L,) of their 90 % regions.

    Radii are geodesic, in square roots of the area.
    """
    marks = checks.indices("vertices", vertices, synced.shapes[i].shape.n_vertices)
    found = []
    for j in range(len(synced.shapes)):
        if j == i:
            found.append((marks, np.zeros(len(marks))))
            continue
        radius = (calibration or default_calibration()).radius(synced.confidence(i, j))
        images = nearest_rows(synced.shared_functions(i, marks), synced.shared_functions(j))
        found.append((images, samples_to_vertices(synced.shapes[i], radius)[marks]))
    return found


def image_probabilities(synced: SyncedShapes, i: int, j: int, calibration: ConformalCalibration) -> np.ndarray:
    """(S_i, S_j) probability that a sample of i belongs at each sample of j; rows sum to one.

    The ring between two calibrated regions about the image gets the probability that they differ by, the last one
    ends at twice the largest radius. In a ring samples share it in proportion to one plus the posterior draws that hit
    them; the probability of a ring without samples goes inwards.
    """
    known, first, second = synced.confidence(i, j), synced.shapes[i], synced.shapes[j]
    away = second.geodesics[known.image]  # (S_i, S_j)
    radii = np.array([calibration.radius(known, level) for level in calibration.levels])[:, :, None]
    ring = (away > radii).sum(axis=0)
    weights = np.where(away > 2 * radii[-1], 0.0, 1.0)
    hits = draw_images(first, second, synced.draws(i, j, _DRAWS))
    np.add.at(weights, (np.arange(len(weights)), hits), weights[np.arange(len(weights)), hits] > 0)
    share, carried = np.zeros(away.shape), np.zeros((len(away), 1))
    for k, mass in reversed(list(enumerate(np.diff([0, *calibration.levels, 1])))):
        inside = np.where(ring == k, weights, 0.0)
        total = inside.sum(axis=1, keepdims=True)
        share += inside * np.where(total > 0, (mass + carried) / np.where(total > 0, total, 1), 0)
        carried = np.where(total > 0, 0, mass + carried)
    return share
