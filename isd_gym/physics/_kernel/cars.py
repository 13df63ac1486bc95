"""Cars on their roads: a control step of many cars, with drives, roads, limits, rewards and observations."""

from __future__ import annotations

import math

import numpy as np

from ..._common.jit import compiled
from ..cost import square
from .lanes import bits, fused, load, noise, select, some, spread, store
from .layout import (
    ACCELERATION_LIMIT,
    AHEAD,
    ALL,
    COUNT,
    CURRENT_LIMIT,
    DEPTH,
    DRIVE_ACTS,
    IS_COMMANDED,
    KEPT,
    KEPT_NOW,
    LINE,
    NOW,
    QUARTER_CAR,
    REWARD,
    SHAPE,
    SHOWS,
    SLEW_LIMIT,
    SUBSTEPS,
    TOGETHER,
    TRAVEL_LIMIT,
    WHOLE,
    WIDTH,
    cars_layout,
    layout,
)
from .linear import U, clip
from .steps import march, outputs, pool_of

#: sizes and places of the numbers of a car: constants of the code, which is compiled for each kind of car
CAR = cars_layout(QUARTER_CAR)
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # increment of SplitMix64


def drive(
    mats,
    ints,
    states,
    cars,
    ways,
    table,
    past,
    rings,
    ahead,
    history,
    settings,
    results,
    seen_out,
    room,
    begin,
    stop,
):
    """Run one control step of the groups of cars from `begin` to `stop` - 1.

    Arrays without a stated shape are flat, which saves the kernel a conversion.

    Args:
        mats: Numbers of the plant (`layout`).
        ints: Sizes of the plant, then `setup` of the batch (`layout`, as are cars, ways, settings and results).
        states: States of the groups.
        cars: Numbers of the cars, row by row.
        ways: Integers of the cars, row by row.
        table: Fixed profiles, one after another [m].
        past: Currents that the drives have not reached yet (steps, currents, cars), newest first [A].
        rings: Tracks drawn ahead (tracks, substeps, points, cars), one ring per physics step of a control
            step [m].
        ahead: Last ring of each track (cars, tracks * points), car by car [m].
        history: Tracks behind the first axle (groups, tracks, `KEPT`, 8) [m].
        settings: Numbers common to all cars.
        results: Reward, costs and tyre loads, row by row.
        seen_out: Observations (cars, signals).
        room: Memory for the inputs of a control step.
        begin: First group.
        stop: End of the groups (exclusive).
    """
    at = layout(ints)
    setup = ints[at.differs + at.laws :]
    wide = setup[ALL]
    substeps, shows = setup[SUBSTEPS], setup[SHOWS]
    own = mats.shape[0] != at.size
    nc, size = at.currents, at.height * WIDTH
    c_at = (substeps + 1) * at.inputs
    road_at = c_at + substeps * nc
    shape_at = road_at + substeps * (2 + CAR.tracks)
    shape_size = (
        shape_rows(at.states, CAR.tracks, CAR.currents, setup[LINE], substeps)
        if setup[SHAPE]
        else 0
    )
    span = (shape_at + shape_size) * WIDTH  # memory of a group
    together = 1 if own else TOGETHER
    broken = 0
    for head in range(begin, stop, together):
        # these groups take turns step by step: while one waits for its friction, the processor has the next one's sums to do
        tail = min(head + together, stop)
        for group in range(head, tail):
            first = group * WIDTH
            u = room[(group - head) * span : (group - head + 1) * span]
            count = min(WIDTH, setup[COUNT] - first)
            if setup[IS_COMMANDED]:
                for j in range(CAR.currents):
                    current = load(cars, (CAR.current + j) * wide + first)
                    target = clip(
                        load(cars, (CAR.target + j) * wide + first),
                        spread(settings[CURRENT_LIMIT]),
                    )
                    current = current + clip(
                        target - current, spread(settings[SLEW_LIMIT])
                    )
                    store(cars, (CAR.current + j) * wide + first, current)
            tracks_at = ground(
                setup,
                cars,
                ways,
                table,
                rings,
                ahead,
                settings,
                u,
                road_at,
                wide,
                first,
                count,
            )
            if setup[SHAPE]:
                state = states[group * size : (group + 1) * size]
                points = ahead.shape[1] // CAR.tracks
                foresee(
                    setup,
                    at,
                    state,
                    cars,
                    ways,
                    history,
                    settings,
                    u,
                    shape_at,
                    wide,
                    group,
                    points,
                )
            wheels(
                setup,
                at.inputs,
                cars,
                history,
                u,
                tracks_at,
                mats[0],
                wide,
                group,
                count,
            )
            for j in range(nc):
                row = setup[CAR.current_of + j]
                if setup[DRIVE_ACTS]:
                    for k in range(substeps):
                        for l in range(count):
                            u[(c_at + k * nc + j) * WIDTH + l] = driven(
                                cars, past, setup[DEPTH], row, wide, first + l
                            )
                else:
                    current = load(cars, (CAR.current + row) * wide + first)
                    for k in range(substeps):
                        store(u, (c_at + k * nc + j) * WIDTH, current)
        for k in range(substeps):
            for group in range(head, tail):
                u = room[(group - head) * span : (group - head + 1) * span]
                pool, state = (
                    pool_of(mats, own, at, group),
                    states[group * size : (group + 1) * size],
                )
                count = min(WIDTH, setup[COUNT] - group * WIDTH)
                march(
                    pool,
                    own,
                    at,
                    ints,
                    state,
                    u,
                    u[c_at * WIDTH :],
                    k,
                    k,
                    1,
                    WIDTH,
                    0,
                    count,
                    k + 1,
                )
        for group in range(head, tail):
            first = group * WIDTH
            count = min(WIDTH, setup[COUNT] - first)
            pool, state = (
                pool_of(mats, own, at, group),
                states[group * size : (group + 1) * size],
            )
            outputs(pool, own, at, ints, state, count)
            broken += record_outcome(
                at, state, cars, settings, results, wide, first, count
            )
            if setup[SHAPE]:
                u = room[(group - head) * span : (group - head + 1) * span]
                shape(
                    setup,
                    at,
                    state,
                    cars,
                    history,
                    settings,
                    results,
                    u,
                    shape_at,
                    wide,
                    group,
                )
            for l in range(count):
                for j in range(CAR.measured):
                    seen_out[first + l, j] = state[U((at.outcome + j) * WIDTH + l)]
                for j in range(CAR.currents):
                    seen_out[first + l, CAR.measured + j] = cars[
                        U((CAR.current + j) * wide + first + l)
                    ]
            if shows == WHOLE:
                show_state(at, state, cars, settings, wide, first, count, seen_out)
            elif shows == AHEAD:
                for track in range(CAR.tracks):
                    look(setup, ahead, track, cars, wide, first, count, seen_out)
    return broken


