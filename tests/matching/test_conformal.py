"""The promise of a calibration: for a vertex of a collection that is as good as drawn with those it was fitted on."""

import numpy as np
import pytest

from fmsync.matching import Confidence, fit_conformal


def drawn(rng, count, size=30):
    """Scores and errors of collections of very different difficulty, of two pairs each, the first twice as large."""
    difficulty = np.exp(rng.standard_normal(count))
    sizes = np.tile([2 * size, size], count)
    score = [rng.random(k) + 0.1 for k in sizes]
    known = [Confidence(*np.zeros((6, len(s))), 0.9, s**2, *np.ones((2, len(s)))) for s in score]
    return known, [s * d * rng.exponential(size=len(s)) for s, d in zip(score, np.repeat(difficulty, 2))]


def test_regions_hold_for_a_vertex_of_a_new_collection():
    rng, count, levels = np.random.default_rng(0), 40, (0.5, 0.9, 0.95)
    held = []
    for _ in range(150):
        known, errors = drawn(rng, count)
        fitted = fit_conformal(known, errors, "drawn", levels, np.repeat(np.arange(count), 2).tolist())
        new, missed = drawn(rng, 8)
        held.append(
            [np.mean(np.concatenate(missed) <= np.concatenate([fitted.radius(k, q) for k in new])) for q in levels]
        )
    held = np.array(held)
    error = held.std(axis=0, ddof=1) / np.sqrt(len(held))
    assert (held.mean(axis=0) > np.array(levels) - 4 * error).all()
    assert (held.mean(axis=0) < np.array(levels) + 1 / (count + 1) + 4 * error).all()


def test_one_fit_for_all_vertices_promises_too_much_to_a_new_collection():
    rng, held = np.random.default_rng(1), []
    for _ in range(400):
        known, errors = drawn(rng, 3)
        fitted = fit_conformal(known, errors, "drawn", (0.9,))
        new, missed = drawn(rng, 8)
        held.append(np.mean(np.concatenate(missed) <= np.concatenate([fitted.radius(k, 0.9) for k in new])))
    assert np.mean(held) + 4 * np.std(held) / np.sqrt(len(held)) < 0.9


def test_what_cannot_be_promised_is_refused():
    known, errors = drawn(np.random.default_rng(2), 3)
    with pytest.raises(ValueError, match="levels: 0.9 needs 9 collections or more, not 3"):
        fit_conformal(known, errors, "drawn", (0.5, 0.9), [0, 0, 1, 1, 2, 2])
    with pytest.raises(ValueError, match="collections: 2 for 6 pairs"):
        fit_conformal(known, errors, "drawn", (0.5,), [0, 1])
    with pytest.raises(ValueError, match="errors: sizes"):
        fit_conformal(known, errors[::-1], "drawn", (0.5,))
