"""Quadrotor simulation with MuJoCo: vehicle, wind, IMU, controller, datasets and Gymnasium environments."""

from .runs.surroundings import settle

settle()
