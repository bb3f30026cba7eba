"""Markdown tables for `sections.md`, with the numbers of the stages and those of the paper."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from ..plan import CHIP, CROSS, FIXED, RNN, SNN
from ..work.scores import SIX
from .claims import METHODS, NETWORKS, QUOTED, TITLES, Numbers, errors, median_time, scatter

CURVES = {
    SNN: "Att-SNN",
    FIXED: "Att-SNN (only weights trained)",
    CHIP: "Att-SNN (Loihi quantisation)",
    RNN: "Att-RNN",
}
"""The networks of the paper's Fig. 4, as its published code names them."""
RESPONSES = {
    "gyro removed": "gyroscope zero",
    "accel zero": "accelerometer zero",
    "accel removed": "accelerometer as in level hover (θ_acc = 0)",
    "intact": "unchanged",
}
"""The paper's four inputs of Fig. 8."""
OWN = {"att-snn, chip": "Att-SNN (Loihi quantisation)"}
"""Networks that are not from the paper."""


def markdown_table(header: str, rows: Iterable[Sequence[object]]) -> str:
    """Format a table with a header "a | b | c".

    The first column is left-aligned, numbers are right-aligned.
    """
    lines = [header.split(" | "), ["---", *["---:"] * header.count(" | ")], *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def named(name: str) -> str:
    """Return the name of a method, in italics if it is not from the paper."""
    return TITLES.get(name, name) if name in SIX else f"*{OWN.get(name, name)}*"


def _statistics(values: Sequence[float], *of: Callable[..., float]) -> str:
    return " / ".join(f"{each(values):.2f}" for each in of)


def fold_table(numbers: Numbers) -> str:
    """Make Table 1: errors of every fold, mean and SD over flights."""
    found = numbers["score-folds"]
    mixed = [name for name in found if name not in CROSS]
    titles = {"sim": "Hummingbird → px4-quad", "px4": "px4-quad → Hummingbird"}
    rows = []
    for row, name in zip(QUOTED["table1"], [*mixed, *[None] * (5 - len(mixed)), *CROSS], strict=True):
        if name is not None:
            ours = [_statistics(found[name][kind], np.mean, _sd) for kind in ("train", "test")]
            theirs = [" / ".join(f"{each:.2f}" for each in row[kind]) for kind in ("train", "test")]
            rows.append([titles.get(row["fold"], f"fold {row['fold']}"), *ours, *theirs])
    return markdown_table("fold | training | test | the paper, training | the paper, test", rows)


def _sd(values: Sequence[float]) -> float:
    return float(np.std(values, ddof=1))


def methods(numbers: Numbers) -> str:
    """Make Table 2: median, mean and SD of every method over flights."""
    rows = []
    for name in (*SIX, "complementary-adaptive", *OWN):
        for start in ("unknown",) if name.startswith("att") else ("known", "unknown"):
            on = {
                stage: errors(numbers, name, start, f"score-fly-{stage}")
                for stage in ("sim", "real", "test-real", "test-sim")
            }
            training, test = (
                _statistics(each, np.median, np.mean, np.std)
                for each in (on["sim"] + on["real"], on["test-real"])
            )
            quoted = METHODS.get((name, start))
            theirs = [" / ".join(f"{x:.2f}" for x in each) for each in quoted] if quoted else ["–", "–"]
            test, home = test + _silenced(numbers, name, "real"), f"{np.mean(on['test-sim']):.2f}"
            home += _silenced(numbers, name, "sim")
            rows.append([named(name), start, training, theirs[0], test, theirs[1], home])
    header = (
        "method | start | training | the paper, training | test | the paper, test | test, Hummingbird, mean"
    )
    return markdown_table(header, rows)


def _silenced(numbers: Numbers, name: str, domain: str) -> str:
    """Error with output weights of zero, which is that of a level estimate whatever the network."""
    level = next(iter(numbers[f"score-fly-test-{domain}"]["silenced_deg"].values()))
    return f" (silenced {level:.1f})" if name.startswith("att") else ""


def losses(numbers: Numbers) -> str:
    """Make the table of best epochs and scatter of the trainings."""
    rows = []
    for stage, title in CURVES.items():
        each, size = numbers[stage], scatter(numbers[stage]["val_mse"])
        best = each["best"]
        spikes = "–" if stage == RNN else f"{best['rate_encoding']:.2f}, {best['rate_hidden']:.2f}"
        quoted = {SNN: QUOTED["losses"]["att-snn"], RNN: QUOTED["losses"]["att-rnn"]}.get(stage)
        scatters = f"{1e3 * size:.2f}" if np.isfinite(size) else "–", f"{1e3 * quoted:.1f}" if quoted else "–"
        epochs = len(each["updates"]), best["epoch"] + 1, f"{best['val_error_deg']:.2f}"
        rows.append([title, *epochs, *scatters, spikes, f"{each['seconds'] / 60:.0f}", each["reason"]])
    header = (
        "network | epochs | best epoch | validation error [°] | scatter [10⁻³ rad²] | scatter in the paper | "
        "spikes per neuron and step, both layers | duration [min] | reason for the end"
    )
    return markdown_table(header, rows)


def recoveries(numbers: Numbers) -> str:
    """Make the table of times until the error is first below 2°."""
    rows = []
    for name, each in numbers["recover"]["curves"].items():
        cells = ["–"] * 4
        for k, kind in enumerate(kind for kind in ("flight", "hover") if kind in each):
            times = each[kind]["times_s"]
            within = np.mean([time is not None for time in times])
            cells[2 * k : 2 * k + 2] = [str(median_time(times)), f"{100 * within:.0f} %"]
        theirs = "< 1" if name in NETWORKS else "> 7" if name in SIX else "between"
        rows.append([named(name), *cells, theirs if name in (*SIX, "complementary-adaptive") else "–"])
    header = "method | in flight [s] | share converged | in hover [s] | share converged | the paper [s]"
    return markdown_table(header, rows)


def activity(numbers: Numbers) -> str:
    """Make the table of shares of neurons that hardly spike."""
    rows, quoted = [], QUOTED["activity"]
    for k, layer in enumerate(("encoding", "recurrent")):
        rate = np.array(numbers["inside"]["rates"][k])
        shares = (
            (rate == 0).mean(),
            quoted["never"][k],
            ((rate > 0) & (rate < 0.005)).mean(),
            quoted["rare"][k],
        )
        rows.append([layer, f"{rate.mean():.3f}", *(f"{100 * share:.0f} %" for share in shares)])
    header = (
        "layer | spikes per neuron and step | neurons that never spike | the paper | "
        "neurons that spike in less than 0.5 % of the steps | the paper"
    )
    return markdown_table(header, rows)
