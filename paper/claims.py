"""The paper's claims, each judged from this run's numbers by a rule that stands here in words and in code."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from .plan import FLOAT, RNN, SNN
from .quoted import CONVERGE_S, FLOPS_RATIO, REMOVABLE, TEST_DEG
from .scores import SHIPPED, SIX

Word = Literal["holds", "partly", "does not hold", "not judged"]
Numbers = Mapping[str, dict[str, Any]]
"""Numbers of the finished stages by name."""

FILTERS = tuple(name for name in SIX if not name.startswith("att"))
NETWORKS = ("att-rnn", "att-snn")
FREE = 1.02
"""An error that is larger by less than this factor is no loss."""
BADLY = 1.25
"""A network generalises badly if its error on the other domain is larger than home-trained ones' by this."""
GROWS = 1.2
"""Errors accumulate if the last part of a flight has an error larger than the first by this factor."""


@dataclass(frozen=True)
class Judgement:
    """A claim and what became of it."""

    item: str
    """The table or figure that it is about."""
    claim: str
    rule: str
    """When it counts as holding."""
    verdict: Word
    measured: str
    why: str = ""


def judge(numbers: Numbers) -> list[Judgement]:
    """All claims; one whose stages are not there is not judged."""
    found = []
    for claim in CLAIMS:
        try:
            verdict, measured, why = claim.judge(numbers)
        except KeyError:
            verdict, measured, why = "not judged", "its numbers were not made in this run", ""
        found.append(Judgement(claim.item, claim.says, claim.rule, verdict, measured, why))
    return found


def pooled(numbers: Numbers, kind: str, method: str, start: str) -> np.ndarray:
    """Errors of a method on every flight of both domains, of the training or the test set [deg]."""
    stages = (f"score-{kind}sim", f"score-{kind}real")
    return np.concatenate([numbers[stage]["sequences"][method][start] for stage in stages])


JudgedClaim = tuple[Word, str, str]


def _competitive(numbers: Numbers) -> JudgedClaim:
    error = {name: float(pooled(numbers, "test-", name, "unknown").mean()) for name in SIX}
    beaten = [name for name in FILTERS if error["att-snn"] < error[name]]
    shown = ", ".join(f"{name} {error[name]:.2f}°" for name in sorted(error, key=error.__getitem__))
    verdict: Word = "holds" if len(beaten) >= 2 else "partly" if beaten else "does not hold"
    theirs = TEST_DEG["att-snn"] / TEST_DEG["complementary"]
    ours = error["att-snn"] / error["complementary"]
    why = (
        f"in the paper Att-SNN has {theirs:.2f} times the error of the complementary filter, here {ours:.2f} "
        "times; a complementary filter takes every acceleration for a tilt, which costs more the more "
        "aggressive the flights are"
    )
    return (
        verdict,
        f"on test flights from an unknown start {shown}; Att-SNN beats {len(beaten)} of 4 filters",
        why,
    )


def scatter(losses: Sequence[float], root_mean_square: bool = False) -> float:
    """How far a validation loss jumps from epoch to epoch, as a share of it, beside its trend.

    The spread of log L[i] − (log L[i−1] + log L[i+1]) / 2 over the middle half of a training, times √(2/3),
    which makes it that of the noise if this is white. Spread: 1.4826 times the median of the sizes, for the
    few steps in which a loss falls by much are not noise, and lead a root mean square, the other measure.
    """
    log = np.log(np.asarray(losses, dtype=np.float64))
    beside = log[1:-1] - 0.5 * (log[:-2] + log[2:])
    quarter = len(beside) // 4
    middle = beside[quarter : len(beside) - quarter]
    spread = np.sqrt(np.mean(middle**2)) if root_mean_square else 1.4826 * np.median(np.abs(middle))
    return float(spread * np.sqrt(2 / 3))


