"""Checks of arguments: each raises a ValueError that names the argument and says what was expected.

:func:`checked` makes them at the border of the library, from the annotations of a function and a few words on shapes.
Loops inside the library call the :func:`unchecked` form of a function.
"""

import functools
import inspect
import os
import re
import types
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import Any, TypeVar, Union, cast, get_args, get_origin

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import connected_components

Function = TypeVar("Function", bound=Callable[..., Any])
Rule = str | tuple[str, ...] | Callable[[str, Any], Any]
Sizes = dict[str, int]  # what the letters of shapes stand for in one call
Test = Callable[[str, Any, Sizes], Any]  # of a name and a value; returns the value to use

_ORTHOGONALITY_TOLERANCE = 1e-6
_ARRAY_LIKE = set(get_args(ArrayLike))
_SEQUENCES = {list, tuple, Sequence, Iterable}  # whose items a rule is for
_SIZES = {"N": "n_nodes", "n": "n", "E": "n_edges", "V": "n_vertices"}  # letters, and what objects call them
_NAMES = {"N": "the nodes ", "V": "the vertices "}


def checked(**rules: Rule) -> Callable[[Function], Function]:
    """Decorator: arguments that are given are tested; arrays, counts and numbers are passed on as such.

    Annotations tell the types: an ``int`` is a count >= 1, one that may be a generator is a seed. A rule is another
    check (name, value), the bound of a count, such as ``"N >= 2"`` or ``"< N"``, or the shape of an array in words:
    ``"... N n n"``, where ``...`` are leading axes, a letter has one value in all arguments (N, n and E those of a
    problem, V that of a shape) and small ones are not 0; behind it ``rotations``, ``skew``, or ``< N`` for integers;
    or the words (in a tuple) that a text may be.
    """

    def decorate(function: Function) -> Function:
        parameters = inspect.signature(function).parameters
        assert rules.keys() <= parameters.keys(), f"{function.__name__}: a rule without its argument"
        named = [p for p in parameters.values() if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]
        tests = [(k, p.name, p.default, _test(p.annotation, rules.get(p.name))) for k, p in enumerate(named)]

        def passed(given: tuple[Any, ...], options: dict[str, Any]) -> list[Any]:
            positional, sizes = list(given), Sizes()
            for k, name, default, test in tests:
                if k < len(positional):
                    positional[k] = test(name, positional[k], sizes)
                elif name in options and options[name] is not default:
                    options[name] = test(name, options[name], sizes)
            return positional

        def wrapper(*args: Any, **kwargs: Any) -> Any:
            return function(*passed(args, kwargs), **kwargs)

        # with the globals of the function, by which doctest tells where it belongs
        home = getattr(inspect.unwrap(function), "__globals__", {})
        outer = types.FunctionType(wrapper.__code__, home, closure=wrapper.__closure__)
        return cast(Function, functools.update_wrapper(outer, function))

    return decorate


def unchecked(function: Function) -> Function:
    """The function without the tests of :func:`checked`, for arguments that are known to be sound."""
    return cast(Function, inspect.unwrap(function))


def _test(annotation: Any, rule: Rule | None) -> Test:
    """The test of an annotation: an instance of its classes, or what can be converted to its other types."""
    union = get_origin(annotation) in (Union, types.UnionType)
    kinds = set(get_args(annotation) if union else [annotation])
    kinds = kinds - _ARRAY_LIKE | {np.ndarray} if kinds >= _ARRAY_LIKE else kinds
    origins = {get_origin(kind) or kind: kind for kind in kinds}
    classes = tuple(os.PathLike if kind is Path else kind for kind in origins if kind not in _CONVERTED)
    rule = _seed if np.random.Generator in origins and int in origins else rule
    if callable(rule) and not {*origins} - {types.NoneType} <= _SEQUENCES:
        convert: Test | None = functools.partial(_apply, rule)
    else:
        convert = next((_CONVERTED[kind](origins[kind], rule) for kind in _CONVERTED if kind in origins), None)
    if {Any, object, inspect.Parameter.empty} & kinds:
        return lambda name, value, sizes: _with_sizes(value, sizes)
    expected = " or ".join(kind.__name__ for kind in classes if kind is not types.NoneType)

    def test(name: str, value: Any, sizes: Sizes) -> Any:
        if isinstance(value, str) and isinstance(rule, tuple):
            one_of(name, value, rule)
        if isinstance(value, classes):
            return _with_sizes(value, sizes)
        if convert is None:
            made = "; fmsync.Shape(vertices, faces) and fmsync.adapters make one" * (expected == "Shape")
            raise ValueError(f"{name}: expected {expected}, got {type(value).__name__}{made}")
        return convert(name, value, sizes)

    return test


