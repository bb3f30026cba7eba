"""Flights: simulation of scenarios and recipes with plant, IMU, estimator and controller in one loop."""
