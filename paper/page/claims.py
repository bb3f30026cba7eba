"""The paper's claims in `claims.toml`, judged from the numbers of a run.

Each function computes whether a claim holds, whether it holds partly, and the measured values.
"""

import tomllib
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..plan import CROSS, RNN, SNN
from ..work.scores import FILTERS

Verdict = Literal["holds", "partly", "does not hold", "not judged"]
Numbers = Mapping[str, dict[str, Any]]
"""Numbers of the finished stages, by name."""
Judged = tuple[bool, bool, str]
"""Whether a claim holds, whether it holds partly, and the measured values."""
Array = NDArray[np.float64]

QUOTED, CLAIMS = (
    tomllib.loads(Path(__file__).with_name(name).read_text("utf-8"))
    for name in ("quoted.toml", "claims.toml")
)
"""Numbers that the paper reports, and its claims."""
METHODS: dict[tuple[str, str], tuple[list[float], list[float]]] = {
    (row["method"], row["start"]): (row["train"], row["test"]) for row in QUOTED["table2"]
}
"""The paper's Table 2: median, mean and SD on training and test flights, by method and start [deg]."""
FOUR = ("madgwick", "mahony", "complementary", "ekf")
NETWORKS = ("att-snn", "att-rnn")
TITLES = {"att-snn": "Att-SNN", "att-rnn": "Att-RNN"}
DRAWS = 2000
AVERAGED = 20
"""Number of epochs in the paper's moving average of a loss; the measure begins after twice as many."""


class Judgement(NamedTuple):
    """A claim and its verdict."""

    item: str  #: the table or figure that it is about
    claim: str
    rule: str  #: when it counts as holding
    limits: str  #: what the verdict does not show
    verdict: Verdict
    measured: str


class Interval(NamedTuple):
    """A number with its 95 % interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        """Format the number and its interval."""
        ends = ["never" if np.isinf(each) else f"{each:.2f}" for each in self]
        return ends[0] if np.isinf(self.value) else f"{ends[0]} ({ends[1]} to {ends[2]})"


class TooShortError(Exception):
    """A training is too short for a measure."""


def judge_claims(numbers: Numbers, judges: bool = True) -> list[Judgement]:
    """Judge all claims. A claim without its stages is not judged, and a small run judges none."""
    judged = []
    for claim in CLAIMS["claim"]:
        verdict: Verdict = "not judged"
        try:
            holds, partly, measured = QUANTITIES[claim["quantity"]](numbers, claim.get("limit", 0.0))
            if judges:
                verdict = "holds" if holds else "partly" if partly else "does not hold"
        except KeyError:
            measured = "its numbers were not made in this run"
        except TooShortError as error:
            measured = str(error)
        if not judges:
            measured += "; the preset quick judges no claim"
        said = {key: claim[key] for key in ("item", "claim", "rule", "limits")}
        judged.append(Judgement(**said, verdict=verdict, measured=measured))
    return judged


def bootstrap_interval(
    function: Callable[..., float], *samples: Sequence[float] | Array, paired: bool = False
) -> Interval:
    """Return the bootstrap interval of a number computed from samples; paired samples are drawn together."""
    rng = np.random.default_rng(0)
    arrays = [np.asarray(each, dtype=np.float64) for each in samples]

    def drawn() -> list[Array]:
        picks = [rng.integers(len(each), size=len(each)) for each in arrays]
        return [each[picks[0] if paired else pick] for each, pick in zip(arrays, picks, strict=True)]

    values = [function(*drawn()) for _ in range(DRAWS)]
    low, high = np.quantile(values, (0.025, 0.975), method="inverted_cdf")
    return Interval(function(*arrays), float(low), float(high))


def ratio(above: Sequence[float], below: Sequence[float], paired: bool = False) -> Interval:
    """Return the mean of some errors divided by the mean of others."""
    return bootstrap_interval(lambda a, b: float(a.mean() / b.mean()), above, below, paired=paired)


def median_time(times: Sequence[float | None]) -> Interval:
    """Return the median of times [s], where None means never."""
    finite = [np.inf if time is None else time for time in times]
    return bootstrap_interval(lambda each: float(np.sort(each)[len(each) // 2]), finite)


def errors(
    numbers: Numbers, method: str, start: str = "unknown", stage: str = "score-fly-test-real"
) -> list[float]:
    """Return the errors of a method on every test flight of a domain, by default the second one [deg]."""
    return numbers[stage]["sequences"][method][start]


def quoted_mean(method: str) -> float:
    """Return the paper's mean error on its test flights from an unknown start [deg]."""
    return METHODS[method, "unknown"][1][1]


