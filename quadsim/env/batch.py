"""The environment of n quadrotors, stepped as one batch."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from ..config.ranges import SAMPLE_RATE
from ..config.toml import nearest
from ..control.attitude_controller import MakeController
from ..control.records import ATTITUDE, LEVELS, Level
from ..flight.mission import Mission
from ..flight.scenario import Scenario, changed
from ..pictures.render import Image, Scene, View
from .made import Made, Spread, controller_for, made_for, scenario_for
from .spaces import (
    INFORMATION,
    OBSERVATION_SPACE,
    action_scale,
    observe,
    outcome_dtype,
    to_command,
)

Array = NDArray[np.float64]
MOST = 100_000
"""Largest number of environments in a batch."""
OPTIONS = ("scenario", "wind", "randomisation")
"""Options of `reset`."""


class QuadrotorVectorEnv(gymnasium.vector.VectorEnv[NDArray[Any], NDArray[Any], NDArray[Any]]):
    """A batch of n quadrotors; spaces, reward and arguments are those of `QuadrotorEnv`."""

    metadata: dict[str, Any] = {  # noqa: RUF012  (Gymnasium's own attribute)
        "render_modes": ["rgb_array"],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        estimator: Made = None,
        scenario: Scenario | str = "hover",
        level: Level = "attitude",
        rate_hz: float = 200.0,
        duration_s: float | None = None,
        render_mode: str | None = None,
        controller: str | Path | MakeController | None = None,
        randomisation: Spread | None = None,
    ) -> None:
        if level not in LEVELS:
            raise ValueError(f'unknown level "{level}"; valid: {", ".join(LEVELS)}')
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f'unknown render_mode "{render_mode}"; valid: rgb_array, or None')
        SAMPLE_RATE.of("rate_hz", rate_hz)
        if not isinstance(num_envs, int) or isinstance(num_envs, bool) or not 1 <= num_envs <= MOST:
            raise ValueError(f"num_envs = {num_envs!r}: a whole number from 1 to {MOST} is allowed")
        self.metadata = {**self.metadata, "render_fps": rate_hz}
        self.num_envs, self.render_mode = num_envs, render_mode
        self._scenario = self._flown = scenario_for(scenario, randomisation)
        self._made, self._controller = estimator, controller_for(controller)
        if self._controller is not None and LEVELS.index(level) > ATTITUDE:
            raise ValueError(f'level "{level}" is below the attitude controller: leave controller out')
        self._rate_hz, self._duration_s = rate_hz, duration_s
        self._level: Level = level
        self._index = LEVELS.index(level)
        self._take(self._mission(self._scenario))
        self.single_observation_space = OBSERVATION_SPACE
        self.single_action_space = Box(-1.0, 1.0, self.scale.shape, np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.actions = np.zeros(self.action_space.shape or ())
        self._random: list[np.random.Generator] = []
        self.done, self.ended = np.zeros(num_envs, dtype=bool), 0
        self._scene: Scene | None = None

    def _mission(self, scenario: Scenario) -> Mission:
        made = made_for(self._made, scenario, self._rate_hz)
        return Mission(scenario, made, self.num_envs, self._rate_hz, self._duration_s, self._controller)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin all episodes; the options are those of `QuadrotorEnv`."""
        super().reset(seed=_whole(seed))
        afresh = self._choose(options) or seed is not None or not self._random
        if seed is not None or not self._random:
            first = int(self.np_random.integers(2**31) if seed is None else seed)
            self._random = [np_random(first + i)[0] for i in range(self.num_envs)]
        every = np.arange(self.num_envs)
        if afresh:
            self.mission.begin(self._seeds(every))
        else:
            self.mission.restart(every, self._seeds(every))
            self.mission.sense()
        outcome = self.observe()
        self.done[:], self.ended = False, 0  # also where a start is beyond the limits
        return outcome["observation"].copy(), self._masked(outcome)

    def _choose(self, options: dict[str, Any] | None) -> bool:
        """Set the scenario that the options ask for, or the environment's own; return whether it has changed.

        Raises:
            ValueError: An option is unknown or has an invalid value.
        """
        if not isinstance(options, Mapping | None):
            raise ValueError(f"options = {options!r}: a dictionary is allowed, or None")
        given = dict(options or {})
        for key in given.keys() - OPTIONS:
            raise ValueError(f'reset has no option "{key}"; {nearest(str(key), OPTIONS)}')
        scenario = scenario_for(given.get("scenario", self._scenario), given.get("randomisation"))
        if "wind" in given:
            try:
                wind = np.asarray(given["wind"], dtype=np.float64)
            except (TypeError, ValueError):
                raise ValueError(f"wind = {given['wind']!r}: should be three numbers [m/s]") from None
            if wind.shape != (3,):
                raise ValueError(f"wind has shape {wind.shape}; it must be (3,) [m/s]")
            scenario = changed(scenario, {"wind": ({"kind": "constant", "velocity": tuple(wind.tolist())},)})
        if scenario == self._flown:
            return False
        mission = self._mission(scenario)
        if len(mission.vehicle.rotors) != len(self.mission.vehicle.rotors):
            raise ValueError(f"{scenario.vehicle} has another number of rotors: make another environment")
        self.close_extras()
        self._take(mission)
        self._flown = scenario
        return True

    def _take(self, mission: Mission) -> None:
        self.scale = action_scale(self._level, mission.vehicle)
        self.mission, self._hover_rotor_vel = mission, mission.vehicle.hover_rotor_vel
        self._outcomes = np.zeros(self.num_envs, outcome_dtype(len(mission.vehicle.rotors)))

    def _seeds(self, ids: NDArray[np.int64]) -> list[np.random.SeedSequence]:
        """Return the seeds of the next flights of some vehicles."""
        return [np.random.SeedSequence(self._random[i].integers(2**32, size=4).tolist()) for i in ids]

    def step(
        self, actions: ArrayLike
    ) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Advance one sample with actions (n, numbers); episodes that ended in the last step restart."""
        take(actions, self.actions)
        outcome = self.advance()
        info, crashed = self._masked(outcome), outcome["crashed"].copy()
        if crashed.any():
            info |= {"cause": self.mission.cause.copy(), "_cause": crashed.copy()}
        observation, reward, over = (outcome[name].copy() for name in ("observation", "reward", "over"))
        return observation, reward, crashed, over, info

    def advance(self) -> NDArray[np.void]:
        """Fly one sample with `actions`; return new records (n,) of `outcome_dtype`.

        Raises:
            ValueError: An action is not finite, or `reset` was not called.
        """
        if not self._random:
            raise ValueError("step was called before reset")
        mission = self.mission
        if not to_command(self._index, self.actions, self.scale, self._hover_rotor_vel, mission.records):
            raise ValueError("an action is not a finite number; has the policy diverged?")
        if self.ended:
            mission.move(self._level)
            again = np.flatnonzero(self.done)
            mission.restart(again, self._seeds(again))
            mission.sense()
        else:
            mission.step(self._level)
        return self.observe()

    def observe(self) -> NDArray[np.void]:
        """Return the outcome of the current sample, as `advance` does."""
        outcome, self.ended = observe(self.mission.records, self.mission.steps, self.done, self._outcomes)
        return outcome

    def _masked(self, outcome: NDArray[np.void]) -> dict[str, Any]:
        """Return information in Gymnasium's format: each key with a mask of vehicles that have a value."""
        every = np.ones(self.num_envs, dtype=bool)
        return {name: outcome[name] for name in INFORMATION} | {f"_{name}": every for name in INFORMATION}

    def render(self) -> tuple[Image, ...] | None:
        """Return a picture of every vehicle; None without a render mode."""
        if self.render_mode != "rgb_array":
            return None
        plant, self._scene = self.mission.plant, self._scene or Scene(self.mission.vehicle)
        views = [View((x, y, z), distance=1.6) for x, y, z in plant.position]
        places = zip(plant.position, plant.quat, views, strict=True)
        return tuple(self._scene.draw(*place) for place in places)

    def close_extras(self, **kwargs: Any) -> None:
        """Release the resources of rendering."""
        if self._scene is not None:
            self._scene.close()
        self._scene = None

    def __reduce__(self) -> NoReturn:
        """Refuse to be copied or pickled, because the arrays are views of the engine's memory."""
        raise TypeError(
            "an environment in flight cannot be copied or pickled, for its arrays are views of the engine's "
            "memory; make another one with the same arguments and reset it with the same seed"
        )


def take(action: ArrayLike, out: Array) -> None:
    """Copy an action.

    Raises:
        ValueError: The action has the wrong shape or is not an array of real numbers.
    """
    given = np.asarray(action)
    if given.dtype.kind not in "fiub":
        raise ValueError(f"an action has the type {given.dtype}; it must be real numbers")
    if given.shape != out.shape:
        raise ValueError(f"an action has shape {given.shape}; it must be {out.shape}")
    out[:] = given


def _whole(seed: int | None) -> int | None:
    if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0):
        raise ValueError(f"seed = {seed!r}: a whole number from 0 on is allowed")
    return None if seed is None else int(seed)
