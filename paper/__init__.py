"""The paper again: its tables and figures, ours beside theirs, and a verdict on each of its claims."""
