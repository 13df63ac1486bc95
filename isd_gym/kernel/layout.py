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

from ..tracks import SUM_STATES, TRACK_STATES

WIDTH = 8  # lanes of a group
CLOSED = 8  # numbers of a device whose contact has a closed form
TOGETHER = 4  # groups of cars that take turns step by step
#: ways through a step: every law is solved for; only those of lanes in which a smooth one acts; in closed form
GENERAL, QUIET, CONTACT = 0, 1, 2

#: what an observation shows beside the measured signals: nothing, the whole state, the road ahead
MEASURED, WHOLE, AHEAD = 0, 1, 2

# Sizes of a plant: the head of `ints`, the first fields of `Layout`.
STATES, INPUTS, CURRENTS, LAWS, SMOOTH, WAY, OUTPUTS, ROWS, COLUMNS, DIFFER, PARAMETERS, INSTANT = range(12)
SIZES = 12  # their number; the laws' codes follow

# Whole numbers of a batch of cars: the head of `setup`.
COUNT = 0  # cars
SUBSTEPS = 1  # physics steps of a control step
IS_COMMANDED = 2  # whether the currents are commanded, and limited, or given
DRIVE_ACTS = 3  # whether a drive does more than hold its current
SHOWS = 4  # what an observation shows: `MEASURED`, `WHOLE`, `AHEAD`
NOW = 5  # place in the rings of the road ahead where the next control step begins
KEPT = 6  # physics steps of the tracks' past that are kept for the wheels behind the first axle
KEPT_NOW = 7  # place in that past where the next physics step goes
ALL = 8  # cars, those that fill up the last group included
DEPTH = 9  # physics steps of past currents that are kept for the drives
TABLES = 10  # from here on: the tables of `CarsLayout`

#: measured signals of a corner: travel, its rate, device travel, its rate
CORNER_SIGNALS = 4
CURRENT_LIMIT, SLEW_LIMIT = 0, 1  # first two of `settings`: [A], [A per control step]
REWARD = 0  # first row of `said`


class CarSize(NamedTuple):
    """Numbers of parts of a car."""

    accelerations: int  # motions of the body that are measured: vertical, pitch, roll
    corners: int  # wheels, each with a suspension of its own
    currents: int  # that are commanded
    tracks: int  # of the road, 1 or 2

    @property
    def filters(self) -> int:
        """First-order sections whose sums are the rough tracks."""
        return TRACK_STATES if self.tracks == 2 else 1

    @property
    def sum_filters(self) -> int:
        """Of these, those of the only track, or of half the sum of left and right; the others: half the difference."""
        return SUM_STATES if self.tracks == 2 else 1


QUARTER_CAR = CarSize(accelerations=1, corners=1, currents=1, tracks=1)


class CarsLayout(NamedTuple):
    """Sizes of cars, and where their numbers begin: in `setup` and `settings`, and by row in `cars`, `ways` and `said`."""

    accelerations: int
    corners: int
    currents: int
    tracks: int
    filters: int
    sum_filters: int
    measured: int  # signals of the network that an observation shows, in the order of the outputs
    signals: int  # these and the tyre loads
    # places in `setup`
    columns: (
        int  # of every corner three: columns of u that take the road's height, rate, acceleration (-1: none)
    )
    track: int  # of every corner
    behind: int  # of every corner, whether it meets its track later than the first axle
    leader: int  # of every track, the corner that meets it first
    current_of: int  # of every current of the network, which of those commanded
    # rows of `cars`, a number a car
    current: int  # present currents [A]
    lagged: int  # states of the drives' lags [A]
    lag_pole: int  # 0: no lag
    saturation: int  # [A]
    delay: int  # of the drives [physics steps]
    target: int  # commanded currents [A]
    height: int  # of the road under each wheel [m]
    height_rate: int  # [m/s]
    late: int  # by how much a corner is behind the first axle [physics steps]
    gain: int  # of the filters [m]
    pole: int
    rough: int  # states of the filters [m]
    outputs: int  # from here on
    # rows of `ways`, a whole number a car
    profile: int  # of every track, next place in the table of fixed profiles
    profile_end: int
    counter: int  # of the random numbers that drive the only track, or the sum and the difference
    # places in `settings`
    weights: int  # factors on the squares of accelerations, travels, tyre loads and currents
    bounds: int  # of the measured signals
    lifted: int  # of every output and corner, the share of the road's height that an observation takes off it
    # rows of `said`, a number a car
    cost: int  # a term for each acceleration, then travel, tyre load, current
    tyre_load: int  # [N], finite even where the car broke
    broken: int  # 1 where an observation left its bounds or is no number
    said: int  # rows in all


