"""Hypotheses: every effect at every place, the motion and forces there, the score test, unmodelled effects."""