def _noisy(numbers: Numbers) -> JudgedClaim:
    jumps = {
        name: [scatter(numbers[name]["val_mse"], way) for way in (False, True)] for name in (SNN, FLOAT, RNN)
    }
    shown = ", ".join(
        f"{what} {100 * jumps[name][0]:.1f} % ({100 * jumps[name][1]:.1f} %)"
        for what, name in (("Att-SNN", SNN), ("in floats", FLOAT), ("Att-RNN", RNN))
    )
    more = [
        spiking > other
        for name in (SNN, FLOAT)
        for spiking, other in zip(jumps[name], jumps[RNN], strict=True)
    ]
    verdict: Word = "holds" if all(more) else "partly" if any(more) else "does not hold"
    why = (
        "a spike is there or not: a small step of the weights moves many of them at once; the learning rates "
        "are each network's own, and the spiking one's is the larger"
        if verdict != "does not hold"
        else "with Lookahead's slow weights and a decaying learning rate little of the spikes' noise is left"
    )
    shown = f"validation loss scatters from epoch to epoch, by the median (by the root mean square): {shown}"
    return verdict, shown, why


def cross_domain(numbers: Numbers, model: str) -> dict[tuple[str, str], np.ndarray]:
    """Errors of the folds (trained on, tested on) [deg]."""
    found: dict[tuple[str, str], list[float]] = {}
    for name, stage in numbers.items():
        if name.startswith(f"fold-{model}-"):
            for score in stage["scores"]:
                found.setdefault((score["trained_on"], score["tested_on"]), []).append(score["error_deg"])
    if not found:
        raise KeyError(model)
    return {key: np.array(errors) for key, errors in found.items()}


def _generalises(numbers: Numbers) -> JudgedClaim:
    ratios, shown = {}, []
    for model in NETWORKS:
        cells = cross_domain(numbers, model)
        away, home = cells["sim", "real"].mean(), cells["real", "(test)"].mean()
        ratios[model] = away / home
        shown.append(f"{model} {away:.2f}° against {home:.2f}°")
    bad = sum(ratio > BADLY for ratio in ratios.values())
    verdict: Word = "holds" if bad == 2 else "partly" if bad else "does not hold"
    learnt = "the second airframe has other inertia, drag and sensors, and a network learns the first one's"
    why = {
        0: "both domains are simulated here and fly alike: the gap to a real vehicle, with its vibration and "
        "its misaligned sensors, is larger; and the folds' networks are trained briefly",
        1: f"{learnt}; the other network has learnt little of either in a fold's short training",
        2: learnt,
    }[bad]
    measured = f"trained on the Hummingbird, tested on the second domain: {', '.join(shown)} if trained there"
    return verdict, measured + _of_shipped(numbers), why


def _of_shipped(numbers: Numbers) -> str:
    """What the weights that ship do on both domains, where they were scored."""
    if not {"score-test-sim", "score-test-real"} <= numbers.keys():
        return ""
    found = []
    for name in SHIPPED:
        home, away = (
            np.mean(numbers[f"score-test-{domain}"]["sequences"][name]["unknown"])
            for domain in ("sim", "real")
        )
        found.append(f"{name} makes {home:.2f}° on the Hummingbird, {away:.2f}° on the second domain")
    return f"; trained far longer, and not on the second domain, {', '.join(found)}"


def _converges(numbers: Numbers) -> JudgedClaim:
    found = numbers["recover"]["found"]
    times = {
        name: found[name]["flight"]["first_s"] for name in (*FILTERS, "complementary-adaptive", *NETWORKS)
    }
    times = {name: np.inf if time is None else time for name, time in times.items()}
    networks = [times[name] for name in NETWORKS]
    filters = [time for name, time in times.items() if name not in NETWORKS]
    fast, slow = max(networks) < CONVERGE_S["networks"], max(filters) > CONVERGE_S["filters"]
    quicker = max(networks) < float(np.median(filters))
    verdict: Word = "holds" if fast and slow else "partly" if quicker else "does not hold"
    shown = ", ".join(f"{name} {_seconds(times[name])}" for name in sorted(times, key=times.__getitem__))
    why = (
        "networks keep no attitude that would have to be forgotten: their memory is a second or so. The "
        "filters' gains are tuned for whole flights, and how long they take to forget follows from those"
    )
    return verdict, f"from 20° to the first time below 2° in flight: {shown}", why


