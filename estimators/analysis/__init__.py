"""Analysis of networks: weights and flights go in; activity, encodings, ablations and costs come out."""
