"""The batched environment for Stable-Baselines3, and the conversion of its agents to policies."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..config.ranges import Between
from ..flight.world import CAUSES
from .batch import QuadrotorVectorEnv, take
from .policy import Policy, PolicySpec

try:
    from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
    from stable_baselines3.common.vec_env import VecEnv
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        "this needs the package stable-baselines3: pip install 'quadsim[rl]'", name=error.name
    ) from error

REPEATS = Between(1, 10_000)


class SB3VecEnv(VecEnv):
    """A batch of n quadrotors, in which each action is held for a number of samples.

    The reward of a step is the sum of the rewards of its samples, divided by `repeat`. A vehicle whose
    episode ends within a step restarts in the next sample and flies with the action 0 until the next step. If
    an episode ends in the last sample of a step, the step has an additional sample, in which the other
    vehicles continue with their action. For an episode that has ended, `infos` contains
    `terminal_observation`, `TimeLimit.truncated` and `cause`.

    Only the first seed given to `seed` and the first options given to `set_options` are used, for the whole
    batch.

    Args:
        num_envs: Number of vehicles.
        repeat: Number of samples for which an action is held. 10 samples at 200 Hz give 20 actions per
            second.
        arguments: Arguments of `QuadrotorEnv`.
    """

    def __init__(self, num_envs: int, repeat: int = 1, **arguments: Any) -> None:
        if not isinstance(repeat, int) or isinstance(repeat, bool):
            raise ValueError(f"repeat = {repeat!r}: should be a whole number")
        self.repeat = int(REPEATS.of("repeat", repeat))
        self.batch = QuadrotorVectorEnv(num_envs, **arguments)
        super().__init__(num_envs, self.batch.single_observation_space, self.batch.single_action_space)

    def reset(self) -> NDArray[np.float32]:
        """Begin all episodes and return the observations, (n, 17)."""
        seed, options = self._seeds[0], self._options[0]
        self._reset_seeds()
        self._reset_options()
        return self.batch.reset(seed=seed, options=options)[0]

    def step_async(self, actions: NDArray[Any]) -> None:
        """Set the actions (n, numbers) of the next step."""
        take(actions, self.batch.actions)

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[np.bool_], list[dict[str, Any]]]:
        """Fly one step; return observations (n, 17), rewards (n,), ends of episodes (n,), and infos."""
        batch, sample = self.batch, 1
        outcome = batch.advance()
        rewards, done = outcome["reward"].copy(), batch.done.copy()
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        self._note(outcome, done, infos)
        while sample < self.repeat or batch.ended:
            outcome = batch.advance()
            rewards += np.where(done, 0.0, outcome["reward"])
            self._note(outcome, batch.done & ~done, infos)
            done |= batch.done
            sample += 1
        return outcome["observation"].copy(), rewards / self.repeat, done, infos

    def _note(self, outcome: NDArray[np.void], ended: NDArray[np.bool_], infos: list[dict[str, Any]]) -> None:
        """Write the last sample of ended episodes to their infos, and set their actions to 0."""
        if not self.batch.ended:
            return
        for i in np.flatnonzero(ended):
            last = outcome[i]
            infos[i] = {
                "terminal_observation": last["observation"].copy(),
                "TimeLimit.truncated": bool(last["over"] and not last["crashed"]),
                "cause": CAUSES[self.batch.mission.cause[i]],
            }
            self.batch.actions[i] = 0.0

    def close(self) -> None:
        """Release the resources of rendering."""
        self.batch.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return a picture of every vehicle."""
        return self.batch.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the batch, once for each vehicle."""
        return [getattr(self.batch, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: the vehicles share one batch."""
        raise NotImplementedError("vehicles of a batch have no attributes of their own")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refused: the vehicles share one batch."""
        raise NotImplementedError("vehicles of a batch have no methods of their own")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Return False for each vehicle, because vehicles have no wrappers of their own."""
        return [False] * len(list(self._get_indices(indices)))


def policy_of(model: OnPolicyAlgorithm, spec: PolicySpec) -> Policy:
    """Return the deterministic policy of a PPO or A2C agent with `MlpPolicy`.

    `save_policy` can write it to a file.

    Raises:
        ValueError: The agent is of another kind, or its network has layers other than linear ones separated
            by tanh.
    """
    if not hasattr(model.policy, "mlp_extractor"):
        raise ValueError(f"{type(model).__name__} has no policy of the kind of PPO and A2C")
    layers = [*model.policy.mlp_extractor.policy_net.children(), model.policy.action_net]
    kinds = [type(each).__name__ for each in layers]
    if kinds != ["Linear", "Tanh"] * (len(layers) // 2) + ["Linear"]:
        raise ValueError(f"the policy has layers {', '.join(kinds)}; only Linear and Tanh in turn are known")
    state = (each.state_dict() for each in layers[::2])
    return Policy(spec, [(each["weight"].numpy(), each["bias"].numpy()) for each in state])
