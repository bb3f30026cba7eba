"""The report of a designed or a held-out benchmark: what to fly on which condition, effects of the axes."""

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from estimators.appearance import looks
from quadsim.runs.files import write_whole
from quadsim.runs.record import RunRecord

from ..bench.axes import (
    ALL,
    Combination,
    Effect,
    advice,
    choices,
    described,
    headline,
    profiles,
    ranking,
    table,
    worst_level,
)
from ..bench.runner import Results, shown_once
from .page import script
from .provenance import provenance
from .template import render

THRESHOLDS = np.geomspace(0.1, 30.0, 80)
"""Errors at which the performance profiles are drawn [deg]."""


def write_axes_report(
    path: str | Path,
    combinations: Sequence[Combination],
    results: Results,
    effects: Sequence[Effect],
    *,
    title: str = "Which attitude estimator to fly, by condition",
    csv: Sequence[str] = (),
    record: RunRecord | None = None,
) -> Path:
    """Write the report.

    Args:
        path: HTML file to write.
        combinations: The design.
        results: Of `bench` on its scenarios.
        effects: Of `axes.effects` on these.
        title: Heading.
        csv: Files beside the report to link to.
        record: Of the run.

    Raises:
        ValueError: No estimator flew.
    """
    if not results.flights:
        raise ValueError("nothing to report: no estimator flew in any combination")
    ranked = ranking(effects)
    return write_whole(
        Path(path).expanduser(),
        render(
            "report/axes.html",
            title=title,
            kicker=f"closed loop, {len(combinations)} combinations of conditions",
            headline=headline(choices(combinations, results), combinations),
            advice=[line.split(": ", 1) for line in advice(combinations, results)],
            same=shown_once(results)[1],
            standings=[_standing(effects, name) for name in ranked],
            axes=_axes(effects, [name for name in ranked if name not in results.unranked]),
            combinations=table(combinations),
            count=len(combinations),
            csv=list(csv),
            seeds=results.settings.seeds,
            rate_hz=results.settings.rate_hz,
            provenance=provenance(results, record),
            payload=_payload(results, effects, ranked),
            script=script("report/js/axes.js"),
        ),
    )


def _standing(effects: Sequence[Effect], name: str) -> dict[str, object]:
    """A row of the standings: an estimator over all flights, and its worst level."""
    whole = next(each for each in effects if each.axis == ALL and each.estimator == name)
    worst = described(worst_level(effects, name))
    return {"all": whole, "worst": f"not ranked: it {whole.unranked}" if whole.unranked else worst}


def _axes(effects: Sequence[Effect], names: Sequence[str]) -> list[dict[str, object]]:
    """Each axis with its levels, and a row of cells for each estimator; shades are of the logarithm."""
    shown = [each for each in effects if each.axis != ALL and each.estimator in names]
    errors = [math.log(each.error_deg) for each in shown if each.error_deg]
    low, high = min(errors, default=0.0), max(errors, default=0.0)
    found = {(each.axis, each.level, each.estimator): each for each in shown}

    def cell(each: Effect) -> dict[str, object]:
        if each.error_deg is None:  # every flight crashed
            return {"effect": each, "shade": 1.0}
        shade = (math.log(each.error_deg) - low) / (high - low) if each.error_deg and high > low else 0.0
        return {"effect": each, "shade": shade}

    out = []
    for axis in dict.fromkeys(each.axis for each in shown):
        levels = list(dict.fromkeys(each.level for each in shown if each.axis == axis))
        rows = [{"estimator": n, "cells": [cell(found[axis, level, n]) for level in levels]} for n in names]
        out.append({"name": axis, "key": f"axis-{len(out)}", "levels": levels, "rows": rows})
    return out


def _payload(results: Results, effects: Sequence[Effect], ranked: Sequence[str]) -> str:
    shares, drawn = profiles(results, THRESHOLDS), [name for name in ranked if name not in results.unranked]
    shown = [each for each in effects if each.axis != ALL and not each.unranked]
    data = {
        "estimators": [name for name in results.estimators if name in ranked],
        "ranked": drawn,
        "looks": {name: look._asdict() for name, look in looks(results.estimators).items()},
        "scenarios": [],
        "thresholds": THRESHOLDS.round(4).tolist(),
        "profiles": {name: each.round(4).tolist() for name, each in shares.items() if name in drawn},
        "effects": [
            [each.axis, each.level, each.estimator, each.error_deg, each.low, each.high, each.crashes]
            for each in shown
        ],
    }
    return json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
