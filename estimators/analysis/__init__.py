"""Analysis of networks: weights and flights go in; activity, ablations and costs come out."""
