"""Cars on their roads: a control step of all of them, with its drive, road, limits, reward and observation."""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from ..cost import squares
from .lanes import bits, load, noise, select, spread, store
from .layout import (
    AHEAD,
    BOUNDS,
    BROKEN,
    COST,
    COUNTER,
    CURRENT,
    CURRENT_LIMIT,
    DELAY,
    HEIGHT,
    HEIGHT_RATE,
    LAG_POLE,
    LAGGED,
    LIFTED,
    PROFILE,
    PROFILE_END,
    REWARD,
    ROUGH,
    ROUGH_GAIN,
    ROUGH_POLE,
    SATURATION,
    SIGNALS,
    SLEW_LIMIT,
    TARGET,
    TOGETHER,
    TYRE_LOAD,
    WEIGHTS,
    WHOLE,
    WIDTH,
    layout,
)
from .linear import U, clip
from .steps import march, outputs, pool_of

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # SplitMix64's step


def drive(
    mats, ints, states, cars, ways, table, past, rings, ahead, settings, said, seen_out, room, begin, stop
):
    """One control step of the groups of cars from `begin` to before `stop`; the number of cars that broke.

    ints[-9:] = cars, physics steps per control step, the columns of u that take the road's height, rate and acceleration
    (-1: none), whether the drive does more than hold its current, whether currents are asked for (and limited) or
    given, what an observation shows (`MEASURED`, `WHOLE`, `AHEAD`), and where the road drawn ahead begins now. `cars`,
    `ways`, `settings`: `layout`. table: the fixed profiles, one after another. past (currents kept, cars): newest first.
    rings (substeps, points, cars): the road drawn ahead, a ring for each physics step of a control step, and ahead
    (cars, points): the last of them, car by car. seen_out (cars, signals): the observations. said: `layout`. room: for the
    inputs of a control step.
    """
    flat, whole, drawn, told = cars.reshape(-1), ways.reshape(-1), rings.reshape(-1), said.reshape(-1)
    together = (
        1 if mats.shape[0] != layout(ints).size else TOGETHER
    )  # numbers of their own fill the processor's cache
    broken = 0
    for group in range(begin, stop, together):
        broken += control(
            mats, ints, states, flat, cars.shape[1], whole, table, past, drawn, ahead, settings, told, seen_out, room,
            group, min(group + together, stop),
        )  # fmt: skip
    return broken


def control(
    mats,
    ints,
    states,
    cars,
    wide,
    ways,
    table,
    past,
    rings,
    ahead,
    settings,
    said,
    seen_out,
    room,
    begin,
    stop,
):
    """One control step of a few groups of cars; arguments as `drive`'s, the rows of cars, ways and rings `wide`, flat.

    The groups take turns step by step: while one waits for its friction, the processor has the next one's sums to do.
    """
    at = layout(ints)
    substeps, asked, shows = ints[-8], ints[-3], ints[-2]
    own = mats.shape[0] != at.size
    nc, size = at.currents, at.height * WIDTH
    c_at = (substeps + 1) * at.inputs
    span = (c_at + substeps * nc) * WIDTH  # inputs of a group
    for group in range(begin, stop):
        first = group * WIDTH
        u = room[(group - begin) * span : (group - begin + 1) * span]
        count = min(WIDTH, ints[-9] - first)
        current = load(cars, CURRENT * wide + first)
        if asked:
            target = clip(load(cars, TARGET * wide + first), spread(settings[CURRENT_LIMIT]))
            current = current + clip(target - current, spread(settings[SLEW_LIMIT]))
            store(cars, CURRENT * wide + first, current)
        travel(ints, cars, ways, table, rings, ahead, u, mats[0], wide, first, count)
        for k in range(substeps * nc):
            if ints[-4]:  # the drive does more than hold its current
                for l in range(count):
                    u[(c_at + k) * WIDTH + l] = driven(cars, past, wide, first + l)
            else:
                store(u, (c_at + k) * WIDTH, current)
    for k in range(substeps):
        for group in range(begin, stop):
            u = room[(group - begin) * span : (group - begin + 1) * span]
            pool, state = pool_of(mats, own, at, group), states[group * size : (group + 1) * size]
            count = min(WIDTH, ints[-9] - group * WIDTH)
            march(pool, own, at, ints, state, u, u[c_at * WIDTH :], k, k, 1, WIDTH, 0, count, k + 1)
    broken = 0
    for group in range(begin, stop):
        first = group * WIDTH
        count = min(WIDTH, ints[-9] - first)
        pool, state = pool_of(mats, own, at, group), states[group * size : (group + 1) * size]
        outputs(pool, own, at, ints, state, count)
        broken += judge(at, state, cars, settings, said, wide, first, count)
        for l in range(count):
            for j in range(5):
                seen_out[first + l, j] = state[U((at.outcome + j) * WIDTH + l)]
            seen_out[first + l, 5] = cars[U(CURRENT * wide + first + l)]
        if shows == WHOLE:
            for l in range(count):
                height = cars[U(HEIGHT * wide + first + l)]
                for j in range(6, seen_out.shape[1]):
                    lift = settings[U(LIFTED + j)] * height
                    seen_out[first + l, j] = state[U((at.outcome + j) * WIDTH + l)] - lift
        elif shows == AHEAD:
            look(ahead, (ints[-1] + 1) % max(ahead.shape[1], 1), cars, wide, first, count, seen_out)
    return broken


