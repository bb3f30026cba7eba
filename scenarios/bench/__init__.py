"""The benchmark: scenarios × estimators × seeds go in; metrics and a verdict come out."""
