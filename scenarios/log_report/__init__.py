"""The report of estimators on recorded logs: traces on one time axis, errors, and a verdict in words."""