def travel(ints, cars, ways, table, rings, ahead, u, h, wide, first, count):
    """The road under a group in the physics steps of a control step, into u (substeps + 1, m, lanes)."""
    m, substeps, now = ints[1], ints[-8], ints[-1]
    col_r, col_v, col_a = ints[-7], ints[-6], ints[-5]
    points = ahead.shape[1]
    height, rate = load(cars, HEIGHT * wide + first), load(cars, HEIGHT_RATE * wide + first)
    rough = load(cars, ROUGH * wide + first)
    gain, pole = load(cars, ROUGH_GAIN * wide + first), load(cars, ROUGH_POLE * wide + first)
    if col_r >= 0:
        store(u, col_r * WIDTH, height)
    if col_v >= 0:
        store(u, col_v * WIDTH, rate)
    if col_a >= 0:
        store(u, col_a * WIDTH, spread(0.0))
    for k in range(substeps):
        rough = pole * rough + gain * noise(ways, COUNTER * wide + first, 1)
        new = rough
        row = (k + 1) * m
        if table.shape[0] > 0:
            scratch = row * WIDTH
            store(u, scratch, new)
            for l in range(count):
                place, end = PROFILE * wide + first + l, PROFILE_END * wide + first + l
                if ways[place] < ways[end]:
                    u[scratch + l] += table[ways[place]]
                    ways[place] += 1
                elif ways[end] > 0:
                    u[scratch + l] += table[ways[end] - 1]
            new = load(u, scratch)
        if points > 0:
            place = (k * points + now) * wide + first
            here = load(rings, place)
            store(rings, place, new)
            if k == substeps - 1:
                for l in range(count):
                    ahead[first + l, now] = rings[U(place + l)]
            new = here
        if col_r >= 0:
            store(u, (row + col_r) * WIDTH, new)
        if col_v >= 0 or col_a >= 0:
            v = (new - height) / h
            if col_v >= 0:
                store(u, (row + col_v) * WIDTH, v)
            if col_a >= 0:
                store(u, (row + col_a) * WIDTH, (v - rate) / h)
            rate = v
        height = new
    store(cars, HEIGHT * wide + first, height)
    store(cars, HEIGHT_RATE * wide + first, rate)
    store(cars, ROUGH * wide + first, rough)


def look(ahead, begin, cars, wide, first, count, seen_out):
    """The road ahead of a group, relative to the height under the wheel, behind its measured signals."""
    points, shown = ahead.shape[1], seen_out.shape[1] - 6
    before = min(points - begin, shown)
    for l in range(count):
        e = first + l
        height, row, to = cars[HEIGHT * wide + e], ahead[e], seen_out[e]
        near, far = to[6 : 6 + before], to[6 + before : 6 + shown]
        source = row[begin : begin + before]
        for i in range(before):
            near[i] = source[i] - height
        for i in range(shown - before):
            far[i] = row[i] - height


