"""Measured records: reading, filtering, several sampling rates, clock lags, and the training/validation/test split.

`reading` checks and converts a source, `agreement` finds turned, mislabelled and swapped channels, `feedback` detects inputs that follow from outputs, `multirate` builds records from channels with time stamps of their own, `filtering` differentiates noisy inputs, `splitting` assigns training, validation
and test records.
"""

from .agreement import find_misreading
from .feedback import Feedback, find_feedback
from .filtering import (
    choose_decimation,
    count_derivatives,
    differentiate_inputs,
    estimate_white_noise,
    find_computed_forces,
)
from .multirate import build_record, check_sampling_rates
from .reading import read_record, thin_long_record
from .splitting import LEAD_IN, cut_segments, split_records

__all__ = [
    "LEAD_IN",
    "Feedback",
    "build_record",
    "check_sampling_rates",
    "choose_decimation",
    "count_derivatives",
    "cut_segments",
    "differentiate_inputs",
    "estimate_white_noise",
    "find_computed_forces",
    "find_feedback",
    "find_misreading",
    "read_record",
    "split_records",
    "thin_long_record",
]
