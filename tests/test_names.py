"""Names: one public function or class of a name in the packages, so that a search finds the right one."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("quadsim", "estimators", "scenarios", "training", "paper")
PARALLEL = ("estimators/filters/", "quadsim/cli/")
"""Filters have kernels of the same names, and a verb has the name of the function that it calls."""


def test_a_public_name_is_defined_once():
    places = defaultdict(list)
    for file in (file for package in PACKAGES for file in (ROOT / package).rglob("*.py")):
        where = file.relative_to(ROOT).as_posix()
        for node in [] if where.startswith(PARALLEL) else ast.parse(file.read_text("utf-8")).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(where)
    assert {name: files for name, files in places.items() if len(files) > 1} == {}
