"""Gymnasium environments: one quadrotor on an attitude estimator of your choice, and its batched twin."""

import copy
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any, NoReturn, TypeAlias, Unpack, cast

import gymnasium
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from .config.ranges import SAMPLE_RATE
from .config.toml import nearest
from .control.cascade import ATTITUDE, LEVELS, POSITION, RATE, ROTOR, VELOCITY, Level
from .control.own import MakeController
from .estimator import (
    AttitudeEstimator,
    OtherSensors,
    Readings,
    accepted_sensors,
    receives_truth,
    roll_pitch_of,
)
from .flight.mission import CAUSES, FLYING, Mission
from .flight.scenario import Scenario, changed, load_scenario
from .own import load_own, named_errors
from .render import Image, Scene, View, Window
from .runs.compiled import njit
from .vehicle import GRAVITY

Array = NDArray[np.float64]

OBSERVATION = np.dtype(
    [
        ("position_error", "f4", 3),
        ("velocity_error", "f4", 3),
        ("acceleration", "f4", 3),
        ("roll_pitch", "f4", 2),
        ("yaw_error", "f4"),
        ("heading", "f4", 2),
        ("gyro", "f4", 3),
    ]
)
"""One observation, see the table of `QuadrotorEnv`."""
POSITION_LIMIT, VELOCITY_LIMIT, ACCELERATION_LIMIT, RATE_LIMIT = 100.0, 50.0, 50.0, 50.0
OBSERVATION_LIMIT = np.repeat(
    [POSITION_LIMIT, VELOCITY_LIMIT, ACCELERATION_LIMIT, np.pi, 1.0, RATE_LIMIT], [3, 3, 3, 3, 2, 3]
)
"""Largest value of each observation; what is larger is clipped."""
ACTION_SCALE: dict[Level, tuple[float, ...]] = {
    "position": (1.0, 1.0, 1.0, np.pi),
    "velocity": (3.0, 3.0, 3.0, np.pi),
    "attitude": (0.6, 0.6, np.pi, GRAVITY),
    "rate": (6.0, 6.0, 2.0, GRAVITY),
    "rotor": (1.0,),
}
"""What an action of 1 means at each level; each rotor: from hover speed to the highest."""

Made: TypeAlias = AttitudeEstimator | str | Path | Callable[[float], AttitudeEstimator] | None
"""An estimator, or what makes one: see `made_for`."""
MOST = 100_000
"""Environments in a batch."""
FPS = 50
"""Pictures per second of flight in a window."""
OPTIONS = ("scenario", "wind")
"""Of `reset`."""