def judge(at, state, cars, settings, said, wide, first, count):
    """Signals, costs and reward of a group after its control step; the number of cars that broke in it.

    A broken car's cost is that of the bounds it left.
    """
    for i in range(at.outputs):
        store(cars, (SIGNALS + i) * wide + first, load(state, (at.outcome + i) * WIDTH))
    good = spread(0.0) < spread(1.0)
    for j in range(5):
        good = good & (abs(load(state, (at.outcome + j) * WIDTH)) <= settings[U(BOUNDS + j)])
    a, l, tyre = (
        load(state, at.outcome * WIDTH),
        load(state, (at.outcome + 1) * WIDTH),
        load(state, (at.outcome + 5) * WIDTH),
    )
    everyone = (1 << count) - 1
    wrong = ~bits(good) & everyone
    if wrong:
        a = select(abs(a) <= settings[BOUNDS], a, spread(settings[BOUNDS]))
        l = select(abs(l) <= settings[BOUNDS + 1], l, spread(settings[BOUNDS + 1]))
        tyre = select(abs(tyre) < math.inf, tyre, spread(0.0))
        store(cars, (SIGNALS + 5) * wide + first, tyre)
    i = load(cars, CURRENT * wide + first)
    by_a, by_l, by_f, by_i = squares(
        settings[WEIGHTS], settings[WEIGHTS + 1], settings[WEIGHTS + 2], settings[WEIGHTS + 3], a, l, tyre, i
    )
    store(said, REWARD * wide + first, -(by_a + by_l + by_f + by_i))
    store(said, COST * wide + first, by_a)
    store(said, (COST + 1) * wide + first, by_l)
    store(said, (COST + 2) * wide + first, by_f)
    store(said, (COST + 3) * wide + first, by_i)
    store(said, TYRE_LOAD * wide + first, tyre)
    store(said, BROKEN * wide + first, select(good, spread(0.0), spread(1.0)))
    number_wrong = 0
    while wrong:
        number_wrong += wrong & 1
        wrong >>= 1
    return number_wrong


def driven(cars, past, wide, e):
    """Current [A] of car e in the next physics step, after its drive's delay, lag and saturation."""
    i, depth = cars[CURRENT * wide + e], past.shape[0]
    if depth > 0:
        for k in range(depth - 1, 0, -1):
            past[k, e] = past[k - 1, e]
        past[0, e] = i
        back = cars[DELAY * wide + e]
        low = int(back)
        part = back - low
        i = past[low, e] if part == 0.0 else ((1.0 - part) * past[low, e] + part * past[low + 1, e])
    pole, most = cars[LAG_POLE * wide + e], cars[SATURATION * wide + e]
    if pole > 0.0:
        # mean over the step of the first-order lag, exact
        was = cars[LAGGED * wide + e]
        cars[LAGGED * wide + e] = i + (was - i) * pole
        i = i + (was - i) * (1.0 - pole) / -math.log(pole)
    if most < 1e8:
        i = most * math.tanh(i / most)
    return i


@nb.njit(error_model="numpy", cache=True)
def road_noise(seed, gain, pole, start, out):
    """Fill `out` with the rough road of one car [m], continuing from counter `seed` and height `start`."""
    r = start
    counters, drawn = np.empty(WIDTH, np.int64), np.empty(WIDTH)
    for l in range(WIDTH):  # `noise` moves them on before it draws
        counters[l] = np.int64(np.uint64(seed) + np.uint64(l + 1) * _GOLDEN - np.uint64(WIDTH) * _GOLDEN)
    for k in range(0, out.shape[0], WIDTH):
        store(drawn, 0, noise(counters, 0, WIDTH))
        for l in range(min(WIDTH, out.shape[0] - k)):
            r = pole * r + gain * drawn[l]
            out[k + l] = r
    return np.uint64(seed) + np.uint64(out.shape[0]) * _GOLDEN
