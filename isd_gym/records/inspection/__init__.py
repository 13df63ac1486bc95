"""Inspection of files: content and oddities of loggers' files, and the column of each channel of a model."""

from .report import Inspection, head, inspect, lines

__all__ = ["Inspection", "head", "inspect", "lines"]