class QuadrotorEnv(gymnasium.Env[NDArray[Any], NDArray[Any]]):
    """A quadrotor in MuJoCo that sees its roll and pitch through an attitude estimator.

    ## Description

    The vehicle flies a scenario (`quadsim.flight.scenario`): a trajectory of set-points, with wind, sensor
    errors and faults. A cascaded controller flies it on the estimate; the action enters that cascade at the
    level of your choice, so that an agent may correct the set-point, or do all of the control itself. One
    step is one sample, 5 ms at the default 200 Hz. The closed-loop benchmark flies the very same `Mission`.

    ## Action space

    `Box(-1, 1, (4,), float32)`, for the four numbers below; 0 is always "nothing special". At level `rotor`
    there are as many numbers as the scenario's vehicle has rotors, each a speed ω_h + a (ω_max − ω_h).

    | level    | 0              | 1               | 2            | 3                          |
    |----------|----------------|-----------------|--------------|----------------------------|
    | position | Δx, ±1 m       | Δy, ±1 m        | Δz, ±1 m     | Δyaw, ±π                   |
    | velocity | Δv_x, ±3 m/s   | Δv_y, ±3 m/s    | Δv_z, ±3 m/s | Δyaw, ±π                   |
    | attitude | roll, ±0.6 rad | pitch, ±0.6 rad | Δyaw, ±π     | thrust per mass, g (1 + a) |
    | rate     | p, ±6 rad/s    | q, ±6 rad/s     | r, ±2 rad/s  | thrust per mass, g (1 + a) |
    | rotor    | first rotor    | second          | …            | …                          |

    Δ is relative to the scenario's set-point, world axes; the zero action at level `position` flies the
    scenario as the benchmark does. ω_h is the hover speed, rotors in the order of the vehicle's file.

    ## Observation space

    `Box((17,), float32)`, clipped to its limits:

    | num   | observation                          | limit    |
    |-------|--------------------------------------|----------|
    | 0–2   | set-point minus position, world      | 100 m    |
    | 3–5   | set-point minus velocity, world      | 50 m/s   |
    | 6–8   | acceleration of the set-point, world | 50 m/s²  |
    | 9–10  | estimated roll and pitch             | π rad    |
    | 11    | set-point yaw minus yaw              | π rad    |
    | 12–13 | cosine and sine of yaw               | 1        |
    | 14–16 | gyroscope, body axes                 | 50 rad/s |

    Roll and pitch come from the estimator under test alone; position, velocity and yaw from the scenario's
    external sensor, with its noise, rate and delay (`quadsim.external`).

    ## Reward

    1 / (1 + ‖e_p‖² + 0.1 ‖e_v‖²) in each step, with e_p [m] and e_v [m/s] the true errors of position and
    velocity, free of what the external sensor adds; 0 in the step of a crash. 1 is perfect.

    ## Starting state

    As the scenario says: at its first set-point, displaced or tilted as drawn for the seed.

    ## Episode end

    - Termination: a crash by the scenario's criteria (by default a tilt above 75°, the ground, or 10 m from
      the set-point); `info["cause"]` tells which, in words; in the batched twin by their index in
      `quadsim.flight.mission.CAUSES`.
    - Truncation: the scenario's duration is over.

    ## Information

    What `reset` and `step` return last: a dictionary of numbers that the agent does not see. In the batched
    twin each has a row for every vehicle.

    | key              | shape    | meaning                                                             |
    |------------------|----------|---------------------------------------------------------------------|
    | `attitude`       | (3,)     | true roll, pitch and yaw [rad]                                      |
    | `estimate`       | (2,)     | estimated roll and pitch [rad]                                      |
    | `attitude_error` | ()       | mean absolute error of roll and pitch [rad]                         |
    | `position`       | (3,)     | true, world axes [m]                                                |
    | `velocity`       | (3,)     | true, world axes [m/s]                                              |
    | `wind`           | (3,)     | world axes [m/s]                                                    |
    | `rotor_vel`      | (rotors,)| rotor speeds [rad/s]                                                |
    | `position_cost`  | ()       | ‖e_p‖² of the reward [m²]                                           |
    | `velocity_cost`  | ()       | 0.1 ‖e_v‖² of the reward                                            |
    | `cause`          | ()       | why it crashed, in the last step of an episode                      |

    ## Options of `reset`

    `reset(options={"scenario": ..., "wind": (x, y, z)})` flies another scenario, by name, file or `Scenario`,
    or with a constant wind [m/s] in place of the scenario's, until the next `reset`.

    ## Arguments

    | argument      | default    | meaning                                                                |
    |---------------|------------|------------------------------------------------------------------------|
    | `estimator`   | None       | source of roll and pitch; None for the true ones                       |
    | `scenario`    | "hover"    | a `Scenario`, the name of a shipped one or the path of a TOML file     |
    | `level`       | "attitude" | where the action enters the controller                                 |
    | `rate_hz`     | 200.0      | samples, and steps, per second                                         |
    | `duration_s`  | None       | length of an episode, instead of the scenario's                        |
    | `render_mode` | None       | "rgb_array" for pictures, "human" for MuJoCo's viewer                  |
    | `controller`  | None       | attitude controller of your own, see `quadsim.control.own`; or weights |

    `metadata["render_fps"]` is `rate_hz`, so that gymnasium's RecordVideo, which draws every step, plays in
    real time (it needs moviepy: `pip install 'quadsim[video]'`).

    `gymnasium.make_vec("quadsim/Quadrotor-v0", num_envs=n, ...)` makes the batched twin: sub-environment i
    is, number for number, this environment reset with `seed + i`. It restarts finished episodes in the next
    step.

    `estimator` is a name or weights, as in `estimators.create`, "module:Class", a function of `rate_hz` that
    makes one, or an `AttitudeEstimator`, which is copied: no two environments share one.

    ## Version history

    - v0: first version.
    """

    # gymnasium declares this as a variable of instances
    metadata: dict[str, Any] = {"render_modes": ["rgb_array", "human"], "render_fps": FPS}  # noqa: RUF012  (Gymnasium's own attribute)

    def __init__(
        self,
        estimator: Made = None,
        scenario: Scenario | str = "hover",
        level: Level = "attitude",
        rate_hz: float = 200.0,
        duration_s: float | None = None,
        render_mode: str | None = None,
        controller: str | Path | MakeController | None = None,
    ) -> None:
        self._flights = Episodes(estimator, scenario, level, 1, rate_hz, duration_s, render_mode, controller)
        self.metadata = {**self.metadata, "render_fps": rate_hz}
        self.render_mode = render_mode
        self.observation_space, self.action_space = self._flights.spaces()
        self._over = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode, with the options of the class's docstring.

        Raises:
            ValueError: An unknown option, or a value that it cannot have.
        """
        super().reset(seed=_whole(seed))
        anew = self._flights.choose(options)
        self._flights.begin([flight_seed(self.np_random)], afresh=seed is not None or anew)
        self._over = False
        return self._flights.observe()[0][0], _first(self._flights.info())

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Fly one sample with an action.

        Raises:
            ValueError: An action of another shape or that is not finite, or the episode is over.
        """
        flights = self._flights
        if self._over:
            raise ValueError("the episode is over; call reset to begin another")
        flights.action[0] = _shaped(action, flights.action.shape[1:])
        observation, reward = flights.step()
        mission = flights.mission
        cause, over = mission.cause.item(), mission.k.item() >= mission.steps
        self._over = cause != FLYING or over
        info = _first(flights.info()) | ({"cause": CAUSES[cause]} if cause != FLYING else {})
        return observation[0], reward.item(), cause != FLYING, over, info

    def render(self) -> Image | None:
        """A picture of the vehicle, (540, 960, 3); None without a render mode, or in a window."""
        return self._flights.picture(0) if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Free what rendering took."""
        self._flights.close()


class QuadrotorVectorEnv(gymnasium.vector.VectorEnv[NDArray[Any], NDArray[Any], NDArray[Any]]):
    """n quadrotors stepped as one batch; spaces, reward and arguments are those of `QuadrotorEnv`."""

    metadata: dict[str, Any] = {  # noqa: RUF012  (Gymnasium's own attribute)
        "render_modes": ["rgb_array", "human"],
        "render_fps": FPS,
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
    ) -> None:
        self._flights = Episodes(
            estimator, scenario, level, num_envs, rate_hz, duration_s, render_mode, controller
        )
        self.metadata = {**self.metadata, "render_fps": rate_hz}
        self.num_envs, self.render_mode = num_envs, render_mode
        self.single_observation_space, self.single_action_space = self._flights.spaces()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._random: list[np.random.Generator] = []
        self._done = np.zeros(num_envs, dtype=bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin all episodes, with the options of `QuadrotorEnv`."""
        super().reset(seed=_whole(seed))
        anew = self._flights.choose(options)
        if seed is not None or not self._random:
            first = int(self.np_random.integers(2**31)) if seed is None else seed
            self._random = [np_random(first + i)[0] for i in range(self.num_envs)]
        self._flights.begin([flight_seed(each) for each in self._random], afresh=seed is not None or anew)
        self._done[:] = False
        return self._flights.observe()[0], self._info()

    def step(
        self, actions: ArrayLike
    ) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Advance one sample with actions (n, numbers); episodes that ended in the last step restart."""
        flights, mission = self._flights, self._flights.mission
        again = np.flatnonzero(self._done)
        seeds = [flight_seed(self._random[i]) for i in again]
        flights.action[:] = _shaped(actions, flights.action.shape)
        observation, reward = flights.step(again, seeds)
        terminated, truncated = mission.cause != FLYING, mission.k >= mission.steps
        reward[again] = 0.0
        self._done = terminated | truncated
        info = self._info()
        if terminated.any():
            info |= {"cause": mission.cause.copy(), "_cause": terminated.copy()}
        return observation, reward, terminated, truncated, info

    def _info(self) -> dict[str, Any]:
        """Information in Gymnasium's form: each key with a mask of the vehicles that have it."""
        found, every = self._flights.info(), np.ones(self.num_envs, dtype=bool)
        return found | {f"_{key}": every.copy() for key in found}

    def render(self) -> tuple[Image, ...] | None:
        """A picture of every vehicle; None without a render mode, or in a window, which shows the first."""
        if self.render_mode != "rgb_array":
            return None
        return tuple(self._flights.picture(i) for i in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Free what rendering took."""
        self._flights.close()


class Episodes:
    """What both environments do: a mission, driven by actions, turned into observations and rewards."""

    def __init__(
        self,
        estimator: Made,
        scenario: Scenario | str,
        level: Level,
        n: int,
        rate_hz: float,
        duration_s: float | None,
        render_mode: str | None,
        controller: str | Path | MakeController | None = None,
    ) -> None:
        if level not in LEVELS:
            raise ValueError(f'unknown level "{level}"; valid: {", ".join(LEVELS)}')
        if render_mode not in (None, "rgb_array", "human"):
            raise ValueError(f'unknown render_mode "{render_mode}"; valid: rgb_array, human, or None')
        SAMPLE_RATE.of("rate_hz", rate_hz)
        if not isinstance(n, int) or not 1 <= n <= MOST:
            raise ValueError(f"num_envs = {n!r}: a whole number from 1 to {MOST} is allowed")
        self._live, self._frame = render_mode == "human", max(round(rate_hz / FPS), 1)
        self._scenario = self._flown = scenario_for(scenario)
        self._made, self._controller = estimator, controller_for(controller)
        if self._controller is not None and LEVELS.index(level) > ATTITUDE:
            raise ValueError(f'level "{level}" is below the attitude controller: leave controller out')
        self._sizes = n, rate_hz, duration_s
        self.mission = self._mission(self._scenario)
        self._level: Level = level
        self._index = LEVELS.index(level)
        vehicle, self._scale = self.mission.vehicle, np.array(ACTION_SCALE[level])
        if level == "rotor":
            span = vehicle.motor.omega_max - vehicle.hover_rotor_vel
            self._scale = np.repeat(self._scale, len(vehicle.rotors)) * span
        self.action, self._hover_rotor_vel = np.zeros((n, self._scale.size)), vehicle.hover_rotor_vel
        self._records = np.zeros(n, OBSERVATION)
        self._observation = self._records.view(np.float32).reshape(n, -1)
        self._scene: Scene | None = None
        self._window: Window | None = None
        self._shown_at = 0.0
        self._begun = False

    def _mission(self, scenario: Scenario) -> Mission:
        n, rate_hz, duration_s = self._sizes
        made = made_for(self._made, scenario, rate_hz)
        if made is not None and n > 1 and not hasattr(made, "restart"):
            made = OnePerVehicle(made)
        return Mission(scenario, made, n, rate_hz, duration_s, self._controller)

    def choose(self, options: dict[str, Any] | None) -> bool:
        """Take the scenario that options ask for, or the environment's own; whether it is another one.

        Raises:
            ValueError: An unknown option, or a value that it cannot have.
        """
        given = dict(options or {})
        for key in given.keys() - OPTIONS:
            raise ValueError(f'reset has no option "{key}"; {nearest(str(key), OPTIONS)}')
        scenario = scenario_for(given.get("scenario", self._scenario))
        if "wind" in given:
            wind = np.asarray(given["wind"], dtype=np.float64)
            if wind.shape != (3,):
                raise ValueError(f"wind has shape {wind.shape}; it must be (3,) [m/s]")
            scenario = changed(scenario, {"wind": ({"kind": "constant", "velocity": tuple(wind.tolist())},)})
        if scenario == self._flown:
            return False
        mission = self._mission(scenario)
        if len(mission.vehicle.rotors) != len(self.mission.vehicle.rotors):
            raise ValueError(f"{scenario.vehicle} has another number of rotors: make another environment")
        self.close()
        self.mission, self._flown, self._begun = mission, scenario, False
        return True

    def info(self) -> dict[str, NDArray[Any]]:
        """What agents do not see, new arrays of n rows; see the table of `QuadrotorEnv`."""
        mission, loop = self.mission, self.mission.loop
        plant, target = loop.plant, mission.target
        estimate = loop.measured_state["roll_pitch"].copy()
        return {
            "attitude": np.column_stack([plant.roll_pitch, plant.yaw]),
            "estimate": estimate,
            "attitude_error": np.abs(estimate - plant.roll_pitch).mean(axis=1),
            "position": plant.position.copy(),
            "velocity": plant.velocity.copy(),
            "wind": mission.air.copy(),
            "rotor_vel": plant.rotor_vel.copy(),
            "position_cost": np.sum((target["position"] - plant.position) ** 2, axis=1),
            "velocity_cost": 0.1 * np.sum((target["velocity"] - plant.velocity) ** 2, axis=1),
        }

    def spaces(self) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
        """Observation and action space of one vehicle."""
        limit = OBSERVATION_LIMIT.astype(np.float32)
        return gymnasium.spaces.Box(-limit, limit, dtype=np.float32), gymnasium.spaces.Box(
            -1.0, 1.0, self._scale.shape, np.float32
        )

    def begin(self, seeds: list[np.random.SeedSequence], afresh: bool) -> None:
        """Begin all flights, one seed each; afresh: forget all earlier ones."""
        if afresh or not self._begun:
            self.mission.begin(seeds)
            self._begun = True
        else:
            self.mission.restart(np.arange(self.mission.n), seeds)
            self.mission.sense()

    def step(
        self, again: NDArray[np.int64] | None = None, seeds: list[np.random.SeedSequence] | None = None
    ) -> tuple[NDArray[np.float32], Array]:
        """Advance one sample with the actions in `action`; flights `again` restart in place of it.

        Returns:
            Observations (n, 17) and rewards (n,) at its end, as new arrays.
        """
        if not self._begun:
            raise ValueError("step was called before reset")
        mission = self.mission
        finite = to_command(self._index, self.action, self._scale, self._hover_rotor_vel, mission.records)
        if not finite:
            raise ValueError("an action is not a finite number; has the policy diverged?")
        if again is not None and len(again):
            mission.move(self._level)
            mission.restart(again, seeds or [])
            mission.sense()
        else:
            mission.step(self._level)
        if self._live:
            self._show()
        return self.observe()

    def observe(self) -> tuple[NDArray[np.float32], Array]:
        """Observations (n, 17) and rewards (n,) at this instant, as new arrays."""
        reward = np.empty(self.mission.n)
        observe(self.mission.records, self._records, reward)
        return self._observation.copy(), reward

    def picture(self, index: int) -> Image:
        """Draw one vehicle."""
        plant = self.mission.loop.plant
        self._scene = self._scene or Scene(self.mission.vehicle)
        x, y, z = plant.position[index]
        return self._scene.draw(plant.position[index], plant.quat[index], View((x, y, z), distance=1.6))

    def close(self) -> None:
        """Free the scene and shut the window."""
        for each in (self._scene, self._window):
            if each is not None:
                each.close()
        self._scene = self._window = None

    def _show(self) -> None:
        """Move the first vehicle in the window, and wait until real time has caught up."""
        mission = self.mission
        if mission.k[0] % self._frame:
            return
        if self._window is None:
            self._window = Window(mission.vehicle)
        self._window.show(mission.loop.plant.position[0], mission.loop.plant.quat[0])
        time.sleep(max(self._shown_at + 1 / FPS - time.perf_counter(), 0.0))
        self._shown_at = time.perf_counter()

    def __reduce__(self) -> NoReturn:
        """Refuse to be copied or pickled: the arrays are views of the engine's memory, which a copy lacks."""
        raise TypeError(
            "an environment in flight cannot be copied or pickled, for its arrays are views of the engine's "
            "memory; make another one with the same arguments and reset it with the same seed"
        )


def scenario_for(scenario: object) -> Scenario:
    """An environment's scenario, given as a name, a file or a `Scenario`.

    Raises:
        ValueError: It is none of these, or there is no such file.
    """
    if isinstance(scenario, Scenario):
        return scenario
    if not isinstance(scenario, str | Path):
        raise ValueError(f"scenario = {scenario!r}: should be a name, a file or a Scenario")
    return load_scenario(scenario)


def made_for(estimator: Made, scenario: Scenario, rate_hz: float) -> AttitudeEstimator | None:
    """An environment's own estimator.

    Args:
        estimator: A name, weights or "module:Class", as `estimators.create` takes them, made for the
            scenario's vehicle and IMU; a function or class that makes one of `rate_hz`; an estimator, which
            is copied; None for the true attitude.
        scenario: The scenario of the flight.
        rate_hz: Samples per second.

    Raises:
        ValueError: No such estimator, or one that cannot be copied.
    """
    if estimator is None:
        return None
    import estimators
    from estimators.custom import tried

    if isinstance(estimator, str | Path):
        vehicle = scenario.vehicle if scenario.vehicle_known else None
        return estimators.create(str(estimator), rate_hz, vehicle=vehicle, imu=scenario.imu)
    return tried(_name_of(estimator), _own_copy(estimator, rate_hz))


def controller_for(controller: str | Path | MakeController | None) -> MakeController | None:
    """What makes an environment's attitude controller; None for the cascade's own.

    Args:
        controller: A function of sample rate and vehicle, or its name ("file.py:make", "module:make"); a
            spiking controller's weights, by path or name; None or "cascaded".

    Raises:
        ValueError: No such controller.
    """
    if controller is None or callable(controller):
        return controller
    name = str(controller)
    if name == "cascaded":
        return None
    from estimators.control.controller import create_controller, is_controller

    if is_controller(name):
        return partial(create_controller, name)
    return load_own(name)


def _own_copy(
    estimator: AttitudeEstimator | Callable[[float], AttitudeEstimator], rate_hz: float
) -> AttitudeEstimator:
    """What a function makes, or a copy of an estimator."""
    if isinstance(estimator, type | FunctionType | MethodType | partial):
        with named_errors(f"{_name_of(estimator)} is called with one argument, rate_hz, and"):
            return estimator(rate_hz)
    if not hasattr(estimator, "update"):
        raise ValueError(
            f"estimator = {estimator!r}: should be a name, an estimator, or a function that makes one"
        )
    try:
        return copy.deepcopy(cast(AttitudeEstimator, estimator))
    except (Exception, SystemExit) as error:  # whatever a user's class does
        raise ValueError(
            f"{_name_of(estimator)} cannot be copied, and environments do not share an estimator: give "
            f"a function that makes one, lambda rate_hz: ... ({error})"
        ) from error


def _name_of(estimator: object) -> str:
    return getattr(estimator, "__name__", type(estimator).__name__)


class OnePerVehicle:
    """An estimator for n vehicles made of n copies, for one that cannot restart single vehicles."""

    def __init__(self, estimator: AttitudeEstimator) -> None:
        self.rate_hz = estimator.rate_hz
        self._pattern, self._each = estimator, [copy.deepcopy(estimator)]
        self._accepted = accepted_sensors(estimator.update)
        self._name = _name_of(estimator)
        if receives_truth(estimator):
            self.observe = self._observe

    def reset(self, n: int = 1, roll_pitch: ArrayLike | None = None) -> None:
        """Start n vehicles."""
        self._each = [copy.deepcopy(self._pattern) for _ in range(n)]
        self.restart(np.arange(n), roll_pitch)

    def restart(self, ids: NDArray[np.int64], roll_pitch: ArrayLike | None = None) -> None:
        """Reset some vehicles, to attitudes (m, 2) [rad] where these are known."""
        known = None if roll_pitch is None else np.asarray(roll_pitch)
        for row, vehicle in enumerate(ids):
            self._each[vehicle].reset(1, roll_pitch=None if known is None else known[row : row + 1])

    def update(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Take one sample of every vehicle."""
        readings = Readings(gyro, accel, **sensors)
        alone = [readings.map(lambda each, i=i: each[i : i + 1]) for i in range(len(self._each))]
        pairs = zip(self._each, alone, strict=True)
        found = [its.give(each.update, self._accepted) for each, its in pairs]
        return np.concatenate([roll_pitch_of(each, (1, 2), self._name) for each in found])

    def _observe(self, quat: Array) -> None:
        for i, each in enumerate(self._each):
            each.observe(quat[i : i + 1])  # pyright: ignore[reportAttributeAccessIssue]


def _first(rows: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """The only row of each array; a number where it is one."""
    return {key: values[0] if values.ndim > 1 else values[0].item() for key, values in rows.items()}


def _shaped(action: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    action = np.asarray(action, dtype=np.float64)
    if action.shape != shape:
        raise ValueError(f"an action has shape {action.shape}; it must be {shape}")
    return action


def _whole(seed: int | None) -> int | None:
    if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0):
        raise ValueError(f"seed = {seed!r}: a whole number from 0 on is allowed")
    return seed


def flight_seed(random: np.random.Generator) -> np.random.SeedSequence:
    """Draw the seed of a flight."""
    return np.random.SeedSequence(random.integers(2**32, size=4).tolist())


@njit(cache=True)
def to_command(level, action, scale, hover_rotor_vel, loops):
    """Write the commands of actions (n, numbers) to the loops; False if an action is not finite."""
    u = np.empty(scale.size)
    for i in range(action.shape[0]):
        wanted, out, c = loops[i].flight.target, loops[i].set_point, loops[i].controller
        for j in range(scale.size):
            if not np.isfinite(action[i, j]):
                return False
            u[j] = min(max(action[i, j], -1.0), 1.0) * scale[j]
        if level == POSITION:
            for j in range(3):
                out.position[j] = wanted.position[j] + u[j]
            out.yaw = wanted.yaw + u[3]
        elif level == VELOCITY:
            for j in range(3):
                out.velocity[j] = wanted.velocity[j] + u[j]
            out.yaw = wanted.yaw + u[3]
        elif level == ATTITUDE:
            c.attitude_cmd[0], c.attitude_cmd[1], c.attitude_cmd[2] = u[0], u[1], wanted.yaw + u[2]
            c.thrust_cmd = GRAVITY + u[3]
        elif level == RATE:
            c.rate_cmd[0], c.rate_cmd[1], c.rate_cmd[2] = u[0], u[1], u[2]
            c.thrust_cmd = GRAVITY + u[3]
        elif level == ROTOR:
            for j in range(scale.size):
                c.rotor_vel_cmd[j] = hover_rotor_vel + u[j]
    return True


@njit(cache=True)
def _clip(value, limit):
    return min(max(value, -limit), limit)


@njit(cache=True)
def observe(loops, observation, reward):
    """Write observations (n,) and rewards (n,); see the tables of `QuadrotorEnv`."""
    for i in range(observation.shape[0]):
        out, wanted, m, p = observation[i], loops[i].flight.target, loops[i].measured, loops[i].vehicle
        distance = speed = 0.0  # squared errors
        for j in range(3):
            out.position_error[j] = _clip(wanted.position[j] - m.position[j], POSITION_LIMIT)
            out.velocity_error[j] = _clip(wanted.velocity[j] - m.velocity[j], VELOCITY_LIMIT)
            out.acceleration[j] = _clip(wanted.acceleration[j], ACCELERATION_LIMIT)
            out.gyro[j] = _clip(m.gyro[j], RATE_LIMIT)
            distance += (wanted.position[j] - p.position[j]) ** 2
            speed += (wanted.velocity[j] - p.velocity[j]) ** 2
        out.roll_pitch[0] = _clip(m.roll_pitch[0], np.pi)
        out.roll_pitch[1] = _clip(m.roll_pitch[1], np.pi)
        error = wanted.yaw - m.yaw
        out.yaw_error = np.arctan2(np.sin(error), np.cos(error))
        out.heading[0], out.heading[1] = np.cos(m.yaw), np.sin(m.yaw)
        reward[i] = 1.0 / (1.0 + distance + 0.1 * speed) if loops[i].flight.cause == FLYING else 0.0
