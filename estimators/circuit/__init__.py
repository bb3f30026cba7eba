"""The spiking circuit that follows turns: Att-SNN on the chip's integers, and Att-RNN, the same in floats."""