def ground(
    setup, cars, ways, table, rings, ahead, settings, u, room_at, wide, first, count
):
    """Write the tracks of a group in the physics steps of a control step at the first axle into u (.., 8) from row `room_at`.

    Each track has one height per physics step. Return the first row of the tracks.
    """
    substeps, now = setup[SUBSTEPS], setup[NOW]
    points = ahead.shape[1] // CAR.tracks
    tracks_at = room_at + substeps
    begin = 0
    for t in range(
        CAR.tracks
    ):  # the only track, or half the sum and half the difference of left and right
        end, track_at = (
            CAR.sum_filters if t == 0 else CAR.filters,
            tracks_at + t * substeps,
        )
        for k in range(substeps):
            store(
                u,
                (room_at + k) * WIDTH,
                noise(ways, (CAR.counter + t) * wide + first, 1),
            )
        for i in range(begin, end):
            rough = load(cars, (CAR.rough + i) * wide + first)
            gain, pole = (
                load(cars, (CAR.gain + i) * wide + first),
                load(cars, (CAR.pole + i) * wide + first),
            )
            for k in range(substeps):
                rough = pole * rough + gain * load(u, (room_at + k) * WIDTH)
                place = (track_at + k) * WIDTH
                store(u, place, rough if i == begin else load(u, place) + rough)
            store(cars, (CAR.rough + i) * wide + first, rough)
        begin = end
    if CAR.tracks == 2:
        for k in range(substeps):
            left, right = (tracks_at + k) * WIDTH, (tracks_at + substeps + k) * WIDTH
            common, opposite = load(u, left), load(u, right)
            store(u, left, common + opposite)
            store(u, right, common - opposite)
    for t in range(CAR.tracks):
        track_at = tracks_at + t * substeps
        if table.shape[0] > 0:
            for l in range(count):
                place, end = (
                    (CAR.profile + t) * wide + first + l,
                    (CAR.profile_end + t) * wide + first + l,
                )
                for k in range(substeps):
                    if ways[place] < ways[end]:
                        u[(track_at + k) * WIDTH + l] += table[ways[place]]
                        ways[place] += 1
                    elif ways[end] > 0:
                        u[(track_at + k) * WIDTH + l] += table[ways[end] - 1]
        if points > 0:
            for k in range(substeps):
                place = ((t * substeps + k) * points + now) * wide + first
                here = load(rings, place)
                store(rings, place, load(u, (track_at + k) * WIDTH))
                if k == substeps - 1:
                    for l in range(count):
                        ahead[first + l, t * points + now] = rings[U(place + l)]
                store(u, (track_at + k) * WIDTH, here)
    return tracks_at


