"""The benchmark: scenarios × estimators × seeds go in; metrics, breaking points and a verdict come out."""