def cars_layout(size: CarSize) -> CarsLayout:
    """Return the places of the numbers of cars.

    Args:
        size: Numbers of parts of a car.
    """
    na, corners, nc, tracks = size
    filters = size.filters
    track = TABLES + 3 * corners
    leader = track + 2 * corners
    height = 6 * nc
    gain = height + 3 * corners
    measured = na + CORNER_SIGNALS * corners
    bounds = 2 + na + 2 * corners + nc
    return CarsLayout(
        na, corners, nc, tracks, filters, size.sum_filters, measured, measured + corners,
        TABLES, track, track + corners, leader, leader + tracks,
        0, nc, 2 * nc, 3 * nc, 4 * nc, 5 * nc, height, height + corners, height + 2 * corners,
        gain, gain + filters, gain + 2 * filters, gain + 3 * filters,
        0, tracks, 2 * tracks,
        2, bounds, bounds + measured,
        REWARD + 1, na + 4, na + 4 + corners, na + 5 + corners,
    )  # fmt: skip


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
    devices: int  # contact in closed form: stops and frictions that share terminals; for each of them `CLOSED` numbers:
    upper: int  # elongations at which the stop is met
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
    n, m, nc, nl, ns = ints[STATES], ints[INPUTS], ints[CURRENTS], ints[LAWS], ints[SMOOTH]
    rows, columns, differ, parameters, instant = (
        ints[ROWS], ints[COLUMNS], ints[DIFFER], ints[PARAMETERS], ints[INSTANT],
    )  # fmt: skip
    start, end, current = n, n + m, n + 2 * m
    last = current + nc
    force = last + nl * differ
    step = force + nl
    step_columns = force + ns
    acting = step + rows
    failed = acting + 9 * nl
    scratch = failed + 2
    outcome = scratch + (nl * (nl + 4) + WIDTH - 1) // WIDTH
    ny = ints[OUTPUTS]
    out_rows = (ny + 2 * nl * instant + 3) // 4 * 4
    gains = 1 + rows * step_columns
    spans = gains + nl * rows
    upper = spans + ns
    devices = max(ns, nl - ns, 1)
    out = upper + CLOSED * devices
    own = out + out_rows * columns
    return Layout(
        n, m, nc, nl, ns, ints[WAY], ny, rows, columns, differ, parameters, instant,
        SIZES, SIZES + nl,
        start, end, current, last, force,
        step, step + n, step + n + nl,
        acting, acting + nl, acting + 2 * nl, acting + 3 * nl, acting + 4 * nl, acting + 5 * nl, acting + 6 * nl,
        acting + 7 * nl, acting + 8 * nl, failed, scratch, outcome, outcome + out_rows,
        1, step_columns, gains, spans, devices, upper, upper + 1, upper + 2, upper + 3, upper + 4, upper + 5, upper + 6, upper + 7,
        out, out_rows, own, own + nl * parameters,
    )  # fmt: skip


def aligned(*shape: int) -> np.ndarray:
    """Zeros that begin where eight lanes are one access to memory; twice as fast as where they are not."""
    count = int(np.prod(shape))
    raw = np.zeros(count + WIDTH)
    skip = -(raw.ctypes.data // raw.itemsize) % WIDTH
    return raw[skip : skip + count].reshape(shape)
