"""Place of each number of the kernel, by name; used by Python and by compiled code.

The numbers of a plant are three arrays:

- `ints`: the sizes, in the order of the first fields of `Layout`; then the code of every law; then for every
  law whether its rate is a difference of its elongations;
- `mats`: numbers that are constant in a step. Lanes with a common network share one pool. Otherwise a group
  of eight lanes has a pool with each number eight times in a row; the parameters of a law, which are read as
  an array, are contiguous for each lane;
- `state`: rows of eight lanes, the variable numbers.

Laws are sorted, smooth laws first. A step computes ``rows``: the states; then for every law the signal that
identifies a quiet car (elongation of a smooth law, rate of a dry law); then for every law the other signal.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..tracks import SUM_STATES, TRACK_STATES

WIDTH = 8  # lanes of a group
CLOSED = 8  # numbers of a device with a closed form of its contact
TOGETHER = 4  # groups of cars that alternate step by step
#: ways through a step: all laws are solved; laws are solved in lanes with an acting smooth law; closed form
GENERAL, QUIET, CONTACT = 0, 1, 2

#: content of an observation after the measured signals: nothing, the whole state, the road ahead
MEASURED, WHOLE, AHEAD = 0, 1, 2

# Sizes of a plant: the head of `ints`, the first fields of `Layout`.
(
    STATES,
    INPUTS,
    CURRENTS,
    LAWS,
    SMOOTH,
    WAY,
    OUTPUTS,
    ROWS,
    COLUMNS,
    DIFFER,
    PARAMETERS,
    INSTANT,
) = range(12)
SIZES = 12  # their number; the laws' codes follow

# integers of a batch of cars: head of `setup`
COUNT = 0  # number of cars
SUBSTEPS = 1  # physics steps per control step
IS_COMMANDED = 2  # whether the currents are commanded and limited, or given
DRIVE_ACTS = 3  # whether a drive has other effects than a held current
SHOWS = 4  # content of an observation: `MEASURED`, `WHOLE`, `AHEAD`
NOW = 5  # start of the next control step in the rings of the road ahead
KEPT = 6  # stored physics steps of the tracks, for the wheels behind the first axle
KEPT_NOW = 7  # place of the next physics step in the stored tracks
ALL = 8  # number of cars, including those that complete the last group
DEPTH = 9  # stored physics steps of currents, for the drives
SHAPE = 10  # place in `settings` of the value function of a shaped reward, see `cars.shape`; 0: no shaping
LINE = 11  # control steps of each track behind the first axle that the value function knows
TABLES = 12  # start of the tables of `CarsLayout`

#: measured signals of a corner: travel, its rate, device travel, its rate
CORNER_SIGNALS = 4
CURRENT_LIMIT, SLEW_LIMIT = 0, 1  # first two of `settings`: [A], [A per control step]
#: limits of Table 5 on the vertical acceleration of the body [m/s^2] and on the travel of a suspension [m]
ACCELERATION_LIMIT, TRAVEL_LIMIT = 5.0, 0.08
REWARD = 0  # first row of `results`


class CarSize(NamedTuple):
    """Numbers of parts of a car."""

    accelerations: int  # measured accelerations of the body: vertical, pitch, roll
    corners: int  # corners, each with a wheel and a suspension
    currents: int  # commanded currents
    tracks: int  # tracks of the road, 1 or 2

    @property
    def filters(self) -> int:
        """Number of first-order sections of the rough tracks."""
        return TRACK_STATES if self.tracks == 2 else 1

    @property
    def sum_filters(self) -> int:
        """Number of these sections for the only track, or for half the sum of left and right; the others belong
        to half the difference."""
        return SUM_STATES if self.tracks == 2 else 1


QUARTER_CAR = CarSize(accelerations=1, corners=1, currents=1, tracks=1)


class CarsLayout(NamedTuple):
    """Sizes of cars, and starts of their numbers in `setup` and `settings` and by row in `cars`, `ways` and `results`."""

    accelerations: int
    corners: int
    currents: int
    tracks: int
    filters: int
    sum_filters: int
    measured: int  # number of signals of the network in an observation, in the order of the outputs
    signals: int  # number of these signals and the tyre loads
    # places in `setup`
    columns: int  # for every corner, three columns of u for height, rate and acceleration of the road (-1: none)
    track: int  # of every corner
    behind: int  # for every corner, whether its track is delayed against the first axle
    leader: int  # for every track, its first corner
    current_of: int  # for every current of the network, the commanded current
    # rows of `cars`, one number per car
    current: int  # present currents [A]
    lagged: int  # states of the drives' lags [A]
    lag_pole: int  # 0: no lag
    saturation: int  # [A]
    delay: int  # of the drives [physics steps]
    target: int  # commanded currents [A]
    height: int  # of the road under each wheel [m]
    height_rate: int  # [m/s]
    late: int  # delay of a corner against the first axle [physics steps]
    gain: int  # of the filters [m]
    pole: int
    rough: int  # states of the filters [m]
    value: int  # value function after the last step [-]
    outputs: int  # from here on
    # rows of `ways`, one integer per car
    profile: int  # for every track, the next place in the table of fixed profiles
    profile_end: int
    counter: int  # counters of the random numbers of the only track, or of sum and difference
    # places in `settings`
    weights: (
        int  # factors on the squares of accelerations, travels, tyre loads and currents
    )
    bounds: int  # of the measured signals
    # for every output and corner, the share of the road's height that is subtracted in an observation
    lifted: int
    # rows of `results`, one number per car
    cost: int  # one term per acceleration, then travel, tyre load, current
    tyre_load: int  # [N], finite also for a broken car
    exceeds: int  # 1 where acceleration, then travel, is outside the limits of Table 5
    shaped: int  # shaped reward
    broken: int  # 1 for an observation outside its bounds or not finite
    results: int  # total number of rows


def _in_order(first: int, **sizes: int) -> dict[str, int]:
    """Return the start of each part; the parts follow one another from `first` on."""
    starts = {}
    for name, size in sizes.items():
        starts[name] = first
        first += size
    return starts


def cars_layout(size: CarSize) -> CarsLayout:
    """Return the places of the numbers of cars."""
    accelerations, corners, currents, tracks = size
    filters = size.filters
    measured = accelerations + CORNER_SIGNALS * corners
    setup = _in_order(
        TABLES,
        columns=3 * corners,
        track=corners,
        behind=corners,
        leader=tracks,
        current_of=currents,
    )
    cars = _in_order(
        0,
        current=currents,
        lagged=currents,
        lag_pole=currents,
        saturation=currents,
        delay=currents,
        target=currents,
        height=corners,
        height_rate=corners,
        late=corners,
        gain=filters,
        pole=filters,
        rough=filters,
        value=1,
        outputs=measured,
    )
    ways = _in_order(0, profile=tracks, profile_end=tracks, counter=tracks)
    settings = _in_order(
        2,
        weights=accelerations + 2 * corners + currents,
        bounds=measured,
        lifted=corners,
    )
    results = _in_order(
        REWARD + 1,
        cost=accelerations + 3,
        tyre_load=corners,
        exceeds=2,
        shaped=1,
        broken=1,
        results=0,
    )
    return CarsLayout(
        accelerations=accelerations,
        corners=corners,
        currents=currents,
        tracks=tracks,
        filters=filters,
        sum_filters=size.sum_filters,
        measured=measured,
        signals=measured + corners,
        **setup,
        **cars,
        **ways,
        **settings,
        **results,
    )


class Layout(NamedTuple):
    """Sizes, and starts of the parts: rows of `state`, numbers of `mats`."""

    # sizes, as they stand at the head of `ints`
    states: int
    inputs: int  # used inputs: moved nodes, their derivatives, and forces
    currents: int
    laws: int
    smooth: int
    way: int  # GENERAL, QUIET or CONTACT
    outputs: int
    rows: int  # rows of a step, a multiple of four
    columns: int  # columns of the outputs' matrix
    differ: int  # 1 if the rate of any law is a difference of elongations
    parameters: int  # largest number of parameters of a law
    instant: int  # 1 if friction or a current moves the terminals of a law instantly: see `steps.outputs`
    # places in `ints`
    code: int  # >= 0 for a smooth law, < 0 for a dry law
    differs: int
    # rows of `state`: inputs of a step, in the order of the columns of its matrix
    start: int  # inputs at the start of the step
    end: int
    current: int
    last: int  # elongations of the laws at the start of the step, for `differ`
    # forces of the laws at the start of the step; the step depends on the smooth laws, the outputs on all
    # laws
    force: int
    # results of the step before the forces at its end act
    step: int
    first: int  # for every law, the signal that identifies a quiet car
    other: int
    # numbers of every law
    acting: int  # acting force
    memory: int
    elongation: int
    rate: int
    factor: int  # factor of the secant step
    tried: int  # trial force; for a dry law, its bound
    answer: int  # force of the law
    coming: int  # next memory
    tried_rate: int
    failed: int  # number of the first unsolved step (0: none), and its law
    scratch: int
    outcome: int  # outputs; for `instant`, also elongations and rates of all laws
    height: int  # total number of rows
    # numbers of `mats`
    matrix: int
    step_columns: int
    gains: int  # contribution of a law's force at the end of the step to the rows
    spans: int  # |elongation| below which a smooth law is at rest
    # contact in closed form: stops and frictions with common terminals, `CLOSED` numbers per device
    devices: int
    upper: int  # elongations at which the stop is in contact
    lower: int
    per_elongation: int  # force of the stop per elongation beyond the limits, per rate, per friction
    per_rate: int
    per_friction: int
    level: int  # level of the friction
    give: int  # friction that stops a rate, without and with contact
    give_stopped: int
    out: int  # matrix of the outputs
    out_rows: int
    own: int  # parameters of the laws
    size: int


def layout(ints: Any) -> Layout:
    """Return the layout of `ints`; also called in compiled code."""
    states = ints[STATES]
    inputs = ints[INPUTS]
    laws = ints[LAWS]
    smooth = ints[SMOOTH]
    outputs = ints[OUTPUTS]
    rows = ints[ROWS]
    columns = ints[COLUMNS]
    differ = ints[DIFFER]
    parameters = ints[PARAMETERS]
    instant = ints[INSTANT]
    current = states + 2 * inputs
    last = current + ints[CURRENTS]
    force = last + laws * differ
    step = force + laws
    step_columns = force + smooth
    acting = step + rows
    failed = acting + 9 * laws
    scratch = failed + 2
    outcome = scratch + (laws * (laws + 4) + WIDTH - 1) // WIDTH
    out_rows = (outputs + 2 * laws * instant + 3) // 4 * 4
    gains = 1 + rows * step_columns
    spans = gains + laws * rows
    upper = spans + smooth
    devices = max(smooth, laws - smooth, 1)
    out = upper + CLOSED * devices
    own = out + out_rows * columns
    return Layout(
        states=states,
        inputs=inputs,
        currents=ints[CURRENTS],
        laws=laws,
        smooth=smooth,
        way=ints[WAY],
        outputs=outputs,
        rows=rows,
        columns=columns,
        differ=differ,
        parameters=parameters,
        instant=instant,
        code=SIZES,
        differs=SIZES + laws,
        start=states,
        end=states + inputs,
        current=current,
        last=last,
        force=force,
        step=step,
        first=step + states,
        other=step + states + laws,
        acting=acting,
        memory=acting + laws,
        elongation=acting + 2 * laws,
        rate=acting + 3 * laws,
        factor=acting + 4 * laws,
        tried=acting + 5 * laws,
        answer=acting + 6 * laws,
        coming=acting + 7 * laws,
        tried_rate=acting + 8 * laws,
        failed=failed,
        scratch=scratch,
        outcome=outcome,
        height=outcome + out_rows,
        matrix=1,
        step_columns=step_columns,
        gains=gains,
        spans=spans,
        devices=devices,
        upper=upper,
        lower=upper + 1,
        per_elongation=upper + 2,
        per_rate=upper + 3,
        per_friction=upper + 4,
        level=upper + 5,
        give=upper + 6,
        give_stopped=upper + 7,
        out=out,
        out_rows=out_rows,
        own=own,
        size=own + laws * parameters,
    )


def aligned(*shape: int) -> np.ndarray:
    """Return zeros that are aligned for eight lanes, which doubles the speed of memory access."""
    count = int(np.prod(shape))
    raw = np.zeros(count + WIDTH)
    skip = -(raw.ctypes.data // raw.itemsize) % WIDTH
    return raw[skip : skip + count].reshape(shape)
