"""Records in the form that loggers write: files with separate time stamps and rates, oddities, and the map from
columns to channels."""

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
