"""Bounds of the cost: what no controller, or none that is causal, can do better."""
