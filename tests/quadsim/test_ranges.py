"""Every number of a configuration has both its ends, and what is outside them is refused in words."""

import importlib
import math
import pkgutil
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import annotated_types
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadsim.config.ranges import SAMPLES, Between, steps_of
from quadsim.config.toml import Strict, parse
from quadsim.dataset import store as dataset_store
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import dataset_info
from quadsim.flight.recipe import Recipe
from quadsim.flight.scenario import Scenario
from quadsim.flight.simulate import simulate_flights
from quadsim.imu.spec import ImuSpec
from quadsim.trajectory.specs import Mix
from quadsim.vehicle import Vehicle, load_vehicle


def models() -> list[type[Strict]]:
    for package in ("quadsim", "estimators", "training", "paper"):
        for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
            if not module.name.endswith("__main__"):
                importlib.import_module(module.name)
    found, todo = [], [Strict]
    while todo:
        below = todo.pop().__subclasses__()
        found += below
        todo += below
    return [each for each in found if not each.__module__.startswith("test")]


def unbounded(annotation: Any, metadata: tuple[Any, ...] = ()) -> bool:
    """Whether a number anywhere in an annotation lacks one of its ends."""
    if get_origin(annotation) is Annotated:
        inner, *more = get_args(annotation)
        return unbounded(inner, (*metadata, *more))
    if get_origin(annotation) in (UnionType, Union):
        return any(unbounded(part, metadata) for part in get_args(annotation))
    if get_origin(annotation) is not None:
        return any(unbounded(part) for part in get_args(annotation) if part is not Ellipsis)
    if annotation not in (int, float):
        return False
    kinds = [type(part) for each in metadata for part in (each, *getattr(each, "metadata", ()))]
    low, high = {annotated_types.Ge, annotated_types.Gt}, {annotated_types.Le, annotated_types.Lt}
    return Between not in kinds and not (low & set(kinds) and high & set(kinds))


def test_every_number_of_every_model_has_both_ends():
    open_ended = [
        f"{model.__module__}.{model.__name__}.{name}"
        for model in models()
        for name, field in model.model_fields.items()
        if unbounded(field.annotation, tuple(field.metadata))
    ]
    assert open_ended == []


@given(st.floats(allow_nan=False, allow_infinity=True))
def test_a_value_is_taken_or_the_nearest_one_is_named(value):
    kind = Between(-2.0, 5.0, "m")
    if -2.0 <= value <= 5.0:
        assert kind.of("height", value) == value
        return
    with pytest.raises(ValueError, match=r"should be -2 to 5 m; the nearest is (-2|5)$") as caught:
        kind.of("height", value)
    assert str(caught.value).endswith("-2" if value < 0 else "5")


def test_what_is_no_number_has_no_nearest():
    with pytest.raises(ValueError, match=r"height = nan: should be -2 to 5 m$"):
        Between(-2.0, 5.0, "m").of("height", math.nan)


HOVER = {"description": "x", "duration_s": 2.0}
HEAVY = load_vehicle("hummingbird").model_dump(mode="json")


@pytest.mark.parametrize(
    ("model", "data", "said"),
    [
        (
            Scenario,
            HOVER | {"wind": [{"kind": "constant", "velocity": [1e9, 0.0, 0.0]}]},
            "the nearest is 100",
        ),
        (Vehicle, HEAVY | {"inertia": [5e-7, 5e-7, 5e-7]}, "m from the axes"),
        (ImuSpec, {"lever_arm": [1e9, 0.0, 0.0]}, "should be -5 to 5 m; the nearest is 5"),
        (Mix, {"min_tilt_deg": 50.0, "max_tilt_deg": 40.0}, "min_tilt_deg = 50 is above max_tilt_deg = 40"),
        (
            Mix,
            {"circle_share": 1.0, "eight_share": 1.0, "pause_share": 1.0, "jump_share": 1.0},
            "= 4; shares",
        ),
    ],
)
def test_what_no_flight_can_have_is_refused_with_its_range(model, data, said):
    with pytest.raises(ValueError, match=r"^file: ") as caught:
        parse(data, model, "file")
    assert said in str(caught.value)


@pytest.mark.parametrize("rate", [1e-300, 0.0, -200.0, 1e9, math.nan, math.inf])
def test_rates_at_which_nothing_flies_are_refused(rate):
    with pytest.raises(ValueError, match="rate_hz = "):
        steps_of(10.0, rate)


@pytest.mark.parametrize("duration", [0.0, -1.0, 1e-9, 1e12, math.nan, math.inf])
def test_flights_without_a_sample_or_without_an_end_are_refused(duration):
    with pytest.raises(ValueError, match="duration_s = "):
        steps_of(duration, 200.0)


def test_the_longest_flight_is_taken():
    assert steps_of(SAMPLES.high / 200.0, 200.0) == SAMPLES.high


def test_flights_that_all_leave_the_range_of_the_model_are_an_error_in_words(tmp_path, monkeypatch, quadsim):
    def diverging(config, seeds, steps, rate_hz):
        log = simulate_flights(config, seeds, steps, rate_hz)
        log["gyro"][:] = np.nan
        return log

    monkeypatch.setattr(dataset_store, "simulate_flights", diverging)
    config = Recipe(description="x")
    path = generate(config, 2, 0.1, tmp_path / "x.zarr", workers=1)
    with pytest.raises(ValueError, match="none of 2 flights has a valid sample"):
        dataset_info(path)
    code, out, _ = quadsim("generate", "--flights", 2, "--duration", 0.1, "--workers", 1, "--out", "y.zarr")
    assert code == 2
    assert "nan" not in out
