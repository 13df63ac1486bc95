"""Simulation of networks over measured records: inputs between samples, many variants side by side, a cache."""
