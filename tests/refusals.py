"""What is wrong is refused in one line."""

import pytest

from isd_gym._common.errors import InputError


def refused(words, call, /, *given, **options):
    """Assert that a call ends in an `InputError` of one harmless line with these words (any if none are given), and return the line."""
    with pytest.raises(InputError, match=words or None) as error:
        call(*given, **options)
    text = str(error.value)
    assert text.isprintable() and len(text) < 1500
    return text
