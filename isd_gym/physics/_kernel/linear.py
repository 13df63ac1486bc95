"""Linear part of a step: a matrix of the pool times the state of eight lanes, exact over the step."""

from __future__ import annotations

import numba as nb

from .lanes import fused, load, select, spread, store
from .layout import WIDTH

U = nb.uintp  # an unsigned index avoids the code for negative indices


def sums(mats, own, at, height, columns, state, result, rows):
    """Write a matrix of the pool, stored column by column, times the first `columns` rows of the state into the
    rows from `result`.

    The last rows are computed first: the rest of the step starts with these rows, so that the processor does
    not wait.
    """
    for i in range(rows - 4, -1, -4):
        a, b, c, d = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
        k = at + i
        if own:
            for j in range(columns):
                x = load(state, j * WIDTH)
                a = fused(load(mats, k * WIDTH), x, a)
                b = fused(load(mats, (k + 1) * WIDTH), x, b)
                c = fused(load(mats, (k + 2) * WIDTH), x, c)
                d = fused(load(mats, (k + 3) * WIDTH), x, d)
                k += height
        else:
            for j in range(columns):
                x = load(state, j * WIDTH)
                a = fused(spread(mats[U(k)]), x, a)
                b = fused(spread(mats[U(k + 1)]), x, b)
                c = fused(spread(mats[U(k + 2)]), x, c)
                d = fused(spread(mats[U(k + 3)]), x, d)
                k += height
        to = (result + i) * WIDTH
        store(state, to, a)
        store(state, to + WIDTH, b)
        store(state, to + 2 * WIDTH, c)
        store(state, to + 3 * WIDTH, d)


def pooled(mats, own, k):
    """Return number k of the pool in every lane."""
    if own:
        return load(mats, k * WIDTH)
    return spread(mats[U(k)])


def number(mats, own, k, l):
    """Return number k of the pool of lane l."""
    return mats[U(k * WIDTH + l)] if own else mats[U(k)]


def clip(x, level):
    """Return x limited to +-level."""
    x = select(x > level, level, x)
    return select(x < -level, -level, x)


def take(state, row, values, at, width, first, count):
    """Write a row of the state from inputs: one number for all lanes (width 1), or the numbers of `count` cars from `first`."""
    if width == 1:
        store(state, row * WIDTH, spread(values[U(at)]))
    elif count == WIDTH:
        store(state, row * WIDTH, load(values, at * width + first))
    else:
        for l in range(count):
            state[U(row * WIDTH + l)] = values[U(at * width + first + l)]
