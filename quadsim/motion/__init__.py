"""The equations of motion: rotors and frame, a free body, and MuJoCo where the ground can be touched."""
