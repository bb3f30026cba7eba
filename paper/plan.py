"""Which stages there are, what each takes from, and which of them a table or figure needs."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from typing import Any

from quadsim.config.toml import nearest
from quadsim.runs.fingerprint import content_digest

from . import scores, work
from .scores import FILTERS, SHIPPED
from .settings import Budget, PaperSettings
from .stages import Stage

SIM, REAL = "fly-sim", "fly-real"
CHOOSE = ("fly-val-sim", "fly-val-real")
TEST = ("fly-test-sim", "fly-test-real")
SETS = (SIM, REAL, *TEST)
"""What Table 2 is about."""
SNN, FLOAT, PAPER, RNN = "net-snn", "net-snn-float", "net-snn-paper", "net-rnn"
WHOLE = "net-sim"
"""The whole network on all of the Hummingbird's flights: the end of both curves, of size and of minutes."""
NETWORKS = {"att-rnn": ["att-rnn", RNN], "att-snn": ["att-snn-loihi", SNN]}


def shipped_networks() -> dict[str, list[str]]:
    """Networks with the weights that ship; a digest of these, so that new ones are scored again."""
    found = {}
    for label, model in SHIPPED.items():
        weights = files("assets") / "weights" / f"{model.removesuffix('-loihi')}.safetensors"
        found[label] = [model, "", content_digest(weights.read_bytes())[:8]]
    return found


ITEMS = (
    "table1", "table2", "fig3", "fig4", "fig5", "fig6", "fig7", "fig8", "fig9", "flops", "loop",
    "rate", "size", "minutes",
)  # fmt: skip
"""What `--only` chooses from."""

NETWORK = {
    "encoding": 100, "hidden": 100, "pruning_target": 0, "rate_cost": 0.003, "rate_targets": [0.2, 0.4],
    "reinitialise_until": 0.6,
}  # fmt: skip
"""The paper's size of network, and as many spikes as it likes."""


SNN_STEP_S, RNN_STEP_S = 2.3e-8, 3.5e-5
"""Time of a training step, of a hidden neuron and of a GRU of 100: for order and progress alone."""


def chosen(only: str | None) -> list[str]:
    """The tables and figures asked for as "table1,fig5"; None for all of them.

    Raises:
        ValueError: There is no such thing, with the nearest that there is.
    """
    if only is None:
        return list(ITEMS)
    names = [name.strip().lower().replace(" ", "") for name in only.split(",") if name.strip()]
    for name in names:
        if name not in ITEMS:
            raise ValueError(f'there is no "{name}" to make; {nearest(name, ITEMS)}')
    if not names:
        raise ValueError(f"nothing to make: --only takes some of {', '.join(ITEMS)}")
    return [name for name in ITEMS if name in names]


def stages_of(settings: PaperSettings) -> tuple[dict[str, Stage], dict[str, list[str]]]:
    """Every stage by name, and the stages whose numbers each item shows."""
    stages = {
        stage.name: stage
        for stage in [
            *_flights(settings),
            *_filters(settings),
            *_networks(settings),
            *_folds(settings),
            *_scores(settings),
            *_rates(settings),
            *_sizes(settings),
            *_minutes(settings),
        ]
    }
    folds = [name for name in stages if name.startswith("fold-")]
    tables = [f"score-{name.removeprefix('fly-')}" for name in SETS]
    shows = {
        "table1": folds,
        "table2": [*tables, *(f"tune-{name}" for name in FILTERS)],
        "fig3": ["distributions"],
        "fig4": [SNN, FLOAT, PAPER, RNN],
        "fig5": tables,
        "fig6": ["recover"],
        "fig7": ["inside"],
        "fig8": ["inside"],
        "fig9": ["latencies", "inside"],
        "flops": ["inside"],
        "loop": ["loop"],
        "rate": [name for name in stages if name.startswith("compare-rate-")],
        "size": ["compare-size"],
        "minutes": ["compare-minutes"],
    }
    return stages, shows


