"""Flights: scenarios and recipes go in, samples of plant, IMU, estimator and controller come out."""
