"""Records as loggers write them: files with their own stamps and rates, oddities, and which column is which channel."""

from .mapping import ChannelMap, Column, Logger, files_of, runs
from .recording import Raster, Recording, Signal, mended, rasters

__all__ = [
    "ChannelMap",
    "Column",
    "Logger",
    "Raster",
    "Recording",
    "Signal",
    "files_of",
    "mended",
    "rasters",
    "runs",
]
