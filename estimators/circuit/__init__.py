"""The circuit that tracks rotations: Att-SNN with spikes, in the chip's integers, and Att-RNN in floats."""
