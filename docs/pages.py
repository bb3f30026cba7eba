"""Pages, figures and tables that scripts make, and whether they are out of date.

    python docs/pages.py --check     # lists what is out of date; exit status 1 if anything is
    python docs/pages.py --remake    # runs the command of each page that is out of date

`pages.toml` names what each page is made from. A page ends with a stamp: the command that makes it, and a
digest of the weights, assets and code that its numbers come from. `pages.lock` holds the digest of each of
them, so that the check can name those that changed. Recordings and the versions of libraries do not count.
"""

import argparse
import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from quadsim.config.toml import Strict, parse
from quadsim.runs.fingerprint import closure, file_digest, fingerprint

ROOT = Path(__file__).parents[1]
STAMP = re.compile(r"made by: (?P<command>[^;]+); digest (?P<digest>[0-9a-f]+)")
LINE = re.compile(rf"<!-- {STAMP.pattern} -->\n?")
KEY = re.compile(r"\{([a-z][a-z0-9_:-]*)\}")
LENGTH = 12
"""Hexadecimal digits of a digest."""
LISTED = 8
"""Names that a line of the check has at most."""
NOTICE = (
    "> Made by code and weights of {made_at}, which have changed since: some numbers are older than they."
)
"""First line of an archived page."""


class Entry(Strict):
    """What `pages.toml` says of one command."""

    command: str
    """Makes the files, from the repository's root."""
    makes: tuple[str, ...]
    """Files, or patterns of them."""
    code: tuple[str, ...]
    """Scripts; all that they import from the project counts too."""
    files: tuple[str, ...] = ()
    """Weights, assets, templates and data, or patterns of them."""
    ignored: tuple[str, ...] = ()
    """Modules that are imported but give no number of this page, or patterns of them."""
    archived: str | None = None
    """Why the files cannot be remade today; then those without a stamp are no failure."""
    made_at: str = ""
    """The commit of archived files."""


class Pages(Strict):
    """The whole of `pages.toml`."""

    ignored: tuple[str, ...] = ()
    """Modules that no number comes from."""
    page: dict[str, Entry]


@dataclass(frozen=True)
class Page:
    """A page with its figures: what one command makes."""

    name: str
    entry: Entry
    ignored: tuple[str, ...] = ()
    root: Path = ROOT

    @cached_property
    def inputs(self) -> dict[str, str]:
        """Digest of each file that the page is made from.

        Raises:
            ValueError: A pattern of `pages.toml` that fits no file.
        """
        code = closure(self._found(self.entry.code), self.root)
        ignored = {self.root / each for each in self.ignored} | {*self._found(self.entry.ignored)}
        files = sorted({*code, *self._found(self.entry.files)} - ignored)
        return {path.relative_to(self.root).as_posix(): file_digest(path)[:LENGTH] for path in files}

    @cached_property
    def digest(self) -> str:
        """One digest of all inputs."""
        return fingerprint(self.inputs)[:LENGTH]

    @property
    def stamp(self) -> str:
        """What the page's files end with, or hold as their comment."""
        return f"made by: {self.entry.command}; digest {self.digest}"

    @property
    def made(self) -> list[Path]:
        """The files that there are of it."""
        return [path for pattern in self.entry.makes for path in sorted(self.root.glob(pattern))]

    @property
    def missing(self) -> list[str]:
        """Patterns of which no file has been made yet."""
        return [pattern for pattern in self.entry.makes if not any(self.root.glob(pattern))]

    def write(self, parts: Mapping[str, str | Sequence[str]]) -> Path:
        """Fill the page's template, stamp it, and note its inputs; the page's path.

        Args:
            parts: For each {key} of the template a text, or the rows of a table.

        Raises:
            ValueError: Keys and parts do not agree.
        """
        source = self.root / f"docs/{self.name}.template.md"
        text = source.read_text()
        keys = set(KEY.findall(text))
        if keys != set(parts):
            raise ValueError(f"{source.name}: {', '.join(sorted(keys ^ set(parts)))}: key or part alone")
        path = self.root / f"docs/{self.name}.md"
        path.write_text(KEY.sub(lambda key: _text(parts[key[1]]), text))
        self.sign(path)
        return path

    def write_block(self, path: Path, name: str, rows: Sequence[str]) -> None:
        """Replace the lines of a page between `<!-- NAME -->` and the stamp.

        Raises:
            ValueError: The page has no such block.
        """
        begin = f"<!-- {name} -->\n"
        block = re.compile(re.escape(begin) + r".*?" + LINE.pattern, re.DOTALL)
        text = path.read_text()
        if not block.search(text):
            raise ValueError(f"{path.name}: no block from {begin.strip()} to a stamp")
        table = "\n".join(rows)
        path.write_text(block.sub(lambda _: f"{begin}\n{table}\n\n<!-- {self.stamp} -->\n", text))
        self.note()

    def sign(self, path: Path) -> None:
        """Stamp a page's last line, and note its inputs."""
        text = LINE.sub("", path.read_text()).rstrip("\n")
        path.write_text(f"{text}\n\n<!-- {self.stamp} -->\n")
        self.note()

    def save(self, figure: Figure, name: str, *, dpi: int = 130, colours: int = 96) -> None:
        """Write a figure into docs/img with the stamp as its comment; line drawings need few colours."""
        path = self.root / "docs" / "img" / name
        figure.savefig(path, dpi=dpi)
        self.sign_image(path, colours)

    def sign_image(self, path: Path, colours: int = 96) -> None:
        """Write a PNG again with few colours and the stamp."""
        comment = PngInfo()
        comment.add_text("Comment", self.stamp)
        image = Image.open(path).convert("P", palette=Image.Palette.ADAPTIVE, colors=colours)
        image.save(path, optimize=True, pnginfo=comment)

    def stale(self) -> list[Path]:
        """Files of it whose stamp is missing or of other inputs."""
        return [path for path in self.made if read_stamp(path) != self.digest]

    def excused(self, path: Path) -> bool:
        """Whether an archived file says that it is one: a page in its first line; figures belong to pages."""
        if self.entry.archived is None or read_stamp(path) is not None:
            return False
        return path.suffix != ".md" or path.read_text().startswith(
            NOTICE.format(made_at=self.entry.made_at) + "\n"
        )

    def changed(self) -> list[str]:
        """Inputs that are new, removed or other than when the page was made."""
        before = read_lock(self.root).get(self.name, {})
        names = sorted({*before, *self.inputs})
        return [name for name in names if before.get(name) != self.inputs.get(name)]

    def note(self) -> None:
        """Write the digests of the inputs into `pages.lock`."""
        lock = read_lock(self.root) | {self.name: self.inputs}
        (self.root / "docs" / "pages.lock").write_text(json.dumps(lock, indent=0, sort_keys=True) + "\n")

    def _found(self, patterns: Sequence[str]) -> list[Path]:
        found = []
        for pattern in patterns:
            files = sorted(self.root.glob(pattern))
            if not files:
                raise ValueError(f"pages.toml: {self.name}: {pattern}: no such file")
            found += files
        return found


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