def wheels(setup, inputs, cars, history, u, tracks_at, h, wide, group, count):
    """Write the road under the wheels of a group in the physics steps of a control step into u (substeps + 1, inputs, lanes).

    A wheel behind the first axle meets the height of the first axle `late` steps before, linear between two
    steps.
    """
    substeps, kept, now, first = (
        setup[SUBSTEPS],
        setup[KEPT],
        setup[KEPT_NOW],
        group * WIDTH,
    )
    if kept > 0:
        for t in range(CAR.tracks):
            place, passed = now, (group * CAR.tracks + t) * kept
            for k in range(substeps):
                store(
                    history,
                    (passed + place) * WIDTH,
                    load(u, (tracks_at + t * substeps + k) * WIDTH),
                )
                place = place + 1 if place + 1 < kept else 0
    for c in range(CAR.corners):
        track, row = setup[CAR.track + c], 3 * c + CAR.columns
        col_r, col_v, col_a = setup[row], setup[row + 1], setup[row + 2]
        met_at = tracks_at + track * substeps
        if setup[CAR.behind + c]:
            met_at = tracks_at + CAR.tracks * substeps
            meet_again(
                history,
                cars,
                (CAR.late + c) * wide + first,
                (group * CAR.tracks + track) * kept,
                kept,
                now,
                u,
                met_at,
                substeps,
                count,
            )
        height = load(cars, (CAR.height + c) * wide + first)
        rate = load(cars, (CAR.height_rate + c) * wide + first)
        if col_r >= 0:
            store(u, col_r * WIDTH, height)
        if col_v >= 0:
            store(u, col_v * WIDTH, rate)
        if col_a >= 0:
            store(u, col_a * WIDTH, spread(0.0))
        for k in range(substeps):
            new = load(u, (met_at + k) * WIDTH)
            to = (k + 1) * inputs
            if col_r >= 0:
                store(u, (to + col_r) * WIDTH, new)
            if col_v >= 0 or col_a >= 0:
                v = (new - height) / h
                if col_v >= 0:
                    store(u, (to + col_v) * WIDTH, v)
                if col_a >= 0:
                    store(u, (to + col_a) * WIDTH, (v - rate) / h)
                rate = v
            height = new
        store(cars, (CAR.height + c) * wide + first, height)
        store(cars, (CAR.height_rate + c) * wide + first, rate)


def meet_again(history, cars, late_at, passed, kept, now, u, met_at, substeps, count):
    """Write the heights at a wheel behind the first axle in the physics steps of a control step into u from row `met_at`."""
    late = load(cars, late_at)
    first = cars[late_at]
    if count == WIDTH and not some(late != first):  # all lanes at once
        back = int(first)
        part = first - back
        place = now - back if now >= back else now - back + kept
        older = load(history, (passed + (place - 1 if place > 0 else kept - 1)) * WIDTH)
        for k in range(substeps):
            newer = load(history, (passed + place) * WIDTH)
            store(u, (met_at + k) * WIDTH, (1.0 - part) * newer + part * older)
            older = newer
            place = place + 1 if place + 1 < kept else 0
    else:
        for l in range(count):
            lane = cars[late_at + l]
            back = int(lane)
            part = lane - back
            place = now - back if now >= back else now - back + kept
            older = history[
                (passed + (place - 1 if place > 0 else kept - 1)) * WIDTH + l
            ]
            for k in range(substeps):
                newer = history[(passed + place) * WIDTH + l]
                u[(met_at + k) * WIDTH + l] = (1.0 - part) * newer + part * older
                older = newer
                place = place + 1 if place + 1 < kept else 0