def _apply(rule: Callable[[str, Any], Any], name: str, value: Any, sizes: Sizes) -> Any:
    return rule(name, value)


def _with_sizes(value: Any, sizes: Sizes) -> Any:
    problem = getattr(value, "problem", value)
    told = {letter: getattr(problem, field, None) for letter, field in _SIZES.items()}
    sizes.update({letter: size for letter, size in told.items() if isinstance(size, int)})
    return value


def _array_test(kind: Any, rule: Rule | None) -> Test:
    found = re.fullmatch(r"(.*?)(?: (rotations|skew)| < (\w+))?", str(rule or "..."))
    assert found is not None
    shape, kind, below = found.groups()
    letters = shape.split()

    def test(name: str, value: Any, sizes: Sizes) -> np.ndarray:
        values = _fitting(name, array(name, value) if below is None else _integers(name, value), letters, sizes)
        if kind == "rotations":
            rotations(name, values, "matrix")
        elif kind == "skew":
            rest = np.abs(values + np.swapaxes(values, -1, -2)).max(initial=0)
            if rest > _ORTHOGONALITY_TOLERANCE * max(1.0, np.abs(values).max(initial=0)):
                raise ValueError(f"{name}: not skew-symmetric, off by {rest:.2g}; take fmsync.so.skew of it")
        elif below in sizes:
            _inside(name, values, sizes[below], _NAMES.get(below, ""))
        return values

    return test


def _inside(name: str, values: np.ndarray, size: int, what: str) -> np.ndarray:
    if len(bad := np.argwhere((values < 0) | (values >= size))):
        raise ValueError(f"{name}[{bad[0][0]}] = {values[tuple(bad[0])]} is outside {what}0..{size - 1}")
    return values


def _count_test(kind: Any, rule: Rule | None) -> Test:
    found = re.fullmatch(r"(?:(\w+) )?(>=|<) (\w+)", str(rule or ">= 1"))
    assert found is not None
    letter, sign, bound = found.groups()

    def test(name: str, value: Any, sizes: Sizes) -> int:
        number = count(name, value, int(bound) if sign == ">=" else 0)
        if sign == "<" and number >= sizes.get(bound, np.inf):
            raise ValueError(f"{name}: {value} is outside 0..{sizes[bound] - 1}")
        if letter:
            sizes[letter] = number
        return number

    return test


def _sequence_test(kind: Any, rule: Rule | None) -> Test:
    inner = get_args(kind)
    test_one, fixed = _test(inner[0], rule), len(inner) if len(set(inner)) == 1 < len(inner) else None

    def test(name: str, value: Any, sizes: Sizes) -> Any:
        if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
            raise ValueError(f"{name}: expected a sequence, got {type(value).__name__}")
        if not isinstance(value, Sequence | np.ndarray):
            return value  # goes through its items once
        if fixed is not None and len(value) != fixed:
            raise ValueError(f"{name}: expected {fixed} values, got {len(value)}")
        items = [test_one(f"{name}[{k}]", item, dict(sizes)) for k, item in enumerate(value)]
        return tuple(items) if isinstance(value, tuple) else items

    return test


def plain(name: str, value: object) -> np.ndarray:
    """An array of whatever kind, but neither masked nor ragged."""
    if isinstance(value, np.ma.MaskedArray):
        raise ValueError(f"{name}: a masked array; fill or leave out what is masked")
    try:
        return np.asarray(value)
    except (ValueError, TypeError):
        raise ValueError(f"{name}: not one array of numbers; its rows must have equal lengths") from None


