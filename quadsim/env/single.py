"""The environment of one quadrotor."""

from pathlib import Path
from typing import Any, NoReturn

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..control.attitude_controller import MakeController
from ..control.records import Level
from ..flight.scenario import Scenario
from ..flight.world import CAUSES
from ..pictures.render import Image
from .batch import QuadrotorVectorEnv, take
from .made import Made, Spread
from .spaces import INFORMATION


class QuadrotorEnv(gymnasium.Env[NDArray[Any], NDArray[Any]]):
    """A simulated quadrotor whose roll and pitch come from an attitude estimator.

    ## Description

    The vehicle flies a scenario (`quadsim.flight.scenario`): a trajectory of set-points, with wind, sensor
    errors and faults. A cascaded controller uses the estimated attitude. The action enters the cascade at a
    level that you choose, so an agent can correct the set-point or replace the whole controller. One step is
    one sample, 5 ms at the default 200 Hz. The closed-loop benchmark uses the same `Mission`.

    ## Action space

    `Box(-1, 1, (4,), float32)`, with the four numbers below. An action of 0 is neutral. At level `rotor`, the
    action has one number a per rotor, which commands the speed ω_h + a (ω_max − ω_h).

    | level    | 0              | 1               | 2            | 3                          |
    |----------|----------------|-----------------|--------------|----------------------------|
    | position | Δx, ±1 m       | Δy, ±1 m        | Δz, ±1 m     | Δyaw, ±π                   |
    | velocity | Δv_x, ±3 m/s   | Δv_y, ±3 m/s    | Δv_z, ±3 m/s | Δyaw, ±π                   |
    | attitude | roll, ±0.6 rad | pitch, ±0.6 rad | Δyaw, ±π     | thrust per mass, g (1 + a) |
    | rate     | p, ±6 rad/s    | q, ±6 rad/s     | r, ±2 rad/s  | thrust per mass, g (1 + a) |
    | rotor    | first rotor    | second          | …            | …                          |

    Δ is relative to the set-point of the scenario, in world axes. With an action of 0 at level `position`,
    the flight equals that of the benchmark. ω_h is the hover speed. The rotors have the order of the
    vehicle's file.

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

    Roll and pitch come from the estimator. Position, velocity and yaw come from the scenario's external
    sensor, with its noise, rate and delay (`quadsim.external`).

    ## Reward

    1 / (1 + ‖e_p‖² + 0.1 ‖e_v‖²) in each step, where e_p [m] and e_v [m/s] are the true errors of position
    and velocity. The largest reward is 1. The reward is 0 in the step of a crash.

    ## Starting state

    The scenario defines the start: its first set-point, displaced or tilted by amounts drawn for the seed.

    ## Episode end

    - Termination: a crash by the scenario's criteria. By default, these are a tilt above 75°, contact with
      the ground, and a distance of 10 m from the set-point. `info["cause"]` names the criterion. In the
      batched environment, it is an index into `quadsim.flight.world.CAUSES`.
    - Truncation: the scenario's duration is over.

    ## Information

    The last value that `reset` and `step` return is a dictionary of quantities that the agent does not
    observe. In the batched environment, each quantity has a row for every vehicle.

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

    `reset(options={"scenario": ..., "wind": (x, y, z), "randomisation": {...}})` replaces the scenario (by a
    name, a file or a `Scenario`), the wind (by a constant one [m/s]) or the randomisation. The options hold
    until the next `reset`.

    ## Domain randomisation

    The table `randomisation` has the same keys as in recipes and scenarios. For example, `{"mass": 0.2,
    "delay": 1.0}` draws a mass within ±20 % and a delay of 0 to 2 times the nominal one, for each episode and
    vehicle. The keys are `mass`, `inertia`, `thrust`, `torque`, `rotor_drag`, `frame_drag`, `motor_lag`,
    `imu` (a factor for each error of the IMU), `wind` and `delay` (of the external sensor). The controller
    and the estimator use the nominal vehicle.

    ## Arguments

    | argument      | default    | meaning                                                                |
    |---------------|------------|------------------------------------------------------------------------|
    | `estimator`   | None       | source of roll and pitch; None for the true ones                       |
    | `scenario`    | "hover"    | a `Scenario`, the name of a shipped one or the path of a TOML file     |
    | `level`       | "attitude" | where the action enters the controller                                 |
    | `rate_hz`     | 200.0      | samples, and steps, per second                                         |
    | `duration_s`  | None       | length of an episode, instead of the scenario's                        |
    | `render_mode` | None       | "rgb_array" for pictures                                               |
    | `controller`  | None       | your own attitude controller, or weights                               |
    | `randomisation` | None     | ranges of the vehicle, the IMU, the wind and the delay, see above      |

    `metadata["render_fps"]` equals `rate_hz`, so videos by gymnasium's RecordVideo play in real time.
    RecordVideo needs moviepy: `pip install 'quadsim[video]'`.

    `gymnasium.make_vec("quadsim/Quadrotor-v0", num_envs=n, ...)` makes the batched environment. Its
    sub-environment i gives exactly the same numbers as this environment reset with `seed + i`. It restarts
    finished episodes in the next step.

    `estimator` is a name, weights or "module:Class", as in `estimators.create`; a function of `rate_hz` that
    makes an estimator; or an `AttitudeEstimator`, of which each environment uses its own copy.

    ## Version history

    - v0: first version.
    """

    # gymnasium declares this as a variable of instances
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"]}  # noqa: RUF012  (Gymnasium's own attribute)

    def __init__(
        self,
        estimator: Made = None,
        scenario: Scenario | str = "hover",
        level: Level = "attitude",
        rate_hz: float = 200.0,
        duration_s: float | None = None,
        render_mode: str | None = None,
        controller: str | Path | MakeController | None = None,
        randomisation: Spread | None = None,
    ) -> None:
        self._batch = QuadrotorVectorEnv(
            1, estimator, scenario, level, rate_hz, duration_s, render_mode, controller, randomisation
        )
        self.metadata = {**self.metadata, "render_fps": rate_hz}
        self.render_mode, self._action = render_mode, self._batch.actions[0]
        self.observation_space = self._batch.single_observation_space
        self.action_space = self._batch.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode; the class docstring describes the options.

        Raises:
            ValueError: An unknown option, or a value that it cannot have.
        """
        observation, info = self._batch.reset(seed=seed, options=options)
        super().reset(seed=None if seed is None else int(seed))
        return observation[0], {key: rows[0] for key, rows in info.items() if key[0] != "_"}

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Fly one sample with an action.

        Raises:
            ValueError: The action has the wrong shape or is not finite, or the episode has ended.
        """
        if self._batch.ended:
            raise ValueError("the episode is over; call reset to begin another")
        take(action, self._action)
        row = self._batch.advance().item()
        assert isinstance(row, tuple)
        info = dict(zip(INFORMATION, row))  # noqa: B905  (the rest of the row is no information)
        reward, observation, crashed, over = row[-4:]
        if crashed:
            info["cause"] = CAUSES[self._batch.mission.cause[0]]
        return observation, reward, crashed, over, info

    def render(self) -> Image | None:
        """Return a picture of the vehicle, (540, 960, 3); None without a render mode."""
        pictures = self._batch.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """Release the resources of rendering."""
        self._batch.close_extras()

    def __reduce__(self) -> NoReturn:
        """Refuse to be copied or pickled, as `QuadrotorVectorEnv` does."""
        return self._batch.__reduce__()
