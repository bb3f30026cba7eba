"""Quadrotor simulation with MuJoCo: vehicle, wind, IMU, controller, datasets and Gymnasium environments."""

from gymnasium.envs.registration import register

from .runs.surroundings import settle

settle()

register(
    id="quadsim/Quadrotor-v0",
    entry_point="quadsim.env:QuadrotorEnv",
    vector_entry_point="quadsim.env:QuadrotorVectorEnv",
)
