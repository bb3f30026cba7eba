"""Attitude controllers trained by imitation of a teacher that is given the true state."""
