"""The environment and its batched twin."""

import gymnasium

import quadsim  # noqa: F401  registers it

ID = "quadsim/Quadrotor-v0"


def make(n, **arguments):
    """The environment itself, or the batched one of n."""
    return gymnasium.make(ID, **arguments).unwrapped if n == 1 else gymnasium.make_vec(ID, n, **arguments)
