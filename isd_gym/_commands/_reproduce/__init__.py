"""Sections of `isd-gym reproduce`, one per module."""
