"""Evaluation of estimators on recorded flights and logs: errors, intervals and figures."""
