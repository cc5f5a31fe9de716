"""Left and right swapped on a share of the pairs of cats: what the flag of two modes has to find."""

from dataclasses import replace

import numpy as np

import data_gen
from fmsync.matching.confidence import two_modes


def planted_flips(synced, share: float, far: float = 0.16) -> tuple[float, float]:
    """Precision and recall of the flag of two modes when left and right are swapped on a share of the pairs.

    For shapes of ``data_gen.load_collection("cats")``, whose mirror images are known. A sample truly has two modes if
    it is farther than ``far`` from its mirror image and its votes split; those nearly on the mirror plane are left out.
    """
    count, n_vertices = len(synced.shapes), synced.shapes[0].shape.n_vertices
    mirror = data_gen.left_right_flip(n_vertices)
    chosen = np.random.default_rng(0).permutation(len(synced.edges)) < round(share * len(synced.edges))
    flipped = {tuple(e): bool(f) for e, f in zip(synced.edges.tolist(), chosen)}
    matches = []
    for (_, j), found, turned in zip(synced.edges, synced.matches, chosen):
        basis = synced.shapes[j].basis.truncated(len(found.c_ij))
        turn = basis.coefficients(basis.eigenfunctions[mirror])
        matches.append(replace(found, c_ij=found.c_ij @ turn) if turned else found)
    other = replace(synced, matches=tuple(matches))
    hits = np.zeros(3)  # flagged rightly, flagged wrongly, missed
    for i, j in synced.edges.tolist():
        others = [k for k in range(count) if k not in (i, j)]
        votes = [flipped[i, j]] + [flipped[min(i, k), max(i, k)] ^ flipped[min(k, j), max(k, j)] for k in others]
        support = min(np.mean(votes), 1 - np.mean(votes))
        points, own = synced.shapes[j].shape.vertices, synced.shapes[i].samples
        apart = np.linalg.norm(points[own] - points[mirror[own]], axis=1)
        clear = (apart < far / 2) | (apart > far)
        true = (apart > far) & (support >= 0.2)
        flagged = two_modes(other.votes(i, j), synced.shapes[j].geodesics)[0]
        hits += [(clear & a & b).sum() for a, b in ((flagged, true), (flagged, ~true), (~flagged, true))]
    return float(hits[0] / max(hits[0] + hits[1], 1)), float(hits[0] / max(hits[0] + hits[2], 1))
