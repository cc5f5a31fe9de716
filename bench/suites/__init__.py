"""Suites: small declarative files that say which methods meet which problems; ``smoke.toml`` explains every key."""

import importlib
import inspect
import itertools
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from bench import methods
from bench.cache import code_hash, data_hash, key_of
from fmsync.registry import near_names

_FOLDER = Path(__file__).parent
_LIMITS = {"seeds": int, "seconds": int | float, "memory": int | float}
_TOP = {"description": str, "methods_of": str, "grid": list, "method": dict, **_LIMITS}
_GRID = {"generator": str, "problem": dict, "methods": list, **_LIMITS}


@dataclass(frozen=True)
class Run:
    """One method on one problem; label, limits and file are not part of what determines its result."""

    generator: str
    problem: Mapping[str, object]
    seed: int
    label: str  # name in the tables
    method: str
    options: Mapping[str, object] = field(default_factory=dict)
    seconds: float = 60.0  # limits: of the method alone,
    memory: float = 2000.0  # in MiB above what the process holds before it
    file: str | None = None  # that registers the method, when it is not part of the package

    @cached_property
    def content(self) -> dict:
        """What determines the result; the label does not."""
        what = {name: getattr(self, name) for name in ("generator", "seed", "method", "code")}
        data = data_hash(self.generator, self.problem)
        return {**what, "problem": dict(self.problem), "options": dict(self.options), "data": data}

    @property
    def code(self) -> str:
        """Hash of the source, as this process has it."""
        return code_hash(self.generator.partition(":")[0], self.module)

    @cached_property
    def key(self) -> str:
        """Name of the result in the cache."""
        return key_of(self.content)

    @cached_property
    def module(self) -> str:
        """Module that registers the method: a worker imports this one, and not those of all methods."""
        return methods.get(self.method).module

    def __str__(self) -> str:
        problem = " ".join(f"{name}={value}" for name, value in self.problem.items())
        return f"{self.label} [{problem} seed={self.seed}]"


@dataclass(frozen=True)
class Suite:
    """A parsed suite file."""

    name: str
    description: str
    runs: tuple[Run, ...]


