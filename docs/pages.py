"""Measured parts of pages: templates that scripts fill with measurements.

    python docs/pages.py filters loihi      # measures, and writes these parts of their pages
    python docs/pages.py --check            # fails for parts edited since they were made; lists older ones
    python docs/pages.py --stamp filters    # accepts an edit of a part

The template of part NAME is docs/parts/NAME.md. A function returns the tables and sentences that fill it. In
its page, the part is between the line <!-- part NAME --> and its stamp. The stamp contains the command, the
commit, a fingerprint of code and assets, and a digest of text and pictures.
"""

import argparse
import re
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from math import isnan
from pathlib import Path
from typing import NamedTuple

import matplotlib
import pandas as pd
from matplotlib.figure import Figure
from PIL import Image

from quadsim.dataset.figures import STYLE
from quadsim.runs.fingerprint import closure, content_digest, file_digest, fingerprint
from quadsim.runs.record import commit

ROOT = Path(__file__).parents[1]
PARTS = {
    "README": ("README.md", "errors.readme"),
    "verdict": ("docs/results.md", "closed_loop.held_out"),
    "closed-loop": ("docs/results.md", "closed_loop.suite"),
    "recordings": ("docs/results.md", "errors.recordings"),
    "control": ("docs/results.md", "controllers.controllers"),
    "simulator": ("docs/simulator.md", "simulator.theory"),
    "identify": ("docs/simulator.md", "simulator.identification"),
    "filters": ("docs/filters.md", "filters.filters"),
    "circuit": ("docs/networks.md", "circuit.circuit"),
    "training": ("docs/networks.md", "layers.errors_and_training"),
    "loihi": ("docs/chip.md", "layers.chip"),
    "deploy": ("docs/chip.md", "cortex.microcontrollers"),
    "speed": ("docs/speed.md", "speed.speed"),
    "paper": ("docs/paper.md", "errors.paper"),
    "betaflight": ("docs/betaflight.md", "autopilots.betaflight"),
}
"""Parts, the page that each stands in, and the script and function that measure it."""
STAMP = re.compile(
    r"(?P<older>\*[^*\n]+ at commit [\w-]+[^*\n]* has changed since[^*\n]*\*\n\n)?"
    r"<!-- made by: (?P<command>[^;]+); commit (?P<commit>[\w-]+); "
    r"code (?P<code>\w+); text (?P<text>\w+) -->\n"
)
KEY = re.compile(r"\{([a-z][a-z0-9_:-]*)\}")
PICTURE = re.compile(r"\]\((img/[^)]+)\)")
LENGTH = 12
"""Hexadecimal digits of a digest."""

Row = tuple[object, ...]
Value = str | Sequence[str] | Sequence[Row] | pd.DataFrame
Values = Mapping[str, Value]
"""For each {key} of a template a text, lines, rows of a table whose heading it has, or a table."""


class Part(NamedTuple):
    """A part of a page, its script and its pictures."""

    name: str
    root: Path = ROOT

    @property
    def path(self) -> Path:
        """The page that the part stands in."""
        return self.root / PARTS[self.name][0]

    @property
    def template(self) -> Path:
        """What `write` fills."""
        return self.root / f"docs/parts/{self.name}.md"

    @property
    def code(self) -> str:
        """Fingerprint of the script with all that it imports, of the template, assets and scenarios."""
        files = closure([self.root / f"docs/{PARTS[self.name][1].partition('.')[0]}.py"], self.root)
        files |= {self.template, *self.root.glob("assets/**/*"), *self.root.glob("scenarios/*.toml")}
        files |= {*self.root.glob("estimators/filters/**/*.py")}  # which are imported by name
        digests = {
            file.relative_to(self.root).as_posix(): file_digest(file) for file in files if file.is_file()
        }
        return fingerprint(digests)[:LENGTH]

    def split(self) -> tuple[str, str, re.Match[str] | None, str]:
        """What the page has up to the part, the part's text, its stamp, and what the page has after that.

        Raises:
            ValueError: The page has no mark of this part.
        """
        before, mark, rest = self.path.read_text("utf-8").partition(f"<!-- part {self.name} -->\n")
        if not mark:
            raise ValueError(f"{self.path.name}: no line <!-- part {self.name} -->")
        stamp = STAMP.search(rest.partition("<!-- part ")[0])
        body, after = (rest[: stamp.start()], rest[stamp.end() :]) if stamp else ("", rest)
        return before + mark, body, stamp, after

    def digest(self, body: str) -> str:
        """Digest of the part's text and pictures."""
        pictures = [self.root / "docs" / each for each in PICTURE.findall(body)]
        there = [content_digest(each.read_bytes()) if each.is_file() else "missing" for each in pictures]
        return fingerprint(body, *there)[:LENGTH]

    def measure(self, given: argparse.Namespace) -> Values:
        """What the part's function returns; it draws the pictures, too."""
        script, _, function = PARTS[self.name][1].partition(".")
        with matplotlib.rc_context(STYLE):
            return getattr(import_module(script), function)(self, given)

    def write(self, values: Values, made_at: str) -> None:
        """Fill the template, and stamp the part.

        Raises:
            ValueError: Keys of the template and values do not agree.
        """
        before, _, _, after = self.split()
        template = self.template.read_text("utf-8").rstrip("\n")
        if keys := set(KEY.findall(template)) ^ set(values):
            raise ValueError(f"{self.template.name}: {', '.join(sorted(keys))}: key or value alone")
        body = f"\n{KEY.sub(lambda key: _text(values[key[1]]), template)}\n\n"
        command = f"python docs/pages.py {self.name}"
        stamp = _stamp(command, made_at, self.code, self.digest(body))
        self.path.write_text(f"{before}{body}{stamp}{after}", "utf-8")

    def restamp(self) -> None:
        """Accept the text as it is; it says so if it is older than its code.

        Raises:
            ValueError: The part has no stamp.
        """
        before, body, found, after = self.split()
        if found is None:
            raise ValueError(f"{self.path.name}: part {self.name} has no stamp")
        older = f"*This part was made at commit {found['commit']}. The code has changed since then.*\n\n"
        stamp = _stamp(found["command"], found["commit"], found["code"], self.digest(body))
        text = f"{before}{body}{older * (found['code'] != self.code)}{stamp}{after}"
        self.path.write_text(text, "utf-8")

    def save(self, figure: Figure, name: str, *, dpi: int = 130, colours: int = 96) -> None:
        """Write a figure into docs/img; line drawings need few colours."""
        path = self.root / "docs" / "img" / name
        figure.savefig(path, dpi=dpi)
        reduce_colours(path, colours)


