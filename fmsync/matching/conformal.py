"""Regions that hold what they promise: learnt on shapes whose truth is known, used on others."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np

from fmsync import checks
from fmsync.matching.confidence import Confidence

LEVELS = (0.25, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98)


@dataclass(frozen=True)
class ConformalCalibration:
    """The error to expect for an uncertainty score, and how often which multiple of the region score is exceeded.

    ``fitted_on`` says in words which shapes; ``mean`` is their mean error over mean uncertainty score. Regions of
    radius ``scale * region_score`` held the share ``level`` of the truths, of ``levels`` and ``scales``.
    """

    fitted_on: str
    mean: float
    levels: tuple[float, ...]
    scales: tuple[float, ...]

    @checks.checked()
    def expected(self, known: Confidence) -> np.ndarray:
        """Expected error (S,) of the images, in square roots of the area: what to rank vertices by."""
        return self.mean * known.uncertainty_score()

    @checks.checked(level=checks.probability)
    def radius(self, known: Confidence, level: float | None = None) -> np.ndarray:
        """Radii (S,) of regions that hold ``level``, by default that of ``known``, from which on symmetry counts."""
        level = known.level if level is None else level
        radius = self.scale(level) * known.region_score()
        return np.maximum(radius, known.symmetry_radius) if level >= known.level else radius

    @checks.checked(level=checks.probability)
    def scale(self, level: float) -> float:
        """What region scores are multiplied by; ValueError outside the levels it was fitted at."""
        if not self.levels[0] <= level <= self.levels[-1]:
            raise ValueError(f"level: {level} is outside {self.levels[0]} to {self.levels[-1]}, where this was fitted")
        return float(np.interp(level, self.levels, self.scales))

    @checks.checked()
    def save(self, path: str | Path) -> None:
        """Write it as JSON."""
        Path(path).write_text(json.dumps(asdict(self), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")

    @classmethod
    @checks.checked()
    def load(cls, path: str | Path) -> "ConformalCalibration":
        """Read what :meth:`save` wrote; ValueError that says what is wrong with the file."""
        path = Path(path)
        if not path.is_file():
            raise ValueError(f"{path}: there is no such file")
        try:
            fields = json.loads(path.read_text(encoding="utf-8"))
            levels, scales = (tuple(float(x) for x in fields[k]) for k in ("levels", "scales"))
            if len(scales) != len(levels) or not levels or not (np.diff(levels) > 0).all():
                raise ValueError("it needs rising levels, and a scale for each")
            return cls(str(fields["fitted_on"]), float(fields["mean"]), levels, scales)
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path}: not a calibration ({error!r}); ConformalCalibration.save writes one") from error


@checks.checked(errors="S", levels=checks.probability, collections=">= 0")
def fit_conformal(
    known: list[Confidence],
    errors: list[np.ndarray],
    fitted_on: str = "own shapes",
    levels: tuple[float, ...] = LEVELS,
    collections: Sequence[int] | None = None,
) -> ConformalCalibration:
    r"""Calibration from true errors (S,) of each of ``known``: evaluate it on another collection.

    The scale of a level is the conformal quantile of the ratio of error and region score (Lei et al. 2018): it
    holds for further vertices of the shapes that it was fitted on. ``collections`` says from which of K collections
    each of ``known`` is, and makes it hold for a vertex of a *new* one that is as good as drawn with them (Lee, Barber
    and Willett 2023): every collection has the weight :math:`1/(K+1)`, its vertices share it, and the rest lies at
    infinity. A level above :math:`K/(K+1)` is then a ValueError.

    >>> rng = np.random.default_rng(0)
    >>> score = rng.random(400)
    >>> known = Confidence(*np.zeros((6, 400)), 0.9, score**2, *np.ones((2, 400)))
    >>> fitted = fit_conformal([known], [rng.exponential(score)])
    >>> bool(abs(fitted.scale(0.9) / np.log(10) - 1) < 0.2)  # the 90 % quantile of an exponential distribution
    True
    """
    scores = [k.region_score() for k in known]
    if len(scores) != len(errors) or any(len(s) != len(e) for s, e in zip(scores, errors)):
        raise ValueError(f"errors: sizes {[*map(len, errors)]} for {[*map(len, scores)]} samples")
    truth = np.concatenate(errors)
    ratios = truth / np.maximum(np.concatenate(scores), 1e-12)
    what, own = "samples", np.arange(len(ratios))
    if collections is not None:
        if len(collections) != len(known):
            raise ValueError(f"collections: {len(collections)} for {len(known)} pairs; say where each is from")
        what, own = "collections", np.unique(np.repeat(collections, [*map(len, errors)]), return_inverse=True)[1]
    sizes = np.bincount(own)
    if (highest := max(levels)) > len(sizes) / (len(sizes) + 1):
        raise ValueError(f"levels: {highest} needs {highest / (1 - highest):.0f} {what} or more, not {len(sizes)}")
    order = np.argsort(ratios, kind="stable")
    shares = np.cumsum(1 / ((len(sizes) + 1) * sizes[own[order]]))
    scales = ratios[order[np.searchsorted(shares, np.array(levels) - 1e-12)]]
    mean = float(truth.mean() / max(np.concatenate([k.uncertainty_score() for k in known]).mean(), 1e-12))
    return ConformalCalibration(fitted_on, mean, tuple(levels), tuple(map(float, scales)))


@cache
def default_calibration() -> ConformalCalibration:
    """The one that comes with the package, fitted on a hundred random species of ``data_gen.creatures``."""
    return ConformalCalibration.load(Path(__file__).with_name("conformal.json"))
