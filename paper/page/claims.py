"""The paper's claims, each judged from this run's numbers.

Each function below judges the claim in the first paragraph of its docstring by the rule in the second one, as
the page prints them. It returns whether the claim holds, whether it holds partly, what was measured, and why.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from inspect import getdoc
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np

from training.cross_domain import TEST, Score, table

from .plan import FLOAT, RNN, SNN, TRAINED_ON
from .quoted import CONVERGE_S, FLOPS_RATIO, REMOVABLE, TEST_DEG
from .scores import SHIPPED, SIX

Verdict = Literal["holds", "partly", "does not hold", "not judged"]
Numbers = Mapping[str, dict[str, Any]]
"""Numbers of the finished stages by name."""
Judged = tuple[bool, bool, str, str]

NETWORKS = ("att-rnn", "att-snn")
TOLERANCE = 1.02
"""An error that is larger by less than this factor is no loss."""


class Judgement(NamedTuple):
    """A claim and its verdict."""

    item: str
    """The table or figure that it is about."""
    claim: str
    rule: str
    """When it counts as holding."""
    verdict: Verdict
    measured: str
    why: str = ""


def judge(numbers: Numbers) -> list[Judgement]:
    """All claims; one whose stages are not there is not judged."""
    judged = []
    for function in CLAIMS:
        claim, rule = (getdoc(function) or "").split(".\n\nIt holds if ")
        text = function.__name__, claim, " ".join(rule.rstrip(".").split())
        try:
            holds, partly, measured, why = function(numbers)
            verdict: Verdict = "holds" if holds else "partly" if partly else "does not hold"
            judged.append(Judgement(*text, verdict, measured, why))
        except KeyError:
            judged.append(Judgement(*text, "not judged", "its numbers were not made in this run"))
    return judged


def pooled(numbers: Numbers, kind: str, method: str, start: str) -> np.ndarray:
    """Errors of a method on every flight of both domains, of the training or the test set [deg]."""
    stages = (f"score-{kind}sim", f"score-{kind}real")
    return np.concatenate([numbers[stage]["sequences"][method][start] for stage in stages])


def scatter(losses: Sequence[float], root_mean_square: bool = False) -> float:
    """Standard deviation of a validation loss from epoch to epoch, as a share of it, without its trend.

    That of log L[i] − (log L[i−1] + log L[i+1]) / 2 over the middle half of a training, times √(2/3), which
    makes it that of the noise if this is white: 1.4826 times the median of the sizes, which the few steps of
    a steep descent do not enlarge, or the root mean square.
    """
    log = np.log(np.asarray(losses, dtype=np.float64))
    jumps = log[1:-1] - 0.5 * (log[:-2] + log[2:])
    quarter = len(jumps) // 4
    middle = jumps[quarter : len(jumps) - quarter]
    size = np.sqrt(np.mean(middle**2)) if root_mean_square else 1.4826 * np.median(np.abs(middle))
    return float(size * np.sqrt(2 / 3))


def fold_errors(numbers: Numbers) -> list[Any]:
    """Entries of Table 1: mean and standard deviation over the folds of each network and pair of domains."""
    rows = [row for name, stage in numbers.items() if name.startswith("fold-") for row in stage["scores"]]
    scores = sorted((Score(**row) for row in rows), key=lambda s: (s.model, s.trained_on != "sim", s.fold))
    return table(scores)


def by_rate(numbers: Numbers) -> dict[float, dict[str, float]]:
    """Mean error of each estimator at each sample rate [deg]."""
    errors = {
        float(name.removeprefix("compare-rate-")): {
            label: float(np.mean([np.mean(each) for each in flights.values()]))
            for label, flights in stage["errors"].items()
        }
        for name, stage in numbers.items()
        if name.startswith("compare-rate-")
    }
    if not errors:
        raise KeyError("rate")
    return dict(sorted(errors.items()))


def table2(numbers: Numbers) -> Judged:
    """Att-SNN is competitive with the filters.

    It holds if its mean error on test flights is below that of two of the four filters; partly: of one.
    """
    error = {name: float(pooled(numbers, "test-", name, "unknown").mean()) for name in SIX}
    beaten = [name for name in error if name not in NETWORKS and error["att-snn"] < error[name]]
    shown = ", ".join(f"{name} {error[name]:.2f}°" for name in sorted(error, key=error.__getitem__))
    theirs, ours = (each["att-snn"] / each["complementary"] for each in (TEST_DEG, error))
    why = (
        f"in the paper Att-SNN has {theirs:.2f} times the error of the complementary filter, here {ours:.2f} "
        "times; a complementary filter takes every acceleration for a tilt, which costs more the more "
        "aggressive the flights are"
    )
    measured = f"on test flights from an unknown start {shown}; Att-SNN beats {len(beaten)} of 4 filters"
    return len(beaten) >= 2, bool(beaten), measured, why


def fig4(numbers: Numbers) -> Judged:
    """The SNN's loss is noisier than the RNN's.

    It holds if its validation loss scatters more, on the chip's grid and in floats, by the median and by the
    root mean square of the jumps; partly: in some of these.
    """
    titles = {SNN: "Att-SNN", FLOAT: "in floats", RNN: "Att-RNN"}
    jumps = {name: [scatter(numbers[name]["val_mse"], way) for way in (False, True)] for name in titles}
    shown = ", ".join(
        f"{title} {100 * jumps[name][0]:.1f} % ({100 * jumps[name][1]:.1f} %)"
        for name, title in titles.items()
    )
    more = [jumps[name][k] > jumps[RNN][k] for name in (SNN, FLOAT) for k in (0, 1)]
    why = (
        "a spike is there or not: a small step of the weights moves many of them at once; the learning rates "
        "are each network's own, and the spiking one's is the larger"
        if any(more)
        else "with Lookahead's slow weights and a decaying learning rate little of the spikes' noise is left"
    )
    measured = (
        f"validation loss scatters from epoch to epoch, by the median (by the root mean square): {shown}"
    )
    return all(more), any(more), measured, why


def table1(numbers: Numbers) -> Judged:
    """Training on a single source generalises badly.

    It holds if on the other domain the error is above 1.25 times that of networks trained there, for both
    networks; partly: for one.
    """
    errors = {(e.model, e.trained_on, e.tested_on): e.mean_deg for e in fold_errors(numbers)}
    bad, shown = 0, []
    for model in NETWORKS:
        other, home = errors[model, "sim", "real"], errors[model, "real", TEST]
        bad += int(other > 1.25 * home)
        shown.append(f"{model} {other:.2f}° against {home:.2f}°")
    learnt = "the second airframe has other inertia, drag and sensors, and a network learns the first one's"
    why = (
        "both domains are simulated here and fly alike: the gap to a real vehicle, with its vibration and "
        "its misaligned sensors, is larger; and the folds' networks are trained briefly",
        f"{learnt}; the other network has learnt little of either in a fold's short training",
        learnt,
    )[bad]
    measured = f"trained on the Hummingbird, tested on the second domain: {', '.join(shown)} if trained there"
    return bad == 2, bad > 0, measured, why


def fig6(numbers: Numbers) -> Judged:
    """From 20° off, networks converge in < 1 s and filters in > 7 s.

    It holds if both networks are first below 2° within 1 s and some filter after 7 s; partly: both networks
    are quicker than the median filter.
    """
    times = {
        name: np.inf if each["flight"]["first_s"] is None else each["flight"]["first_s"]
        for name, each in numbers["recover"]["curves"].items()
        if name not in SHIPPED
    }
    slowest = max(times[name] for name in NETWORKS)
    filters = [time for name, time in times.items() if name not in NETWORKS]
    holds = slowest < CONVERGE_S["networks"] and max(filters) > CONVERGE_S["filters"]
    shown = ", ".join(
        f"{name} never" if np.isinf(times[name]) else f"{name} {times[name]:.2f} s"
        for name in sorted(times, key=times.__getitem__)
    )
    why = (
        "networks store no attitude that would have to be forgotten: their memory is a second or so. The "
        "filters' gains are tuned for whole flights, and how long they take to forget follows from those"
    )
    measured = f"from 20° to the first time below 2° in flight: {shown}"
    return holds, slowest < float(np.median(filters)), measured, why


def fig7(numbers: Numbers) -> Judged:
    """About 25 % of the neurons can go without loss.

    It holds if 25 % can go for less than 2 % more error; partly: more than 5 % can.
    """
    inside = numbers["inside"]
    fractions = np.array(inside["fractions"])
    free = {
        by: float(fractions[np.array(errors) < TOLERANCE * errors[0]].max())
        for by, errors in inside["ablation"].items()
        if by != "random"
    }
    best = max(free, key=free.__getitem__)
    errors = inside["ablation"][best]
    at = int(np.argmin(np.abs(fractions - REMOVABLE)))
    measured = (
        f"{100 * free[best]:.0f} % can go for less than 2 % more error (by {best}, nothing trained again); "
        f"without {100 * fractions[at]:.0f} % of them the error is {errors[at]:.2f}° in place of "
        f"{errors[0]:.2f}°"
    )
    why = f"{sum(inside['silent'])} neurons hardly ever spike, and each of the others carries a share"
    return free[best] > REMOVABLE - 0.01, free[best] > 0.05, measured, why


def fig8(numbers: Numbers) -> Judged:
    """The accelerometer is the reference in the long time, the gyroscope in the short.

    It holds if slow attitude is followed better without gyroscope than without accelerometer, fast attitude
    the other way round; partly: one of them.
    """
    responses = numbers["inside"]["responses"]
    no_gyro, no_accel = responses["gyro removed"], responses["accel removed"]
    long_time = no_gyro["slow_gain"] > no_accel["slow_gain"]
    short_time = no_accel["fast_gain"] > no_gyro["fast_gain"]
    measured = (
        f"slow attitude (below 0.2 Hz) is followed with a gain of {no_gyro['slow_gain']:.2f} without "
        f"gyroscope and of {no_accel['slow_gain']:.2f} without accelerometer; fast attitude (above 1 Hz) of "
        f"{no_gyro['fast_gain']:.2f} and of {no_accel['fast_gain']:.2f}"
    )
    why = (
        "as in any filter, rates drift when integrated and forces are disturbed when accelerating"
        if long_time
        else "thrust is along the body's z at any tilt, and in flight the accelerometer depends on tilt by "
        "rotor drag alone; in flights as aggressive as these even slow attitude comes mostly from the rates"
    )
    return long_time and short_time, long_time or short_time, measured, why


def flops(numbers: Numbers) -> Judged:
    """Att-RNN needs about 3 × the FLOPs of Att-SNN.

    It holds if the ratio is 2.4 or more, multiplying zeros too; partly: only without silent neurons.
    """
    count = numbers["inside"]["flops"]
    dense, sparse = (count["gru"] / count[kind] for kind in ("dense", "sparse"))
    measured = (
        f"{count['gru']:.0f} operations an update against {count['dense']:.0f}: {dense:.1f} times; counting "
        f"only synapses of neurons that spike, {sparse:.0f} times"
    )
    why = "a GRU has three gates where a spiking layer has one current; formulas are our own"
    return dense >= 0.8 * FLOPS_RATIO, sparse >= FLOPS_RATIO, measured, why


def rate(numbers: Numbers) -> Judged:
    """Higher data rates lower the error.

    It holds if the error is lower at the highest rate than at the lowest by 2 %, and never 2 % higher than at
    the rate before; partly: the former alone.
    """
    rates = by_rate(numbers)
    first, *_, last = rates.values()
    lower = last[TRAINED_ON] < first[TRAINED_ON] / TOLERANCE
    falling = all(b[TRAINED_ON] <= TOLERANCE * a[TRAINED_ON] for a, b in pairwise(rates.values()))
    shown = ", ".join(f"{errors[TRAINED_ON]:.2f}° at {hz:g} Hz" for hz, errors in rates.items())
    why = (
        "more steps in a second carry finer rates of spikes and shorter delays"
        if lower
        else "the network comes from 200 Hz, and is trained on briefly over more steps the higher the rate"
    )
    return lower and falling, lower, f"trained on at each rate: {shown}", why


def loop(numbers: Numbers) -> Judged:
    """Errors do not accumulate in the loop.

    It holds if no flight crashes, and in every scenario the last third's error is below 1.2 times the
    first's; partly: in some.
    """
    scores = {name: each["att-snn"] for name, each in numbers["loop"]["scenarios"].items()}
    crashes, flights = (sum(each[key] for each in scores.values()) for key in ("crashes", "flights"))
    growth = {
        name: each["parts_deg"][-1] / each["parts_deg"][0]
        for name, each in scores.items()
        if np.isfinite(each["parts_deg"]).all()
    }
    steady = sum(ratio < 1.2 for ratio in growth.values())
    shown = ", ".join(f"{name} {ratio:.2f}" for name, ratio in growth.items())
    measured = (
        f"{crashes} of {flights} flights with attitude from Att-SNN crashed; error of the last third over "
        f"that of the first: {shown}"
    )
    why = "the accelerometer is a reference that does not drift, and the network forgets in a second"
    return steady == len(scores) and crashes == 0, steady > 0, measured, why


CLAIMS = (table2, fig4, table1, fig6, fig7, fig8, flops, rate, loop)
