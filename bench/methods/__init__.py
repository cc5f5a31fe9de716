"""What the benchmark compares. A method is one file: a function ``(problem, *, rng, **options) -> Answer`` and a name.

Everything registered in :mod:`fmsync.estimators` and :mod:`fmsync.samplers` takes part under its own name; files here
add controls, protocols and peers. A file anywhere else takes part after :func:`load`.
"""

import importlib
import importlib.util
import inspect
import pkgutil
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.problems import Planted
from fmsync import diagnostics, estimators, samplers
from fmsync.estimators.base import ESTIMATORS
from fmsync.problem import SyncProblem, relative_maps
from fmsync.registry import near_names
from fmsync.samplers.base import SAMPLERS

Rng = np.random.Generator
Relative = Callable[[np.ndarray], np.ndarray]  # pairs (K, 2) -> maps (K, n, n)

_NOT_OPTIONS = {"problem", "target", "rng", "callback", "start", "self", "method", "options", "kwargs"}
_REGISTRY: dict[str, "Method"] = {}


@dataclass(frozen=True, eq=False)
class Answer:
    """What a method says about a problem.

    ``relative`` gives the maps (K, n, n) of any pairs (K, 2), NaN where it says nothing; ``draws`` (T, N, n, n) are
    absolute rotations, each in any gauge, of methods that sample; ``numbers``, called when the clock has stopped, gives
    metrics that only the method can know; ``path`` are (step, relative) on the way, for figures of convergence.
    """

    relative: Relative
    draws: np.ndarray | None = None
    numbers: Callable[[], Mapping[str, float]] = dict
    path: tuple[tuple[int, Relative], ...] = ()

    @classmethod
    def from_absolute(cls, absolute: np.ndarray, **fields) -> "Answer":
        """From rotations (N, n, n)."""
        return cls(lambda pairs: relative_maps(absolute, pairs), **fields)


@dataclass(frozen=True, eq=False)
class Method:
    """A registered method; ``kind`` is "estimator", "sampler" or "function"."""

    name: str
    function: Callable
    kind: str = "function"
    sees_planted: bool = False

    @property
    def module(self) -> str:
        """Module that holds the method's own file."""
        return self.function.__module__

    @property
    def option_names(self) -> set[str] | None:
        """Options it takes; None when it passes on whatever it is given."""
        own = inspect.signature(self.function).parameters
        if self.kind == "sampler":
            return {*own, *inspect.signature(samplers.sample).parameters} - _NOT_OPTIONS
        if self.kind == "function" and any(p.kind is p.VAR_KEYWORD for p in own.values()):
            return None
        return set(own) - _NOT_OPTIONS | ({"restarts"} if self.kind == "estimator" and "init" in own else set())

    def run(self, planted: Planted, rng: Rng, options: Mapping[str, object]) -> Answer:
        """Answer a :class:`~bench.problems.Planted` problem."""
        if self.kind == "estimator":
            return Answer(estimators.solve(planted.problem, self.name, rng=rng, **options).relative)
        if self.kind == "sampler":
            return sampled(planted.problem, self.name, rng=rng, **options)
        return self.function(planted if self.sees_planted else planted.problem, rng=rng, **options)


def sampled(problem: SyncProblem, method: str, *, rng: Rng, **options) -> Answer:
    """Draws of a sampler; its point answer is the chordal mean of the relative maps, free of any gauge."""
    began = time.perf_counter()
    post = samplers.sample(problem, method, rng=rng, **options)
    seconds = time.perf_counter() - began

    def numbers() -> dict[str, float]:
        ess = np.fmin.reduce([diagnostics.ess(x) for x in diagnostics.scalars(post).values()])  # NaN if nothing varies
        return {} if np.isnan(ess) else {"ess_per_second": float(ess) / seconds}

    draws = np.swapaxes(post.absolute, 0, 1).reshape(-1, *post.absolute.shape[2:])  # chains take turns
    return Answer(post.relative_mean, draws, numbers)


def method(name: str, *, sees_planted: bool = False) -> Callable[[Callable], Callable]:
    """Register ``(problem, *, rng, **options) -> Answer``; ``sees_planted``: it gets the truth, too."""

    def register(function: Callable) -> Callable:
        _REGISTRY[name] = Method(name, function, sees_planted=sees_planted)
        return function

    return register


def names() -> list[str]:
    """Names that a suite may use."""
    importlib.import_module("bench.peers")
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")
    return sorted(_registered())


def get(name: str) -> Method:
    """The method of that name; a ValueError with the nearest names when there is none."""
    if name not in _registered():
        known = names()  # looks through the folders only when it must
        if name not in known:
            raise ValueError(f"method: there is no {name!r}; {near_names(name, known)}")
    return _registered()[name]


def _registered() -> dict[str, Method]:
    found = {name: Method(name, function, "estimator") for name, function in ESTIMATORS.items()}
    return found | {name: Method(name, function, "sampler") for name, function in SAMPLERS.items()} | _REGISTRY


def load(file: str | Path) -> list[str]:
    """Run a file that registers methods (of any of the three kinds); gives the names it added."""
    path = Path(file).resolve()
    if not path.is_file():
        raise ValueError(f"{file}: there is no such file")
    module_name = f"fmsync_bench_file_{path.stem}"
    if getattr(sys.modules.get(module_name), "__file__", None) != str(path):
        names()
        before = _registered()
        spec = importlib.util.spec_from_file_location(module_name, path)
        module = importlib.util.module_from_spec(spec)
        sys.modules[module_name] = module
        spec.loader.exec_module(module)
        for name, entry in before.items():
            if _registered()[name].function is not entry.function:
                raise ValueError(f"{file}: the name {name!r} is taken by {entry.module}; choose another")
    added = [name for name, entry in _registered().items() if entry.module == module_name]
    if not added:
        raise ValueError(f'{file}: registers no method; decorate a function with @method("name")')
    return added
