"""The stages, their inputs, and the stages that each table or figure needs."""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from quadsim.config.toml import nearest
from quadsim.held_out import unreserved

from .stages import Stage
from .work import domains, filters, inside, scores, trainings
from .work.scores import FILTERS

PRESETS: dict[str, dict[str, Any]] = tomllib.loads(Path(__file__).with_name("sizes.toml").read_text("utf-8"))
"""Sizes of the stages of `quadsim paper`, by preset."""
Sizes = Mapping[str, Any]
"""Sizes of a preset, with its name as "preset" and the "seed" of all random numbers."""

SNN, FIXED, CHIP, RNN = "net-snn", "net-weights", "net-chip", "net-rnn"
"""Networks trained by the paper's recipe: Att-SNN in floats, with fixed time constants, on the chip, and
Att-RNN."""
CROSS = ("net-only-sim", "net-only-real")
"""Att-SNN trained on one domain."""
HOVER = {"kind": "hover", "position": [0.0, 0.0, 20.0]}
CRUISE = {"kind": "waypoints", "points": [[20.0 * k, 0.0, 20.0] for k in range(11)], "speed": 5.0}
"""Trajectory with a long phase of constant velocity."""
IN_LOOP = ("complementary", "mahony", "ekf")
OURS = ("estimators",)
"""Packages whose whole code counts, because estimators are made by name."""

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
    "rate": ("score-rate-", "rate-"),
    "minutes": ("score-minutes", "minutes-"),
}
"""Items for `--only`, with prefixes of the names of the stages that each shows."""

PAPER: dict[str, Any] = {"model": "att-snn", "preset": "paper", "quantised": False, "recurrent_delay": 2}
ON_CHIP: dict[str, Any] = {"model": "att-snn", "preset": "paper"}
GRU: dict[str, Any] = {"model": "att-rnn", "preset": "paper"}


def chosen(only: str | None) -> list[str]:
    """Return the tables and figures given as "table1,fig5"; None for all.

    Raises:
        ValueError: An item does not exist; the message names the nearest one.
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
    """Return the sizes of a preset.

    Raises:
        ValueError: The preset does not exist, or a held-out suite reserves the seed.
    """
    if preset not in PRESETS:
        raise ValueError(f"no preset {preset!r}, there are {' and '.join(PRESETS)}")
    return PRESETS[preset] | {"preset": preset, "seed": unreserved(seed)}


def stages_of(sizes: Sizes) -> tuple[dict[str, Stage], dict[str, list[str]]]:
    """Return every stage by name, inputs first, and the stages that each item shows."""
    stages = {stage.name: stage for stage in _stages(sizes, sizes["seed"])}
    return stages, {
        item: [name for name in stages if name.startswith(prefixes)] for item, prefixes in ITEMS.items()
    }


def _stages(s: Sizes, seed: int) -> Iterator[Stage]:
    first = 1000 * seed
    domain = [
        _fly("sim", s["sim_flights"], s["flight_s"], first + 1),
        _fly("real", s["real_flights"], s["flight_s"], first + 2, domain="real"),
    ]
    test = [
        _fly("test-sim", s["test_flights"], s["test_s"], first + 5),
        _fly("test-real", s["test_flights"], s["test_s"], first + 6, domain="real"),
    ]
    hover = _fly("hover", 8, min(20.0, s["test_s"]), first + 7, trajectory=HOVER)
    cruise = _fly("cruise", 8, 60.0, first + 8, trajectory=CRUISE)
    yield from (*domain, *test, hover, cruise)
    yield Stage("distributions", domains.distributions, {"flights": domain})

    swarm = {"particles": s["particles"], "iterations": s["iterations"], "seed": seed}
    tuned = {
        name: Stage(
            f"tune-{name}", filters.tune_filter, {"name": name, "flights": domain} | swarm, packages=OURS
        )
        for name in FILTERS
    }
    long, short = PAPER | s["snn"], PAPER | s["fold"]
    rnn, snn = _train(RNN, domain, seed, GRU | s["rnn"]), _train(SNN, domain, seed, long)
    chip = _train(CHIP, domain, seed, ON_CHIP | s["snn"])
    fixed = _train(FIXED, domain, seed, short | {"fixed_taus": True})
    folds = [_train(f"net-fold-{k}", domain, seed + k, short) for k in range(1, s["folds"])]
    only = [_train(name, [each], seed, short) for name, each in zip(CROSS, domain, strict=True)]
    yield from (*tuned.values(), rnn, snn, chip, fixed, *folds, *only)

    looped = {"att-snn": ("att-snn", snn), "att-snn, chip": ("att-snn-loihi", chip)}
    every = {"filters": tuned, "networks": looped | {"att-rnn": ("att-rnn", rnn)}, "seed": seed}
    loop = {"seeds": s["loop_seeds"], "duration_s": s["loop_s"], "seed": seed, "networks": looped}
    loop |= {"filters": {name: tuned[name] for name in IN_LOOP}}
    yield _ours("score-folds", scores.score_folds, domains=domain, mixed=[snn, *folds], only=only)
    for each in (*domain, *test):
        yield _ours(f"score-{each.name}", scores.score, flights=each, **every)
    yield _ours("recover", scores.recover, flying=test, hover=hover, **every)
    yield _ours("inside", inside.inspect_network, flights=test[0], network=chip, twin=rnn)
    yield _ours("manipulate", inside.manipulate, cruise=cruise, test=test[0], networks=[snn, chip])
    yield Stage("latencies", scores.latencies, {"rounds": s["latency_rounds"]}, alone=True, packages=OURS)
    yield Stage("loop", scores.close_loop, loop, packages=(*OURS, "scenarios"))

    for rate in s["rates_hz"]:  # the same network on as many hours of the same manoeuvres
        data = _fly(f"rate-{rate:g}", s["rate_flights"], s["flight_s"], first + 11, rate_hz=rate)
        unseen = _fly(f"rate-test-{rate:g}", s["test_flights"], s["test_s"], first + 12, rate_hz=rate)
        network = _train(f"rate-{rate:g}", [data], seed, PAPER | s["rate"])
        yield from (data, unseen, network)
        made = {"filters": {}, "networks": {"att-snn": ("att-snn", network)}, "seed": seed}
        yield _ours(f"score-rate-{rate:g}", scores.score, flights=unseen, **made)

    choose = _fly("minutes-validation", s["minutes_validation"], s["flight_s"], first + 14)
    yield choose
    made = {}
    for n in s["minutes"]:  # the same network on the first so many minutes of the same flights
        data = _fly(f"minutes-{n}", n, 60.0, first + 13)
        network = _train(f"minutes-{n}", [data], seed, PAPER | s["study"], [choose])
        yield from (data, network)
        made[str(n)] = ("att-snn", network)
    yield _ours("score-minutes", scores.score, flights=test[0], filters={}, networks=made, seed=seed)


def _fly(name: str, flights: int, duration_s: float, seed: int, domain: str = "sim", **more: Any) -> Stage:
    settings = {"domain": domain, "flights": flights, "duration_s": duration_s, "seed": seed}
    return Stage(f"fly-{name}", domains.generate_flights, settings | more)


def _train(
    name: str, data: Sequence[Stage], seed: int, recipe: dict[str, Any], validation: Sequence[Stage] = ()
) -> Stage:
    return Stage(
        name, trainings.train_network, {"data": data, "validation": validation, "seed": seed} | recipe
    )


def _ours(name: str, make: Any, **arguments: Any) -> Stage:
    """A stage that makes estimators."""
    return Stage(name, make, arguments, packages=OURS)