def operations(neurons: int, inputs: int) -> dict[str, int]:
    """Return the operations per step of a layer by the paper's formulas."""
    m, n = neurons, inputs
    return {"snn": m * m + m * n + 2 * m, "gru": 3 * m * m + 3 * m * n + 3 * m}


def deviations(losses: Sequence[float]) -> Array:
    """Return the deviations of a validation loss from its moving average, as in the paper's code.

    The deviations are mean(L[i] … L[i + 19]) − L[i] from the 41st epoch on. A training of less than 62 epochs
    has none.
    """
    loss = np.asarray(losses, dtype=np.float64)
    if len(loss) < 3 * AVERAGED + 2:
        return np.empty(0)
    average = np.convolve(loss, np.full(AVERAGED, 1 / AVERAGED), mode="valid")
    return (average - loss[: len(average)])[2 * AVERAGED :]


def scatter(losses: Sequence[float]) -> float:
    """Return the standard deviation of `deviations`; NaN for a training that is too short."""
    found = deviations(losses)
    return float(np.std(found)) if found.size else float("nan")


def over_filters(numbers: Numbers, limit: float) -> Judged:
    """Divide the error of Att-SNN by the mean of the two middle filters."""
    order = sorted(FOUR, key=lambda name: float(np.mean(errors(numbers, name))))
    middle = np.mean([errors(numbers, name) for name in order[1:3]], axis=0)
    over = ratio(errors(numbers, "att-snn"), middle.tolist(), paired=True)
    theirs = quoted_mean("att-snn") / float(np.median([quoted_mean(name) for name in FOUR]))
    return (
        over.high < limit,
        over.value < limit,
        f"{over} times the median filter, in the paper {theirs:.2f} times",
    )


def over_twin(numbers: Numbers, limit: float) -> Judged:
    """Divide the error of Att-SNN by that of Att-RNN."""
    over = ratio(errors(numbers, "att-snn"), errors(numbers, "att-rnn"), paired=True)
    theirs = quoted_mean("att-snn") / quoted_mean("att-rnn")
    return over.low > limit, over.value > limit, f"{over} times, in the paper {theirs:.2f} times"