def suite_names() -> list[str]:
    """Suites of the package."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def suite_file(name: str | Path) -> Path:
    """File of a suite of the package, or the ``.toml`` file itself; a ValueError offers near names."""
    path = Path(name) if str(name).endswith(".toml") else _FOLDER / f"{name}.toml"
    if not path.is_file():
        raise ValueError(f"suite: there is no {str(name)!r}; {near_names(str(name), suite_names())}")
    return path


def load_suite(
    name: str | Path, *, files: Iterable[str | Path] = (), seeds: int | None = None, only: str | None = None
) -> Suite:
    """Read a suite of the package by name, or any file that ends in ``.toml``.

    ``"paper@tosca_cat"`` is the suite ``paper`` with the shapes of another collection. The methods that ``files``
    register join every grid; ``seeds`` is the largest number of seeds, where the file does not say fewer; ``only`` is a
    regular expression that the descriptions (``str(run)``) of the runs to keep match.
    """
    base, _, collection = str(name).partition("@")
    path = suite_file(base if collection else name)
    if seeds is not None and seeds < 1:
        raise ValueError(f"seeds: need at least one, got {seeds}")
    extra = {added: str(Path(file).resolve()) for file in files for added in methods.load(file)}
    reader = _Reader(path, extra)
    runs = reader.runs(seeds)
    if Path(collection).name != collection:
        raise ValueError(f"collection: {collection!r} is not a name; put the folder into the one FMSYNC_DATA names")
    if collection:
        runs = [replace(c, problem={**c.problem, "collection": collection}) for c in runs if "collection" in c.problem]
        if not runs:
            raise ValueError(f"{path}: no grid names a collection that {collection!r} could replace")
        data_hash(runs[0].generator, runs[0].problem)  # refuses one that is not on this machine
    try:
        runs = [run for run in runs if re.search(only or "", str(run))]
    except re.error as error:
        raise ValueError(f"only: {only!r} is not a regular expression: {error}") from None
    if not runs:
        raise ValueError(f"only: no run of {path.stem} matches {only!r}")
    return Suite(path.stem + f"@{collection}" * bool(collection), reader.file["description"], tuple(runs))


def generator_function(generator: str) -> Callable:
    """The function named ``module:function``, imported now: the package itself knows no problems."""
    module, _, function = generator.partition(":")
    try:
        return getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"generator: {generator!r} cannot be imported ({error}); write 'module:function'") from error


class _Reader:
    """Checks a file from top to bottom, so that nothing starts which would stop half-way."""

    def __init__(self, path: Path, extra: Mapping[str, str]):
        self._path, self._text, self._extra = path, path.read_text(encoding="utf-8"), extra
        try:
            self.file = tomllib.loads(self._text)
        except tomllib.TOMLDecodeError as error:
            raise ValueError(f"{path}: {error}") from None
        self._check(self.file, _TOP, "suite", ("description", "seeds", "grid"))
        self._tables = self.file.get("method", {})
        if other := self.file.get("methods_of"):
            self._tables = _Reader(suite_file(other), {}).file.get("method", {}) | self._tables
        for label in self._tables:
            self._entry(label)

    def runs(self, seeds: int | None) -> list[Run]:
        runs = []
        for grid in self.file["grid"]:
            self._check(grid, _GRID, "grid", ("generator", "problem", "methods"))
            generator, told = grid["generator"], {"seconds": 60, "memory": 2000, **self.file, **grid}
            try:
                known = set(inspect.signature(generator_function(generator)).parameters) - {"seed"}
            except ValueError as error:
                raise ValueError(f"{self._where(generator)}: {error}") from None
            self._check_names(grid["problem"], known, f"problem of {generator}")
            entries = {label: self._entry(label) for label in grid["methods"]}
            used = {method for method, _ in entries.values()}
            entries |= {label: self._entry(label) for label in self._extra if label not in used}
            limits, most = (float(told["seconds"]), float(told["memory"])), told["seeds"]
            choices = [value if isinstance(value, list) else [value] for value in grid["problem"].values()]
            for values in itertools.product(*choices):  # problem by problem: a worker makes each once
                problem = dict(zip(grid["problem"], values))
                for seed in range(min(seeds or most, most)):
                    for label, (method, options) in entries.items():
                        file = self._extra.get(method)
                        runs.append(Run(generator, problem, seed, label, method, options, *limits, file))
        return runs

    def _entry(self, label: str) -> tuple[str, dict]:
        """Method and options of a label: those of its table, if it has one."""
        options = dict(self._tables.get(label, {}))
        name = options.pop("use", label)
        try:
            known = methods.get(name).option_names
        except ValueError as error:
            raise ValueError(f"{self._where(name)}: {error}") from None
        if known is not None:
            self._check_names(options, known, f"method {label}")
        return name, options

    def _check(self, table: Mapping, known: Mapping[str, type], where: str, needed: Iterable[str]) -> None:
        self._check_names(table, known, where)
        for key, value in table.items():
            if not isinstance(value, known[key]) or isinstance(value, bool):
                raise ValueError(f"{self._where(key)}: {key} = {value!r} has the wrong type")
            if key in _LIMITS and value <= 0:
                raise ValueError(f"{self._where(key)}: {key} must be > 0, got {value}")
        if missing := [key for key in needed if key not in table]:
            raise ValueError(f"{self._where(f'[[{where}]]')}: {missing[0]} is missing")

    def _check_names(self, keys: Iterable[str], known: Iterable[str], where: str) -> None:
        for key in keys:
            if key not in known:
                raise ValueError(f"{self._where(key)}: {where} has no key {key!r}; {near_names(key, known)}")

    def _where(self, word: str) -> str:
        pattern = re.compile(rf"(?<![\w-]){re.escape(word)}(?![\w-])")
        lines = (number for number, line in enumerate(self._text.splitlines(), 1) if pattern.search(line))
        return f"{self._path}, line {next(lines, 1)}"
