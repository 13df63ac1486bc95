"""Diagnosis of a co-simulation FMU: `comparison` (stepping), `refit` (parameters), `diagnosis` (verdict).

An FMU shows its terminals only. The verdict names no effect and no place.
"""

from .diagnosis import diagnose_unit

__all__ = ["diagnose_unit"]
