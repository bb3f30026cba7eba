"""Tables in Markdown for the gaps of `sections.md`, from the stages' numbers, the paper's own beside ours."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from ..plan import CHIP, CROSS, FIXED, RNN, SNN
from ..work.scores import FILTERS, SHIPPED, SIX
from .claims import NETWORKS, TITLES, Numbers, by_rate, errors, interval, median_time, scatter, shown_time
from .quoted import ACTIVITY, FOLDS, LAYER, LOSSES, METHODS, operations

DOMAIN_NAMES = {"fly-sim": "Hummingbird", "fly-real": "px4-quad"}
CURVES = {
    SNN: "Att-SNN",
    FIXED: "Att-SNN (only weights trained)",
    CHIP: "Att-SNN (Loihi quantisation)",
    RNN: "Att-RNN",
}
"""The networks of the paper's Fig. 4, as its published code names them."""
RESPONSES = {
    "gyro removed": "gyroscope 0",
    "accel zero": "accelerometer 0",
    "accel removed": "accelerometer such that θ_acc = 0",
    "intact": "untouched",
}
"""The paper's four inputs of Fig. 8."""
OWN = {"att-snn, chip": "Att-SNN (Loihi quantisation)", "att-snn, ours": "Att-SNN, our recipe"}
OWN |= dict.fromkeys(SHIPPED, "")