def _flights(s: PaperSettings) -> list[Stage]:
    def fly(name: str, domain: str, flights: int, seed: int, **more: Any) -> Stage:
        settings = {
            "domain": domain,
            "flights": flights,
            "duration_s": s.flight_s,
            "seed": 1000 * s.seed + seed,
        }
        seconds = 0.006 * flights * s.flight_s
        return Stage(name, work.fly, settings | more, seconds=seconds)

    sets = [
        fly(SIM, "sim", s.sim_flights, 1),
        fly(REAL, "real", s.real_flights, 2),
        fly(CHOOSE[0], "sim", s.validation_flights[0], 3),
        fly(CHOOSE[1], "real", s.validation_flights[1], 4),
        fly(TEST[0], "sim", s.test_flights[0], 5),
        fly(TEST[1], "real", s.test_flights[1], 6),
        fly("fly-hover", "sim", 8, 7, duration_s=min(20.0, s.flight_s), hover=True),
    ]
    fewer = [fly(f"fly-sim-{n}", "sim", n, 1) for n in s.minutes_flights[:-1]]  # the first of SIM's
    rates = [
        fly(f"fly-{kind}-{rate:g}", "sim", n, seed, rate_hz=rate)
        for rate in s.rates_hz
        for kind, n, seed in zip(("rate", "rate-val", "rate-test"), s.rate_flights, (11, 12, 13), strict=True)
    ]
    return [*sets, *fewer, *rates, Stage("distributions", work.distributions, inputs=(SIM, REAL))]


def _filters(s: PaperSettings) -> list[Stage]:
    samples = 200 * s.flight_s * (s.sim_flights + s.real_flights)
    return [
        Stage(
            f"tune-{name}",
            work.tune_filter,
            {"name": name, "particles": s.particles, "iterations": s.iterations, "seed": s.seed},
            (SIM, REAL),
            seconds=6e-8 * samples * s.particles * s.iterations,
        )
        for name in FILTERS
    ]


def _net(
    name: str, s: PaperSettings, budget: Budget, data: Sequence[str], validation: Sequence[str],
    rate_hz: float = 200.0, seed: int = 0, preset: str = "best", **choices: Any,
) -> Stage:  # fmt: skip
    """A training."""
    if choices.get("model") != "att-rnn" and preset == "best":
        choices = NETWORK | choices
    settings = {
        "data": list(data), "validation": list(validation), "preset": preset, "seed": s.seed + seed,
        **budget.choices(), **choices,
    }  # fmt: skip
    inputs = (*data, *validation, *([choices["init"]] if "init" in choices else []))
    return Stage(name, work.train, settings, inputs, _seconds(budget, rate_hz, choices))


def _seconds(budget: Budget, rate_hz: float, choices: dict[str, Any]) -> float:
    steps = budget.updates * budget.batch_size * budget.window_s * rate_hz
    if choices.get("model") == "att-rnn":
        return steps * RNN_STEP_S
    return 3.0 + 0.8 * budget.epochs + steps * choices.get("hidden", 100) * SNN_STEP_S


def _networks(s: PaperSettings) -> list[Stage]:
    data, by = (SIM, REAL), CHOOSE
    return [
        _net(SNN, s, s.main, data, by, model="att-snn"),
        _net(FLOAT, s, s.main, data, by, model="att-snn", quantised=False),
        _net(
            PAPER, s, s.paper, data, by, preset="paper", model="att-snn", quantised=False, recurrent_delay=2
        ),
        _net(RNN, s, s.rnn, data, by, model="att-rnn"),
    ]


def _folds(s: PaperSettings) -> list[Stage]:
    found = []
    for model, budget in (("att-snn", s.fold_snn), ("att-rnn", s.fold_rnn)):
        spikes = NETWORK if model == "att-snn" else {}
        for domain, other in (("sim", "real"), ("real", "sim")):
            for k in range(s.folds):
                settings = {
                    "domain": domain, "others": [other], "fold": k, "folds": s.folds, "preset": "best",
                    "model": model, "seed": s.seed, **budget.choices(), **spikes,
                }  # fmt: skip
                seconds = _seconds(budget, 200.0, {"model": model}) + 20
                inputs = (f"fly-{domain}", f"fly-{other}")
                found.append(Stage(f"fold-{model}-{domain}-{k}", work.fold, settings, inputs, seconds))
    return found


