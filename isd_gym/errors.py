"""The error every bad input ends in."""

from __future__ import annotations


class InputError(ValueError):
    """What a user handed over cannot be used; the message is one line that says what and where."""
