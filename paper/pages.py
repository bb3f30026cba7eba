"""The pages: prose of `sections.md` around the tables and figures, every number of them from the run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from quadsim.dataset.figures import STYLE
from quadsim.runs.files import save_figure, write_whole

from . import figures, tables
from .claims import Judgement, Numbers, judge
from .plan import ITEMS
from .quoted import SPREAD_RAD, TITLE
from .settings import Budget, PaperSettings

OWN_PAGES = ("rate", "size", "minutes")
"""Items with a page of their own."""
FIGURES: dict[str, Callable[[Numbers, PaperSettings], Figure]] = {
    "fig3": lambda n, s: figures.distributions(n),
    "fig4": lambda n, s: figures.losses(n),
    "fig5": lambda n, s: figures.violins(n),
    "fig6": lambda n, s: figures.recoveries(n),
    "fig7": lambda n, s: figures.spiking(n),
    "fig8": lambda n, s: figures.manipulated(n),
    "fig9": lambda n, s: figures.costs(n),
    "loop": lambda n, s: figures.loops(n),
    "rate": lambda n, s: figures.rates(n),
    "size": lambda n, s: figures.sizes(n),
    "minutes": lambda n, s: figures.minutes(n, s.flight_s),
}
MARKS = {"holds": "✔ holds", "partly": "◐ partly", "does not hold": "✘ does not hold", "not judged": "–"}


@dataclass(frozen=True)
class Placement:
    """Names of the pages and their figures."""

    prefix: str = ""
    """Begins the names of the three pages and of all figures."""
    images: str = "."
    """Folder of the figures, inside that of the pages."""
    kinds: tuple[str, ...] = ("png", "svg")
    """Formats; the pages show the first."""
    then: str = ""
    """A further command that these pages are made with."""


BESIDE = Placement()


def write_pages(
    folder: Path,
    numbers: Numbers,
    shown: Sequence[str],
    settings: PaperSettings,
    seconds: float,
    placement: Placement = BESIDE,
) -> Path:
    """Write the page, the three beside it, and their figures.

    Args:
        folder: Where.
        numbers: Of the finished stages.
        shown: Items whose stages are all finished.
        settings: Of the run.
        seconds: Time that its stages took, added up.
        placement: Names of the pages and their figures.
    """
    prefix, kinds, then = placement.prefix, placement.kinds, placement.then
    judged, texts = judge(numbers), sections()
    bodies = {}
    for item in shown:
        parts = [texts[item][1].format(**VALUES[item](numbers, settings))]
        if item in FIGURES:
            name = (Path(placement.images) / f"{prefix}{item}").as_posix()
            _save(FIGURES[item], numbers, settings, [folder / f"{name}.{kind}" for kind in kinds])
            parts.append(f"![{texts[item][0]}]({name}.{kinds[0]})")
        parts += [_verdict(each) for each in judged if each.item == item]
        bodies[item] = "\n\n".join(parts)
    for item in OWN_PAGES:
        if item in bodies:
            head = f"# {texts[item][0]}\n\n{_made_by(settings, then)}\n\n{texts['domains'][1]}"
            write_whole(folder / f"{prefix}{item}.md", f"{head}\n\n{bodies[item]}\n")
    missing = "Not made in this run."
    whole = [f"## {texts[item][0]}\n\n{bodies.get(item, missing)}" for item in ITEMS if item not in OWN_PAGES]
    beyond = [
        f"* [{texts[item][0]}]({prefix}{item}.md)" if item in bodies else f"* {texts[item][0]}: {missing}"
        for item in OWN_PAGES
    ]
    title, text = texts["paper"]
    filled = text.format(
        title=TITLE, made_by=_made_by(settings, then), minutes=f"{seconds / 60:.0f}",
        domains=texts["domains"][1], checklist=_checklist(judged), sections="\n\n".join(whole),
        beyond="\n".join(beyond),
        **_sizes(settings),
    )  # fmt: skip
    return write_whole(folder / "paper.md", f"# {title}\n\n{filled}\n")


def sections() -> dict[str, tuple[str, str]]:
    """Heading and text of every part of `sections.md` by its name."""
    found = {}
    text = (files("paper") / "sections.md").read_text(encoding="utf-8")
    for part in text.split("=== ")[1:]:
        head, body = part.split("\n", 1)
        name, _, title = head.partition(": ")
        found[name] = title, body.strip()
    return found


def _save(
    make: Callable[[Numbers, PaperSettings], Figure],
    numbers: Numbers,
    settings: PaperSettings,
    paths: Sequence[Path],
) -> None:
    with matplotlib.rc_context(STYLE):
        figure = make(numbers, settings)
        for path in paths:
            save_figure(path, figure, dpi=130, metadata={"Date": None} if path.suffix == ".svg" else None)


def _checklist(judged: Sequence[Judgement]) -> str:
    rows = [
        f"| {each.claim} | **{MARKS[each.verdict]}** | {each.measured} | {each.rule} |" for each in judged
    ]
    return "\n".join(["| the paper says | here | measured | it holds if |", "|---|---|---|---|", *rows])


def _verdict(each: Judgement) -> str:
    """A claim, the verdict and its reason, below its table or figure."""
    why = f"\nWhy: {each.why}." if each.why else ""
    return f"**“{each.claim}”: {each.verdict}.** {each.measured[:1].upper()}{each.measured[1:]}.{why}"


def _made_by(settings: PaperSettings, then: str) -> str:
    seed = f" --seed {settings.seed}" if settings.seed else ""
    further = f" and `{then}`" if then else ""
    return f"Made by `quadsim paper --preset {settings.preset}{seed} --out runs/paper`{further}."


def _said(budget: Budget) -> str:
    return f"{budget.updates} updates of {budget.batch_size} windows of {budget.window_s:g} s"


def _sizes(s: PaperSettings) -> dict[str, Any]:
    return {
        "flight_s": f"{s.flight_s:g}", "sim": s.sim_flights, "real": s.real_flights,
        "validation": sum(s.validation_flights), "test": sum(s.test_flights),
        "test_sim": s.test_flights[0], "test_real": s.test_flights[1],
        "particles": s.particles, "iterations": s.iterations,
        "main": _said(s.main), "recipe": _said(s.paper), "rnn": _said(s.rnn),
        "fold_snn": _said(s.fold_snn), "fold_rnn": _said(s.fold_rnn),
        "study": _said(s.study), "rate": _said(s.rate),
    }  # fmt: skip


def _table2(numbers: Numbers, s: PaperSettings) -> dict[str, Any]:
    return {
        "training": s.sim_flights + s.real_flights,
        "test": sum(s.test_flights),
        "table": tables.methods(numbers),
        "tuned": tables.tuned(numbers),
    }


def _fig3(numbers: Numbers, s: PaperSettings) -> dict[str, Any]:
    found = numbers["distributions"]
    spread = [
        np.radians(found[domain][f"{axis} [°]"]["sd"]) for domain in found for axis in ("roll", "pitch")
    ]
    near = min(spread) > 0.8 * SPREAD_RAD and max(spread) < 1.2 * SPREAD_RAD
    return {
        "table": tables.spreads(numbers), "low": f"{min(spread):.2f}", "high": f"{max(spread):.2f}",
        "theirs": SPREAD_RAD, "alike": "flights as aggressive as its own" if near else "not alike in this",
    }  # fmt: skip


def _fig4(numbers: Numbers, s: PaperSettings) -> dict[str, Any]:
    best = {stage: numbers[stage]["best"]["val_error_deg"] for stage in figures.CURVES}
    order = [f"{figures.CURVES[stage]} {best[stage]:.2f}°" for stage in sorted(best, key=best.__getitem__)]
    return {
        "table": tables.curves(numbers), "order": ", ".join(order),
        "rounding": f"{best[figures.SNN] - best[figures.FLOAT]:+.2f}",
    }  # fmt: skip


def _fig6(numbers: Numbers, s: PaperSettings) -> dict[str, Any]:
    found = numbers["recover"]
    return {
        "starts": found["starts"],
        "hovers": found["hovers"],
        "table": tables.recoveries(numbers),
    }


def _fig7(numbers: Numbers, s: PaperSettings) -> dict[str, Any]:
    inside = numbers["inside"]
    means = {f"mean_{k}": f"{np.mean(inside['rates'][k]):.2f}" for k in (0, 1)}
    return means | {f"silent_{k}": inside["silent"][k] for k in (0, 1)}


def _fig9(numbers: Numbers, s: PaperSettings) -> dict[str, Any]:
    found = numbers["latencies"]["µs"]
    snn, gru, chip = (found[name][1] for name in ("SNN, plain PyTorch", "GRU, PyTorch", "att-snn-loihi"))
    order = "the slower of the two as in the paper" if snn > gru else "the other way round than in the paper"
    return {
        "table": tables.latencies(numbers), "energy": tables.energy(numbers),
        "gru": f"{gru:.0f}", "snn": f"{snn:.0f}", "chip": f"{chip:.1f}",
        "order": order,
    }  # fmt: skip


def _loop(numbers: Numbers, s: PaperSettings) -> dict[str, Any]:
    duration = f"{numbers['loop']['duration_s']:g}"
    return {"seeds": s.loop_seeds, "duration": duration, "table": tables.loops(numbers)}


def _rate(numbers: Numbers, s: PaperSettings) -> dict[str, Any]:
    return {
        "budget": _said(s.rate), "training": s.rate_flights[0], "test": s.rate_flights[2],
        "table": tables.rates(numbers),
    }  # fmt: skip


def _enough(numbers: Numbers, stage: str) -> tuple[str, str]:
    """The least that comes within a tenth of the error of the most, and the most."""
    found = numbers[stage]
    errors = {name: float(np.mean(found["errors"][name]["fly-test-sim"])) for name in found["sizes"]}
    most = list(errors)[-1]
    return next(name for name, error in errors.items() if error <= 1.1 * errors[most]), most


def _size(numbers: Numbers, s: PaperSettings) -> dict[str, Any]:
    least, most = _enough(numbers, "compare-size")
    parameters = numbers["compare-size"]["sizes"][least][1]
    text = f"{least} neurons ({parameters} parameters) come within a tenth of the error of {most}."
    table = tables.compared(numbers, "compare-size", "neurons")
    return _sizes(s) | {"budget": _said(s.study), "table": table, "enough": text}


def _minutes(numbers: Numbers, s: PaperSettings) -> dict[str, Any]:
    least, most = (int(flights) * s.flight_s / 60 for flights in _enough(numbers, "compare-minutes"))
    text = f"{least:.1f} minutes of flight come within a tenth of the error of {most:.1f}."
    table = tables.compared(numbers, "compare-minutes", "flights", s.flight_s)
    sizes = _sizes(s) | {"validation": s.validation_flights[0]}
    return sizes | {"budget": _said(s.study), "table": table, "enough": text}


VALUES: dict[str, Callable[[Numbers, PaperSettings], dict[str, Any]]] = {
    "table1": lambda n, s: {"folds": s.folds, "table": tables.folds(n)},
    "table2": _table2,
    "fig3": _fig3,
    "fig4": _fig4,
    "fig5": lambda n, s: _sizes(s),
    "fig6": _fig6,
    "fig7": _fig7,
    "fig8": lambda n, s: {"table": tables.manipulations(n)},
    "fig9": _fig9,
    "flops": lambda n, s: {"table": tables.operations(n)},
    "loop": _loop,
    "rate": _rate,
    "size": _size,
    "minutes": _minutes,
}
"""What fills the gaps in each part of `sections.md`."""
