"""The stages, what each takes from, and which of them a table or figure needs."""

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from quadsim.config.toml import nearest
from quadsim.held_out import unreserved

from .stages import Stage
from .work import domains, filters, inside, scores, trainings
from .work.scores import FILTERS

PRESETS: dict[str, dict[str, Any]] = tomllib.loads(Path(__file__).with_name("sizes.toml").read_text("utf-8"))
"""Sizes of all that `quadsim paper` does."""
Sizes = Mapping[str, Any]
"""Those of a preset, with its name as "preset" and the "seed" of everything random."""

SIM, REAL = "fly-sim", "fly-real"
TEST = ("fly-test-sim", "fly-test-real")
SNN, FIXED, CHIP, RNN = "net-snn", "net-weights", "net-chip", "net-rnn"
"""By the paper's recipe: Att-SNN in floats, with fixed time constants, on the chip, and Att-RNN."""
CROSS = {"net-only-sim": SIM, "net-only-real": REAL}
CRUISE = {"kind": "waypoints", "points": [[20.0 * k, 0.0, 20.0] for k in range(11)], "speed": 5.0}
"""A flight that has a constant velocity for long."""

ITEMS = {
    "table1": ("score-folds",),
    "table2": ("score-fly", "tune-"),
    "fig3": ("distributions",),
    "fig4": (SNN, FIXED, CHIP, RNN),
    "fig5": ("score-fly",),
    "fig6": ("recover",),
    "fig7": ("inside",),
    "fig8": ("manipulate",),
    "fig9": ("latencies", "inside"),
    "operations": ("inside",),
    "loop": ("loop",),
    "rate": ("compare-rate-", "rate-"),
    "minutes": ("compare-minutes", "minutes-"),
}
"""What `--only` chooses from, and how the names begin of the stages whose numbers it shows."""

PAPER: dict[str, Any] = {"model": "att-snn", "preset": "paper", "quantised": False, "recurrent_delay": 2}
ON_CHIP: dict[str, Any] = {"model": "att-snn", "preset": "paper"}
GRU: dict[str, Any] = {"model": "att-rnn", "preset": "paper"}


