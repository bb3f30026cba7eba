"""The paper's claims, each judged from this run's numbers.

Each function below judges the claim in the first paragraph of its docstring by the rule in the second; the
third says what the verdict does not show. The page prints all three. It returns a verdict and what was
measured.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from inspect import getdoc
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..plan import CROSS, RNN, SNN
from ..work.scores import FILTERS
from .quoted import ACTIVITY, CONVERGE_S, LOSSES, mean_deg, operations

Verdict = Literal["holds", "partly", "does not hold", "not judged"]
Numbers = Mapping[str, dict[str, Any]]
"""Numbers of the finished stages by name."""
Judged = tuple[Verdict, str]
Array = NDArray[np.float64]

FOUR = ("madgwick", "mahony", "complementary", "ekf")
NETWORKS = ("att-snn", "att-rnn")
TITLES = {"att-snn": "Att-SNN", "att-rnn": "Att-RNN"}
TOLERANCE = 1.02
"""An error that is larger by less than this factor is no loss."""
DRAWS = 2000
AVERAGED = 20
"""Epochs of the paper's moving average of a loss; its measure begins after twice as many."""


class Judgement(NamedTuple):
    """A claim and its verdict."""

    item: str
    """The table or figure that it is about."""
    claim: str
    rule: str
    """When it counts as holding."""
    verdict: Verdict
    measured: str
    limits: str
    """What the verdict does not show."""


