"""Where each number of the kernel lies, by name; read by Python and by compiled code alike.

A plant's numbers are three arrays:

- `ints`: the sizes, in the order of the first fields of `Layout`; then of every law its code, then whether its rate is a
  difference of its elongations;
- `mats`: numbers that do not change in a step. A plant whose lanes share a network has one pool of them; where every lane
  has its own, a group of eight lanes has a pool with each number eight times, side by side (but a law's parameters, which
  it reads as an array, lie together lane by lane);
- `state`: rows of eight lanes, what changes.

Laws are sorted, smooth ones first. A step computes ``rows``: the states; then of every law what tells a quiet car (elongation of
a smooth law, rate of a dry one); then of every law the other of the two.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

WIDTH = 8  # lanes of a group
TOGETHER = 4  # groups of cars that take turns step by step
#: ways through a step: every law is solved for; only those of lanes in which a smooth one acts; in closed form
GENERAL, QUIET, CONTACT = 0, 1, 2

#: what an observation shows beside the measured signals: nothing, the whole state, the road ahead
MEASURED, WHOLE, AHEAD = 0, 1, 2

# What a car of a batch carries beside its state: rows of `cars`, each a number a car.
CURRENT = 0  # commanded current [A]
LAGGED = 1  # state of the drive's lag [A]
ROUGH_GAIN = 2  # of the rough road [m]
ROUGH_POLE = 3
HEIGHT = 4  # of the road under the wheel [m]
HEIGHT_RATE = 5  # [m/s]
LAG_POLE = 6  # 0: no lag
SATURATION = 7  # [A]
DELAY = 8  # [physics steps]
ROUGH = 9  # height of the rough road [m]
TARGET = 10  # current that was asked for [A]
SIGNALS = 11  # outputs from here on

# What a control step says of a car: rows of `said`.
REWARD = 0
COST = 1  # four terms: acceleration, travel, tyre load, current
TYRE_LOAD = 5  # [N], finite even where the car broke
BROKEN = 6  # 1 where an observation left its bounds or is no number
SAID = 7  # rows

# Whole numbers of a car: rows of `ways`.
PROFILE = 0  # next place in the table of fixed profiles
PROFILE_END = 1
COUNTER = 2  # of the rough road's random numbers

# Numbers of a drive: `settings`.
CURRENT_LIMIT, SLEW_LIMIT = 0, 1  # [A], [A per control step]
WEIGHTS = 2  # factors on the squares of acceleration, travel, tyre load and current
BOUNDS = 6  # of the five measured signals
LIFTED = 11  # of every output, whether the road's height is to be taken off it in an observation


class Layout(NamedTuple):
    """Sizes, and where things begin: rows of `state`, numbers of `mats`."""

    # sizes, as they stand at the head of `ints`
    states: int
    inputs: int  # moved nodes, their derivatives and forces, as far as anything uses them
    currents: int
    laws: int
    smooth: int
    way: int  # GENERAL, QUIET or CONTACT
    outputs: int
    rows: int  # of a step, a multiple of four
    columns: int  # of the outputs' matrix
    differ: int  # 1 where the rate of any law is a difference of elongations
    parameters: int  # that a law may read
    instant: int  # 1 where friction or a current moves the terminals of a law at once: see `steps.outputs`
    # places in `ints`
    code: int  # >= 0 a smooth law, < 0 a dry one
    differs: int
    # rows of `state`: what a step reads, in the order of its matrix' columns
    start: int  # inputs at the start of the step
    end: int
    current: int
    last: int  # elongations of the laws at the start of the step, where `differ`
    force: int  # of the laws, at the start of the step; it depends on those of the smooth ones, the outputs on all
    # what a step makes of it before the forces at its end act
    step: int
    first: int  # of every law, what tells a quiet car
    other: int
    # of every law
    acting: int  # force that acts
    memory: int
    elongation: int
    rate: int
    factor: int  # of the secant
    tried: int  # force that was tried; of a dry law, its bound
    said: int  # what the law answered
    coming: int  # memory after it
    tried_rate: int
    failed: int  # number of the first step that was not solved (0: none), and its law
    scratch: int
    outcome: int  # outputs; where `instant`, then elongations and rates of all laws
    height: int  # rows in all
    # numbers of `mats`
    matrix: int
    step_columns: int
    gains: int  # what the force of a law at the end of the step adds to the rows
    spans: int  # |elongation| below which a smooth law rests
    upper: int  # contact in closed form: elongations at which the stop is met
    lower: int
    per_elongation: int  # its force, by what the elongation is beyond them, by the rate, by the friction
    per_rate: int
    per_friction: int
    level: int  # of the friction
    give: int  # friction that stops a rate, clear of the stop and on it
    give_stopped: int
    out: int  # matrix of the outputs
    out_rows: int
    own: int  # parameters of the laws
    size: int


def layout(ints: Any) -> Layout:
    """The `Layout` of `ints` (compiled code calls it, too)."""
    n, m, nc, nl, ns = ints[0], ints[1], ints[2], ints[3], ints[4]
    rows, columns, differ, parameters, instant = ints[7], ints[8], ints[9], ints[10], ints[11]
    start, end, current = n, n + m, n + 2 * m
    last = current + nc
    force = last + nl * differ
    step = force + nl
    step_columns = force + ns
    acting = step + rows
    failed = acting + 9 * nl
    scratch = failed + 2
    outcome = scratch + (nl * (nl + 4) + WIDTH - 1) // WIDTH
    ny = ints[6]
    out_rows = (ny + 2 * nl * instant + 3) // 4 * 4
    gains = 1 + rows * step_columns
    spans = gains + nl * rows
    upper = spans + ns
    out = upper + 8
    own = out + out_rows * columns
    return Layout(
        n, m, nc, nl, ns, ints[5], ny, rows, columns, differ, parameters, instant,
        12, 12 + nl,
        start, end, current, last, force,
        step, step + n, step + n + nl,
        acting, acting + nl, acting + 2 * nl, acting + 3 * nl, acting + 4 * nl, acting + 5 * nl, acting + 6 * nl,
        acting + 7 * nl, acting + 8 * nl, failed, scratch, outcome, outcome + out_rows,
        1, step_columns, gains, spans, upper, upper + 1, upper + 2, upper + 3, upper + 4, upper + 5, upper + 6, upper + 7,
        out, out_rows, own, own + nl * parameters,
    )  # fmt: skip


def aligned(*shape: int) -> np.ndarray:
    """Zeros that begin where eight lanes are one access to memory; twice as fast as where they are not."""
    count = int(np.prod(shape))
    raw = np.zeros(count + WIDTH)
    skip = -(raw.ctypes.data // raw.itemsize) % WIDTH
    return raw[skip : skip + count].reshape(shape)
