"""Backends of Att-SNN: weights and a batch go in, outputs and gradients come out."""
