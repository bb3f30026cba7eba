"""The closed-loop benchmark: scenarios × estimators × seeds, with metrics and a verdict."""
