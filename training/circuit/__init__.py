"""Training of the circuit that tracks rotations, by gradients through time."""
