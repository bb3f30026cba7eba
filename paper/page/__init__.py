"""The pages: what the paper says, ours beside it, and verdicts."""