def chosen(only: str | None) -> list[str]:
    """The tables and figures asked for as "table1,fig5"; None for all of them.

    Raises:
        ValueError: There is no such item; the message names the nearest.
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


def sizes_of(preset: str, seed: int = 0) -> dict[str, Any]:
    """Sizes of a preset.

    Raises:
        ValueError: There is no such preset, or the seed is of a held-out suite.
    """
    if preset not in PRESETS:
        raise ValueError(f"no preset {preset!r}, there are {' and '.join(PRESETS)}")
    return PRESETS[preset] | {"preset": preset, "seed": unreserved(seed)}


def stages_of(sizes: Sizes) -> tuple[dict[str, Stage], dict[str, list[str]]]:
    """Every stage by name, and the stages whose numbers each item shows."""
    groups = (_flights, _filters, _networks, _scores, _rates, _minutes)
    stages = {stage.name: stage for group in groups for stage in group(sizes)}
    return stages, {
        item: [name for name in stages if name.startswith(prefixes)] for item, prefixes in ITEMS.items()
    }


def _fly(name: str, count: int, duration_s: float, seed: int, domain: str = "sim", **more: Any) -> Stage:
    settings = {"domain": domain, "flights": count, "duration_s": duration_s, "seed": seed}
    return Stage(name, domains.fly, settings | more)


def _flights(s: Sizes) -> list[Stage]:
    hover = {"kind": "hover", "position": [0.0, 0.0, 20.0]}
    first = 1000 * s["seed"]
    return [
        _fly(SIM, s["sim_flights"], s["flight_s"], first + 1),
        _fly(REAL, s["real_flights"], s["flight_s"], first + 2, "real"),
        _fly(TEST[0], s["test_flights"], s["test_s"], first + 5),
        _fly(TEST[1], s["test_flights"], s["test_s"], first + 6, "real"),
        _fly("fly-hover", 8, min(20.0, s["test_s"]), first + 7, trajectory=hover),
        _fly("fly-cruise", 8, 60.0, first + 8, trajectory=CRUISE),
        Stage("distributions", domains.distributions, inputs=(SIM, REAL)),
    ]


def _filters(s: Sizes) -> list[Stage]:
    swarm = {"particles": s["particles"], "iterations": s["iterations"], "seed": s["seed"]}
    return [
        Stage(f"tune-{name}", filters.tune, {"name": name} | swarm, (SIM, REAL), packages=("estimators",))
        for name in FILTERS
    ]


def _train(
    name: str,
    recipe: dict[str, Any],
    seed: int,
    data: Sequence[str] = (SIM, REAL),
    validation: Sequence[str] = (),
) -> Stage:
    settings = {"data": list(data), "validation": list(validation), "seed": seed} | recipe
    return Stage(name, trainings.train, settings, (*data, *validation))


def _networks(s: Sizes) -> list[Stage]:
    long, short = PAPER | s["snn"], PAPER | s["fold"]
    return [
        _train(RNN, GRU | s["rnn"], s["seed"]),
        _train(SNN, long, s["seed"]),
        _train(CHIP, ON_CHIP | s["snn"], s["seed"]),
        _train(FIXED, short | {"fixed_taus": True}, s["seed"]),
        *(_train(f"net-fold-{k}", short, s["seed"] + k) for k in range(1, s["folds"])),
        *(_train(name, short, s["seed"], [domain]) for name, domain in CROSS.items()),
    ]


def _score(
    name: str,
    on: Sequence[str],
    tuned: Sequence[str],
    trained: scores.Networks,
    make: Any = scores.compare,
    **settings: Any,
) -> Stage:
    """Run filters, as tuned, and networks on the flights of some stages."""
    needed = [stage for _, stage in trained.values()]
    inputs = (*on, *(f"tune-{each}" for each in tuned), *needed)
    settings |= {"flights": list(on), "filters": list(tuned), "networks": trained}
    return Stage(name, make, settings, inputs, packages=("estimators",))


def _scores(s: Sizes) -> list[Stage]:
    looped = {"att-snn": ("att-snn", SNN), "att-snn, chip": ("att-snn-loihi", CHIP)}
    made = looped | {"att-rnn": ("att-rnn", RNN)}
    in_loop = ["complementary", "mahony", "ekf"]
    loop = {"seeds": s["loop_seeds"], "duration_s": s["loop_s"], "filters": in_loop, "networks": looped}
    folds = [SNN, *(f"net-fold-{k}" for k in range(1, s["folds"]))]
    tuned = (*(f"tune-{name}" for name in in_loop), SNN, CHIP)
    rounds = {"rounds": s["latency_rounds"]}
    ours, all_of_ours = ("estimators",), ("estimators", "scenarios")
    mixed = {"mixed": folds, "only": CROSS}
    return [
        Stage("score-folds", scores.folds, mixed, (SIM, REAL, *folds, *CROSS), packages=ours),
        *(
            _score(f"score-{each}", [each], FILTERS, made, scores.score, seed=s["seed"])
            for each in (SIM, REAL, *TEST)
        ),
        _score("recover", [*TEST, "fly-hover"], FILTERS, made, scores.recover, seed=s["seed"]),
        Stage("inside", inside.look, inputs=(TEST[0], CHIP, RNN), packages=ours),
        Stage("manipulate", inside.manipulate, inputs=("fly-cruise", TEST[0], SNN, CHIP), packages=ours),
        Stage("latencies", scores.latencies, rounds, alone=True, packages=ours),
        Stage("loop", scores.close_loop, loop | {"seed": s["seed"]}, tuned, packages=all_of_ours),
    ]


def _rates(s: Sizes) -> list[Stage]:
    """The same network trained at every sample rate on as many hours of the same manoeuvres."""
    stages, first = [], 1000 * s["seed"]
    for rate in s["rates_hz"]:
        train, test = f"fly-rate-{rate:g}", f"fly-rate-test-{rate:g}"
        at: dict[str, Any] = {"rate_hz": rate}
        made = {"att-snn": ("att-snn", f"rate-{rate:g}")}
        stages += [
            _fly(train, s["rate_flights"], s["flight_s"], first + 11, **at),
            _fly(test, s["test_flights"], s["test_s"], first + 12, **at),
            _train(f"rate-{rate:g}", PAPER | s["rate"], s["seed"], [train]),
            _score(f"compare-rate-{rate:g}", [test], (), made, **at),
        ]
    return stages


def _minutes(s: Sizes) -> list[Stage]:
    """The same network trained on the first so many minutes of the same flights."""
    choose, first = "fly-minutes-validation", 1000 * s["seed"]
    stages = [_fly(choose, s["minutes_validation"], s["flight_s"], first + 14)]
    for n in s["minutes"]:
        stages.append(_fly(f"fly-minutes-{n}", n, 60.0, first + 13))
        recipe = PAPER | s["study"]
        stages.append(_train(f"minutes-{n}", recipe, s["seed"], [f"fly-minutes-{n}"], [choose]))
    made = {str(n): ("att-snn", f"minutes-{n}") for n in s["minutes"]}
    return [*stages, _score("compare-minutes", TEST[:1], (), made)]