def _seconds(time: float) -> str:
    return "never" if np.isinf(time) else f"{time:.2f} s"


def _removable(numbers: Numbers) -> JudgedClaim:
    inside = numbers["inside"]
    fractions = np.array(inside["fractions"])
    free = {
        by: float(max(f for f, e in zip(fractions, errors, strict=True) if e < FREE * errors[0]))
        for by, errors in inside["ablation"].items()
        if by != "random"
    }
    best = max(free, key=free.__getitem__)
    most = free[best]
    at = int(np.argmin(np.abs(fractions - REMOVABLE)))
    errors = inside["ablation"][best]
    verdict: Word = "holds" if most > REMOVABLE - 0.01 else "partly" if most > 0.05 else "does not hold"
    silent = sum(inside["silent"])
    why = f"{silent} neurons hardly ever spike, and each of the others carries a share"
    return (
        verdict,
        f"{100 * most:.0f} % can go for less than 2 % more error (by {best}, nothing trained again); without "
        f"{100 * fractions[at]:.0f} % of them the error is {errors[at]:.2f}° in place of {errors[0]:.2f}°",
        why,
    )


def _references(numbers: Numbers) -> JudgedClaim:
    found = numbers["inside"]["responses"]
    no_gyro, no_accel = found["gyro removed"], found["accel removed"]
    long_time = no_gyro["slow_gain"] > no_accel["slow_gain"]
    short_time = no_accel["fast_gain"] > no_gyro["fast_gain"]
    verdict: Word = (
        "holds" if long_time and short_time else "partly" if long_time or short_time else "does not hold"
    )
    measured = (
        f"slow attitude (below 0.2 Hz) is followed with a gain of {no_gyro['slow_gain']:.2f} without "
        f"gyroscope and of {no_accel['slow_gain']:.2f} without accelerometer; fast attitude (above 1 Hz) of "
        f"{no_gyro['fast_gain']:.2f} and of {no_accel['fast_gain']:.2f}"
    )
    why = (
        "as in any filter, rates drift when integrated and forces are disturbed when accelerating"
        if long_time
        else "thrust lies along the body's z at any tilt, and only rotor drag tells a flying accelerometer "
        "of it; in flight as aggressive as this the network gets even slow attitude mostly from the rates"
    )
    return verdict, measured, why


def _flops(numbers: Numbers) -> JudgedClaim:
    flops = numbers["inside"]["flops"]
    dense, sparse = (flops["gru"] / flops[kind] for kind in ("dense", "sparse"))
    verdict: Word = (
        "holds" if dense >= 0.8 * FLOPS_RATIO else "partly" if sparse >= FLOPS_RATIO else "does not hold"
    )
    measured = (
        f"{flops['gru']:.0f} operations an update against {flops['dense']:.0f}: {dense:.1f} times; counting "
        f"only synapses of neurons that spike, {sparse:.0f} times"
    )
    return (
        verdict,
        measured,
        "a GRU has three gates where a spiking layer has one current; formulas are our own",
    )


def by_rate(numbers: Numbers) -> dict[float, dict[str, float]]:
    """Mean error of each estimator at each sample rate [deg]."""
    found = {
        float(name.removeprefix("compare-rate-")): {
            label: float(np.mean([np.mean(e) for e in errors.values()]))
            for label, errors in stage["errors"].items()
        }
        for name, stage in numbers.items()
        if name.startswith("compare-rate-")
    }
    if not found:
        raise KeyError("rate")
    return dict(sorted(found.items()))


