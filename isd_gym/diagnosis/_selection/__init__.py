"""Selection: screening, forward addition and backward elimination, held-out scores, comparisons and weights."""