def show_state(at, state, cars, settings, wide, first, count, seen_out):
    """Write displacements over the road and the other outputs after the measured signals of an observation."""
    begin = CAR.measured + CAR.currents
    for l in range(count):
        for j in range(begin, seen_out.shape[1]):
            i = CAR.signals + j - begin
            value = state[U((at.outcome + i) * WIDTH + l)]
            for c in range(CAR.corners):
                height = cars[U((CAR.height + c) * wide + first + l)]
                value -= settings[U(CAR.lifted + i * CAR.corners + c)] * height
            seen_out[first + l, j] = value


def look(setup, ahead, track, cars, wide, first, count, seen_out):
    """Write a track ahead of a group, relative to the height under its first wheel, after the measured signals."""
    points = ahead.shape[1] // CAR.tracks
    shown = (seen_out.shape[1] - CAR.measured - CAR.currents) // CAR.tracks
    begin = (setup[NOW] + 1) % max(points, 1)
    before = min(points - begin, shown)
    height_at = (CAR.height + setup[CAR.leader + track]) * wide + first
    to = CAR.measured + CAR.currents + track * shown
    for l in range(count):
        e = first + l
        height, row = (
            cars[U(height_at + l)],
            ahead[e, track * points : (track + 1) * points],
        )
        near, far = seen_out[e, to : to + before], seen_out[e, to + before : to + shown]
        source = row[begin : begin + before]
        for i in range(before):
            near[i] = source[i] - height
        for i in range(shown - before):
            far[i] = row[i] - height


def record_outcome(at, state, cars, settings, results, wide, first, count):
    """Write signals, costs and reward of a group after its control step, and return the number of cars that broke.

    The cost of a broken car is the cost at the violated bounds.
    """
    for i in range(at.outputs):
        store(
            cars,
            (CAR.outputs + i) * wide + first,
            load(state, (at.outcome + i) * WIDTH),
        )
    good = spread(0.0) < spread(1.0)
    for j in range(CAR.measured):
        good = good & (
            abs(load(state, (at.outcome + j) * WIDTH)) <= settings[U(CAR.bounds + j)]
        )
    everyone = (1 << count) - 1
    wrong = ~bits(good) & everyone
    weight, cost = CAR.weights, CAR.cost
    total, term = spread(0.0), spread(0.0)
    for j in range(CAR.accelerations):
        x = load(state, (at.outcome + j) * WIDTH)
        if wrong:
            x = select(
                abs(x) <= settings[CAR.bounds + j], x, spread(settings[CAR.bounds + j])
            )
        term = square(settings[weight + j], x)
        total = total + term
        store(results, (cost + j) * wide + first, term)
        if j == 0:
            beyond = select(
                spread(ACCELERATION_LIMIT) < abs(x), spread(1.0), spread(0.0)
            )
            store(results, CAR.exceeds * wide + first, beyond)
    weight, cost = weight + CAR.accelerations, cost + CAR.accelerations
    term, beyond = spread(0.0), spread(0.0)
    for c in range(CAR.corners):
        j = CAR.accelerations + 4 * c
        x = load(state, (at.outcome + j) * WIDTH)
        if wrong:
            x = select(
                abs(x) <= settings[CAR.bounds + j], x, spread(settings[CAR.bounds + j])
            )
        term = term + square(settings[weight + c], x)
        beyond = select(spread(TRAVEL_LIMIT) < abs(x), spread(1.0), beyond)
    total = total + term
    store(results, cost * wide + first, term)
    store(results, (CAR.exceeds + 1) * wide + first, beyond)
    weight += CAR.corners
    term = spread(0.0)
    for c in range(CAR.corners):
        x = load(state, (at.outcome + CAR.measured + c) * WIDTH)
        if wrong:
            x = select(abs(x) < math.inf, x, spread(0.0))
            store(cars, (CAR.outputs + CAR.measured + c) * wide + first, x)
        term = term + square(settings[weight + c], x)
        store(results, (CAR.tyre_load + c) * wide + first, x)
    total = total + term
    store(results, (cost + 1) * wide + first, term)
    weight += CAR.corners
    term = spread(0.0)
    for j in range(CAR.currents):
        term = term + square(
            settings[weight + j], load(cars, (CAR.current + j) * wide + first)
        )
    total = total + term
    store(results, (cost + 2) * wide + first, term)
    store(results, REWARD * wide + first, -total)
    store(results, CAR.broken * wide + first, select(good, spread(0.0), spread(1.0)))
    number_wrong = 0
    while wrong:
        number_wrong += wrong & 1
        wrong >>= 1
    return number_wrong