def markdown_table(header: str, rows: Iterable[Sequence[object]]) -> str:
    """A table under a header "a | b | c"; the first column to the left, numbers to the right."""
    lines = [header.split(" | "), ["---", *["---:"] * header.count(" | ")], *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def _named(name: str) -> str:
    """A method, in italics where it is none of the paper's."""
    return TITLES.get(name, name) if name in SIX else f"*{OWN.get(name) or name}*"


def _spread(values: Sequence[float]) -> str:
    return f"{np.mean(values):.2f} ({np.std(values, ddof=1):.2f})"


def folds(numbers: Numbers) -> str:
    """Table 1: errors of every fold, mean (SD) over flights."""
    found = numbers["score-folds"]
    rows = []
    mixed = [name for name in found if name not in CROSS]
    for key, name in [*zip("12345", mixed, strict=False), ("sim", "net-only-sim"), ("px4", "net-only-real")]:
        theirs = [f"{mean:.2f} ({sd:.2f})" for mean, sd in FOLDS[key]]
        title = {"sim": "Hummingbird → px4-quad", "px4": "px4-quad → Hummingbird"}.get(key, f"fold {key}")
        rows.append([title, *(_spread(found[name][kind]) for kind in ("train", "test")), *theirs])
    return markdown_table("fold | training | test | the paper, training | the paper, test", rows)


def methods(numbers: Numbers) -> str:
    """Table 2: median, mean and SD of every method over flights."""
    rows = []
    for name in (*SIX, "complementary-adaptive", *OWN):
        for start in ("unknown",) if name.startswith("att") else ("known", "unknown"):
            training = [
                e
                for stage in ("score-fly-sim", "score-fly-real")
                for e in errors(numbers, name, start, stage)
            ]
            test = errors(numbers, name, start)
            cells = [
                " / ".join(f"{f(each):.2f}" for f in (np.median, np.mean, np.std))
                for each in (training, test)
            ]
            home = np.mean(errors(numbers, name, start, "score-fly-test-sim"))
            quoted = METHODS.get((name, start))
            theirs = [" / ".join(f"{x:.2f}" for x in each) for each in quoted] if quoted else ["–", "–"]
            beside = [_silenced(numbers, name, domain) for domain in ("real", "sim")]
            ours = [cells[1] + beside[0], f"{home:.2f}{beside[1]}"]
            rows.append([_named(name), start, cells[0], theirs[0], ours[0], theirs[1], ours[1]])
    header = (
        "method | start | training | the paper, training | test | the paper, test | test, Hummingbird, mean"
    )
    return markdown_table(header, rows)


def _silenced(numbers: Numbers, name: str, domain: str) -> str:
    """Error with output weights of zero, which is that of a level estimate whatever the network."""
    level = next(iter(numbers[f"score-fly-test-{domain}"]["silenced_deg"].values()))
    return f" (silenced {level:.1f})" if name.startswith("att") else ""


def tuned(numbers: Numbers) -> str:
    """Parameters from the swarm."""
    rows = []
    for name in FILTERS:
        each = numbers[f"tune-{name}"]
        values = ", ".join(f"`{key}` {value:.4g}" for key, value in each["values"].items())
        rows.append([name, values, f"{each['rmse_deg']:.2f}"])
    return markdown_table("filter | tuned values | RMSE on the flights that tuned it [°]", rows)


def distributions(numbers: Numbers) -> str:
    """Standard deviations of inputs and outputs in both domains."""
    domains = {f"fly-{name}": each for name, each in numbers["distributions"].items()}
    rows = [
        [DOMAIN_NAMES[domain], *(f"{each['sd']:.2f}" for each in columns.values())]
        for domain, columns in domains.items()
    ]
    return markdown_table(" | ".join(["SD of", *next(iter(domains.values()))]), rows)


def losses(numbers: Numbers) -> str:
    """Best epochs and scatter of the trainings."""
    rows = []
    for stage, title in CURVES.items():
        each = numbers[stage]
        best = each["best"]
        size = scatter(each["val_mse"])
        spikes = "–" if stage == RNN else f"{best['rate_encoding']:.2f}, {best['rate_hidden']:.2f}"
        quoted = {SNN: LOSSES["att-snn"], RNN: LOSSES["att-rnn"]}.get(stage)
        rows.append(
            [
                title,
                f"{len(each['updates'])}",
                best["epoch"] + 1,
                f"{best['val_error_deg']:.2f}",
                f"{1e3 * size:.2f}" if np.isfinite(size) else "–",
                f"{1e3 * quoted:.1f}" if quoted else "–",
                spikes,
                f"{each['seconds'] / 60:.0f}",
                each["reason"],
            ]
        )
    header = (
        "network | epochs | the best | validation error [°] | scatter [10⁻³ rad²] | the paper | "
        "spikes a step, both layers | min | ended because"
    )
    return markdown_table(header, rows)


def recoveries(numbers: Numbers) -> str:
    """When the error is first below 2°."""
    rows = []
    for name, each in numbers["recover"]["curves"].items():
        cells = []
        for kind in ("flight", "hover"):
            if kind in each:
                times = each[kind]["times_s"]
                within = np.mean([time is not None for time in times])
                cells += [shown_time(median_time(times)), f"{100 * within:.0f} %"]
            else:
                cells += ["–", "–"]
        theirs = "< 1" if name in NETWORKS else "> 7" if name in SIX else "between"
        rows.append([_named(name), *cells, theirs if name in (*SIX, "complementary-adaptive") else "–"])
    return markdown_table(
        "method | in flight [s] | converged | in hover [s] | converged | the paper [s]", rows
    )


def activity(numbers: Numbers) -> str:
    """Shares of neurons that hardly spike."""
    rows = []
    rates = [np.array(each) for each in numbers["inside"]["rates"]]
    for layer, rate, never, rare in zip(
        ("encoding", "recurrent"), rates, ACTIVITY["never"], ACTIVITY["rare"], strict=True
    ):
        ours = [(rate == 0).mean(), ((rate > 0) & (rate < 0.005)).mean()]
        cells = [f"{100 * share:.0f} %" for share in (ours[0], never, ours[1], rare)]
        rows.append([layer, f"{rate.mean():.3f}", *cells])
    header = (
        "layer | spikes per neuron and step | never spike | the paper | below 0.5 % of the steps | the paper"
    )
    return markdown_table(header, rows)


def manipulations(numbers: Numbers) -> str:
    """Errors and gains with a sensor changed."""
    rows = []
    for network, title in ((SNN, "Att-SNN"), (CHIP, "Att-SNN (Loihi quantisation)")):
        for way, name in RESPONSES.items():
            each = numbers["manipulate"]["networks"][network][way]
            keys = ("cruise_deg", "error_deg", "slow_gain", "fast_gain")
            rows.append([title, name, *(f"{each[key]:.2f}" for key in keys)])
    header = (
        "network | inputs | error at constant velocity [°] | in aggressive flight [°] | "
        "gain below 0.2 Hz | above 1 Hz"
    )
    return markdown_table(header, rows)


def latencies(numbers: Numbers) -> str:
    """Time of one update."""
    rows = [
        [name, f"{middle:.2f}", f"{high:.2f}"]
        for name, (_, middle, high) in sorted(numbers["latencies"].items(), key=lambda item: item[1][1])
    ]
    return markdown_table("estimator | median [µs] | 99 % [µs]", rows)


def layer(numbers: Numbers) -> str:
    """The paper's measurements of a step of the recurrent layer."""
    rows = [
        ["Loihi, a board of 32 chips", f"{LAYER['loihi_us']:g}", f"{LAYER['loihi_uj']:g}"],
        ["PyTorch SNN, a laptop", f"{LAYER['snn_us']:g}", "–"],
        ["GRU, a laptop", f"{LAYER['gru_us']:g}", "–"],
    ]
    return markdown_table(
        "the paper, the recurrent layer alone | time of a step [µs] | energy of a step [µJ]", rows
    )


def energy(numbers: Numbers) -> str:
    """Operations and modelled energy of a step."""
    rows, total = [], 0.0
    for each in numbers["inside"]["costs"]:
        count, picojoules = each["count"], each["picojoules"]
        total += count * picojoules
        nanojoules, share = f"{count * picojoules / 1e3:.2f}", f"{100 * each['share']:.0f} %"
        rows.append([each["operation"], f"{count:.1f}", f"{picojoules:g}", nanojoules, share])
    rows.append(["sum, modelled", "", "", f"{total / 1e3:.1f}", ""])
    return markdown_table("operation | a step | pJ each | nJ a step | share", rows)


def counted(numbers: Numbers) -> str:
    """Operations of one update, by the paper's formulas and counted."""
    flops = numbers["inside"]["flops"]
    by_formula = operations(100, 100)
    rows = [
        [
            "by the paper's formulas, the recurrent layer",
            by_formula["snn"],
            by_formula["gru"],
            f"{by_formula['gru'] / by_formula['snn']:.2f}",
        ],
        [
            "counted, all layers, zeros too",
            f"{flops['dense']:.0f}",
            f"{flops['gru']:.0f}",
            f"{flops['gru'] / flops['dense']:.2f}",
        ],
        [
            "counted, synapses of spikes alone",
            f"{flops['sparse']:.0f}",
            f"{flops['gru']:.0f}",
            f"{flops['gru'] / flops['sparse']:.1f}",
        ],
    ]
    return markdown_table("operations an update | Att-SNN | Att-RNN | ratio", rows)


def loops(numbers: Numbers) -> str:
    """The closed loop: crashes, errors and whether they grow."""
    rows = []
    for scenario, scores in numbers["loop"]["scenarios"].items():
        for name, each in scores.items():
            parts = " → ".join(f"{part:.2f}" for part in each["parts_deg"])
            error, *tracking = (f"{each[key]:.2f}" for key in ("error_deg", "attitude_deg", "position_m"))
            crashed = f"{each['crashes']} of {each['flights']}"
            title = name if name == "truth" or name in FILTERS else _named(name)
            rows.append([scenario, title, crashed, error, parts, *tracking])
    header = (
        "scenario | attitude from | crashed | estimation error [°] | in thirds of the flight [°] | "
        "attitude tracking [°] | position tracking [m]"
    )
    return markdown_table(header, rows)


def rates(numbers: Numbers) -> str:
    """Errors at each sample rate."""
    methods = ("att-snn", "complementary", "mahony")
    found = {name: by_rate(numbers, name) for name in methods}
    trained = {
        float(name.removeprefix("rate-")): each for name, each in numbers.items() if name.startswith("rate-")
    }
    rows = []
    for hz, each in found["att-snn"].items():
        mean = interval(lambda x: float(x.mean()), each)
        training = trained[hz]
        cells = [f"{np.mean(found[name][hz]):.2f}" for name in methods[1:]]
        rows.append(
            [
                f"{hz:g}",
                str(mean),
                *cells,
                len(training["updates"]),
                training["best"]["epoch"] + 1,
                training["reason"],
            ]
        )
    return markdown_table(
        "samples a second | Att-SNN [°] | complementary [°] | mahony [°] | epochs | the best | ended because",
        rows,
    )


def flown_minutes(numbers: Numbers) -> str:
    """Errors of networks trained on several minutes of flight."""
    rows = []
    for n, sets in numbers["compare-minutes"]["errors"].items():
        training = numbers[f"minutes-{n}"]
        cells = [str(interval(lambda x: float(x.mean()), each)) for each in sets.values()]
        rows.append([n, *cells, len(training["updates"]), training["best"]["epoch"] + 1, training["reason"]])
    header = (
        "minutes of flight | unseen Hummingbird flights [°] | px4-quad, never trained on [°] | epochs | "
        "the best | "
        "ended because"
    )
    return markdown_table(header, rows)
