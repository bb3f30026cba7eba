"""Estimators of users in the environment: how they are given, and what of them is refused in words."""

import gymnasium
import numpy as np
import pytest
from environments import ID, make
from level import Level

import estimators


class Still(Level):
    updates = 0

    def update(self, gyro, accel):
        self.updates += 1
        return super().update(gyro, accel)


@pytest.mark.parametrize(
    "given",
    [
        estimators.create("mahony"),
        lambda rate_hz: estimators.create("mahony", rate_hz),
        Still,
        "test_env_estimators:Still",
    ],
    ids=["object", "function", "class", "own"],
)
def test_estimators_are_given_by_object_function_class_or_module_as_well(given):
    seen = []
    for each in (given, "mahony"):
        env = make(1, estimator=each)
        env.reset(seed=1)
        seen.append(env.step(np.zeros(4))[0])
    assert (seen[0][9:11] == 0).all() if "Still" in str(given) else (seen[0] == seen[1]).all()


@pytest.mark.parametrize("name", ["mahony", "vqf", "att-snn-loihi"])
def test_environments_given_one_object_fly_as_if_each_had_its_own(name):
    shared = estimators.create(name, vehicle="hummingbird")
    alone = [gymnasium.make(ID, estimator=name, scenario="step") for _ in range(2)]
    together = [gymnasium.make(ID, estimator=shared, scenario="step") for _ in range(2)]
    for k in range(2):
        alone[k].reset(seed=k)
        together[k].reset(seed=k)
    for _ in range(40):
        for one, other in zip(alone, together, strict=True):
            assert (one.step(np.zeros(4, np.float32))[0] == other.step(np.zeros(4, np.float32))[0]).all()


def test_an_estimator_that_cannot_be_copied_is_refused_in_words():
    class Held(Still):
        def __deepcopy__(self, memo):
            raise TypeError("a handle of a device")

    with pytest.raises(ValueError, match=r"Held cannot be copied.*give a function"):
        gymnasium.make(ID, estimator=Held(200.0))


def still(name, **methods):
    made = type(name, (Still,), {"__module__": __name__, **methods})
    globals()[name] = made  # as test_env_estimators:name
    return made


def failing(self, gyro, accel):
    raise KeyError("gain")


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (still("OtherArgument", reset=lambda self, n=1, attitude=None: None),
         "unexpected keyword argument 'roll_pitch'"),
        (still("Three", update=lambda self, gyro, accel: np.zeros((self.n, 3))),
         r"float64 array of shape \(3, 3\); roll and pitch \[rad\], real numbers of shape \(3, 2\)"),
        (still("NoRate", __init__=lambda self: None), "with one argument, rate_hz"),
        (still("Failing", update=failing), "ends with KeyError: 'gain'"),
    ],
)  # fmt: skip
def test_what_is_no_estimator_is_said_before_the_first_flight(made, said):
    with pytest.raises(ValueError, match=f"{made.__name__}.*{said}"):
        gymnasium.make(ID, estimator=made)
    with pytest.raises(ValueError, match=f"test_env_estimators:{made.__name__}.*{said}"):
        estimators.create(f"test_env_estimators:{made.__name__}")


def later(change):
    """An `update` that is level for three samples, and then changed."""

    def update(self, gyro, accel):
        found = Still.update(self, gyro, accel)
        return found if self.updates < 4 else change(found)

    return update


def end(*_):
    raise SystemExit(0)


def reset_once(self, n=1, roll_pitch=None):
    Still.reset(self, n)
    if self.updates:
        end()


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize(
    ("made", "said"),
    [
        (still("Exits", update=later(end)), "update ends with SystemExit: 0"),
        (still("Wrong", update=later(lambda found: found[:, :1])),
         r"update returns a float64 array of shape \((1|2), 1\)"),
        (still("Complex", update=later(lambda found: found + 0j)), "update returns a complex128 array"),
        (still("ExitsAtReset", reset=reset_once), "reset ends with SystemExit: 0"),
    ],
)  # fmt: skip
def test_what_an_estimator_does_in_flight_is_said_in_one_line(n, made, said):
    env = make(n, estimator=made)
    action = np.zeros(env.action_space.shape, np.float32)
    with pytest.raises(ValueError, match=said):  # noqa: PT012  (any of them may be the one)
        env.reset(seed=0)
        for _ in range(6):
            env.step(action)
