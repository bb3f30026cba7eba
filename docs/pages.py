"""Pages of results: templates that scripts fill with what they measure.

    python docs/pages.py filters loihi      # measures, and writes docs/filters.md and docs/loihi.md
    python docs/pages.py --check            # fails for pages edited since they were made; lists older ones
    python docs/pages.py --stamp filters    # accepts an edit of a page

A page ends with a stamp: its command, the commit that made it, a fingerprint of the code and assets that it
was made by, and a digest of its text and pictures. The page NAME is docs/NAME.template.md, filled with what
the function `values` of its script returns; of README.md the script writes the part from `BLOCK` to the
stamp.
"""

import argparse
import re
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import matplotlib
from matplotlib.figure import Figure
from PIL import Image

from quadsim.dataset.figures import STYLE
from quadsim.runs.fingerprint import closure, content_digest, file_digest, fingerprint
from quadsim.runs.record import commit

ROOT = Path(__file__).parents[1]
SCRIPTS = {
    "simulator": "simulator",
    "filters": "filters",
    "circuit": "circuit",
    "training": "training_page",
    "loihi": "loihi",
    "deploy": "deploy",
    "verdict": "verdict",
    "closed-loop": "closed_loop",
    "control": "control_page",
    "logs": "logs",
    "identify": "identify",
    "speed": "speed",
    "paper": "paper_page",
    "README": "readme",
}
"""Pages, and the module that makes each."""
BLOCK = "<!-- results -->\n"
STAMP = re.compile(
    r"(?P<older>\*Made at commit [\w-]+; the code has changed since\.\*\n\n)?"
    r"<!-- made by: (?P<command>[^;]+); commit (?P<commit>[\w-]+); "
    r"code (?P<code>\w+); text (?P<text>\w+) -->\n"
)
KEY = re.compile(r"\{([a-z][a-z0-9_:-]*)\}")
PICTURE = re.compile(r"\]\((img/[^)]+)\)")
LENGTH = 12
"""Hexadecimal digits of a digest."""

Parts = Mapping[str, str | Sequence[str]]
"""For each {key} of a template a text, or the rows of a table."""


class Page(NamedTuple):
    """A page, its script and its pictures."""

    name: str
    root: Path = ROOT

    @property
    def path(self) -> Path:
        """The page's file."""
        return self.root / ("README.md" if self.name == "README" else f"docs/{self.name}.md")

    @property
    def template(self) -> Path:
        """What `write` fills."""
        return self.root / f"docs/{self.name}.template.md"

    @property
    def code(self) -> str:
        """Fingerprint of the script with all that it imports, of the template, assets and scenarios."""
        files = closure([self.root / f"docs/{SCRIPTS[self.name]}.py"], self.root)
        files |= {self.template, *self.root.glob("assets/**/*"), *self.root.glob("scenarios/*.toml")}
        files |= {*self.root.glob("estimators/filters/**/*.py")}  # which are imported by name
        digests = {
            file.relative_to(self.root).as_posix(): file_digest(file) for file in files if file.is_file()
        }
        return fingerprint(digests)[:LENGTH]

    def digest(self, body: str) -> str:
        """Digest of a page's text and pictures."""
        pictures = [self.root / "docs" / each for each in PICTURE.findall(body)]
        there = [content_digest(each.read_bytes()) if each.is_file() else "missing" for each in pictures]
        return fingerprint(body, *there)[:LENGTH]

    def write(self, parts: Parts) -> None:
        """Fill the template, or the README's part, and stamp it.

        Raises:
            ValueError: Keys of the template and parts do not agree.
        """
        if self.name == "README":
            before, _, after = split(self.path.read_text("utf-8"))
            body = f"\n{_text(parts['results'])}\n\n"
        else:
            before, body, after = "", self.template.read_text("utf-8").rstrip("\n") + "\n\n", ""
            keys = set(KEY.findall(body))
            if keys != set(parts):
                raise ValueError(
                    f"{self.template.name}: {', '.join(sorted(keys ^ set(parts)))}: key or part alone"
                )
            body = KEY.sub(lambda key: _text(parts[key[1]]), body)
        stamp = _stamp(f"python docs/pages.py {self.name}", commit(), self.code, self.digest(body))
        self.path.write_text(f"{before}{body}{stamp}{after}", "utf-8")

    def restamp(self) -> None:
        """Accept the text as it is; it says so if it is older than its code."""
        text = self.path.read_text("utf-8")
        found = read_stamp(self.path)
        before, body, after = split(text)
        older = f"*Made at commit {found['commit']}; the code has changed since.*\n\n"
        stamp = _stamp(found["command"], found["commit"], found["code"], self.digest(body))
        self.path.write_text(f"{before}{body}{older * (found['code'] != self.code)}{stamp}{after}", "utf-8")

    def save(self, figure: Figure, name: str, *, dpi: int = 130, colours: int = 96) -> None:
        """Write a figure into docs/img; line drawings need few colours."""
        path = self.root / "docs" / "img" / name
        figure.savefig(path, dpi=dpi)
        reduce_colours(path, colours)


