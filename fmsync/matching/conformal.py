"""Regions that hold what they promise: learnt on shapes whose truth is known, used on others."""

import json
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np

from fmsync import checks
from fmsync.checks import checked
from fmsync.matching.confidence import Confidence

LEVELS = (0.25, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98)


@dataclass(frozen=True)
class ConformalCalibration:
    """The error to expect for an uncertainty score, and how often which multiple of the score is exceeded.

    Attributes
    ----------
    fitted_on
        In words, the shapes it was fitted on.
    mean
        Mean error over mean score.
    levels, scales
        Regions of radius ``scale * score`` held the share ``level`` of the truths.
    """

    fitted_on: str
    mean: float
    levels: tuple[float, ...]
    scales: tuple[float, ...]

    @checked()
    def expected(self, known: Confidence) -> np.ndarray:
        """Expected error (S,) of the images, in square roots of the area: what to rank vertices by."""
        return self.mean * known.uncertainty_score()

    @checked(level=checks.probability)
    def radius(self, known: Confidence, level: float | None = None) -> np.ndarray:
        """Radii (S,) of regions that hold ``level``, by default that of ``known``, from which on symmetry counts."""
        level = known.level if level is None else level
        radius = self.scale(level) * known.uncertainty_score()
        return np.maximum(radius, known.symmetry_radius) if level >= known.level else radius

    @checked(level=checks.probability)
    def scale(self, level: float) -> float:
        """What scores are multiplied by; ValueError outside the levels it was fitted at."""
        if not self.levels[0] <= level <= self.levels[-1]:
            raise ValueError(f"level: {level} is outside {self.levels[0]} to {self.levels[-1]}, where this was fitted")
        return float(np.interp(level, self.levels, self.scales))

    @checked()
    def save(self, path: str | Path) -> None:
        """Write it as JSON."""
        Path(path).write_text(json.dumps(asdict(self), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")

    @classmethod
    @checked()
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


@checked(errors="S", levels=checks.probability)
def fit_conformal(
    known: list[Confidence], errors: list[np.ndarray], fitted_on: str = "own shapes", levels: tuple[float, ...] = LEVELS
) -> ConformalCalibration:
    """Calibration from true errors (S,) of each of ``known``: evaluate it on another collection.

    The scale of a level is the conformal quantile of error over uncertainty score (Lei et al. 2018).

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> score = rng.random(400)
    >>> known = Confidence(*np.zeros((6, 400)), 0.9, score, np.ones(400))
    >>> fitted = fit_conformal([known], [rng.exponential(score)])
    >>> bool(abs(fitted.scale(0.9) / np.log(10) - 1) < 0.2)  # the 90 % quantile of an exponential distribution
    True
    """
    score, truth = np.concatenate([k.uncertainty_score() for k in known]), np.concatenate(errors)
    if len(score) != len(truth):
        raise ValueError(f"errors: {len(truth)} for {len(score)} samples")
    ratios = truth / np.maximum(score, 1e-12)
    shares = np.minimum(1.0, np.array(levels) * (1 + 1 / len(ratios)))
    mean = float(truth.mean() / max(score.mean(), 1e-12))
    return ConformalCalibration(fitted_on, mean, tuple(levels), tuple(map(float, np.quantile(ratios, shares))))


@cache
def default_calibration() -> ConformalCalibration:
    """The one that comes with the package, fitted on synthetic cats; other animals may need their own."""
    return ConformalCalibration.load(Path(__file__).with_name("conformal.json"))
