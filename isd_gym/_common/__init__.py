"""Errors, files, units, seeds and entry points, which every other room uses."""
