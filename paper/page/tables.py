"""Tables in Markdown for the gaps of `sections.md`, from the stages' numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from training.cross_domain import TEST, TRAIN

from .claims import NETWORKS, Numbers, by_rate, fold_errors, pooled
from .figures import CURVES, DOMAIN_TITLES
from .plan import RNN
from .quoted import CHIP, GENERAL_DEG, NOT_QUOTED, PYTORCH_US, TEST_DEG
from .scores import FILTERS, SHIPPED, SIX

DOMAIN_NAMES = {"sim": "Hummingbird", "real": "second domain"}


def _table(header: str, rows: Iterable[Sequence[object]]) -> str:
    """A table under a header "a | b | c"; the first column to the left, numbers to the right."""
    lines = [header.split(" | "), ["---", *["---:"] * header.count(" | ")], *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def _italic(name: str) -> str:
    return f"*{name}*" if name in SHIPPED else name


def folds(numbers: Numbers) -> str:
    """Table 1: k-fold and cross-domain errors."""
    tested = {TRAIN: "training flights", TEST: "unseen flights of the same domain"}
    rows = []
    for cell in fold_errors(numbers):
        quoted = (cell.model, cell.trained_on, cell.tested_on) == ("att-snn", "sim", "real")
        on = tested.get(cell.tested_on) or f"all of the {DOMAIN_NAMES[cell.tested_on]}"
        error = f"{cell.mean_deg:.2f} ± {cell.sd_deg:.2f}"
        home, theirs = DOMAIN_NAMES[cell.trained_on], GENERAL_DEG if quoted else NOT_QUOTED
        rows.append([cell.model, home, on, cell.folds, error, theirs])
    return _table("network | trained on | tested on | folds | mean ± SD [°] | the paper [°]", rows)


def methods(numbers: Numbers) -> str:
    """Table 2: median, mean and SD of every method, pooled over both domains (networks: unknown start)."""
    rows = []
    every = [*SIX, "complementary-adaptive", *SHIPPED]
    known = [name for name in every if not name.startswith("att")]
    for name, start in [*((name, "unknown") for name in every), *((name, "known") for name in known)]:
        errors = [pooled(numbers, kind, name, start) for kind in ("", "test-")]
        cells = [value for each in errors for value in (np.median(each), each.mean(), each.std(ddof=1))]
        cells += [np.mean(numbers[f"score-test-{each}"]["sequences"][name][start]) for each in DOMAIN_NAMES]
        theirs = TEST_DEG.get(name, NOT_QUOTED) if start == "unknown" else NOT_QUOTED
        rows.append([_italic(name), start, *(f"{error:.2f}" for error in cells), theirs])
    header = (
        "method | start | training: median | mean | SD | test: median | mean | SD | test, Hummingbird | "
        "test, second domain | the paper, test"
    )
    return _table(header, rows)


def tuned(numbers: Numbers) -> str:
    """Parameters from the swarm."""
    rows = []
    for name in FILTERS:
        each = numbers[f"tune-{name}"]
        values = ", ".join(f"`{key}` {value:.4g}" for key, value in each["values"].items())
        rows.append([name, values, f"{each['rmse_deg']:.2f}"])
    return _table("filter | tuned values | RMSE on the training flights [°]", rows)


def distributions(numbers: Numbers) -> str:
    """Standard deviations of inputs and outputs in both domains."""
    domains = numbers["distributions"]
    rows = [
        [DOMAIN_TITLES[domain], *(f"{each['sd']:.2f}" for each in columns.values())]
        for domain, columns in domains.items()
    ]
    return _table(" | ".join(["SD of", *domains["sim"]]), rows)


def losses(numbers: Numbers) -> str:
    """Last and best epochs of the four trainings, the best network first."""
    rows = []
    for stage in sorted(CURVES, key=lambda name: numbers[name]["best"]["val_error_deg"]):
        best = numbers[stage]["best"]
        spikes = "–" if stage == RNN else f"{best['rate_encoding']:.2f}, {best['rate_hidden']:.2f}"
        updates, minutes = numbers[stage]["updates"][-1], numbers[stage]["seconds"] / 60
        error = f"{best['val_error_deg']:.2f}"
        rows.append([CURVES[stage], f"{updates:.0f}", best["updates"], error, spikes, f"{minutes:.1f}"])
    header = (
        "network | updates | of them to the best | validation error [°] | spikes a step, both layers | min"
    )
    return _table(header, rows)


def recoveries(numbers: Numbers) -> str:
    """When the error is first below 2°."""
    rows = []
    for name, each in numbers["recover"]["curves"].items():
        cells = []
        for kind in ("flight", "hover"):
            if kind in each:
                time = each[kind]["first_s"]
                cells += ["never" if time is None else f"{time:.2f}", f"{100 * each[kind]['within']:.0f} %"]
            else:
                cells += ["–", "–"]
        theirs = "< 1 s" if name in NETWORKS else "> 7 s (its filters)" if name in SIX else NOT_QUOTED
        rows.append([_italic(name), *cells, theirs])
    return _table("method | in flight [s] | converged | in hover [s] | converged | the paper", rows)


def manipulations(numbers: Numbers) -> str:
    """Errors and gains with a sensor changed."""
    rows = [
        [name, *(f"{each[key]:.2f}" for key in ("error_deg", "gain", "slow_gain", "fast_gain"))]
        for name, each in numbers["inside"]["responses"].items()
    ]
    return _table("inputs | error [°] | gain | gain below 0.2 Hz | gain above 1 Hz", rows)


def latencies(numbers: Numbers) -> str:
    """Time of one update."""
    chip = numbers["latencies"]["att-snn-loihi"][1]
    theirs = {name: f"{value:g}" for name, value in PYTORCH_US.items()}
    theirs["att-snn-loihi"] = f"{CHIP['µs']:g} (the chip itself)"
    rows = [
        [name, f"{middle:.2f}", f"{high:.2f}", f"{middle / chip:.2f}", theirs.get(name, NOT_QUOTED)]
        for name, (_, middle, high) in sorted(numbers["latencies"].items(), key=lambda item: item[1][1])
    ]
    return _table("estimator | median [µs] | 99 % [µs] | over att-snn-loihi | the paper [µs]", rows)


def energy(numbers: Numbers) -> str:
    """Operations and modelled energy of a step."""
    rows, total = [], 0.0
    for each in numbers["inside"]["costs"]:
        count, picojoules = each["count"], each["picojoules"]
        total += count * picojoules
        nanojoules, share = f"{count * picojoules / 1e3:.2f}", f"{100 * each['share']:.0f} %"
        rows.append([each["operation"], f"{count:.1f}", f"{picojoules:g}", nanojoules, share])
    rows.append(["sum, modelled", "", "", f"{total / 1e3:.1f}", ""])
    return _table("operation | a step | pJ each | nJ a step | share", rows)


def operations(numbers: Numbers) -> str:
    """Floating-point operations of one update."""
    flops = numbers["inside"]["flops"]
    rows = [
        [label, f"{flops[key]:.0f}", f"{flops[key] / flops['dense']:.2f}", theirs]
        for key, label, theirs in (
            ("dense", "Att-SNN, zeros multiplied too", NOT_QUOTED),
            ("sparse", "Att-SNN, synapses of spikes alone", NOT_QUOTED),
            ("gru", "Att-RNN", "about 3"),
        )
    ]
    return _table("network | operations an update | over the first | the paper", rows)


def loops(numbers: Numbers) -> str:
    """The closed loop: crashes, errors and whether they grow."""
    rows = []
    for scenario, scores in numbers["loop"]["scenarios"].items():
        for name, each in scores.items():
            parts = " → ".join(f"{part:.2f}" for part in each["parts_deg"])
            error, *tracking = (f"{each[key]:.2f}" for key in ("error_deg", "attitude_deg", "position_m"))
            crashed = f"{each['crashes']} of {each['flights']}"
            rows.append([scenario, _italic(name), crashed, error, parts, *tracking])
    header = (
        "scenario | attitude from | crashed | estimation error [°] | in thirds of the flight [°] | "
        "attitude tracking [°] | position tracking [m]"
    )
    return _table(header, rows)


def rates(numbers: Numbers) -> str:
    """Errors at each sample rate."""
    by_hz = by_rate(numbers)
    rows = [[f"{rate:g}", *(f"{error:.2f}" for error in each.values())] for rate, each in by_hz.items()]
    names = next(iter(by_hz.values()))
    return _table(" | ".join(["samples a second", *(f"{name} [°]" for name in names)]), rows)


def sizes(numbers: Numbers) -> str:
    """Errors of networks of several sizes, and which are enough."""
    stage = numbers["compare-size"]
    names = {
        name: f"{name} neurons ({parameters} parameters)" for name, (_, parameters) in stage["sizes"].items()
    }
    return _compared(stage, names, "network")


def minutes(numbers: Numbers) -> str:
    """Errors of networks trained on several minutes of flight, and which are enough."""
    stage = numbers["compare-minutes"]
    names = {name: f"{int(name) * stage['duration_s'] / 60:.1f} minutes of flight" for name in stage["sizes"]}
    return _compared(stage, names, "trained on")


def _compared(stage: Mapping[str, Any], names: Mapping[str, str], first: str) -> str:
    """Errors on both test sets, and the least network within a tenth of the error of the last."""
    errors = stage["errors"]
    rows = [
        [
            names.get(name, name),
            *(f"{np.mean(each):.2f} ± {np.std(each, ddof=1):.2f}" for each in sets.values()),
        ]
        for name, sets in errors.items()
    ]
    *_, last = names
    means = {name: np.mean(errors[name]["fly-test-sim"]) for name in names}
    least = next(name for name in names if means[name] <= 1.1 * means[last])
    table = _table(f"{first} | unseen Hummingbird flights [°] | second domain [°]", rows)
    return f"{table}\n\n{names[least]} come within a tenth of the error of {names[last]}."
