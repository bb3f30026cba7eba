"""Evaluation without a loop: recorded flights or logs go in; errors, intervals and figures come out."""
