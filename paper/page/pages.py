"""The page: prose of `sections.md` around the tables and figures, every number of it from the run."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

from quadsim.dataset.figures import STYLE
from quadsim.runs.files import save_figure, write_whole

from ..plan import ITEMS, Sizes
from . import tables
from .claims import CLAIMS, Judgement, Numbers, judge
from .figures import FIGURES

MARKS = {"holds": "✔ holds", "partly": "◐ partly", "does not hold": "✘ does not hold", "not judged": "–"}
MISSING = "Not made in this run."
LOOK = "\n\n**This is preset quick: short flights and trainings, for a look. No verdict follows from it.**"


class _Gaps(dict[str, Any]):
    """What fills a gap of `sections.md`: settings `s`, numbers `n`, or a function of `tables` by its name."""

    def __missing__(self, name: str) -> str:
        return getattr(tables, name)(self["n"])


def write_pages(
    folder: Path, numbers: Numbers, shown: Sequence[str], sizes: Sizes, seconds: float
) -> list[Judgement]:
    """Write paper.md, and its figures into img/; the judged claims.

    Args:
        folder: Where.
        numbers: Of the finished stages.
        shown: Items whose stages are all finished.
        sizes: Of the run.
        seconds: Time that its stages took, added up.
    """
    judges = sizes["preset"] == "full"  # the run is large enough for verdicts
    judged, texts = judge(numbers, judges), sections()
    seed = f" --seed {sizes['seed']}" if sizes["seed"] else ""
    gaps = _Gaps(
        s=sizes,
        n=numbers,
        look="" if judges else LOOK,
        computing_min=f"{seconds / 60:.0f}",
        made_by=f"Made by `quadsim paper --preset {sizes['preset']}{seed} --out runs/paper`.",
        checklist="\n".join(
            f"| {each.claim} | **{MARKS[each.verdict]}** | {each.measured} | {each.rule} | {each.limits} |"
            for each in judged
        ),
        elsewhere="\n".join(f"* {what}: **not judged**, {why}." for what, why in CLAIMS["elsewhere"].items()),
    )
    bodies = dict.fromkeys(ITEMS, MISSING)
    for item in shown:
        parts = [texts[item][1].format_map(gaps)]
        if item in FIGURES:
            with matplotlib.rc_context(STYLE):
                save_figure(folder / "img" / f"paper-{item}.png", FIGURES[item](numbers), dpi=130)
            parts.append(f"![{texts[item][0]}](img/paper-{item}.png)")
        parts += [_verdict(each) for each in judged if each.item == item]
        bodies[item] = "\n\n".join(parts)
    gaps["sections"] = "\n\n".join(f"## {texts[item][0]}\n\n{body}" for item, body in bodies.items())
    title, text = texts["paper"]
    write_whole(folder / "paper.md", f"# {title}\n\n{text.format_map(gaps)}\n")
    return judged


def sections() -> dict[str, tuple[str, str]]:
    """Heading and text of every part of `sections.md` by its name."""
    text = Path(__file__).with_name("sections.md").read_text(encoding="utf-8")
    parts = {}
    for part in text.split("=== ")[1:]:
        head, body = part.split("\n", 1)
        name, _, title = head.partition(": ")
        parts[name] = title, body.strip()
    return parts


def _verdict(each: Judgement) -> str:
    """A claim and its verdict, below its table or figure."""
    return f"**“{each.claim}”: {each.verdict}.** {each.measured[:1].upper()}{each.measured[1:]}."
