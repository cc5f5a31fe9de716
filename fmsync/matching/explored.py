"""What a reader explores: where two shapes send their vertices, under several noises; needs the extra ``viz`` too."""

from collections.abc import Mapping

import numpy as np

from fmsync.functional_maps import nearest_rows, row_images
from fmsync.matching.conformal import ConformalCalibration
from fmsync.matching.synchronize import SyncedShapes
from fmsync.viz.explorer import Explorer, State, explorer

_CHOICE, _DRAWS = 160, 100  # vertices to choose from, and draws that carry them: a dozen posteriors stay below 1 MB


def explore(
    worlds: Mapping[tuple[float, str], SyncedShapes],
    pair: tuple[int, int],
    calibration: ConformalCalibration,
    *,
    alt: str,
    level: float = 0.9,
    common_order: bool = False,
    vertex: int | None = None,
) -> Explorer:
    """Two synchronised shapes to explore: images of their vertices as observed, synchronised, drawn and calibrated.

    * ``worlds``: a synchronisation of the same shapes for each noise variance and temperature in words, such as ``(0.1,
      "β = 1")``; those of one variance differ in their posterior alone.
    * ``pair``, ``calibration``, ``level``: two shapes; what turns uncertainty scores into regions; and the share that
      regions are to hold.
    * ``alt``, ``common_order``: a sentence or two that say what is shown; whether vertex x of one shape is known to
      belong to x of the other.
    * ``vertex``: of the first shape; the nearest vertex to choose from is chosen at first.
    """
    ways = (pair, pair[::-1])
    states = []
    for (noise, temperature), synced in worlds.items():
        known = [synced.confidence(*way, level) for way in ways]
        centres = [synced.shapes[j].samples[k.image[:_CHOICE]] for k, (_, j) in zip(known, ways)]
        radii = [k.radius[:_CHOICE] for k in known]
        drawn = [_images(synced, i, j, synced.draws(i, j, _DRAWS)) for i, j in ways]
        states.append(State("posterior", drawn, radii, centres, noise, temperature))
        if all(s.view == "posterior" or s.noise != noise for s in states):
            widened = [calibration.radius(k, level)[:_CHOICE] for k in known]
            if pair in synced.observed:
                observed = [_images(synced, i, j, synced.observed[i, j][None]) for i, j in ways]
                states.append(State("observed", observed, noise=noise))
            states.append(State("synchronised", [centre[:, None] for centre in centres], noise=noise))
            states.append(State("calibrated", states[-1].images, widened, centres, noise))
    states.sort(key=lambda s: ("observed", "synchronised", "posterior", "calibrated").index(s.view))
    synced = next(iter(worlds.values()))
    choice = [synced.shapes[k].samples[:_CHOICE] for k in pair]
    shapes = [synced.shapes[k].shape for k in pair]
    row = None
    if vertex is not None:
        row = int(nearest_rows(shapes[0].vertices[[vertex]], shapes[0].vertices[choice[0]])[0])
    first = max(n for n, s in enumerate(states) if s.view == "posterior" and s.noise == states[0].noise)
    truth = choice if common_order else None
    return explorer(shapes, choice, states, alt=alt, truth=truth, level=level, start=first, vertex=row)


def _images(synced: SyncedShapes, i: int, j: int, maps: np.ndarray) -> np.ndarray:
    """Vertices (S, T) of shape j where maps C_ij (T, n, n) send the vertices to choose from on shape i."""
    n = maps.shape[-1]
    return row_images(synced.shapes[i].sampled(_CHOICE)[:, :n], maps, synced.shapes[j].basis.eigenfunctions[:, :n]).T
