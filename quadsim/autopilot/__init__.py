"""Firmware of real autopilots in the loop: a separate process replaces the estimator and the controller."""