def _scores(s: PaperSettings) -> list[Stage]:
    tuned = tuple(f"tune-{name}" for name in FILTERS)
    shipped = shipped_networks()
    every = NETWORKS | shipped
    found = [
        Stage(
            f"score-{name.removeprefix('fly-')}",
            scores.score,
            {"flights": name, "networks": every, "settle_s": 10.0, "seed": s.seed},
            (name, *tuned, SNN, RNN),
            seconds=60,
        )
        for name in SETS
    ]
    recover = Stage(
        "recover",
        scores.recover,
        {"flights": list(TEST), "hover": "fly-hover", "networks": every, "seed": s.seed},
        (*TEST, "fly-hover", *tuned, SNN, RNN),
        seconds=20,
    )
    inside = Stage(
        "inside",
        scores.look_inside,
        {"flights": TEST[0], "network": SNN, "rnn": RNN},
        (TEST[0], SNN, RNN),
        seconds=90,
    )
    latencies = Stage(
        "latencies",
        scores.latencies,
        {"rounds": s.latency_rounds},
        seconds=1.0 * s.latency_rounds,
        alone=True,
    )
    networks = {"att-snn": NETWORKS["att-snn"], "att-snn, shipped": shipped["att-snn, shipped"]}
    loop = Stage(
        "loop",
        scores.close_loop,
        {"networks": networks, "seeds": s.loop_seeds, "duration_s": s.loop_s, "seed": s.seed},
        ("tune-complementary", "tune-mahony", "tune-ekf", SNN),
        seconds=40,
    )
    return [*found, recover, inside, latencies, loop]


def _rates(s: PaperSettings) -> list[Stage]:
    found = []
    for rate in s.rates_hz:
        train, validation, test = (f"fly-{kind}-{rate:g}" for kind in ("rate", "rate-val", "rate-test"))
        moved, trained = f"rescaled-{rate:g}", f"rate-{rate:g}"
        compared = {"rescaled": ["att-snn", moved], "trained on": ["att-snn", trained]}
        found += [
            Stage(moved, work.rescale, {"rate_hz": rate}, (FLOAT,), seconds=1),
            _net(
                trained, s, s.rate, (train,), (validation,), rate, model="att-snn", init=moved,
                quantised=False, optimiser_lr=0.015,
            ),
            Stage(
                f"compare-rate-{rate:g}",
                scores.compare,
                {
                    "flights": [test], "filters": ["mahony", "complementary"], "networks": compared,
                    "rate_hz": rate,
                },
                (test, "tune-mahony", "tune-complementary", moved, trained),
                seconds=5,
            ),
        ]  # fmt: skip
    return found


def _whole(s: PaperSettings) -> Stage:
    return _net(WHOLE, s, s.study, (SIM,), CHOOSE[:1], model="att-snn")


def _sizes(s: PaperSettings) -> list[Stage]:
    nets = [
        _net(
            f"size-{size}", s, s.study, (SIM,), CHOOSE[:1], model="att-snn", encoding=size // 2,
            hidden=size - size // 2,
        )
        for size in s.sizes[:-1]
    ]  # fmt: skip
    names = [*(net.name for net in nets), WHOLE]
    labels = {str(size): ["att-snn-loihi", name] for size, name in zip(s.sizes, names, strict=True)}
    settings = {"flights": list(TEST), "filters": ["mahony", "complementary"], "networks": labels}
    inputs = (*TEST, "tune-mahony", "tune-complementary", *names)
    return [_whole(s), *nets, Stage("compare-size", scores.compare, settings, inputs, seconds=10)]


def _minutes(s: PaperSettings) -> list[Stage]:
    nets = [
        _net(f"minutes-{n}", s, s.study, (f"fly-sim-{n}",), CHOOSE[:1], model="att-snn")
        for n in s.minutes_flights[:-1]
    ]
    names = [*(net.name for net in nets), WHOLE]
    labels = {str(n): ["att-snn-loihi", name] for n, name in zip(s.minutes_flights, names, strict=True)}
    settings = {"flights": list(TEST), "filters": [], "networks": labels}
    return [*nets, Stage("compare-minutes", scores.compare, settings, (*TEST, *names), seconds=10)]
