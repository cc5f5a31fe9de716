"""IPython extension that records every claim of a page, with its margin, instead of stopping at the first that fails.

``assert a < b`` becomes a record of the text, whether it holds, the two values and their distance; so do the members
of ``and``, and comparisons of arrays under ``all()``. Convergence warnings are recorded too. The records are lines of
JSON in the file that the environment variable ``FMSYNC_CLAIMS`` names.
"""

import ast
import json
import operator
import os
import warnings

import numpy as np
from IPython.core.interactiveshell import InteractiveShell

_ORDER = {"Lt": operator.lt, "LtE": operator.le, "Gt": operator.gt, "GtE": operator.ge}
_OTHER = {"Eq": operator.eq, "NotEq": operator.ne, "In": lambda a, b: a in b, "NotIn": lambda a, b: a not in b}
_OTHER |= {"Is": operator.is_, "IsNot": operator.is_not}


class Claims(ast.NodeTransformer):
    """Replaces each ``assert`` by calls of ``__claim__``."""

    def visit_Assert(self, node: ast.Assert) -> list[ast.Expr]:
        is_and = isinstance(node.test, ast.BoolOp) and isinstance(node.test.op, ast.And)
        parts = node.test.values if is_and else [node.test]
        calls = (ast.copy_location(ast.Expr(self._call(part)), node) for part in parts)
        return [ast.fix_missing_locations(call) for call in calls]

    def _call(self, test: ast.expr) -> ast.Call:
        comparison, reduce = test, None
        match test:
            case ast.Call(func=ast.Attribute(value=ast.Compare() as comparison, attr="all")):
                reduce = "all"
        if isinstance(comparison, ast.Compare):
            operands = [comparison.left, *comparison.comparators]
            names = [type(op).__name__ for op in comparison.ops]
        else:
            operands, names = [test], []
        arguments = [ast.Constant(ast.unparse(test)), ast.List(operands, ast.Load())]
        arguments += [ast.Constant(tuple(names)), ast.Constant(reduce)]
        return ast.Call(ast.Name("__claim__", ast.Load()), arguments, [])


def check(text: str, operands: list, names: tuple[str, ...], reduce: str | None) -> dict:
    """The record of one claim.

    >>> check("1 < 3", [1, 3], ("Lt",), None)
    {'claim': '1 < 3', 'holds': True, 'values': [1.0, 3.0], 'margin': 2.0}
    """
    if not names:
        return {"claim": text, "holds": bool(operands[0]), "values": [], "margin": None}
    holds, margins = True, []
    for name, left, right in zip(names, operands, operands[1:]):
        answer = (_ORDER | _OTHER)[name](left, right)
        holds = holds and bool(np.all(answer) if reduce else answer)
        if name in _ORDER:
            gap = _numbers(right) - _numbers(left) if name.startswith("L") else _numbers(left) - _numbers(right)
            margins.append(float(np.min(gap)))
    values = [float(_numbers(x).flat[0]) if _numbers(x).size == 1 else None for x in operands] if margins else []
    return {"claim": text, "holds": holds, "values": values, "margin": min(margins, default=None)}


def _numbers(x) -> np.ndarray:
    try:
        return np.asarray(x, dtype=float)
    except (TypeError, ValueError):
        return np.array(np.nan)


def load_ipython_extension(shell: InteractiveShell) -> None:
    """Record the claims and the convergence warnings of this kernel."""
    path = os.environ["FMSYNC_CLAIMS"]

    def write(record: dict) -> None:
        with open(path, "a", encoding="utf-8") as file:
            file.write(json.dumps(record) + "\n")

    told = warnings.showwarning

    def showwarning(message: Warning | str, category: type[Warning], *rest, **more) -> None:
        if category.__name__ == "ConvergenceWarning":
            write({"warning": str(message)})
        told(message, category, *rest, **more)

    warnings.showwarning = showwarning
    warnings.simplefilter("always", category=UserWarning, append=True)
    shell.user_ns["__claim__"] = lambda *arguments: write(check(*arguments))
    shell.ast_transformers.append(Claims())