def _integers(name: str, value: object) -> np.ndarray:
    found = plain(name, value)
    if found.size and found.dtype.kind not in "iu":
        raise ValueError(f"{name}: must hold integers, got {found.dtype} of shape {found.shape}")
    return found.astype(np.int64, copy=False)


def _fitting(name: str, values: np.ndarray, letters: list[str], sizes: Sizes) -> np.ndarray:
    """Refuse other shapes, and remember the sizes of letters that are new."""
    axes = list(values.shape)
    fits, own = len(axes) == len(letters), letters
    if "..." in letters:
        k, own = letters.index("..."), [letter for letter in letters if letter != "..."]
        fits, axes = len(axes) >= len(own), axes[:k] + axes[len(axes) - len(own) + k :]
    known = {letter: sizes[letter] for letter in own if letter in sizes}
    for letter, size in zip(own, axes):
        wanted = int(letter) if letter.isdigit() else sizes.setdefault(letter, size)
        fits = fits and size == wanted and (size > 0 or letter.isupper())
    if not fits:
        where = " with " * bool(known) + ", ".join(f"{letter} = {size}" for letter, size in known.items())
        comma = "," * (len(letters) == 1)
        raise ValueError(f"{name}: expected ({', '.join(letters)}{comma}){where}, got shape {values.shape}")
    return values


def real(name: str, value: object) -> np.ndarray:
    """Real numbers of any shape, NaN and infinity among them, in single precision if they are, else in double."""
    found = plain(name, value)
    if found.dtype.kind not in "biuf":
        raise ValueError(f"{name}: expected real numbers, got {found.dtype}")
    return found if found.dtype in (np.float32, np.float64) else found.astype(float)


def array(name: str, value: object) -> np.ndarray:
    """Finite :func:`real` numbers."""
    found = real(name, value)
    if not np.isfinite(found).all():
        bad = np.argwhere(~np.isfinite(found))
        raise ValueError(f"{name}: entry {bad[0].tolist()} is not finite ({len(bad)} such entries)")
    return found


def _seed(name: str, value: Any) -> Any:
    items = value if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str) and len(value) else [value]
    if not all(isinstance(k, int | np.integer) and not isinstance(k, bool) and k >= 0 for k in items):
        raise ValueError(f"{name}: expected a seed (an integer >= 0) or a numpy.random.Generator, got {value!r}")
    return value


