"""Attitude controllers learnt by imitation: a teacher that has the truth, students that read an estimate."""
