"""The linear part of a step: a matrix of the pool times the state of eight lanes, exact over the step."""

from __future__ import annotations

import numba as nb

from .lanes import fused, load, select, spread, store
from .layout import WIDTH

U = nb.uintp  # an unsigned index spares the code for negative ones


def sums(mats, own, at, height, columns, state, result, rows):
    """Rows `result`... of the state = a matrix of the pool, stored column by column, times its first `columns` rows.

    The last rows first: what a step does next begins with them, and the processor does not wait.
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
    """Number k of the pool, in every lane."""
    if own:
        return load(mats, k * WIDTH)
    return spread(mats[U(k)])


def number(mats, own, k, l):
    """Number k of the pool, of lane l."""
    return mats[U(k * WIDTH + l)] if own else mats[U(k)]


def clip(x, level):
    x = select(x > level, level, x)
    return select(x < -level, -level, x)


def take(state, row, values, at, width, first, count):
    """A row of the state from inputs: one number for all lanes (width 1), or those of the `count` cars from `first` on."""
    if width == 1:
        store(state, row * WIDTH, spread(values[U(at)]))
    elif count == WIDTH:
        store(state, row * WIDTH, load(values, at * width + first))
    else:
        for l in range(count):
            state[U(row * WIDTH + l)] = values[U(at * width + first + l)]
