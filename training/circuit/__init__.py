"""Training of the circuit that follows turns, by gradients through time."""
