"""The stages, what each takes from, and which of them a table or figure needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
SNN, FLOAT, PAPER, RNN = "net-snn", "net-snn-float", "net-snn-paper", "net-rnn"
COMPLETE = "net-sim"
"""The network of full size on all of the Hummingbird's flights: last of the curves of size and of minutes."""
RATE_SETS = ("rate", "rate-val", "rate-test")
STUDY_FILTERS = ("mahony", "complementary")
RESCALED, TRAINED_ON = "Att-SNN, rescaled", "Att-SNN, rescaled and trained on"

ITEMS = {
    "table1": ("fold-",),
    "table2": ("score-", "tune-"),
    "fig3": ("distributions",),
    "fig4": (SNN, RNN),
    "fig5": ("score-",),
    "fig6": ("recover",),
    "fig7": ("inside",),
    "fig8": ("inside",),
    "fig9": ("latencies", "inside"),
    "flops": ("inside",),
    "loop": ("loop",),
    "rate": ("compare-rate-",),
    "size": ("compare-size",),
    "minutes": ("compare-minutes",),
}
"""What `--only` chooses from, and how the names begin of the stages whose numbers it shows."""

GRU: dict[str, Any] = {"model": "att-rnn"}
SPIKING: dict[str, Any] = {
    "model": "att-snn",
    "encoding": 100,
    "hidden": 100,
    "pruning_target": 0,
    "rate_cost": 0.003,
    "rate_targets": [0.2, 0.4],
    "reinitialise_until": 0.6,
}
"""The paper's size of network, and as many spikes as it likes."""


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
    groups = (_flights, _filters, _networks, _folds, _scores, _rates, _studies)
    stages = {stage.name: stage for group in groups for stage in group(settings)}
    return stages, {
        item: [name for name in stages if name.startswith(prefixes)] for item, prefixes in ITEMS.items()
    }


def _flights(s: PaperSettings) -> list[Stage]:
    def fly(name: str, domain: str, flights: int, seed: int, **more: Any) -> Stage:
        settings = {"domain": domain, "flights": flights, "duration_s": s.flight_s} | more
        settings["seed"] = 1000 * s.seed + seed
        return Stage(name, work.fly, settings, seconds=0.006 * flights * s.flight_s)

    return [
        fly(SIM, "sim", s.sim_flights, 1),
        fly(REAL, "real", s.real_flights, 2),
        fly(CHOOSE[0], "sim", s.validation_flights[0], 3),
        fly(CHOOSE[1], "real", s.validation_flights[1], 4),
        fly(TEST[0], "sim", s.test_flights[0], 5),
        fly(TEST[1], "real", s.test_flights[1], 6),
        fly("fly-hover", "sim", 8, 7, duration_s=min(20.0, s.flight_s), hover=True),
        *(fly(f"fly-sim-{n}", "sim", n, 1) for n in s.minutes_flights[:-1]),  # the first of SIM's
        *(
            fly(f"fly-{kind}-{rate:g}", "sim", flights, seed, rate_hz=rate)
            for rate in s.rates_hz
            for kind, flights, seed in zip(RATE_SETS, s.rate_flights, (11, 12, 13), strict=True)
        ),
        Stage("distributions", work.distributions, inputs=(SIM, REAL)),
    ]


def _filters(s: PaperSettings) -> list[Stage]:
    swarm = {"particles": s.particles, "iterations": s.iterations, "seed": s.seed}
    samples = 200 * s.flight_s * (s.sim_flights + s.real_flights)
    seconds = 6e-8 * samples * s.particles * s.iterations
    return [
        Stage(f"tune-{name}", work.tune_filter, {"name": name} | swarm, (SIM, REAL), seconds)
        for name in FILTERS
    ]


def _train(
    name: str,
    s: PaperSettings,
    budget: Budget,
    data: Sequence[str] = (SIM, REAL),
    validation: Sequence[str] = CHOOSE,
    rate_hz: float = 200.0,
    **choices: Any,
) -> Stage:
    """Train a network; choices: fields of `TrainConfig`, but `init` is a stage."""
    settings = {"data": list(data), "validation": list(validation), "preset": "hummingbird", "seed": s.seed}
    inputs = (*data, *validation, *([choices["init"]] if "init" in choices else []))
    seconds = _seconds(budget, choices, rate_hz)
    return Stage(name, work.train, settings | dict(budget) | choices, inputs, seconds)


def _seconds(budget: Budget, choices: Mapping[str, Any], rate_hz: float = 200.0) -> float:
    steps = budget.updates * budget.batch_size * budget.window_s * rate_hz
    if choices["model"] == "att-rnn":
        return steps * 3.5e-5
    return 3.0 + 0.8 * budget.epochs + steps * choices.get("hidden", 100) * 2.3e-8