def reduce_colours(path: Path, colours: int) -> None:
    """Write a PNG again with few colours."""
    image = Image.open(path).convert("P", palette=Image.Palette.ADAPTIVE, colors=colours)
    image.save(path, optimize=True)


def number(value: object) -> str:
    """A cell of a table: a float with two decimals, a dash where there is none, anything else as it is."""
    if not isinstance(value, float):
        return str(value)
    return "–" if isnan(value) else f"{value:.2f}"


def span(low: float, high: float) -> str:
    """The ends of an interval."""
    return f"{low:.2f}–{high:.2f}"


def table(frame: pd.DataFrame) -> str:
    """A table under the names of its columns."""
    rows = frame.itertuples(index=False, name=None)
    return "\n".join([row(tuple(frame)), "|---" * frame.shape[1] + "|", *map(row, rows)])


def row(cells: Row) -> str:
    """A line of a table."""
    return f"| {' | '.join(map(number, cells))} |"


def confirmed(claim: str, value: float, most: float = 0) -> float:
    """A number that a page publishes, which the page claims to be `most` or less.

    Raises:
        ValueError: It is larger, or not a number.
    """
    if not value <= most:
        raise ValueError(f"{claim}: {value:g}, should be at most {most:g}")
    return value


def check(parts: Sequence[Part]) -> list[str]:
    """Parts that were edited since they were made; prints those that are older than their code."""
    edited = []
    for part in parts:
        _, body, stamp, _ = part.split()
        where = f"{part.path.name}, part {part.name}"
        if stamp is None or part.digest(body) != stamp["text"]:
            edited.append(f"{where}: edited since it was made; python docs/pages.py {part.name}")
        elif stamp["code"] != part.code:
            print(f"{where}: made at {stamp['commit']}, older than its code")
    return edited


def _stamp(command: str, commit: str, code: str, text: str) -> str:
    return f"<!-- made by: {command}; commit {commit}; code {code}; text {text} -->\n"


def _text(value: Value) -> str:
    if isinstance(value, pd.DataFrame):
        return table(value)
    if isinstance(value, str):
        return value
    return "\n".join(each if isinstance(each, str) else row(each) for each in value)


def main(arguments: Sequence[str] | None = None) -> int:
    """Make parts, or check them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(PARTS))
    parser.add_argument("--check", action="store_true", help="all parts; exit status 1 if any was edited")
    parser.add_argument("--stamp", action="store_true", help="accept edits of the named parts")
    parser.add_argument("--data", type=Path, default=ROOT / "data", help="simulated flights")
    parser.add_argument("--recordings", type=Path, default=ROOT / "data" / "recordings", help="real flights")
    given = parser.parse_args(arguments)
    if unknown := set(given.names) - set(PARTS):
        parser.error(f"no part {', '.join(unknown)}; there are {', '.join(PARTS)}")
    if given.stamp and not given.names:
        parser.error(f"--stamp needs the names of the parts to accept: {', '.join(PARTS)}")
    made_at = commit()  # before pages and pictures change
    for part in map(Part, given.names):
        if given.stamp:
            part.restamp()
        else:
            part.write(part.measure(given), made_at)
    edited = check([Part(name) for name in PARTS]) if given.check else []
    print(*edited, sep="\n", end="\n" if edited else "")
    return int(bool(edited))


if __name__ == "__main__":
    sys.exit(main())
