"""Find where simulation and measurement disagree, name the missing effect, and add it."""

from .result import Contender, Diagnosis, Effect, Gate, Law, Place, Quantity, Trace
from .workflow import diagnose

__all__ = ["Contender", "Diagnosis", "Effect", "Gate", "Law", "Place", "Quantity", "Trace", "diagnose"]