def reduce_colours(path: Path, colours: int) -> None:
    """Write a PNG again with few colours."""
    image = Image.open(path).convert("P", palette=Image.Palette.ADAPTIVE, colors=colours)
    image.save(path, optimize=True)


def read_stamp(path: Path) -> re.Match[str]:
    """The stamp of a page.

    Raises:
        ValueError: There is none.
    """
    found = STAMP.search(path.read_text("utf-8"))
    if found is None:
        raise ValueError(f"{path.name}: no stamp")
    return found


def split(text: str) -> tuple[str, str, str]:
    """What a page has before the part that is measured, that part, and what is after its stamp."""
    stamp = STAMP.search(text)
    end, after = (stamp.start(), text[stamp.end() :]) if stamp else (len(text), "")
    before, mark, body = text[:end].rpartition(BLOCK)
    return before + mark, body, after


def row(*cells: object) -> str:
    """A line of a table."""
    return "| " + " | ".join(map(str, cells)) + " |"


def confirmed(claim: str, value: float, most: float = 0) -> float:
    """A number that a page publishes, which the page claims to be `most` or less.

    Raises:
        ValueError: It is larger, or not a number.
    """
    if not value <= most:
        raise ValueError(f"{claim}: {value:g}, should be at most {most:g}")
    return value


def check(pages: Sequence[Page]) -> list[str]:
    """Pages that were edited since they were made; prints those that are older than their code."""
    edited = []
    for page in pages:
        text = page.path.read_text("utf-8")
        stamp = STAMP.search(text)
        if stamp is None or page.digest(split(text)[1]) != stamp["text"]:
            edited.append(f"{page.path.name}: edited since it was made; python docs/pages.py {page.name}")
        elif stamp["code"] != page.code:
            print(f"{page.path.name}: made at {stamp['commit']}, older than its code")
    return edited


def _stamp(command: str, commit: str, code: str, text: str) -> str:
    return f"<!-- made by: {command}; commit {commit}; code {code}; text {text} -->\n"


def _text(part: str | Sequence[str]) -> str:
    return part if isinstance(part, str) else "\n".join(part)


def main(arguments: Sequence[str] | None = None) -> int:
    """Make pages, or check them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(SCRIPTS))
    parser.add_argument("--check", action="store_true", help="all pages; exit status 1 if any was edited")
    parser.add_argument("--stamp", action="store_true", help="accept edits of the named pages")
    parser.add_argument("--data", type=Path, default=ROOT / "data", help="simulated flights")
    parser.add_argument("--recordings", type=Path, default=ROOT / "data" / "recordings", help="real flights")
    parser.add_argument("--run", type=Path, default=ROOT / "runs" / "paper", help="finished run of the paper")
    parser.add_argument("--rounds", type=int, default=9, help="turns of what is timed")
    given = parser.parse_args(arguments)
    if unknown := set(given.names) - set(SCRIPTS):
        parser.error(f"no page {', '.join(unknown)}; there are {', '.join(SCRIPTS)}")
    for page in map(Page, given.names):
        if given.stamp:
            page.restamp()
        else:
            with matplotlib.rc_context(STYLE):
                page.write(import_module(SCRIPTS[page.name]).values(page, given))
    edited = check([Page(name) for name in SCRIPTS]) if given.check else []
    print(*edited, sep="\n", end="\n" if edited else "")
    return int(bool(edited))


if __name__ == "__main__":
    sys.exit(main())
