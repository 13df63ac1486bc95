"""A vehicle suspension with a hydraulic electric inerter, for control, learning and diagnosis."""

__version__ = "0.1.0"