def _text(part: str | Sequence[str]) -> str:
    return part if isinstance(part, str) else "\n".join(part)


def load_pages(root: Path = ROOT) -> dict[str, Page]:
    """All pages of `docs/pages.toml`, by name."""
    file = root / "docs" / "pages.toml"
    pages = parse(tomllib.loads(file.read_text()), Pages, "docs/pages.toml")
    return {name: Page(name, entry, pages.ignored, root) for name, entry in pages.page.items()}


def load_page(name: str) -> Page:
    """A page, with the digest of its inputs as they are now: take it before the work begins."""
    page = load_pages()[name]
    _ = page.digest
    return page


def read_stamp(path: Path) -> str | None:
    """The digest in a file's stamp, or None if it has none."""
    if path.suffix == ".md":
        found = LINE.search(path.read_text())
    elif path.suffix == ".mp4":
        found = STAMP.search(path.read_bytes().decode("latin-1"))
    else:
        with Image.open(path) as image:
            comment = image.info.get("Comment", image.info.get("comment", ""))
        found = STAMP.search(comment.decode() if isinstance(comment, bytes) else comment)
    return found["digest"] if found else None


def read_lock(root: Path) -> dict[str, dict[str, str]]:
    """Page to the inputs that it was made from, and their digests."""
    file = root / "docs" / "pages.lock"
    return json.loads(file.read_text()) if file.is_file() else {}


def problems(pages: Mapping[str, Page]) -> Iterator[tuple[Page, str]]:
    """Pages that are out of date, each with a line that says what and why."""
    for page in pages.values():
        stale = [path for path in page.stale() if not page.excused(path)]
        if stale or page.missing:
            names = _listed([*page.missing, *(path.relative_to(page.root).as_posix() for path in stale)])
            never = page.name not in read_lock(page.root)
            why = "never stamped" if never else _listed(page.changed()) or "no stamp of these inputs"
            yield page, f"{names}: out of date ({why}); {page.entry.command}"


def archived(pages: Mapping[str, Page]) -> Iterator[str]:
    """A line for each command whose files are archived."""
    for page in pages.values():
        files = [path.relative_to(page.root).as_posix() for path in page.made if page.excused(path)]
        if files:
            yield f"{_listed(files)}: archived: {page.entry.archived}"


def _listed(names: Sequence[str]) -> str:
    """Names in a line, the first of many."""
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return ", ".join(names[:LISTED]) + more


def main() -> int:
    """Check the pages, or make those that are out of date."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--check", action="store_true", help="list what is out of date")
    action.add_argument("--remake", action="store_true", help="run the commands of what is out of date")
    arguments = parser.parse_args()
    pages = load_pages()
    found = list(problems(pages))
    for line in archived(pages):
        print(line)
    for page, line in found:
        print(line)
        if arguments.remake:
            command = page.entry.command.split()
            subprocess.run([sys.executable, *command[1:]], check=True, cwd=page.root)
    if not found:
        print(f"{len(pages)} pages are up to date, or archived")
    return int(bool(found) and arguments.check)


if __name__ == "__main__":
    sys.exit(main())
