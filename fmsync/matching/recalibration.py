"""Regions that hold what they promise: learnt on shapes whose truth is known, used on others."""

import json
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np

from fmsync.matching.confidence import Confidence

LEVELS = (0.25, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98)
SHIPPED = Path(__file__).with_name("recalibration.json")


@dataclass(frozen=True)
class Recalibration:
    """The error to expect given its signs, and how often which multiple of it is exceeded.

    Attributes
    ----------
    fitted_on
        In words, the shapes it was fitted on.
    mean
        Mean error over mean evidence.
    levels, scales
        Regions of radius ``scale * evidence`` held the share ``level`` of the truths.
    """

    fitted_on: str
    mean: float
    levels: tuple[float, ...]
    scales: tuple[float, ...]

    def expected(self, known: Confidence) -> np.ndarray:
        """Expected error (S,) of the images, in square roots of the area: what to rank vertices by."""
        return self.mean * known.evidence()

    def radius(self, known: Confidence, level: float | None = None) -> np.ndarray:
        """Radii (S,) of regions that hold ``level``; left out, the level of ``known``."""
        return self.scale(known.level if level is None else level) * known.evidence()

    def scale(self, level: float) -> float:
        """What evidence is multiplied by; ValueError outside the levels it was fitted at."""
        if not self.levels[0] <= level <= self.levels[-1]:
            raise ValueError(f"level: {level} is outside {self.levels[0]} to {self.levels[-1]}, where this was fitted")
        return float(np.interp(level, self.levels, self.scales))

    def save(self, path: str | Path) -> None:
        """Write it as JSON."""
        Path(path).write_text(json.dumps(asdict(self), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> "Recalibration":
        """Read what :meth:`save` wrote; ValueError that says what is wrong with the file."""
        path = Path(path)
        if not path.is_file():
            raise ValueError(f"{path}: there is no such file")
        try:
            fields = json.loads(path.read_text(encoding="utf-8"))
            numbers = {k: tuple(float(x) for x in fields[k]) for k in ("levels", "scales")}
            read = cls(str(fields["fitted_on"]), float(fields["mean"]), **numbers)
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path}: not a recalibration ({error!r}); Recalibration.save writes one") from error
        if len(read.scales) != len(read.levels) or not read.levels or not (np.diff(read.levels) > 0).all():
            raise ValueError(f"{path}: not a recalibration: it needs rising levels, and a scale for each")
        return read


def fit_recalibration(
    known: list[Confidence], errors: list[np.ndarray], fitted_on: str = "own shapes", levels: tuple[float, ...] = LEVELS
) -> Recalibration:
    """Recalibration from true errors (S,) of each of ``known``: judge it on another collection than it was fitted on.

    The scale of a level is the conformal quantile of error over evidence (Lei et al. 2018).

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> stretch = rng.random(400)
    >>> known = Confidence(*np.zeros((6, 400)), 0.9, stretch, np.ones(400))
    >>> fitted = fit_recalibration([known], [rng.exponential(stretch)])
    >>> bool(abs(fitted.scale(0.9) / np.log(10) - 1) < 0.2)  # the 90 % quantile of an exponential law
    True
    """
    evidence, truth = np.concatenate([k.evidence() for k in known]), np.concatenate(errors)
    if len(evidence) != len(truth):
        raise ValueError(f"errors: {len(truth)} for {len(evidence)} samples")
    ratios = truth / np.maximum(evidence, 1e-12)
    shares = np.minimum(1.0, np.array(levels) * (1 + 1 / len(ratios)))
    mean = float(truth.mean() / max(evidence.mean(), 1e-12))
    return Recalibration(fitted_on, mean, tuple(levels), tuple(map(float, np.quantile(ratios, shares))))


@cache
def shipped() -> Recalibration:
    """The one that comes with the package, fitted on synthetic cats; other animals may need their own."""
    return Recalibration.load(SHIPPED)
