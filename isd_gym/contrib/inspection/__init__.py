"""The command `isd-gym inspect`: content and oddities of loggers' files, and the column of each channel of a model."""

from .report import Inspection, head, inspect, lines, page

__all__ = ["Inspection", "head", "inspect", "lines", "page"]
