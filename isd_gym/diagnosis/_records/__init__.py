"""Measured records: reading, filtering, several sampling rates, feedback, and the training/validation/test split."""