def shape_rows(states, tracks, currents, line, substeps):
    """Return the rows of the state of the value function and of the news of the road of a control step."""
    return states + tracks * line + currents + (tracks + 1) * substeps


def foresee(
    setup, at, state, cars, ways, history, settings, u, x_at, wide, group, points
):
    """Add the value of the news of the road in a control step to the value of the state before the step.

    The news are the rises of the tracks in the physics steps, less their expectations before the control step. The noise
    is drawn again from the counters, since a road with a preview was drawn earlier.
    """
    substeps, first = setup[SUBSTEPS], group * WIDTH
    size = car_state(
        setup, at, state, cars, history, settings, u, x_at, wide, group, setup[KEPT_NOW]
    )
    news_at, news = x_at + size, CAR.tracks * substeps
    noise_at = news_at + news
    begin = 0
    for t in range(CAR.tracks):
        end, counter = (
            CAR.sum_filters if t == 0 else CAR.filters,
            (CAR.counter + t) * wide + first,
        )
        for k in range(substeps):
            back = points * substeps + substeps - 1 - k
            store(u, (noise_at + k) * WIDTH, noise(ways, counter, -back))
            noise(ways, counter, back)
            store(u, (news_at + t * substeps + k) * WIDTH, spread(0.0))
        for i in range(begin, end):
            gain, pole = (
                load(cars, (CAR.gain + i) * wide + first),
                load(cars, (CAR.pole + i) * wide + first),
            )
            height = spread(0.0)
            for k in range(substeps):
                place, before = (news_at + t * substeps + k) * WIDTH, height
                height = fused(pole, height, gain * load(u, (noise_at + k) * WIDTH))
                store(u, place, load(u, place) + (height - before))
        begin = end
    if CAR.tracks == 2:
        for k in range(substeps):
            left, right = (news_at + k) * WIDTH, (news_at + substeps + k) * WIDTH
            common, opposite = load(u, left), load(u, right)
            store(u, left, common + opposite)
            store(u, right, common - opposite)
    place = setup[SHAPE] + at.states * CAR.tracks + size * (size + 1) // 2
    total = load(cars, CAR.value * wide + first)
    for i in range(news):
        slope = spread(0.0)
        for j in range(size):
            slope = fused(
                spread(settings[U(place)]), load(u, (x_at + j) * WIDTH), slope
            )
            place += 1
        total = fused(slope, load(u, (news_at + i) * WIDTH), total)
    store(
        cars,
        CAR.value * wide + first,
        total + square_form(settings, place, u, news_at, news),
    )


def shape(setup, at, state, cars, history, settings, results, u, x_at, wide, group):
    """Write the shaped reward of a group after its control step.

    The shaped reward is the reward, plus the value of the state before the step and of the news of the road, minus
    the value of the state after the step. A car beyond its bounds has no value after the step.
    """
    first = group * WIDTH
    now = setup[KEPT_NOW] + setup[SUBSTEPS]
    size = car_state(
        setup, at, state, cars, history, settings, u, x_at, wide, group, now
    )
    before = load(cars, CAR.value * wide + first)
    value = square_form(settings, setup[SHAPE] + at.states * CAR.tracks, u, x_at, size)
    good = load(results, CAR.broken * wide + first) == 0.0
    value = select(good, value, before)
    store(
        results,
        CAR.shaped * wide + first,
        load(results, REWARD * wide + first) + (before - value),
    )
    store(cars, CAR.value * wide + first, value)