def flag(name: str, value: object) -> bool:
    """True or False."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name}: expected True or False, got {value!r}")
    return bool(value)


def _number(name: str, value: object, what: str, holds: Callable[[float], bool]) -> float:
    value = value.item() if isinstance(value, np.ndarray) and value.ndim == 0 else value
    if isinstance(value, bool) or not (isinstance(value, Real) and np.isfinite(float(value)) and holds(float(value))):
        raise ValueError(f"{name}: {what}, got {value!s}")
    return float(value)


# of a name and a value: a finite number, as a float
number = functools.partial(_number, what="must be a finite number", holds=lambda x: True)
positive = functools.partial(_number, what="must be finite and > 0", holds=lambda x: x > 0)
not_negative = functools.partial(_number, what="must be finite and >= 0", holds=lambda x: x >= 0)
probability = functools.partial(_number, what="must lie strictly between 0 and 1", holds=lambda x: 0 < x < 1)
share = functools.partial(_number, what="must lie in (0, 1]", holds=lambda x: 0 < x <= 1)


def count(name: str, value: object, least: int = 1) -> int:
    """A whole number >= ``least``."""
    whole = _number(name, value, f"an integer >= {least}", lambda x: x == int(x) and x >= least)
    return int(value) if isinstance(value, int | np.integer) else int(whole)


def one_of(name: str, value: object, choices: Collection[str]) -> None:
    """One of some names."""
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"{name}: {' or '.join(map(repr, choices))}, not {value!r}")


def unused(because: str, **given: tuple[object, object]) -> None:
    """Refuse options (value, default) that something else makes meaningless."""
    for name, (value, default) in given.items():
        if value != default:
            raise ValueError(f"{name}: has no meaning {because}; leave it out")


def indices(name: str, values: object, size: int, what: str = "vertices") -> np.ndarray:
    """Integers (K,) from 0 to ``size`` - 1."""
    array = plain(name, values)
    if array.ndim != 1 or (array.size and not np.issubdtype(array.dtype, np.integer)):
        raise ValueError(f"{name}: must be a row of integers, got {array.dtype} of shape {array.shape}")
    return _inside(name, array, size, f"the {what} ")


def edge_weights(weights: ArrayLike | None, edges: np.ndarray) -> np.ndarray:
    """Positive numbers (E,), a copy; ones by default."""
    array = np.ones(len(edges)) if weights is None else np.array(real("weights", weights), dtype=float)
    if array.shape != (len(edges),):
        raise ValueError(f"weights: expected ({len(edges)},), got {array.shape}")
    if (bad := np.flatnonzero(~((array > 0) & np.isfinite(array)))).size:
        raise ValueError(f"weights: {edge_name(edges, bad[0])} has weight {array[bad[0]]}; must be > 0")
    return array


def edge_name(edges: np.ndarray, e: int) -> str:
    """What messages call an edge: its number and its ends."""
    return f"edge {e} ({edges[e, 0]}, {edges[e, 1]})"


def set_fields(instance: object, **fields: object) -> None:
    """Set fields of a frozen dataclass, whose arrays are read-only from now on."""
    for name, value in fields.items():
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
        object.__setattr__(instance, name, value)


def rotations(name: str, c: np.ndarray, each: str = "node") -> None:
    """Rotations (..., n, n), up to an error of 1e-6 in every entry of CᵀC; messages number them as ``each``."""
    c = c.reshape(-1, *c.shape[-2:])
    if not np.isfinite(c).all():
        raise ValueError(f"{name}: {each} {np.flatnonzero(~np.isfinite(c).all((1, 2)))[0]} holds NaN or infinity")
    rest = np.abs(np.swapaxes(c, -1, -2) @ c - np.eye(c.shape[-1])).max((1, 2))
    tolerance = max(_ORTHOGONALITY_TOLERANCE, 100 * np.finfo(c.dtype).eps)
    if (bad := np.flatnonzero((rest > tolerance) | (np.linalg.det(c) < 0))).size:
        raise ValueError(f"{name}: {each} {bad[0]} is not a rotation; project it first with fmsync.so.project")


def connected_edges(n_nodes: int, edges: ArrayLike) -> np.ndarray:
    """Edges (E, 2) of a connected graph without self-loops, a copy as int64."""
    n_nodes, array = count("n_nodes", n_nodes, least=2), np.array(_integers("edges", edges))
    if array.ndim != 2 or array.shape[1] != 2 or len(array) == 0:
        raise ValueError(f"edges: expected (E, 2) with E >= 1, got shape {array.shape}")
    if (bad := np.flatnonzero(((array < 0) | (array >= n_nodes)).any(axis=1))).size:
        raise ValueError(f"edges: {edge_name(array, bad[0])} is out of range for {n_nodes} nodes")
    if (bad := np.flatnonzero(array[:, 0] == array[:, 1])).size:
        raise ValueError(f"edges: {edge_name(array, bad[0])} is a self-loop; remove it")
    graph = sp.coo_array((np.ones(len(array)), array.T), shape=(n_nodes, n_nodes))
    n_parts, part_of = connected_components(graph, directed=False)
    if n_parts > 1:
        parts = [np.flatnonzero(part_of == k).tolist() for k in range(n_parts)]
        shown = [str(part[:8])[1:-1] + " ..." * (len(part) > 8) for part in parts[:6]]
        told = "; ".join(shown) + " ..." * (len(parts) > 6)
        todo = "add edges between them or solve each on its own"
        raise ValueError(f"edges: the graph falls into {len(parts)} components ({told}); {todo}")
    return array


# What annotations are converted to, and by which test; of two that apply the first.
_CONVERTED: dict[Any, Callable[[Any, Rule | None], Test]] = {
    np.ndarray: _array_test,
    float: lambda kind, rule: functools.partial(_apply, number),
    int: _count_test,
    bool: lambda kind, rule: functools.partial(_apply, flag),
    **dict.fromkeys(_SEQUENCES, _sequence_test),
}
