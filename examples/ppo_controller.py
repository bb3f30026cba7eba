"""Fine-tune a spiking attitude controller with PPO from stable-baselines3, for another airframe.

    python examples/ppo_controller.py [--updates 60] [--out reports/ppo-controller]

The controller, trained by imitation, flies vehicles with twice the moment of inertia of its training, spread
in mass and motor lag and with weak rotors, after steps of roll and pitch. The agent is its output layer: the
observation is what arrives there, the spikes of each hidden neuron after the filter of the output neurons;
the mean of an action is the output layer's weights times it, the angular acceleration that is asked for.
Encoding and hidden layer stay as they are. PPO tries weights, each for an episode (generalised
state-dependent exploration): at 200 samples a second, noise of single actions turns nothing. Rounded to the
chip's, the weights are a controller again.

Writes `tuned.safetensors`, to fly with `quadsim bench --controller`, and `ppo.csv`: the RMS angle between the
commanded and the true thrust axis and the RMS change of the rotor command in episodes that no training saw,
flown on the emulated chip, and the same for the vehicles that the controller knows.

Needs stable-baselines3: pip install 'quadsim[rl]'.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from estimators.control.controller import SpikingController
from estimators.networks.network import real_weights
from estimators.networks.weights_file import Network, load_network, save_network
from quadsim.flight.loop import FlightLoop
from quadsim.flight.recipe import load_recipe
from quadsim.rotation import quat_from_euler
from quadsim.runs.files import write_csv
from quadsim.seeding import child
from quadsim.vehicle import GRAVITY, randomise

Array = NDArray[np.float64]
VEHICLES = 64  # that learn at once
STEPS = 400  # samples of an episode, and of each vehicle between two updates of the policy
HOLD = 120  # samples for which a set-point holds, at most
TILT = 20.0  # its largest roll and pitch [deg]
INERTIA = 2.0  # moment of inertia over the one that the controller was trained for
WEAK = 0.15  # largest loss of thrust of a rotor, as a share
EVERY = 10  # updates after which it is judged
EPISODES = 64  # to judge a controller by
JUDGED = 2000  # their seed; those of the training begin at 0
GAMMA = 0.98
LEARNING_RATE = 1e-3
STEP = 0.1  # of the output weights, over that of the critic
CHANGE = 60.0  # of the rotor command in a sample that costs as much as 10° [rad/s]
SPREAD = 0.01  # standard deviation of the weights that it tries
WORST = np.radians(60.0)  # what a larger error counts as


class Relay:
    """An attitude controller that returns the action of the agent."""

    def reset(self, n: int) -> None:
        """Start n vehicles."""
        self.action = np.zeros((n, 4))

    def update(self, set_point: Array, gyro: Array, accel: Array, roll_pitch: Array) -> Array:
        """See `AttitudeController`."""
        return self.action


class Flights:
    """n vehicles that follow steps of roll and pitch, and draw new ones when they begin again.

    Args:
        n: Number of vehicles.
        seed: Of the first flights; later ones have the numbers that follow.
        inertia: Over that of the vehicle that the controller was trained for.
    """

    def __init__(self, n: int, seed: int, inertia: float = INERTIA) -> None:
        self.n, self.seed, self.inertia = n, seed, inertia
        self.recipe = load_recipe("control")

    def begin(self) -> None:
        """Draw vehicles and set-points, and start."""
        root = np.random.SeedSequence(self.seed)
        self.seed += 1
        rng = np.random.default_rng(child(root, 0))
        nominal = self.recipe.vehicle
        heavy = nominal.model_copy(update={"inertia": tuple(self.inertia * each for each in nominal.inertia)})
        vehicles = [randomise(heavy, self.recipe.randomisation, rng) for _ in range(self.n)]
        self.relay = Relay()
        self.loop = FlightLoop(
            vehicles,
            self.n,
            imu=self.recipe.imu,
            seed=[child(root, 1, k) for k in range(self.n)],
            nominal=self.recipe.vehicle,
            controller=lambda rate_hz, vehicle: self.relay,
        )
        self.loop.reset(position=np.tile([0.0, 0.0, 100.0], (self.n, 1)))
        rotors = len(self.recipe.vehicle.rotors)
        self.loop.plant.rotor_effect[:] = 1.0 - WEAK * rng.uniform(size=(self.n, rotors))
        holds = np.cumsum(rng.integers(HOLD // 4, HOLD, (self.n, STEPS)), axis=1)
        steps = np.radians(TILT) * rng.uniform(-1.0, 1.0, (self.n, STEPS, 2))
        which = [np.searchsorted(each, np.arange(STEPS + 1), side="right") for each in holds]
        self.wanted = np.stack([steps[k, each] for k, each in enumerate(which)])
        self.k = 0

    @property
    def readings(self) -> tuple[Array, Array, Array, Array]:
        """Set-point (n, 4), gyro (n, 3), accel (n, 3) and roll and pitch (n, 2), as of a controller."""
        set_point = np.zeros((self.n, 4))
        set_point[:, :2], set_point[:, 3] = self.wanted[:, self.k], GRAVITY
        return set_point, self.loop.gyro, self.loop.readings.accel, self.loop.attitude

    def fly(self, ang_acc: Array) -> tuple[Array, Array]:
        """Fly a sample with angular accelerations (n, 3) [rad/s²].

        Returns:
            The angle between the thrust axes wanted and true, (n,) [rad], and the RMS change of the rotor
            command, (n,) [rad/s].
        """
        before = self.loop.controller.rotor_vel_cmd.copy()
        self.relay.action = np.concatenate([ang_acc, np.full((self.n, 1), GRAVITY)], axis=1)
        command = np.zeros((self.n, 4))
        command[:, :2], command[:, 2] = self.wanted[:, self.k], self.loop.plant.yaw
        command[:, 3] = GRAVITY
        self.loop.step("attitude", command)
        plant, wanted = self.loop.plant, self.wanted[:, self.k]
        axes = [_up(quat_from_euler(wanted[:, 0], wanted[:, 1], plant.yaw)), _up(plant.quat)]
        self.k += 1
        change = np.sqrt(np.mean((self.loop.controller.rotor_vel_cmd - before) ** 2, axis=1))
        error = np.minimum(np.arccos(np.clip(np.sum(axes[0] * axes[1], axis=1), -1.0, 1.0)), WORST)
        return error, change


def _up(quat: Array) -> Array:
    w, x, y, z = quat.T
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)


class Filtered:
    """The hidden layer of a controller for n vehicles, and its spikes as they arrive at the output layer."""

    def __init__(self, weights: Network, n: int) -> None:
        self.controller = SpikingController(*weights)
        self.controller.reset(n)
        real = real_weights(weights.config, weights.tensors)
        self.keep = float(real.syn2[0]), float(real.mem2[0])
        self.current, self.potential, self.spikes = (np.zeros((n, weights.config.hidden)) for _ in range(3))

    def update(self, readings: tuple[Array, Array, Array, Array]) -> NDArray[np.float32]:
        """Filtered spikes (n, hidden) after one more sample: those of the step before arrive now."""
        self.current = self.keep[0] * self.current + self.spikes
        self.potential = self.keep[1] * self.potential + self.current
        self.controller.update(*readings)
        listed = self.controller.states["s1"]
        self.spikes = np.zeros_like(self.spikes)
        for row, each in zip(self.spikes, listed, strict=True):
            row[each[1 : 1 + each[0]]] = 1.0
        return self.potential.astype(np.float32)


class Agents(VecEnv):
    """The flights as stable-baselines3 takes them; all episodes end together.

    Args:
        weights: Controller whose hidden layer is observed.
        n: Number of vehicles.
        seed: Of the first episodes.
        size: What an observation is divided by, (hidden,).
    """

    def __init__(self, weights: Network, n: int, seed: int, size: Array) -> None:
        self.weights, self.flights, self.size = weights, Flights(n, seed), size.astype(np.float32)
        bound = weights.config.set_point.bound / weights.config.output_scale
        observation = gymnasium.spaces.Box(-np.inf, np.inf, size.shape, np.float32)
        super().__init__(n, observation, gymnasium.spaces.Box(-bound, bound, (3,), np.float32))

    def reset(self) -> NDArray[np.float32]:
        """Begin all episodes."""
        self.flights.begin()
        self.hidden = Filtered(self.weights, self.num_envs)
        return self._observed()

    def _observed(self) -> NDArray[np.float32]:
        return self.hidden.update(self.flights.readings) / self.size

    def step_async(self, actions: Array) -> None:
        """Take the actions of the next step."""
        self.actions = actions

    def step_wait(self) -> tuple[NDArray[np.float32], Array, NDArray[np.bool_], list[dict[str, Any]]]:
        """Fly a sample. Error and change of command cost; returns are of the size of 1, for the critic."""
        error, change = self.flights.fly(self.actions * self.weights.config.output_scale)
        cost = (np.degrees(error) / 10.0) ** 2 + (change / CHANGE) ** 2
        earned, observation = (GAMMA - 1.0) * cost, self._observed()
        over = self.flights.k == STEPS
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if over:
            infos = [{"terminal_observation": each, "TimeLimit.truncated": True} for each in observation]
            observation = self.reset()
        return observation, earned, np.full(self.num_envs, over), infos

    def close(self) -> None:
        """Nothing to free."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the batch, once for each vehicle."""
        return [getattr(self, attr_name, None)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: the vehicles share one loop."""
        raise NotImplementedError("vehicles of a batch have no attributes of their own")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refused: the vehicles share one loop."""
        raise NotImplementedError("vehicles of a batch have no methods of their own")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """No vehicle has a wrapper of its own."""
        return [False] * len(list(self._get_indices(indices)))


def judge(weights: Network, inertia: float = INERTIA) -> tuple[float, float]:
    """On the emulated chip: RMS tracking error [deg], and RMS change of the rotor command [rad/s]."""
    flights = Flights(EPISODES, JUDGED, inertia)
    flights.begin()
    controller = SpikingController(*weights, on_loihi=True)
    controller.reset(EPISODES)
    flown = [flights.fly(controller.update(*flights.readings)[:, :3]) for _ in range(STEPS)]
    error, change = np.sqrt(np.mean(np.square(flown), axis=(0, 2)))
    return float(np.degrees(error)), float(change)


class Output(nn.Module):
    """Output layer of a controller, without bias as on the chip.

    Args:
        weights: To begin from, (3, hidden).
    """

    def __init__(self, weights: Array) -> None:
        super().__init__()
        self.register_buffer("start", torch.from_numpy(weights.astype(np.float32)))
        self.change = nn.Parameter(torch.zeros_like(self.start))

    @property
    def weight(self) -> torch.Tensor:
        """The weights now, (3, hidden)."""
        return self.start + STEP * self.change

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Mean of the actions, (n, 3)."""
        return x @ self.weight.T


def observed_size(weights: Network) -> Array:
    """Root mean square of what arrives at the output layer while the controller flies, (hidden,)."""
    flights, squares = Flights(VEHICLES, 0), []
    flights.begin()
    hidden = Filtered(weights, VEHICLES)
    output = real_weights(weights.config, weights.tensors).w_out * weights.config.output_scale
    for _ in range(STEPS):
        arrived = hidden.update(flights.readings)
        flights.fly(arrived @ output.T)
        squares.append(np.mean(arrived**2, axis=0))
    return np.sqrt(np.mean(squares, axis=0)) + 1e-3


def agent(weights: Network, seed: int) -> PPO:
    """PPO whose policy is the controller's output layer, from the weights that it has."""
    size = observed_size(weights)
    model = PPO(
        "MlpPolicy",
        Agents(weights, VEHICLES, seed + 1, size),
        n_steps=STEPS,
        batch_size=3200,
        n_epochs=5,
        gamma=GAMMA,
        learning_rate=LEARNING_RATE,
        seed=seed,
        policy_kwargs={"net_arch": {"pi": [], "vf": [64, 64]}, "log_std_init": float(np.log(SPREAD))},
        use_sde=True,  # noise of the weights, which holds, not of the actions: a sample of 5 ms turns nothing
        device="cpu",
    )
    model.policy.action_net = Output(real_weights(weights.config, weights.tensors).w_out * size)
    model.policy.log_std.requires_grad_(False)
    rate = model.lr_schedule(1.0)
    model.policy.optimizer = torch.optim.Adam(model.policy.parameters(), lr=rate, eps=1e-5)
    return model


def with_output(weights: Network, output: Array) -> Network:
    """The controller with other output weights (3, hidden), rounded to the chip's."""
    mantissas = np.clip(2 * np.rint(128 * output), -256, 254).astype(np.int16)
    return weights._replace(tensors=weights.tensors | {"w_out": mantissas})


def main(arguments: Sequence[str] | None = None) -> None:
    """Fine-tune, print the tracking error now and then, and write the controller."""
    parser = argparse.ArgumentParser(description="Fine-tune a spiking controller with PPO.")
    parser.add_argument("--controller", default="control-attitude", help="name or weights to begin from")
    parser.add_argument("--updates", type=int, default=60, help="of the policy")
    parser.add_argument("--seed", type=int, default=0, help="of the training")
    parser.add_argument("--out", type=Path, default=Path("reports/ppo-controller"), help="folder to write")
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    try:
        weights = load_network(given.controller)
    except (ValueError, OSError) as error:
        parser.error(str(error))
    config = weights.config
    if config.reads != "attitude" or (config.steps_per_sample, config.rate_hz) != (1, 200.0):
        parser.error(
            f"{given.controller}: give one that reads an attitude, at 200 Hz, a step for each sample"
        )
    if given.updates < 0:
        parser.error(f"--updates {given.updates}: should not be negative")
    model, tuned, rows = agent(weights, given.seed), weights, []
    print("updates, tracking error [°] and change of the command [rad/s]: inertia doubled, as known")
    done = 0
    for update in [*range(0, given.updates, EVERY), given.updates]:
        if update > done:
            model.learn((update - done) * VEHICLES * STEPS, reset_num_timesteps=False)
            done = update
            tuned = with_output(weights, model.policy.action_net.weight.detach().numpy() / model.env.size)
        (heavy, change), (known, known_change) = judge(tuned), judge(tuned, 1.0)
        rows.append(
            {"updates": update, "heavy_deg": heavy, "heavy_change": change}
            | {"known_deg": known, "known_change": known_change}
        )
        print(f"{update:7} {heavy:7.2f} {change:6.1f} {known:7.2f} {known_change:6.1f}", flush=True)
    given.out.mkdir(parents=True, exist_ok=True)
    save_network(given.out / "tuned.safetensors", *tuned)
    write_csv(given.out / "ppo.csv", rows)
    print(given.out / "tuned.safetensors")


if __name__ == "__main__":
    main()