def car_state(setup, at, state, cars, history, settings, u, x_at, wide, group, now):
    """Write the state of the value function into u from row `x_at`, and return its size.

    The state is that of the car above the road of the first axle, the rises of each track behind the first axle
    in the last control steps, and the currents. `now` is the place in the stored tracks of the next physics step.
    """
    first, kept, substeps, line = (
        group * WIDTH,
        setup[KEPT],
        setup[SUBSTEPS],
        setup[LINE],
    )
    lift = setup[SHAPE]
    for i in range(at.states):
        x = load(state, i * WIDTH)
        for t in range(CAR.tracks):
            height = load(cars, (CAR.height + setup[CAR.leader + t]) * wide + first)
            x = fused(spread(-settings[U(lift + i * CAR.tracks + t)]), height, x)
        store(u, (x_at + i) * WIDTH, x)
    to = x_at + at.states
    for t in range(CAR.tracks):
        passed = (group * CAR.tracks + t) * kept
        for j in range(line):
            newer = (now - 1 - substeps * j + kept) % kept
            older = (now - 1 - substeps * (j + 1) + kept) % kept
            rise = load(history, (passed + newer) * WIDTH) - load(
                history, (passed + older) * WIDTH
            )
            store(u, to * WIDTH, rise)
            to += 1
    for j in range(CAR.currents):
        store(u, to * WIDTH, load(cars, (CAR.current + j) * wide + first))
        to += 1
    return to - x_at


def square_form(settings, place, u, x_at, size):
    """Return ``x' V x`` of the rows of u from `x_at`; the upper triangle of V is stored row by row, twice V off
    the diagonal."""
    total = spread(0.0)
    for i in range(size):
        row = spread(0.0)
        for j in range(i, size):
            row = fused(spread(settings[U(place)]), load(u, (x_at + j) * WIDTH), row)
            place += 1
        total = fused(row, load(u, (x_at + i) * WIDTH), total)
    return total


def driven(cars, past, depth, row, wide, e):
    """Return the current `row` [A] of car e in the next physics step, after delay, lag and saturation of its drive."""
    i = cars[(CAR.current + row) * wide + e]
    if depth > 0:
        place, step = row * wide + e, CAR.currents * wide
        for k in range(depth - 1, 0, -1):
            past[place + k * step] = past[place + (k - 1) * step]
        past[place] = i
        back = cars[(CAR.delay + row) * wide + e]
        low = int(back)
        part = back - low
        newer = past[place + low * step]
        i = (
            newer
            if part == 0.0
            else ((1.0 - part) * newer + part * past[place + (low + 1) * step])
        )
    pole, most = (
        cars[(CAR.lag_pole + row) * wide + e],
        cars[(CAR.saturation + row) * wide + e],
    )
    if pole > 0.0:
        # exact mean of the first-order lag over the step
        was = cars[(CAR.lagged + row) * wide + e]
        cars[(CAR.lagged + row) * wide + e] = i + (was - i) * pole
        i = i + (was - i) * (1.0 - pole) / -math.log(pole)
    if most < 1e8:
        i = most * math.tanh(i / most)
    return i


@compiled(error_model="numpy")
def road_noise(seed, gain, pole, start, out):
    """Fill `out` with the rough road of one car [m], continuing from counter `seed` and height `start`."""
    r = start
    counters, drawn = np.empty(WIDTH, np.int64), np.empty(WIDTH)
    for l in range(WIDTH):  # `noise` increments the counters before the draw
        counters[l] = np.int64(
            np.uint64(seed) + np.uint64(l + 1) * _GOLDEN - np.uint64(WIDTH) * _GOLDEN
        )
    for k in range(0, out.shape[0], WIDTH):
        store(drawn, 0, noise(counters, 0, WIDTH))
        for l in range(min(WIDTH, out.shape[0] - k)):
            r = pole * r + gain * drawn[l]
            out[k + l] = r
    return np.uint64(seed) + np.uint64(out.shape[0]) * _GOLDEN
