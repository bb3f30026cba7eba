"""Counting of operations: an estimator runs from modified Python source that counts its arithmetic.

A separate process imports the estimator with compilation switched off and a modified syntax tree. Each of +,
−, ×, ÷, powers, matrix products and functions such as square roots counts one operation per resulting float.
Operations in compiled packages are not counted.
"""

import ast
import builtins
import importlib.machinery
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
ARITHMETIC = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow)
FUNCTIONS = {
    "sqrt", "sin", "cos", "tan", "arcsin", "arccos", "arctan", "arctan2", "asin", "acos", "atan", "atan2",
    "exp", "log", "hypot", "sum", "mean", "dot", "cross", "prod", "norm",
}  # fmt: skip
"""Counted functions of `math`, `numpy` and `numpy.linalg`; each term of a sum counts."""
SAMPLES = 50
"""Number of samples for which operations are counted, after the same number of other samples."""
LONGEST_S = 60.0

_counted = [0]


def counted_operations(source: str, rate_hz: float) -> float | None:
    """Return the operations of an estimator per sample; None if they cannot be counted."""
    folders = [str(ROOT), *filter(None, sys.path)]
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(folders)}
    command = [sys.executable, "-P", "-B", "-m", __name__, source, str(rate_hz)]
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=LONGEST_S, check=True
        )
        return float(done.stdout.split()[-1])
    except (OSError, subprocess.SubprocessError, ValueError, IndexError):
        return None


class Counting(ast.NodeTransformer):
    """Wraps arithmetic in calls that count."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:  # noqa: D102
        self.generic_visit(node)
        if isinstance(node.op, ast.MatMult):
            return _call("__product__", node.left, node.right)
        return _call("__counted__", node) if isinstance(node.op, ARITHMETIC) else node

    def visit_AugAssign(self, node: ast.AugAssign) -> list[ast.stmt]:  # noqa: D102
        self.generic_visit(node)
        target = ast.parse(ast.unparse(node.target), mode="eval").body
        return [node, ast.Expr(_call("__counted__", target))]

    def visit_Call(self, node: ast.Call) -> ast.AST:  # noqa: D102
        self.generic_visit(node)
        if not (isinstance(node.func, ast.Attribute) and node.func.attr in FUNCTIONS):
            return node
        return ast.Call(ast.Name("__called__", ast.Load()), [node.func, *node.args], node.keywords)


def _call(name: str, *arguments: ast.expr) -> ast.Call:
    return ast.Call(ast.Name(name, ast.Load()), list(arguments), [])


def _floats(value: Any) -> int:
    """Return the number of floats in a value."""
    if isinstance(value, float):
        return 1
    return value.size if getattr(getattr(value, "dtype", None), "kind", "") == "f" else 0


def _count(value: Any) -> Any:
    _counted[0] += _floats(value)
    return value


def _product(left: Any, right: Any) -> Any:
    found = left @ right
    _counted[0] += 2 * _floats(found) * left.shape[-1]
    return found


def _called(function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    found = function(*arguments, **options)
    _counted[0] += max(map(_floats, (found, *arguments)))
    return found


def _main(source: str, rate_hz: float) -> None:
    """Print the operations per sample."""
    builtins.__dict__.update(__counted__=_count, __product__=_product, __called__=_called)
    loader = importlib.machinery.SourceFileLoader
    compile_plainly = loader.source_to_code

    def source_to_code(self: Any, data: Any, path: Any, **options: Any) -> Any:
        file = Path(os.fsdecode(path))
        product = file.is_relative_to(ROOT) and file.relative_to(ROOT).parts[0] not in (
            "estimators",
            "examples",
        )
        foreign = product or not file.is_absolute() or "site-packages" in file.parts or "lib" in file.parts
        if foreign and file != ROOT / "quadsim" / "rotation.py":
            return compile_plainly(self, data, path, **options)
        tree = ast.fix_missing_locations(Counting().visit(ast.parse(data)))
        return compile(tree, path, "exec", dont_inherit=True)

    loader.source_to_code = source_to_code  # pyright: ignore[reportAttributeAccessIssue]
    loader.path_stats = _no_cache  # pyright: ignore[reportAttributeAccessIssue]
    import numpy as np

    from estimators import create
    from estimators.filters.driver import CompiledFilter

    def run_records(self: Any, gyro: Any, accel: Any, rotors: Any) -> Any:
        records = (each.view(np.recarray) for each in (self.state, self._samples, self._params))
        self.run(*records, self._dt, gyro, accel, rotors, out := np.empty((len(gyro), gyro.shape[1], 2)))
        return out

    CompiledFilter._run = run_records  # whose records have fields as attributes in compiled code alone
    made = create(source, rate_hz, vehicle="hummingbird")
    made.reset(1)
    for k in range(2 * SAMPLES):
        if k == SAMPLES:
            _counted[0] = 0
        swing = np.sin(0.1 * k + np.arange(6.0))
        made.update(0.3 * swing[None, :3], swing[None, 3:] + [[0.0, 0.0, 9.81]])
    print(_counted[0] / SAMPLES)


def _no_cache(self: Any, path: str) -> Any:
    """Compiled files of unchanged source are not read."""
    raise OSError


if __name__ == "__main__":
    sys.path += [] if os.getcwd() in sys.path else [os.getcwd()]
    _main(sys.argv[1], float(sys.argv[2]))
