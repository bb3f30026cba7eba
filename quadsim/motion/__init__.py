"""Equations of motion of rotors and frame; motion of a free body, or by MuJoCo with ground contact."""
