"""Hypotheses: every effect at every place, the motion and forces there, matches of laws, unmodelled effects."""
