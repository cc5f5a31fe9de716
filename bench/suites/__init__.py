"""Suites: small declarative files that say which methods meet which problems.

.. code-block:: toml

    description = "What the suite shows"
    seeds = 10                      # problems of every kind, the same for every method
    seconds = 60                    # limit of a cell
    memory = 2000                   # limit of a cell, MB above what the process holds before it
    together = true                 # chains of all seeds as one batch, where a method can; then their times are shares
    methods_of = "paper"            # the names of methods that another suite has made, beside those made here

    [method.mc]                     # a name of your own for a method with options; bare names need no table
    use = "rlfm"
    n_chains = 1

    [[grid]]                        # every problem times every seed times every method; lists are swept
    generator = "bench.problems:rotations"
    problem = { n_nodes = [4, 11], n = 20, sigma2 = [0.1, 0.2] }
    methods = ["spectral", "mle", "mc"]
"""

import difflib
import hashlib
import importlib
import inspect
import itertools
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from bench import methods
from bench.code import fingerprint, method_modules
from bench.store import key_of

_FOLDER = Path(__file__).parent
_TOP = {
    "description": str,
    "seeds": int,
    "seconds": (int, float),
    "memory": (int, float),
    "together": bool,
    "methods_of": str,
    "grid": list,
    "method": dict,
}
_GRID = {"generator": str, "problem": dict, "methods": list, "seeds": int, "seconds": (int, float)}


@dataclass(frozen=True)
class Cell:
    """One method on one problem.

    Attributes
    ----------
    label
        Name in the tables; ``method`` with ``options`` is what runs.
    seconds, memory
        Limits; not part of what the cell is.
    file
        File that registers the method, when it is not part of the package.
    together
        Whether it may run as one batch with cells that differ in their seed alone.
    """

    generator: str
    problem: Mapping[str, object]
    seed: int
    label: str
    method: str
    options: Mapping[str, object] = field(default_factory=dict)
    seconds: float = 60.0
    memory: float = 2000.0
    file: str | None = None
    together: bool = False

    @cached_property
    def content(self) -> dict:
        """What determines the result, and so the cell's address; the label does not."""
        code = {"method": method_modules(self.method), "generator": {self.generator.partition(":")[0]}}
        return {
            "generator": self.generator,
            "problem": dict(self.problem),
            "seed": self.seed,
            "method": self.method,
            "options": dict(self.options),
            "code": _fingerprint(frozenset(code["method"] | code["generator"] | {"bench.measure"})),
            "data": data_fingerprint(self.generator, self.problem),
        }

    @cached_property
    def key(self) -> str:
        """Address of the cell in a store."""
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
    cells: tuple[Cell, ...]


class SuiteError(ValueError):
    """A suite file that cannot be read as one; the message names file and line."""


def suite_names() -> list[str]:
    """Suites of the package.

    Examples
    --------
    >>> from bench.suites import suite_names
    >>> "smoke" in suite_names()
    True
    """
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def suite_file(name: str | Path) -> Path:
    """File of a suite of the package, or the ``.toml`` file itself; a SuiteError offers near names."""
    path = Path(name) if str(name).endswith(".toml") else _FOLDER / f"{name}.toml"
    if not path.is_file():
        close = difflib.get_close_matches(str(name), suite_names())
        hint = f"did you mean {' or '.join(close)}?" if close else f"known: {', '.join(suite_names())}"
        raise SuiteError(f"suite: there is no {str(name)!r}; {hint}")
    return path


def load_suite(
    name: str | Path, *, files: Iterable[str | Path] = (), seeds: int | None = None, only: str | None = None
) -> Suite:
    """Read a suite of the package by name, or any file that ends in ``.toml``.

    Parameters
    ----------
    name
        ``"smoke"``, ..., or a path. ``"paper@tosca_cat"`` is the suite ``paper`` with the shapes of another collection.
    files
        Files that register methods; these join every grid.
    seeds
        At most so many seeds, and no more than the file says.
    only
        Keep the cells whose description (``str(cell)``) matches this regular expression.

    Raises
    ------
    SuiteError
        Unknown suite (offers near names), a key that means nothing (names line and key), a method, option, generator or
        problem parameter that does not exist.
    """
    base, _, collection = str(name).partition("@")
    path = suite_file(base if collection else name)
    if seeds is not None and seeds < 1:
        raise SuiteError(f"seeds: need at least one, got {seeds}")
    text = path.read_text(encoding="utf-8")
    extra = {added: str(Path(file).resolve()) for file in files for added in methods.load(file)}
    cells = _Reader(path, text, extra).cells(seeds)
    if collection:
        cells = _of_collection(cells, collection, path)
    if only is not None:
        try:
            cells = [cell for cell in cells if re.search(only, str(cell))]
        except re.error as error:
            raise SuiteError(f"only: {only!r} is not a regular expression: {error}") from None
        if not cells:
            raise SuiteError(f"only: no cell of {path.stem} matches {only!r}")
    return Suite(
        f"{path.stem}@{collection}" if collection else path.stem, tomllib.loads(text)["description"], tuple(cells)
    )


def _of_collection(cells: Iterable[Cell], collection: str, path: Path) -> list[Cell]:
    """The cells on shapes, with the shapes of another collection, all of which must be on this machine."""
    if Path(collection).name != collection:
        raise SuiteError(f"collection: {collection!r} is not a name; put the folder into the one FMSYNC_DATA names")
    moved = [replace(c, problem={**c.problem, "collection": collection}) for c in cells if "collection" in c.problem]
    if not moved:
        raise SuiteError(f"{path}: no grid names a collection that {collection!r} could replace")
    try:
        data_fingerprint(moved[0].generator, moved[0].problem)
    except ValueError as error:
        raise SuiteError(f"collection: {error}") from error
    return moved


