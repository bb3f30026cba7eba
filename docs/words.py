"""Words to avoid in prose and docstrings: `python docs/words.py` lists each, and fails where there is one."""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
AVOIDED = re.compile(
    r"\b(amiss|anew|breath|hangs? together|is gone|is wanted|knees?|leant|likewise|nobody|revive|"
    r"that there (?:are|is)|told|untrue|what came of)\b",
    re.IGNORECASE,
)
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
FOLDERS = ("quadsim", "estimators", "training", "scenarios", "paper", "docs", "examples", "assets")


def docstrings(file: Path) -> Iterator[tuple[int, str]]:
    """The lines and texts of all docstrings, those of attributes included."""
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            yield node.lineno, str(node.value.value)


def prose(file: Path) -> Iterator[tuple[int, str]]:
    """A page without its code, whose lines stay."""
    yield 1, FENCE.sub(lambda found: "\n" * found[0].count("\n"), file.read_text("utf-8"))


def found(root: Path = ROOT) -> list[str]:
    """Where such a word stands: file, line, word."""
    pages = [file for file in root.glob("*.md") if file.name != "CHANGELOG.md"]
    files = [*pages, *(file for name in FOLDERS for file in (root / name).rglob("*.*"))]
    lines = []
    for file in sorted(files):
        texts = {".py": docstrings, ".md": prose}.get(file.suffix, lambda _: ())
        for start, text in texts(file):
            for word in AVOIDED.finditer(text):
                line = start + text[: word.start()].count("\n")
                lines.append(f"{file.relative_to(root)}:{line}: {word[0]}")
    return lines


if __name__ == "__main__":
    print(*(lines := found()), sep="\n", end="\n" if lines else "")
    sys.exit(bool(lines))
