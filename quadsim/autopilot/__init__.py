"""Firmware of real autopilots in the loop, as a process of its own, in place of estimator and controller."""
