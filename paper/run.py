"""Plan the stages, run missing ones, judge the claims, and write the page."""

import json
import re
import shutil
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import jinja2
import matplotlib

from quadsim.dataset.figures import STYLE
from quadsim.runs.files import save_figure, write_whole

from .page import tables
from .page.claims import CLAIMS, Judgement, judge_claims, operations
from .page.paper_figures import FIGURES
from .plan import Sizes, chosen, sizes_of, stages_of
from .stages import NUMBERS, Progress, run_stages, with_inputs
from .work.scores import FILTERS

MARKS = {"holds": "✔ holds", "partly": "◐ partly", "does not hold": "✘ does not hold", "not judged": "–"}
PAGE = jinja2.Environment(
    loader=jinja2.PackageLoader("paper", "page"),
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
).get_template("sections.md")
"""Template of the page; every number comes from the run."""
VERBS = {"holds": "hold", "partly": "hold partly", "does not hold": "do not", "not judged": "not judged"}


class Paper(NamedTuple):
    """The page and the judgements of the claims."""

    page: Path
    judged: list[Judgement]

    @property
    def headline(self) -> str:
        """The number of claims that hold, in words."""
        counts = Counter(each.verdict for each in self.judged)
        shown = [f"{counts[verdict]} {verb}" for verdict, verb in VERBS.items() if counts[verdict]]
        return f"of the paper's {len(self.judged)} claims {', '.join(shown)}"


def paper(
    out: str | Path,
    only: str | None = None,
    preset: str = "quick",
    seed: int = 0,
    workers: int | None = None,
    progress: Progress = lambda done, total, note: None,
    sizes: Sizes | None = None,
) -> Paper:
    """Reproduce the paper's tables and figures, and write the page.

    Stages that an earlier run with the same settings finished are not run again.

    Args:
        out: Folder for everything.
        only: Some of `plan.ITEMS`, as "table1,fig5"; None for all.
        preset: "quick" or "full".
        seed: Seed of all random numbers.
        workers: Number of processes, by default one per CPU; 1 runs in this process.
        progress: Called during the run.
        sizes: Sizes that replace those of the preset.

    Raises:
        ValueError: An item or the preset is unknown.
        OSError: The folder cannot be written, or a worker died.
    """
    sizes = sizes or sizes_of(preset, seed)
    items, out = chosen(only), Path(out).expanduser().absolute()
    if out.exists() and not out.is_dir():
        raise ValueError(f"{out} is a file; give a folder for the pages and for all that they come from")
    parts = out / sizes["preset"]  # so that a quick run does not replace a full one
    parts.mkdir(parents=True, exist_ok=True)
    stages, shows = stages_of(sizes)
    wanted = with_inputs(stages, [name for item in items for name in shows[item]])
    run_stages(wanted, parts, workers, progress)
    return Paper(out / "paper.md", write_results(parts, out, sizes))


def write_results(parts: Path, folder: Path, sizes: Sizes) -> list[Judgement]:
    """Write the page and the figures of all finished stages; return the judgements.

    Args:
        parts: Folder with the folders of the stages.
        folder: Folder for paper.md and img/.
        sizes: Sizes of the run.
    """
    stages, shows = stages_of(sizes)
    done = {name: stage for name, stage in stages.items() if stage.is_finished(parts)}
    files = {name: parts / name / NUMBERS for name in done}
    numbers = {name: json.loads(file.read_text("utf-8")) for name, file in files.items() if file.exists()}
    shown = [item for item, names in shows.items() if numbers.keys() >= set(names)]
    numbers = {name: numbers[name] for item in shown for name in shows[item]}
    judged = judge_claims(numbers, judges=sizes["preset"] == "full")
    with matplotlib.rc_context(STYLE):
        for item in FIGURES.keys() & shown:
            save_figure(folder / "img" / f"paper-{item}.png", FIGURES[item](numbers), dpi=130)
    if "fig3" in shown:
        for picture in (parts / "distributions").glob("*.png"):
            (folder / "img").mkdir(exist_ok=True)
            shutil.copy(picture, folder / "img" / f"paper-fig3-{picture.name}")
    page = PAGE.render(
        s=sizes,
        n=numbers,
        tables=tables,
        filters=FILTERS,
        operations=operations,
        shown=shown,
        figures=FIGURES,
        judged=judged,
        marks=MARKS,
        elsewhere=CLAIMS["elsewhere"],
        minutes=sum(stage.record(parts)["seconds"] for stage in done.values()) / 60,
    )
    write_whole(folder / "paper.md", re.sub(r"\n{3,}", "\n\n", page).rstrip() + "\n")
    return judged