def _rates(numbers: Numbers) -> JudgedClaim:
    found = by_rate(numbers)
    rates = list(found)
    errors = [found[rate]["trained on"] for rate in rates]
    lower = errors[-1] < errors[0] / FREE
    falling = all(b <= FREE * a for a, b in pairwise(errors))
    verdict: Word = "holds" if lower and falling else "partly" if lower else "does not hold"
    shown = ", ".join(f"{error:.2f}° at {rate:g} Hz" for rate, error in zip(rates, errors, strict=True))
    why = (
        "more steps in a second carry finer rates of spikes and shorter delays"
        if lower
        else "the network comes from 200 Hz, and is trained on briefly over more steps the higher the rate"
    )
    if "mahony" in found[rates[0]]:
        first, last = (found[rate]["mahony"] for rate in (rates[0], rates[-1]))
        why += (
            f"; Mahony, which is not trained, goes from {first:.2f}° to {last:.2f}°: so much is in the rate"
        )
    return verdict, f"trained on at each rate: {shown}", why


def _loop(numbers: Numbers) -> JudgedClaim:
    found = numbers["loop"]["found"]
    crashes = sum(each["att-snn"]["crashes"] for each in found.values())
    flights = sum(each["att-snn"]["flights"] for each in found.values())
    growth = {
        name: parts[-1] / parts[0]
        for name, each in found.items()
        for parts in [each["att-snn"]["parts_deg"]]
        if np.isfinite(parts).all()
    }
    steady = [name for name, ratio in growth.items() if ratio < GROWS]
    verdict: Word = "does not hold"
    if len(steady) == len(found):
        verdict = "holds" if crashes == 0 else "partly"
    elif steady:
        verdict = "partly"
    shown = ", ".join(f"{name} {ratio:.2f}" for name, ratio in growth.items())
    measured = (
        f"{crashes} of {flights} flights on Att-SNN crashed; error of the last third over that of the first: "
        f"{shown}"
    )
    return (
        verdict,
        measured,
        "the accelerometer is a reference that does not drift, and the network forgets in a second",
    )


@dataclass(frozen=True)
class Claim:
    """What the paper says, where its numbers are, and how it is judged."""

    item: str
    says: str
    rule: str
    judge: Callable[[Numbers], JudgedClaim]


CLAIMS = (
    Claim(
        "table2", "Att-SNN is competitive with the filters",
        "its mean error on test flights is below that of two of the four filters; partly: of one",
        _competitive,
    ),
    Claim(
        "fig4", "The SNN's loss is noisier than the RNN's",
        "its validation loss scatters more, on the chip's grid and in floats, by the median and by the root "
        "mean square of the jumps; partly: in some of these", _noisy,
    ),
    Claim(
        "table1", "Training on a single source generalises badly",
        f"on the other domain the error is above {BADLY:g} times that of networks trained there, for both "
        "networks; partly: for one", _generalises,
    ),
    Claim(
        "fig6", "From 20° off, networks converge in < 1 s and filters in > 7 s",
        "both networks are first below 2° within 1 s and some filter after 7 s; partly: both networks are "
        "quicker than the median filter", _converges,
    ),
    Claim(
        "fig7", "About 25 % of the neurons can go without loss",
        "25 % can go for less than 2 % more error; partly: more than 5 % can", _removable,
    ),
    Claim(
        "fig8", "The accelerometer is the reference in the long time, the gyroscope in the short",
        "slow attitude is followed better without gyroscope than without accelerometer, fast attitude the "
        "other way round; partly: one of them", _references,
    ),
    Claim(
        "flops", "Att-RNN needs about 3 × the FLOPs of Att-SNN",
        "2.4 times or more, multiplying zeros too; partly: only when silent neurons are left out", _flops,
    ),
    Claim(
        "rate", "Higher data rates lower the error",
        "lower at the highest rate than at the lowest by 2 %, and never 2 % higher than at the rate before; "
        "partly: the former alone", _rates,
    ),
    Claim(
        "loop", "Errors do not accumulate in the loop",
        f"no crash, and in every scenario the last third's error is below {GROWS:g} times the first's; "
        "partly: in some", _loop,
    ),
)  # fmt: skip
