"""Drives as a Minari data set: `isd-gym record`."""