class Interval(NamedTuple):
    """A number, and the ends of its 95 % interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        """As a page shows it."""
        return f"{self.value:.2f} ({self.low:.2f} to {self.high:.2f})"

    def below(self, limit: float) -> Verdict:
        """Whether it is below a limit: wholly, by its value alone, or not."""
        return "holds" if self.high < limit else "partly" if self.value < limit else "does not hold"

    def above(self, limit: float) -> Verdict:
        """Whether it is above a limit: wholly, by its value alone, or not."""
        return "holds" if self.low > limit else "partly" if self.value > limit else "does not hold"


class TooShortError(Exception):
    """Trainings are too short for a measure."""


def judge(numbers: Numbers, judges: bool = True) -> list[Judgement]:
    """All claims; one whose stages are not there is not judged, and none where the run is too small."""
    judged = []
    for function in CLAIMS:
        claim, rule, limits = (" ".join(part.split()) for part in (getdoc(function) or "").split("\n\n"))
        verdict: Verdict = "not judged"
        try:
            found, measured = function(numbers)
            verdict = found if judges else verdict
        except KeyError:
            measured = "its numbers were not made in this run"
        except TooShortError as error:
            measured = str(error)
        if not judges:
            measured += "; preset quick is for a look, and judges nothing"
        rule, limits = (text.rstrip(".") for text in (re.sub("^It holds if,? ", "", rule), limits))
        judged.append(
            Judgement(
                ITEM.get(function.__name__, function.__name__),
                claim.rstrip("."),
                rule,
                verdict,
                measured,
                limits,
            )
        )
    return judged


def interval(
    function: Callable[..., float], *samples: Sequence[float] | Array, paired: bool = False
) -> Interval:
    """Bootstrap of a number that is computed from samples, which are drawn together where they are paired."""
    rng = np.random.default_rng(0)
    arrays = [np.asarray(each, dtype=np.float64) for each in samples]

    def drawn() -> list[Array]:
        picks = [rng.integers(len(each), size=len(each)) for each in arrays]
        return [each[picks[0] if paired else pick] for each, pick in zip(arrays, picks, strict=True)]

    values = [function(*drawn()) for _ in range(DRAWS)]
    low, high = np.quantile(values, (0.025, 0.975), method="inverted_cdf")
    return Interval(function(*arrays), float(low), float(high))


def ratio(above: Sequence[float], below: Sequence[float], paired: bool = False) -> Interval:
    """Mean of some errors over the mean of others."""
    return interval(lambda a, b: float(a.mean() / b.mean()), above, below, paired=paired)


def errors(
    numbers: Numbers, method: str, start: str = "unknown", stage: str = "score-fly-test-real"
) -> list[float]:
    """Errors of a method on every test flight of a domain, the second one if none is named [deg]."""
    return numbers[stage]["sequences"][method][start]


def scatter(losses: Sequence[float]) -> float:
    """Standard deviation of a validation loss about its moving average, as the paper's code computes it.

    That of mean(L[i] … L[i + 19]) − L[i] from the 41st epoch on; NaN of a shorter training.
    """
    found = deviations(losses)
    return float(np.std(found)) if found.size else float("nan")


def deviations(losses: Sequence[float]) -> Array:
    """Those that `scatter` is the standard deviation of; none of a training of less than 62 epochs."""
    loss = np.asarray(losses, dtype=np.float64)
    if len(loss) < 3 * AVERAGED + 2:
        return np.empty(0)
    average = np.convolve(loss, np.full(AVERAGED, 1 / AVERAGED), mode="valid")
    return (average - loss[: len(average)])[2 * AVERAGED :]


def table2(numbers: Numbers) -> Judged:
    """Att-SNN's error is no larger than that of the classical filters.

    It holds if, from an unknown start on the second domain's test flights, the 95 % interval of its mean
    error over that of the two middle filters lies below 1.1; partly: the ratio alone does.

    Both domains are simulated and all methods were tuned on both: nothing of real flight or of an airframe
    that was not seen.
    """
    ours = {name: float(np.mean(errors(numbers, name))) for name in ("att-snn", *FOUR)}
    order = sorted(FOUR, key=ours.__getitem__)
    middle = np.mean([errors(numbers, name) for name in order[1:3]], axis=0)
    over = ratio(errors(numbers, "att-snn"), middle.tolist(), paired=True)
    theirs = mean_deg("att-snn") / float(np.median([mean_deg(name) for name in FOUR]))
    shown = ", ".join(
        f"{TITLES.get(name, name)} {ours[name]:.2f}°" for name in sorted(ours, key=ours.__getitem__)
    )
    return over.below(1.1), f"{shown}: {over} times the median filter, in the paper {theirs:.2f} times"


def twin(numbers: Numbers) -> Judged:
    """Att-RNN is more accurate than Att-SNN.

    It holds if the 95 % interval of Att-SNN's mean error over Att-RNN's on the second domain's test flights
    lies above 1; partly: the ratio alone does.

    One training of each: another seed moves either. Att-RNN was still improving when its epochs ended.
    """
    over = ratio(errors(numbers, "att-snn"), errors(numbers, "att-rnn"), paired=True)
    theirs = mean_deg("att-snn") / mean_deg("att-rnn")
    both = ", ".join(f"{TITLES[name]} {np.mean(errors(numbers, name)):.2f}°" for name in NETWORKS)
    return over.above(1.0), f"{both}: {over} times, in the paper {theirs:.2f} times"


def fig4(numbers: Numbers) -> Judged:
    """The SNN's validation loss is noisier than the RNN's.

    It holds if the 95 % interval of its standard deviation about the moving average, by the paper's own
    measure, over Att-RNN's lies above 1, in a bootstrap of blocks of 20 epochs; partly: the ratio alone does.

    A loss that is lower altogether scatters less in rad²; one training of each.
    """
    losses = {name: numbers[name]["val_mse"] for name in (SNN, RNN)}
    blocks = [
        np.array_split(found, max(1, len(found) // AVERAGED)) for found in map(deviations, losses.values())
    ]
    if not all(len(each[0]) for each in blocks):
        raise TooShortError(f"the measure needs trainings of {3 * AVERAGED + 2} epochs")
    picks = [np.arange(len(each), dtype=np.float64) for each in blocks]

    def over(first: Array, second: Array) -> float:
        chosen = [[parts[int(k)] for k in pick] for parts, pick in zip(blocks, (first, second), strict=True)]
        ours, theirs = (float(np.std(np.concatenate(each))) for each in chosen)
        return ours / theirs

    found = interval(over, *picks)
    shown = ", ".join(
        f"{title} {1e3 * scatter(losses[name]):.2f}e-3 rad², "
        f"{100 * scatter(losses[name]) / float(np.mean(losses[name][2 * AVERAGED :])):.0f} % of its loss "
        f"(the paper {1e3 * LOSSES[key]:.1f}e-3)"
        for title, name, key in (("Att-SNN", SNN, "att-snn"), ("Att-RNN", RNN, "att-rnn"))
    )
    return found.above(1.0), f"{shown}: {found} times"


def table1(numbers: Numbers) -> Judged:
    """Trained on a single source it generalises badly.

    It holds if, from either domain to the other, the 95 % interval of the error over that of the mixed folds'
    test flights lies above 1.25; partly: one of the two ratios alone does.

    The second domain stands for real flights and is nearer to the first than those are. The mixed test
    flights are of both domains, and a single source has fewer flights to train on.
    """
    folds = numbers["score-folds"]
    mixed = [error for name, each in folds.items() if name not in CROSS for error in each["test"]]
    over = {source: ratio(folds[source]["test"], mixed) for source in CROSS}
    each = [found.above(1.25) for found in over.values()]
    verdict: Verdict = (
        "holds" if set(each) == {"holds"} else "does not hold" if set(each) == {"does not hold"} else "partly"
    )
    titles = {"net-only-sim": "simulation to px4-quad", "net-only-real": "px4-quad to simulation"}
    shown = ", ".join(f"{titles[name]} {found} times" for name, found in over.items())
    return verdict, f"folds {np.mean(mixed):.2f}°; {shown} (the paper 1.83, 2.04)"


def fig6(numbers: Numbers) -> Judged:
    """From 20° off, networks converge in less than 1 s and filters take more than 7 s.

    It holds if the 95 % intervals of both networks' median times to an inclination error below 2° end before
    1 s and every filter's begin after 7 s; partly: both networks are quicker than every filter.

    A filter's time follows from its gains, which are tuned for complete flights: others are quicker, and
    noisier.
    """
    curves = numbers["recover"]["curves"]
    times = {name: median_time(curves[name]["flight"]["times_s"]) for name in (*NETWORKS, *FILTERS)}
    slowest = max(times[name].high for name in NETWORKS)
    quickest = min(times[name].low for name in FILTERS)
    if slowest < CONVERGE_S["networks"] and quickest > CONVERGE_S["filters"]:
        verdict: Verdict = "holds"
    elif max(times[name].value for name in NETWORKS) < min(times[name].value for name in FILTERS):
        verdict = "partly"
    else:
        verdict = "does not hold"
    shown = ", ".join(
        f"{TITLES.get(name, name)} {shown_time(times[name])}"
        for name in sorted(times, key=lambda n: times[n].value)
    )
    return verdict, f"median first time below 2° [s]: {shown}"


def median_time(times: Sequence[float | None]) -> Interval:
    """Median of times [s], where None is never."""
    finite = [np.inf if time is None else time for time in times]
    return interval(lambda each: float(np.sort(each)[len(each) // 2]), finite)


def shown_time(each: Interval) -> str:
    """A median time as a page shows it."""
    if np.isinf(each.value):
        return "never"
    latest = "never" if np.isinf(each.high) else f"{each.high:.2f}"
    return f"{each.value:.2f} ({each.low:.2f} to {latest})"


def fig7(numbers: Numbers) -> Judged:
    """All neurons that spike in less than 0.5 % of the steps, about a quarter, can go without loss.

    It holds if the error without them is less than 2 % larger and they are an eighth of all neurons at least;
    partly: they are fewer.

    Nothing of networks that are trained to spike little, or again after the cut.
    """
    inside = numbers["inside"]
    before, after = inside["ablation"]["activity"][0], inside["without_rare"]["error_deg"]
    every = sum(map(len, inside["rates"]))
    removed = 1 - inside["without_rare"]["neurons"] / every
    synapses = 1 - inside["without_rare"]["synapses"][1] / inside["without_rare"]["synapses"][0]
    lossless = after < TOLERANCE * before
    verdict: Verdict = "holds" if lossless and removed >= 0.125 else "partly" if lossless else "does not hold"
    measured = (
        f"{100 * removed:.0f} % of the neurons, {100 * synapses:.0f} % of the synapses, are such (the paper "
        f"{100 * ACTIVITY['removed_neurons']:.0f} %, almost {100 * ACTIVITY['removed_synapses']:.0f} %); "
        "the error is "
        f"{before:.2f}° with and {after:.2f}° without them"
    )
    return verdict, measured


def fig8(numbers: Numbers) -> Judged:
    """The accelerometer is the reference at a constant attitude, the gyroscope in fast motion.

    It holds if slow attitude (below 0.2 Hz) is followed better without gyroscope than with θ_acc = 0, and
    fast attitude (above 1 Hz) the other way round; partly: one of them.

    Gains are of aggressive test flights, without an interval. The errors at a constant velocity are beside
    them and judge nothing.
    """
    each = numbers["manipulate"]["networks"][SNN]
    no_gyro, no_accel = each["gyro removed"], each["accel removed"]
    slow = no_gyro["slow_gain"] > no_accel["slow_gain"]
    fast = no_accel["fast_gain"] > no_gyro["fast_gain"]
    measured = (
        f"gain of slow attitude {no_gyro['slow_gain']:.2f} without gyroscope, "
        f"{no_accel['slow_gain']:.2f} with "
        "θ_acc = 0; "
        f"of fast attitude {no_gyro['fast_gain']:.2f} and {no_accel['fast_gain']:.2f}"
    )
    return ("holds" if slow and fast else "partly" if slow or fast else "does not hold"), measured


def flops(numbers: Numbers) -> Judged:
    """Att-RNN needs almost 3 times the operations of Att-SNN.

    It holds if it does by the paper's formulas for the recurrent layer, 2.7 times or more.

    The formulas count a multiplication with a spike that is not there; chips that skip these do far less.
    """
    layer = operations(100, 100)
    count = numbers["inside"]["flops"]
    dense, sparse = (count["gru"] / count[kind] for kind in ("dense", "sparse"))
    measured = (
        f"by its formulas {layer['gru']} against {layer['snn']} a step: "
        f"{layer['gru'] / layer['snn']:.2f} times; "
        "all "
        f"layers and operations counted {dense:.1f} times, without those of silent neurons {sparse:.0f} times"
    )
    return ("holds" if layer["gru"] / layer["snn"] >= 2.7 else "does not hold"), measured


def rate(numbers: Numbers) -> Judged:
    """Higher data rates lower the error.

    It holds if the 95 % interval of the error at the highest rate over that at the lowest lies below 1, and
    no rate is 2 % worse than the one before; partly: the ratio alone is below 1.

    The same recipe at every rate, in samples: other time constants at first, or more updates, may do better.
    """
    by_hz = by_rate(numbers, "att-snn")
    over = ratio(by_hz[max(by_hz)], by_hz[min(by_hz)], paired=True)
    means = [float(np.mean(each)) for each in by_hz.values()]
    falls = all(b <= TOLERANCE * a for a, b in pairwise(means))
    verdict = over.below(1.0)
    shown = ", ".join(f"{mean:.2f}° at {hz:g} Hz" for hz, mean in zip(by_hz, means, strict=True))
    return (
        "partly" if verdict == "holds" and not falls else verdict
    ), f"{shown}: {over} times from the lowest to the highest"


def by_rate(numbers: Numbers, method: str) -> dict[float, list[float]]:
    """Errors of a method on the test flights at each sample rate [deg]."""
    prefix = "compare-rate-"
    found = {
        float(name.removeprefix(prefix)): next(iter(stage["errors"][method].values()))
        for name, stage in numbers.items()
        if name.startswith(prefix)
    }
    if not found:
        raise KeyError("rate")
    return dict(sorted(found.items()))


def minutes(numbers: Numbers) -> Judged:
    """Less than 20 minutes of flight are enough to train on.

    It holds if the 95 % interval of the error after 10 minutes over that after the most lies below 1.1 on
    unseen flights; partly: only that after 30 minutes does.

    One airframe, simulated, one training each, and the longest was still improving when its epochs ended.
    """
    found = {int(n): each["fly-test-sim"] for n, each in numbers["compare-minutes"]["errors"].items()}
    most = max(found)
    over = {n: ratio(found[n], found[most], paired=True) for n in (10, 30) if n in found and n < most}
    verdict: Verdict = "does not hold"
    for n, each in over.items():
        if each.high < 1.1 and verdict == "does not hold":
            verdict = "holds" if n == 10 else "partly"
    shown = ", ".join(f"{np.mean(each):.2f}° from {n} min" for n, each in found.items())
    ratios = ", ".join(f"{n} min over {most} min {each} times" for n, each in over.items())
    return verdict, f"{shown}; {ratios}"


def loop(numbers: Numbers) -> Judged:
    """Errors do not accumulate when the vehicle flies on the network.

    It holds if no flight on Att-SNN crashes, and in every scenario the last third's error is below 1.2 times
    the first's; partly: in some.

    Simulated flights; position and yaw come from motion capture.
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
    verdict: Verdict = (
        "holds" if steady == len(scores) and crashes == 0 else "partly" if steady else "does not hold"
    )
    return verdict, f"{crashes} of {flights} flights crashed; last third over first: {shown}"


CLAIMS = (table2, twin, fig4, table1, fig6, fig7, fig8, flops, rate, minutes, loop)
ELSEWHERE = {
    "a step of the recurrent layer takes 10 µs and 13.2 µJ on Loihi": "no chip here; our energy is a model",
    "the network runs on a Loihi beside the flight controller": "no chip and no vehicle here",
    "2.79° on 40 real sequences of a Pixhawk 4 Mini": "a simulated airframe stands for its recordings",
    "both networks overfit to some extent": "windows that train start from rest, flights that validate once",
}
"""What the paper shows and this run cannot, and why."""
ITEM = {"twin": "table2", "flops": "operations"}
"""Items of the claims whose functions have another name."""
