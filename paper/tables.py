"""Tables in Markdown, from the stages' numbers, the paper's figures beside ours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from training.cross_domain import TEST, TRAIN, Score
from training.cross_domain import table as cells_of

from .claims import NETWORKS, Numbers, by_rate, pooled
from .figures import CURVES, DOMAIN_TITLES
from .quoted import CHIP, GENERAL_DEG, NOT_QUOTED, TEST_DEG, quoted
from .scores import FILTERS, SHIPPED, SIX

DOMAIN_NAMES = {"sim": "Hummingbird", "real": "second domain"}


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table; the first column to the left, numbers to the right."""
    lines = [header, ["---", *["---:"] * (len(header) - 1)], *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def folds(numbers: Numbers) -> str:
    """Table 1: k-fold and cross-domain errors."""
    scores = [
        Score(**row) for name, each in numbers.items() if name.startswith("fold-") for row in each["scores"]
    ]
    scores.sort(key=lambda s: (NETWORKS.index(s.model), s.trained_on != "sim", s.fold))
    tested = {TRAIN: "training flights", TEST: "unseen flights of the same domain"}
    rows = []
    for cell in cells_of(scores):
        theirs = NOT_QUOTED
        if (cell.trained_on, cell.tested_on) == ("sim", "real") and cell.model == "att-snn":
            theirs = f"{GENERAL_DEG['trained on simulation, flown']} (others {GENERAL_DEG['otherwise']})"
        on = tested.get(cell.tested_on) or f"all of the {DOMAIN_NAMES[cell.tested_on]}"
        error = f"{cell.mean_deg:.2f} ± {cell.sd_deg:.2f}"
        rows.append([cell.model, DOMAIN_NAMES[cell.trained_on], on, cell.folds, error, theirs])
    return table(["network", "trained on", "tested on", "folds", "mean ± SD [°]", "the paper [°]"], rows)


def methods(numbers: Numbers) -> str:
    """Table 2: median, mean and SD of every method, pooled over both domains (networks: unknown start)."""
    rows = []
    for start in ("unknown", "known"):
        for name in [*SIX, "complementary-adaptive", *SHIPPED]:
            if start == "known" and name.startswith("att"):
                continue
            cells = []
            for kind in ("", "test-"):
                errors = pooled(numbers, kind, name, start)
                cells += [f"{np.median(errors):.2f}", f"{errors.mean():.2f}", f"{errors.std(ddof=1):.2f}"]
            by_domain = [
                np.mean(numbers[f"score-test-{each}"]["sequences"][name][start]) for each in DOMAIN_NAMES
            ]
            theirs = quoted(TEST_DEG.get(name)) if start == "unknown" else NOT_QUOTED
            shown = f"*{name}*" if name in SHIPPED else name
            rows.append([shown, start, *cells, *(f"{error:.2f}" for error in by_domain), theirs])
    header = [
        "method", "start", "training: median", "mean", "SD", "test: median", "mean", "SD",
        "test, Hummingbird", "test, second domain", "the paper, test",
    ]  # fmt: skip
    return table(header, rows)


def tuned(numbers: Numbers) -> str:
    """What the swarm found."""
    rows = []
    for name in FILTERS:
        each = numbers[f"tune-{name}"]
        values = ", ".join(f"`{key}` {value:.4g}" for key, value in each["values"].items())
        rows.append([name, values, f"{each['rmse_deg']:.2f}"])
    return table(["filter", "tuned values", "RMSE on the training flights [°]"], rows)


def spreads(numbers: Numbers) -> str:
    """Standard deviations of inputs and outputs in both domains."""
    found = numbers["distributions"]
    names = list(found["sim"])
    rows = [[DOMAIN_TITLES[d], *(f"{found[d][name]['sd']:.2f}" for name in names)] for d in DOMAIN_NAMES]
    return table(["SD of", *names], rows)


def curves(numbers: Numbers) -> str:
    """How the four trainings ended."""
    rows = []
    for stage, label in CURVES.items():
        best = numbers[stage]["best"]
        spikes = "–" if "rnn" in stage else f"{best['rate_encoding']:.2f}, {best['rate_hidden']:.2f}"
        updates, minutes = numbers[stage]["updates"][-1], numbers[stage]["seconds"] / 60
        error = f"{best['val_error_deg']:.2f}"
        rows.append([label, f"{updates:.0f}", best["updates"], error, spikes, f"{minutes:.1f}"])
    header = [
        "network",
        "updates",
        "of them to the best",
        "validation error [°]",
        "spikes a step, both layers",
        "min",
    ]
    return table(header, rows)


def recoveries(numbers: Numbers) -> str:
    """When the error is first below 2°."""
    rows = []
    for name, each in numbers["recover"]["found"].items():
        cells = []
        for kind in ("flight", "hover"):
            if kind not in each:
                cells += ["–", "–"]
                continue
            time = each[kind]["first_s"]
            cells += ["never" if time is None else f"{time:.2f}", f"{100 * each[kind]['within']:.0f} %"]
        cells.append("< 1 s" if name in NETWORKS else "> 7 s (its filters)" if name in SIX else NOT_QUOTED)
        rows.append([f"*{name}*" if name in SHIPPED else name, *cells])
    header = ["method", "in flight [s]", "got there", "in hover [s]", "got there", "the paper"]
    return table(header, rows)


def manipulations(numbers: Numbers) -> str:
    """Errors and gains with a sensor changed."""
    rows = [
        [name, *(f"{each[key]:.2f}" for key in ("error_deg", "gain", "slow_gain", "fast_gain"))]
        for name, each in numbers["inside"]["responses"].items()
    ]
    return table(["inputs", "error [°]", "gain", "gain below 0.2 Hz", "gain above 1 Hz"], rows)


def latencies(numbers: Numbers) -> str:
    """Time of one update."""
    found = numbers["latencies"]["µs"]
    chip = found["att-snn-loihi"][1]
    theirs = {
        "att-snn-loihi": f"{CHIP['µs']:g} (the chip itself)",
        "SNN, plain PyTorch": "555",
        "GRU, PyTorch": "150",
    }
    rows = [
        [name, f"{middle:.2f}", f"{high:.2f}", f"{middle / chip:.2f}", theirs.get(name, NOT_QUOTED)]
        for name, (_, middle, high) in sorted(found.items(), key=lambda item: item[1][1])
    ]
    return table(["estimator", "median [µs]", "99 % [µs]", "over att-snn-loihi", "the paper [µs]"], rows)


def energy(numbers: Numbers) -> str:
    """Operations and modelled energy of a step."""
    lines = numbers["inside"]["costs"]
    rows = [
        [each["operation"], f"{each['count']:.1f}", f"{each['picojoules']:g}",
         f"{each['count'] * each['picojoules'] / 1e3:.2f}", f"{100 * each['share']:.0f} %"]
        for each in lines
    ]  # fmt: skip
    total = sum(each["count"] * each["picojoules"] for each in lines) / 1e3
    rows.append(["sum, modelled", "", "", f"{total:.1f}", ""])
    return table(["operation", "a step", "pJ each", "nJ a step", "share"], rows)


def operations(numbers: Numbers) -> str:
    """Floating-point operations of one update."""
    flops = numbers["inside"]["flops"]
    names = {
        "dense": "Att-SNN, zeros multiplied too",
        "sparse": "Att-SNN, synapses of spikes alone",
        "gru": "Att-RNN",
    }
    rows = [
        [
            label,
            f"{flops[key]:.0f}",
            f"{flops[key] / flops['dense']:.2f}",
            "about 3" if key == "gru" else NOT_QUOTED,
        ]
        for key, label in names.items()
    ]
    return table(["network", "operations an update", "over the first", "the paper"], rows)


def loops(numbers: Numbers) -> str:
    """The closed loop: crashes, errors and whether they grow."""
    rows = []
    for scenario, found in numbers["loop"]["found"].items():
        for name, each in found.items():
            parts = " → ".join(f"{part:.2f}" for part in each["parts_deg"])
            shown = f"*{name}*" if name in SHIPPED else name
            crashed = f"{each['crashes']} of {each['flights']}"
            error, *tracking = (f"{each[key]:.2f}" for key in ("error_deg", "attitude_deg", "position_m"))
            rows.append([scenario, shown, crashed, error, parts, *tracking])
    header = [
        "scenario", "flown on", "crashed", "estimation error [°]", "in thirds of the flight [°]",
        "attitude tracking [°]", "position tracking [m]",
    ]  # fmt: skip
    return table(header, rows)


def rates(numbers: Numbers) -> str:
    """Errors at each sample rate."""
    found = by_rate(numbers)
    names = list(next(iter(found.values())))
    titles = {"rescaled": "Att-SNN, rescaled", "trained on": "Att-SNN, rescaled and trained on"}
    rows = [[f"{rate:g}", *(f"{each[name]:.2f}" for name in names)] for rate, each in found.items()]
    return table(["samples a second", *(f"{titles.get(name, name)} [°]" for name in names)], rows)


def compared(numbers: Numbers, stage: str, first: str, flight_s: float | None = None) -> str:
    """Errors of networks of several sizes, or of several amounts of flight."""
    found = numbers[stage]
    rows = []
    for name, errors in found["errors"].items():
        head = name
        if flight_s is not None:
            head = f"{name} ({int(name) * flight_s / 60:.1f} min)"
        size = found["sizes"].get(name)
        cells = [f"{np.mean(errors[key]):.2f} ± {np.std(errors[key], ddof=1):.2f}" for key in errors]
        rows.append([head, f"{size[1]}" if size else "–", *cells])
    return table([first, "parameters", "unseen Hummingbird flights [°]", "second domain [°]"], rows)
