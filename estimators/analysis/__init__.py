"""Analysis of networks on recorded flights: activity, ablation and costs."""