def _networks(s: PaperSettings) -> list[Stage]:
    recipe = {"preset": "paper", "model": "att-snn", "quantised": False, "recurrent_delay": 2}
    return [
        _train(SNN, s, s.main, **SPIKING),
        _train(FLOAT, s, s.main, **SPIKING, quantised=False),
        _train(PAPER, s, s.paper, **recipe),
        _train(RNN, s, s.rnn, **GRU),
    ]


def _folds(s: PaperSettings) -> list[Stage]:
    stages = []
    for choices, budget in ((SPIKING, s.fold_snn), (GRU, s.fold_rnn)):
        settings = {"folds": s.folds, "preset": "hummingbird", "seed": s.seed} | dict(budget) | choices
        seconds = _seconds(budget, choices) + 20
        for domain, other in (("sim", "real"), ("real", "sim")):
            inputs = (f"fly-{domain}", f"fly-{other}")
            for k in range(s.folds):
                name = f"fold-{choices['model']}-{domain}-{k}"
                own = {"domain": domain, "other": other, "fold": k}
                stages.append(Stage(name, work.fold, settings | own, inputs, seconds))
    return stages


def _score(
    name: str,
    flights: Sequence[str],
    filters: Sequence[str],
    networks: scores.Networks,
    seconds: float,
    make: Any = scores.compare,
    **settings: Any,
) -> Stage:
    """Run filters, as tuned, and networks on the flights of some stages."""
    trained = [stage for _, stage, *_ in networks.values() if stage]
    inputs = (*flights, *(f"tune-{each}" for each in filters), *trained)
    settings |= {"flights": list(flights), "filters": list(filters), "networks": networks}
    return Stage(name, make, settings, inputs, seconds)


def _scores(s: PaperSettings) -> list[Stage]:
    networks: dict[str, Sequence[str]] = {"att-rnn": ["att-rnn", RNN], "att-snn": ["att-snn-loihi", SNN]}
    for label, model in SHIPPED.items():
        weights = files("assets") / "weights" / f"{model.removesuffix('-loihi')}.safetensors"
        networks[label] = [model, "", content_digest(weights.read_bytes())[:8]]  # new ones are scored again
    spiking = {label: network for label, network in networks.items() if "snn" in label}
    in_loop = ["complementary", "mahony", "ekf"]
    loop = {"seeds": s.loop_seeds, "duration_s": s.loop_s, "filters": in_loop, "networks": spiking}
    seeded = {"seed": s.seed}
    return [
        *(
            _score(each.replace("fly", "score"), [each], FILTERS, networks, 60, scores.score, **seeded)
            for each in (SIM, REAL, *TEST)
        ),
        _score("recover", [*TEST, "fly-hover"], FILTERS, networks, 20, scores.recover, **seeded),
        Stage("inside", scores.look_inside, inputs=(TEST[0], SNN, RNN), seconds=90),
        Stage("latencies", scores.latencies, {"rounds": s.latency_rounds}, (), s.latency_rounds, alone=True),
        Stage("loop", scores.close_loop, loop | seeded, (*(f"tune-{name}" for name in in_loop), SNN), 40),
    ]


def _rates(s: PaperSettings) -> list[Stage]:
    stages = []
    for rate in s.rates_hz:
        train, validation, test = (f"fly-{kind}-{rate:g}" for kind in RATE_SETS)
        moved, trained = f"rescaled-{rate:g}", f"rate-{rate:g}"
        choices = SPIKING | {"init": moved, "quantised": False, "optimiser_lr": 0.015}
        networks = {RESCALED: ["att-snn", moved], TRAINED_ON: ["att-snn", trained]}
        stages += [
            Stage(moved, work.rescale, {"rate_hz": rate}, (FLOAT,), seconds=1),
            _train(trained, s, s.rate, [train], [validation], rate, **choices),
            _score(f"compare-rate-{rate:g}", [test], STUDY_FILTERS, networks, 5, rate_hz=rate),
        ]
    return stages


def _studies(s: PaperSettings) -> list[Stage]:
    """Networks of several sizes, and from several minutes of flight."""

    def train(name: str, data: str, **size: int) -> Stage:
        return _train(name, s, s.study, [data], CHOOSE[:1], **SPIKING | size)

    complete = train(COMPLETE, SIM)
    sizes = [train(f"size-{n}", SIM, encoding=n // 2, hidden=n - n // 2) for n in s.sizes[:-1]]
    minutes = [train(f"minutes-{n}", f"fly-sim-{n}") for n in s.minutes_flights[:-1]]
    stages = [complete]
    for kind, counts, trained, filters in (
        ("size", s.sizes, sizes, STUDY_FILTERS),
        ("minutes", s.minutes_flights, minutes, ()),
    ):
        named = zip(counts, [*trained, complete], strict=True)
        networks = {str(count): ["att-snn-loihi", stage.name] for count, stage in named}
        stages += [*trained, _score(f"compare-{kind}", TEST, filters, networks, 10)]
    return stages
