"""Grids of conditions: `isd-gym sweep`."""
