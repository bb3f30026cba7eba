"""The page: the paper's results, quadsim's results, and verdicts on the claims."""