def generator_function(generator: str) -> Callable:
    """The function named ``module:function``, imported now: the package itself knows no problems."""
    module, _, function = generator.partition(":")
    try:
        return getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"generator: {generator!r} cannot be imported ({error}); write 'module:function'") from error


def data_fingerprint(generator: str, problem: Mapping[str, object]) -> str:
    """SHA-256 over names and bytes of the files that a problem is read from; empty where there are none.

    A generator's module says which they are in a function ``data_files(problem)``, if it reads any.
    """
    files_of = getattr(importlib.import_module(generator.partition(":")[0]), "data_files", None)
    files = files_of(problem) if files_of else []
    if not files:
        return ""
    digest = hashlib.sha256()
    for file in files:
        stat = file.stat()
        digest.update(f"{file.name}\n{_file_hash(file, stat.st_mtime_ns, stat.st_size)}\n".encode())
    return digest.hexdigest()


@lru_cache(maxsize=1024)
def _file_hash(file: Path, mtime_ns: int, size: int) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


class _Reader:
    """Checks a file from top to bottom, so that nothing starts which would stop half-way."""

    def __init__(self, path: Path, text: str, extra: Mapping[str, str]):
        self._path, self._text, self._extra = path, text, extra
        try:
            self.file = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise SuiteError(f"{path}: {error}") from None
        self._check(self.file, _TOP, "")
        for needed in ("description", "seeds", "grid"):
            if needed not in self.file:
                raise SuiteError(f"{path}: {needed} is missing")
        tables = self.file.get("method", {})
        if other := self.file.get("methods_of"):
            file = suite_file(other)
            tables = _Reader(file, file.read_text(encoding="utf-8"), {}).file.get("method", {}) | tables
        self._entries = {label: self._entry(label, table) for label, table in tables.items()}

    def cells(self, seeds: int | None) -> list[Cell]:
        cells = []
        for grid in self.file["grid"]:
            self._check(grid, _GRID, "grid")
            for needed in ("generator", "problem", "methods"):
                if needed not in grid:
                    raise SuiteError(f"{self._where('[[grid]]')}: {needed} is missing in a grid")
            self._check_problem(grid["generator"], grid["problem"])
            entries = [(label, *self._entry_of(label)) for label in grid["methods"]]
            used = {method for _, method, _ in entries}
            entries += [(label, *self._entry_of(label)) for label in self._extra if label not in used]
            limit = grid.get("seconds", self.file.get("seconds", 60))
            memory = self.file.get("memory", 2000)
            n_seeds = min(seeds or np.inf, grid.get("seeds", self.file["seeds"]))
            for problem in _sweep(grid["problem"]):  # problem by problem: a worker makes each once
                for seed in range(int(n_seeds)):
                    for label, method, options in entries:
                        cells.append(
                            Cell(
                                grid["generator"],
                                problem,
                                seed,
                                label,
                                method,
                                options,
                                float(limit),
                                float(memory),
                                self._extra.get(method),
                                self.file.get("together", False),
                            )
                        )
        return cells

    def _entry_of(self, label: str) -> tuple[str, dict]:
        return self._entries[label] if label in self._entries else self._entry(label, {"use": label})

    def _entry(self, label: str, table: Mapping) -> tuple[str, dict]:
        options = {key: value for key, value in table.items() if key != "use"}
        name = table.get("use", label)
        try:
            known = methods.get(name).option_names
        except ValueError as error:
            raise SuiteError(f"{self._where(name)}: {error}") from None
        for option in options:
            if known is not None and option not in known:
                raise SuiteError(self._unknown(option, known, f"method {label}"))
        return name, options

    def _check_problem(self, generator: str, problem: Mapping) -> None:
        try:
            known = set(inspect.signature(generator_function(generator)).parameters) - {"seed"}
        except ValueError as error:
            raise SuiteError(f"{self._where(generator)}: {error}") from None
        for parameter in problem:
            if parameter not in known:
                raise SuiteError(self._unknown(parameter, known, f"problem of {generator}"))

    def _check(self, table: Mapping, known: Mapping[str, type], name: str) -> None:
        for key, value in table.items():
            if key not in known:
                raise SuiteError(self._unknown(key, known, name or "suite"))
            if not isinstance(value, known[key]) or (isinstance(value, bool) and known[key] is not bool):
                raise SuiteError(f"{self._where(key)}: {key} = {value!r} has the wrong type")
            if key in ("seeds", "seconds", "memory") and value <= 0:
                raise SuiteError(f"{self._where(key)}: {key} must be > 0, got {value}")

    def _unknown(self, key: str, known: Iterable[str], where: str) -> str:
        close = difflib.get_close_matches(key, known)
        hint = f"did you mean {close[0]}?" if close else f"known: {', '.join(sorted(known))}"
        return f"{self._where(key)}: {where} has no key {key!r}; {hint}"

    def _where(self, word: str) -> str:
        pattern = re.compile(rf"(?<![\w-]){re.escape(word)}(?![\w-])")
        lines = (number for number, line in enumerate(self._text.splitlines(), 1) if pattern.search(line))
        return f"{self._path}, line {next(lines, 1)}"


def _sweep(problem: Mapping[str, object]) -> list[dict]:
    """Every combination of the values that are lists."""
    choices = [value if isinstance(value, list) else [value] for value in problem.values()]
    return [dict(zip(problem, combination)) for combination in itertools.product(*choices)]


_FINGERPRINTS: dict[frozenset[str], str] = {}


def _fingerprint(modules: frozenset[str]) -> str:
    if modules not in _FINGERPRINTS:  # the same for thousands of cells
        _FINGERPRINTS[modules] = fingerprint(sorted(modules))
    return _FINGERPRINTS[modules]