def scatter_ratio(numbers: Numbers, limit: float) -> Judged:
    """Divide the scatter of Att-SNN's validation loss by that of Att-RNN's, in blocks of epochs."""
    blocks = [
        np.array_split(found, max(1, len(found) // AVERAGED))
        for found in (deviations(numbers[name]["val_mse"]) for name in (SNN, RNN))
    ]
    if not all(len(each[0]) for each in blocks):
        raise TooShortError(f"the measure needs trainings of {3 * AVERAGED + 2} epochs")

    def over(*picks: Array) -> float:
        chosen = [[parts[int(k)] for k in pick] for parts, pick in zip(blocks, picks, strict=True)]
        ours, theirs = (float(np.std(np.concatenate(each))) for each in chosen)
        return ours / theirs

    found = bootstrap_interval(over, *(np.arange(len(each), dtype=np.float64) for each in blocks))
    theirs = QUOTED["losses"]["att-snn"] / QUOTED["losses"]["att-rnn"]
    return found.low > limit, found.value > limit, f"{found} times, in the paper {theirs:.2f} times"


def single_sources(numbers: Numbers, limit: float) -> Judged:
    """Divide the errors in the other domain by those of the mixed folds."""
    folds = numbers["score-folds"]
    mixed = [error for name, each in folds.items() if name not in CROSS for error in each["test"]]
    to_real, to_sim = (ratio(folds[source]["test"], mixed) for source in CROSS)
    both = to_real, to_sim
    measured = (
        f"Hummingbird to px4-quad {to_real} times, px4-quad to Hummingbird {to_sim} times "
        "(in the paper 1.83 and 2.04)"
    )
    return all(each.low > limit for each in both), any(each.value > limit for each in both), measured


def convergence(numbers: Numbers, _: float) -> Judged:
    """Compare the median times until the error is first below 2°."""
    curves, quoted = numbers["recover"]["curves"], QUOTED["converge_s"]
    times = {name: median_time(curves[name]["flight"]["times_s"]) for name in (*NETWORKS, *FILTERS)}
    networks, filters = ([times[name] for name in names] for names in (NETWORKS, FILTERS))
    holds = max(each.high for each in networks) < quoted["networks"]
    holds &= min(each.low for each in filters) > quoted["filters"]
    quicker = max(each.value for each in networks) < min(each.value for each in filters)
    order = sorted(times, key=lambda name: times[name].value)
    shown = ", ".join(f"{TITLES.get(name, name)} {times[name]}" for name in order)
    return holds, quicker, f"median time until the error is below 2° [s]: {shown}"


def rare_neurons(numbers: Numbers, limit: float) -> Judged:
    """Compute the error without neurons that hardly spike, and their number."""
    inside = numbers["inside"]
    before, after = inside["ablation"]["activity"][0], inside["without_rare"]["error_deg"]
    removed = 1 - inside["without_rare"]["neurons"] / sum(map(len, inside["rates"]))
    lossless = after < limit * before
    measured = (
        f"{100 * removed:.0f} % of the neurons removed; error {before:.2f}° before and {after:.2f}° after"
    )
    return lossless and removed >= 0.125, lossless, measured


def gains(numbers: Numbers, _: float) -> Judged:
    """Compute gains of slow and fast attitude without gyroscope, and with θ_acc = 0."""
    each = numbers["manipulate"]["networks"][SNN]
    no_gyro, no_accel = each["gyro removed"], each["accel removed"]
    slow = no_gyro["slow_gain"] > no_accel["slow_gain"]
    fast = no_accel["fast_gain"] > no_gyro["fast_gain"]
    measured = (
        f"gain of slow attitude {no_gyro['slow_gain']:.2f} without gyroscope and "
        f"{no_accel['slow_gain']:.2f} with θ_acc = 0; gain of fast attitude {no_gyro['fast_gain']:.2f} "
        f"and {no_accel['fast_gain']:.2f}"
    )
    return slow and fast, slow or fast, measured


def formulas(numbers: Numbers, limit: float) -> Judged:
    """Compare the operations of the recurrent layers by the paper's formulas with those counted."""
    layer, count = operations(100, 100), numbers["inside"]["flops"]
    over = layer["gru"] / layer["snn"]
    dense, sparse = (count["gru"] / count[kind] for kind in ("dense", "sparse"))
    measured = (
        f"{over:.2f} times by its formulas; {dense:.1f} times with all layers and operations counted, "
        f"{sparse:.0f} times without the operations of silent neurons"
    )
    return over >= limit, False, measured


def rates(numbers: Numbers, limit: float) -> Judged:
    """Divide the error at the highest sample rate by that at the lowest."""
    prefix = "score-rate-"
    stages = sorted(float(name.removeprefix(prefix)) for name in numbers if name.startswith(prefix))
    if not stages:
        raise KeyError(prefix)
    by_hz = {hz: errors(numbers, "att-snn", stage=f"{prefix}{hz:g}") for hz in stages}
    over = ratio(by_hz[max(by_hz)], by_hz[min(by_hz)], paired=True)
    means = [float(np.mean(each)) for each in by_hz.values()]
    falls = all(b <= 1.02 * a for a, b in pairwise(means))
    shown = ", ".join(f"{error:.2f}° at {hz:g} Hz" for hz, error in zip(by_hz, means, strict=True))
    measured = f"{shown}: {over} times from the lowest to the highest"
    return over.high < limit and falls, over.value < limit, measured


def minutes(numbers: Numbers, limit: float) -> Judged:
    """Divide the errors after 10 and 30 minutes of training flights by that after the most."""
    found = {int(n): each["unknown"] for n, each in numbers["score-minutes"]["sequences"].items()}
    most = max(found)
    over = {n: ratio(found[n], found[most], paired=True) for n in (10, 30) if n in found and n < most}
    enough = {n for n, each in over.items() if each.high < limit}
    shown = ", ".join(f"{np.mean(each):.2f}° from {n} min" for n, each in found.items())
    ratios = ", ".join(f"{n} min: {each} times the error with {most} min" for n, each in over.items())
    return 10 in enough, 30 in enough, f"{shown}; {ratios}"


def growth(numbers: Numbers, limit: float) -> Judged:
    """Divide the error in the last third of closed-loop flights by that in the first."""
    scores = {name: each["att-snn"] for name, each in numbers["loop"]["scenarios"].items()}
    crashes, flights = (sum(each[key] for each in scores.values()) for key in ("crashes", "flights"))
    over = {
        name: each["parts_deg"][-1] / each["parts_deg"][0]
        for name, each in scores.items()
        if np.isfinite(each["parts_deg"]).all()
    }
    steady = sum(each < limit for each in over.values())
    shown = ", ".join(f"{name} {each:.2f}" for name, each in over.items())
    measured = (
        f"{crashes} of {flights} flights crashed; "
        f"ratio of the error in the last third to that in the first: {shown}"
    )
    return steady == len(scores) and crashes == 0, steady > 0, measured


QUANTITIES: dict[str, Callable[[Numbers, float], Judged]] = {
    each.__name__: each
    for each in (
        *(over_filters, over_twin, scatter_ratio, single_sources, convergence, rare_neurons),
        *(gains, formulas, rates, minutes, growth),
    )
}
