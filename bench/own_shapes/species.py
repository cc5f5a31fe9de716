"""Regions on species never seen: scores and true errors over random species, and what a calibration on them promises.

Species 1000, 1001, ... are for fitting and for choices that were made on the way, 0, 1, ... for testing alone.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd

from bench.metrics import LEVELS
from bench.own_shapes.confidence import observe
from bench.own_shapes.stages import species
from bench.studies import kept_results
from fmsync import diagnostics
from fmsync.matching import Confidence, ConformalCalibration, fit_conformal

TEST, FIT = range(40), range(1000, 1100)
_FOLDS = 10


def points(number: int) -> pd.DataFrame:
    """Uncertainty score, fullness and true error of some vertices of every pair of a species."""
    with diagnostics.short_run():  # scores do not depend on draws
        seen = observe(species(number), levels=(), n_draws=40)
    rows = [
        pd.DataFrame({"pair": k, "score": known.uncertainty_score(), "fullness": known.fullness, "error": errors})
        for k, (known, errors) in enumerate(zip(seen.known, seen.errors))
    ]
    return pd.concat(rows).assign(species=number).astype("float32")


def all_points(numbers: Iterable[int], folder: Path) -> pd.DataFrame:
    """Those of many species, kept in ``folder``."""
    return pd.concat(kept_results(points, numbers, folder), ignore_index=True)


def fitted(rows: pd.DataFrame) -> ConformalCalibration:
    """The calibration of these species, with the guarantee for a new one."""
    numbers, known, errors = [], [], []
    for (number, _), own in rows.astype(float).groupby(["species", "pair"]):
        numbers.append(int(number))
        # a confidence with these scores
        local, even = own["score"].to_numpy() ** 2, np.ones(len(own))
        known.append(Confidence(*np.zeros((6, len(own))), 0.9, local, even, own["fullness"].to_numpy()))
        errors.append(own["error"].to_numpy())
    return fit_conformal(known, errors, f"{len(set(numbers))} random species", collections=numbers)


def coverage(rows: pd.DataFrame, calibration: ConformalCalibration) -> pd.DataFrame:
    """Share of true images inside the regions of every level, by species."""
    score = rows["score"] / rows["fullness"]
    inside = {str(q): rows["error"] <= calibration.scale(q) * score for q in LEVELS}
    return pd.DataFrame(inside).groupby(rows["species"]).mean()


def left_out(rows: pd.DataFrame) -> pd.DataFrame:
    """Coverage of every species by the calibration of the others, a tenth of them left out at a time."""
    fold = rows["species"].astype(int) % _FOLDS
    return pd.concat([coverage(rows[fold == k], fitted(rows[fold != k])) for k in range(_FOLDS)])


def summary(shares: pd.DataFrame) -> dict:
    """Mean coverage over species, its standard error, and the share of species with less than nine tenths of it."""
    found = {"mean": shares.mean(), "se": shares.sem(), "least": shares.min()}
    found["species far below"] = (shares < 0.9 * shares.columns.astype(float)).mean()
    return pd.DataFrame(found).to_dict(orient="index")


def table(folder: Path, fit: Iterable[int] = FIT, test: Iterable[int] = TEST) -> dict:
    """Coverage over species left out of the fit and over those that no choice was made on."""
    rows, new = all_points(fit, folder), all_points(test, folder)
    return {
        "species": {"fit": rows["species"].nunique(), "test": new["species"].nunique()},
        "left out": summary(left_out(rows)),
        "test": summary(coverage(new, fitted(rows))),
    }
