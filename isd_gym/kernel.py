"""The one compiled kernel: single cars, batches and long records all run through `march`.

A step of length h is exact in the linear part (matrix exponential, inputs linear over the step, currents held).
Dry friction is set-valued and projected (Moreau, time stepping at velocity level: Acary and Brogliato, Springer
2008): its force is the one within its bound that stops the sliding, or the bound. Smooth laws enter as a force that
is linear over the step with its end value found implicitly (second order).

Cars are *lanes*, eight to a group (`lanes`); where each number lies is said by `layout`. There are three ways through a step:
in closed form and without branches (at most one constant friction and one stop: the car), law by law in those lanes that touch
something, or law by law in all lanes. Which of them is a property of the network, and no lane sees its neighbours, so a
car in a batch is the same car alone, to the last bit.

Several laws that see one another are solved by Gauss-Seidel sweeps of secant steps, and where these do not settle by a
safeguarded Newton iteration. A step that is not solved to `GOOD` is no result: its number and law are written down, and
the lane's state becomes nan.

Compiled code is cached on disk under a key made of the sources, so an upgrade never runs yesterday's physics.
"""

from __future__ import annotations

import functools
import hashlib
import math
import types
from collections.abc import Callable, Sequence
from importlib import resources
from typing import Any, NamedTuple

import numba as nb
import numpy as np
from numba.core.options import DefaultOptions

from . import elements as el
from . import layout as layout_module
from .lanes import bits, fused, load, noise, select, some, spread, store
from .layout import (
    AHEAD,
    BOUNDS,
    BROKEN,
    CONTACT,
    COST,
    COUNTER,
    CURRENT,
    CURRENT_LIMIT,
    DELAY,
    GENERAL,
    HEIGHT,
    HEIGHT_RATE,
    LAG_POLE,
    LAGGED,
    LIFTED,
    PROFILE,
    PROFILE_END,
    QUIET,
    REWARD,
    ROUGH,
    ROUGH_GAIN,
    ROUGH_POLE,
    SATURATION,
    SIGNALS,
    SLEW_LIMIT,
    TARGET,
    WEIGHTS,
    WHOLE,
    WIDTH,
    layout,
)

SWEEPS = 40  # of Gauss-Seidel
TIGHT = 1e-9  # relative change of a force at which a law is settled
GOOD = 1e-6  # relative error of a force with which a step counts as solved
U = nb.uintp  # an unsigned index spares the code for negative ones
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # SplitMix64's step

law_force: Callable  # made of the laws that are registered when the kernel is compiled
law_bound: Callable


# ----------------------------------------------------------------------------------------- linear part


def sums(mats, own, at, height, columns, state, result, rows):
    """Rows `result`... of the state = a matrix of the pool, stored column by column, times its first `columns` rows."""
    for i in range(0, rows, 4):
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


# --------------------------------------------------------------------------------------- closed form


def touch(mats, own, ints, state):
    """End a step of at most one stop (or play) and one constant friction, which may stick.

    Clear of the stop the friction is ``clip(-r / g)``. On it, the force of the stop is linear in the friction; with it
    put in, so is the rate, and the friction a clip again. A stop that would pull is not touched.
    """
    at = layout(ints)
    n, nl, ns = at.states, at.laws, at.smooth
    friction, push = spread(0.0), spread(0.0)
    level, rate = spread(0.0), spread(0.0)
    rubs = nl > ns
    if rubs:
        level = pooled(mats, own, at.level)
        rate = load(state, (at.first + ns) * WIDTH)
        friction = clip(rate * pooled(mats, own, at.give), level)
    if ns > 0:
        upper, lower = pooled(mats, own, at.upper), pooled(mats, own, at.lower)
        free, yields = load(state, at.first * WIDTH), spread(0.0)
        if rubs:
            yields = pooled(mats, own, at.gains + ns * at.rows + n)
        place = fused(yields, friction, free)
        meets = (place > upper) | (place < lower)
        if some(meets):
            extended = place > 0.0
            beyond = free - select(extended, upper, lower)
            alone = beyond * pooled(mats, own, at.per_elongation)
            alone = fused(load(state, at.other * WIDTH), pooled(mats, own, at.per_rate), alone)
            shared = pooled(mats, own, at.per_friction)
            held, slip, own_slip = friction, spread(0.0), spread(0.0)
            if rubs:
                slip = pooled(mats, own, at.gains + n + ns)  # what the stop does to the sliding
                own_slip = pooled(mats, own, at.gains + ns * at.rows + n + ns)
                held = clip(fused(slip, alone, rate) * pooled(mats, own, at.give_stopped), level)
            force = fused(shared, held, alone)
            touches = meets & (select(extended, force, -force) > 0.0)
            friction = select(touches, held, friction)
            push = select(touches, force, push)
            # a damped stop pushes from the instant it is met: one that would at once push clear is met, and no more
            own_yield = pooled(mats, own, at.gains + n)
            limit = select(extended, upper, lower)
            rest = fused(yields, friction, free) - limit
            gap = fused(own_yield, push, rest)
            short = touches & (select(extended, gap, -gap) < 0.0)
            if some(short):
                push = select(short, -rest / own_yield, push)
            if rubs:
                # where the sliding reverses within the step, friction has the old sign up to that instant
                was = load(state, (at.rate + ns) * WIDTH)
                end = fused(own_slip, friction, fused(slip, push, rate))
                turns = touches & ~short & (abs(friction) >= level) & (was * end < 0.0)
                if some(turns):
                    bound = friction
                    for _ in range(3):
                        part = select(was * end < 0.0, was / (was - end), spread(0.0))
                        friction = select(turns, bound * (1.0 - 2.0 * part), friction)
                        push = select(turns, fused(shared, friction, alone), push)
                        push = select(turns & (select(extended, push, -push) <= 0.0), spread(0.0), push)
                        end = fused(own_slip, friction, fused(slip, push, rate))
                    # what acted was a mean over the step; what outputs see is the force at its end
                    seen = select(end > 0.0, level, -level)
                    store(state, (at.force + ns) * WIDTH, select(turns & (abs(end) > 1e-9), seen, friction))
                else:
                    store(state, (at.force + ns) * WIDTH, friction)
        elif rubs:
            store(state, (at.force + ns) * WIDTH, friction)
        store(state, at.force * WIDTH, push)
    elif rubs:
        store(state, at.force * WIDTH, friction)
    apply(mats, own, ints, state, push, friction)


def apply(mats, own, ints, state, push, friction):
    """States, elongation of the stop and rate of the friction with the forces that were found."""
    at = layout(ints)
    n, nl, ns = at.states, at.laws, at.smooth
    stop, rub = at.gains, at.gains + ns * at.rows
    for i in range(n + nl):
        x = load(state, (at.step + i) * WIDTH)
        if nl > ns:
            x = fused(pooled(mats, own, rub + i), friction, x)
        if ns > 0 and at.way == CONTACT:
            x = fused(pooled(mats, own, stop + i), push, x)
        to = i if i < n else at.elongation + i - n if i < n + ns else at.rate + i - n
        store(state, to * WIDTH, x)


# ------------------------------------------------------------------------------------------ law by law


def busy(mats, own, ints, state, count):
    """Lanes (as bits) in which laws are to be solved for; in the others the friction is a clip."""
    at = layout(ints)
    everyone = (1 << count) - 1
    if at.way == GENERAL:
        return everyone
    acts = spread(1.0) < spread(0.0)
    for j in range(at.smooth):
        d, f = load(state, (at.first + j) * WIDTH), load(state, (at.force + j) * WIDTH)
        acts = acts | (abs(d) > pooled(mats, own, at.spans + j)) | (f != 0.0)
    if at.laws > at.smooth:
        rate = load(state, (at.first + at.smooth) * WIDTH)
        friction = clip(rate * pooled(mats, own, at.give), pooled(mats, own, at.level))
        store(state, (at.force + at.smooth) * WIDTH, friction)
    return bits(acts) & everyone


def parameters(mats, own, at, j, l):
    """The numbers that law j of lane l reads."""
    begin = at.own * WIDTH + (l * at.laws + j) * at.parameters if own else at.own + j * at.parameters
    return mats[begin : begin + at.parameters]


def settle(mats, own, ints, state, left):
    """Forces of all laws at the end of the step in the lanes `left` (bits); those that cannot be found become nan.

    Gauss-Seidel over the laws, a secant step in each; a single dry friction is eliminated: it follows the forces of
    the others at once. Lanes take turns, which keeps the processor busy: a visit is one long chain of operations.
    """
    at = layout(ints)
    nl, ns = at.laws, at.smooth
    for l in range(WIDTH):
        if left >> l & 1:
            for j in range(nl):
                state[U((at.acting + j) * WIDTH + l)] = state[U((at.force + j) * WIDTH + l)]
                if j >= ns:
                    # the bound is that of the rate at the start of the step: a falling (Stribeck) curve taken at its
                    # end would have several solutions
                    state[U((at.tried + j) * WIDTH + l)] = law_bound(
                        -1 - ints[U(at.code + j)],
                        parameters(mats, own, at, j, l),
                        state[U((at.elongation + j) * WIDTH + l)],
                        state[U((at.rate + j) * WIDTH + l)],
                    )
    for sweep in range(SWEEPS):
        moved = 0
        if nl - ns > 1 or ns == 0:
            for j in range(ns, nl):
                for l in range(WIDTH):
                    if left >> l & 1:
                        moved |= rub(mats, own, ints, state, j, l) << l
        for j in range(ns):
            for l in range(WIDTH):
                if left >> l & 1:
                    moved |= push(mats, own, ints, state, sweep, j, l) << l
        left &= moved
        if left == 0:
            break
    for l in range(WIDTH):
        if left >> l & 1:
            newton(mats, own, ints, state, l)


def seen(mats, own, at, state, row, l, skip):
    """Row `row` of the step in lane l with all forces but that of law `skip`."""
    s = state[U((at.step + row) * WIDTH + l)]
    for i in range(at.laws):
        if i != skip:
            s += number(mats, own, at.gains + i * at.rows + row, l) * state[U((at.acting + i) * WIDTH + l)]
    return s


def rub(mats, own, ints, state, j, l):
    """Dry friction j of lane l against the sliding that the other forces leave; 1 if it changed."""
    at = layout(ints)
    row = at.states + j
    old = state[U((at.acting + j) * WIDTH + l)]
    new = held(
        -1 - ints[U(at.code + j)],
        parameters(mats, own, at, j, l),
        seen(mats, own, at, state, row, l, j),
        number(mats, own, at.gains + j * at.rows + row, l),
        state[U((at.tried + j) * WIDTH + l)],
        state[U((at.elongation + j) * WIDTH + l)],
        state[U((at.rate + j) * WIDTH + l)],
        ints[U(at.differs + j)] == 0,
    )
    state[U((at.acting + j) * WIDTH + l)] = new
    return 1 if at.laws > 1 and abs(new - old) > TIGHT * (1.0 + abs(new)) else 0


def push(mats, own, ints, state, sweep, j, l):
    """A secant step of smooth law j of lane l, and the single dry friction with it; 1 if it changed."""
    at = layout(ints)
    n, nl, ns = at.states, at.laws, at.smooth
    single = nl - ns == 1
    k = at.acting + j
    # elongation, rate, and the rate at the single friction, as the forces at the end of the step make them
    d, s, e = state[U((at.first + j) * WIDTH + l)], state[U((at.other + j) * WIDTH + l)], 0.0
    for i in range(ns if single else nl):
        f = state[U((at.acting + i) * WIDTH + l)]
        column = at.gains + i * at.rows + n
        d += number(mats, own, column + j, l) * f
        s += number(mats, own, column + nl + j, l) * f
        if single:
            e += number(mats, own, column + ns, l) * f
    if single:
        column = at.gains + ns * at.rows + n
        t = held(
            -1 - ints[U(at.code + ns)],
            parameters(mats, own, at, ns, l),
            state[U((at.first + ns) * WIDTH + l)] + e,
            number(mats, own, column + ns, l),
            state[U((at.tried + ns) * WIDTH + l)],
            state[U((at.elongation + ns) * WIDTH + l)],
            state[U((at.rate + ns) * WIDTH + l)],
            ints[U(at.differs + ns)] == 0,
        )
        d += number(mats, own, column + j, l) * t
        s += number(mats, own, column + nl + j, l) * t
        state[U((at.acting + ns) * WIDTH + l)] = t
    p = parameters(mats, own, at, j, l)
    now, z = law_force(
        ints[U(at.code + j)],
        p, d, s, state[U((at.elongation + j) * WIDTH + l)], state[U((at.memory + j) * WIDTH + l)], mats[0],
    )  # fmt: skip
    f, factor = state[U(k * WIDTH + l)], state[U((at.factor + j) * WIDTH + l)]
    r = now - f
    if sweep > 0:
        # secant: step = r / (1 - slope); a law that resists motion has a slope below zero
        span = f - state[U((at.tried + j) * WIDTH + l)]
        change = now - state[U((at.said + j) * WIDTH + l)]
        # alone, it also sees how the friction follows; one of many takes only its own share of the change
        share = number(mats, own, at.gains + j * at.rows + n + nl + j, l) * span
        whole = s - state[U((at.tried_rate + j) * WIDTH + l)]
        if ns > 1 and abs(whole) > 0.1 * abs(share):
            change *= share / whole
        rest = span - change
        if span != 0.0:
            guess = span / rest if span * rest > 0.05 * span * span else 1.0
            # many sweeps: only ever more careful, so that kinks cannot make it run in circles
            factor = guess if sweep < 20 else min(guess, factor)
            state[U((at.factor + j) * WIDTH + l)] = factor
    state[U((at.tried + j) * WIDTH + l)] = f
    state[U((at.said + j) * WIDTH + l)] = now
    state[U((at.coming + j) * WIDTH + l)] = z
    state[U((at.tried_rate + j) * WIDTH + l)] = s
    if abs(r) <= TIGHT * (1.0 + abs(f)):
        return 0
    state[U(k * WIDTH + l)] = f + r * (factor if factor > 0.0 else 1.0)
    return 1


def held(kind, p, rate, gain, level, d, was, slides):
    """Mean force over the step of a dry friction that would slide at `rate` [m/s] without it, `was` at the start.

    gain [m/(N s)] is what a force adds to the rate. The friction holds if it can. Where it slides at the end of the
    step, it has the mean bound over the step, and the old sign up to the instant of reversal, so that a step with a
    reversal is of second order too (unless the rate is only a difference: `slides` false).
    """
    if gain >= 0.0:  # prescribed motion: nothing yields
        return level if rate > 0.0 else (-level if rate < 0.0 else 0.0)
    hold = -rate / gain
    out = level if hold > level else hold
    out = -level if out < -level else out
    if abs(hold) > level and slides:
        for _ in range(4):
            end = rate + gain * out
            mean = 0.5 * (level + law_bound(kind, p, d, end))
            part = was / (was - end) if was * end < 0.0 else 0.0
            new = (mean if hold > 0.0 else -mean) * (1.0 - 2.0 * part)
            if new == out:
                break
            out = new
    return out


def ask(mats, own, ints, state, j, l, dd, ds):
    """Force and next memory of smooth law j of lane l under the forces that act, its elongation off by dd, its rate by ds."""
    at = layout(ints)
    row = at.states + j
    return law_force(
        ints[U(at.code + j)],
        parameters(mats, own, at, j, l),
        seen(mats, own, at, state, row, l, -1) + dd,
        seen(mats, own, at, state, row + at.laws, l, -1) + ds,
        state[U((at.elongation + j) * WIDTH + l)],
        state[U((at.memory + j) * WIDTH + l)],
        mats[0],
    )


def answers(mats, own, ints, state, l):
    """What all laws of lane l say to the forces that act; the largest relative difference, and its law."""
    at = layout(ints)
    n, nl, ns = at.states, at.laws, at.smooth
    worst, who = 0.0, 0
    for j in range(nl):
        f, row = state[U((at.acting + j) * WIDTH + l)], n + j
        if j < ns:
            now, z = ask(mats, own, ints, state, j, l, 0.0, 0.0)
            state[U((at.coming + j) * WIDTH + l)] = z
        else:
            # without what a reversal within the step does, which is not continuous
            gain = number(mats, own, at.gains + j * at.rows + row, l)
            rate, level = seen(mats, own, at, state, row, l, j), state[U((at.tried + j) * WIDTH + l)]
            now = held(0, parameters(mats, own, at, j, l), rate, gain, level, 0.0, 0.0, False)
        state[U((at.said + j) * WIDTH + l)] = now
        error = abs(now - f) / (1.0 + abs(f))
        if error > TIGHT and j < ns:
            # a law that jumps (a damped stop as it is met) has any force between, where it jumps
            least, most = now, now
            for side in range(2):
                near = (1.0 if side == 0 else -1.0) * 1e-9
                dd = near * (1e-3 + abs(seen(mats, own, at, state, row, l, -1)))
                ds = near * (1e-3 + abs(seen(mats, own, at, state, row + nl, l, -1)))
                there = ask(mats, own, ints, state, j, l, dd, ds)[0]
                least, most = min(least, there), max(most, there)
            if least <= f <= most:
                error = 0.0
        if not error <= worst:
            worst, who = error, j
    return worst, who


def newton(mats, own, ints, state, l):
    """Forces of all laws of lane l at once: Newton steps with one-sided slopes, shortened until they help.

    What is found is as good as it gets: it stands if the laws agree with it to `GOOD`, else the lane's state becomes nan.
    """
    at = layout(ints)
    n, nl, ns = at.states, at.laws, at.smooth
    matrix = at.scratch * WIDTH  # (law, law), then the step and the best forces
    step, start, best = matrix + nl * nl, matrix + nl * (nl + 1), matrix + nl * (nl + 2)
    for j in range(nl):
        f = state[U((at.force + j) * WIDTH + l)]
        state[U((at.acting + j) * WIDTH + l)] = f
        state[U(best + j)] = f
    worst, who = answers(mats, own, ints, state, l)
    least, last = worst, who
    for turn in range(60):
        if least <= TIGHT:
            break
        for j in range(nl):
            f = state[U((at.acting + j) * WIDTH + l)]
            state[U(start + j)] = f
            state[U(step + j)] = state[U((at.said + j) * WIDTH + l)] - f
            by_d, by_s, stick = 0.0, 0.0, 0.0
            if j < ns:
                said = state[U((at.said + j) * WIDTH + l)]
                away = 1e-7 if turn % 2 == 0 else -1e-7  # either side of a kink in turn
                dd = away * (1e-3 + abs(seen(mats, own, at, state, n + j, l, -1)))
                ds = away * (1e-2 + abs(seen(mats, own, at, state, n + nl + j, l, -1)))
                by_d = (ask(mats, own, ints, state, j, l, dd, 0.0)[0] - said) / dd
                by_s = (ask(mats, own, ints, state, j, l, 0.0, ds)[0] - said) / ds
            else:
                gain = number(mats, own, at.gains + j * at.rows + n + j, l)
                level = state[U((at.tried + j) * WIDTH + l)]
                if gain < 0.0 and abs(state[U((at.said + j) * WIDTH + l)]) < level:
                    stick = -1.0 / gain
            for i in range(nl):
                column = at.gains + i * at.rows + n + j
                first = number(mats, own, column, l)
                if j < ns:
                    slope = by_d * first + by_s * number(mats, own, column + nl, l)
                else:
                    slope = 0.0 if i == j else stick * first
                state[U(matrix + j * nl + i)] = (1.0 if i == j else 0.0) - slope
        eliminate(state, matrix, step, nl)
        share = 1.0
        for _ in range(14):
            for j in range(nl):
                state[U((at.acting + j) * WIDTH + l)] = state[U(start + j)] + share * state[U(step + j)]
            error, which = answers(mats, own, ints, state, l)
            if error < worst:
                break
            share *= 0.5
        if not error < worst:  # no way down: a cautious step towards what the laws say
            for j in range(nl):
                state[U((at.acting + j) * WIDTH + l)] = state[U(start + j)]
            answers(mats, own, ints, state, l)
            for j in range(nl):
                said = state[U((at.said + j) * WIDTH + l)]
                state[U((at.acting + j) * WIDTH + l)] += (0.5 if turn % 3 else 0.05) * (
                    said - state[U(start + j)]
                )
            error, which = answers(mats, own, ints, state, l)
        worst, who = error, which
        if worst < least:
            least, last = worst, who
            for j in range(nl):
                state[U(best + j)] = state[U((at.acting + j) * WIDTH + l)]
    for j in range(nl):
        state[U((at.acting + j) * WIDTH + l)] = state[U(best + j)]
    answers(mats, own, ints, state, l)
    if not least <= GOOD:
        for j in range(nl):
            state[U((at.acting + j) * WIDTH + l)] = math.nan
        if state[U(at.failed * WIDTH + l)] == 0.0:
            state[U(at.failed * WIDTH + l)] = -1.0  # in this step
            state[U((at.failed + 1) * WIDTH + l)] = last


def eliminate(numbers, matrix, right, n):
    """Solve a small system of equations in place (rows one after another), the largest pivot first."""
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(numbers[U(matrix + i * n + k)]) > abs(numbers[U(matrix + best * n + k)]):
                best = i
        if best != k:
            for j in range(n):
                a, b = U(matrix + k * n + j), U(matrix + best * n + j)
                numbers[a], numbers[b] = numbers[b], numbers[a]
            a, b = U(right + k), U(right + best)
            numbers[a], numbers[b] = numbers[b], numbers[a]
        pivot = numbers[U(matrix + k * n + k)]
        if abs(pivot) < 1e-300:
            pivot = 1e-300
        for i in range(k + 1, n):
            share = numbers[U(matrix + i * n + k)] / pivot
            for j in range(k, n):
                numbers[U(matrix + i * n + j)] -= share * numbers[U(matrix + k * n + j)]
            numbers[U(right + i)] -= share * numbers[U(right + k)]
    for i in range(n - 1, -1, -1):
        t = numbers[U(right + i)]
        for j in range(i + 1, n):
            t -= numbers[U(matrix + i * n + j)] * numbers[U(right + j)]
        pivot = numbers[U(matrix + i * n + i)]
        numbers[U(right + i)] = t / (pivot if abs(pivot) >= 1e-300 else 1e-300)


def finish(mats, own, ints, state, left):
    """End the step of the lanes `left` (bits) with the forces that were solved for."""
    at = layout(ints)
    n, nl, ns = at.states, at.laws, at.smooth
    for l in range(WIDTH):
        if left >> l & 1:
            for i in range(n + 2 * nl):
                t = seen(mats, own, at, state, i, l, -1)
                if i < n:
                    to = i
                elif i < n + nl:  # elongations and rates; those of dry laws stand the other way round
                    to = (at.elongation if i < n + ns else at.rate) + i - n
                else:
                    to = (at.rate if i < n + nl + ns else at.elongation) + i - n - nl
                state[U(to * WIDTH + l)] = t
            for j in range(nl):
                f, s = state[U((at.acting + j) * WIDTH + l)], state[U((at.rate + j) * WIDTH + l)]
                if j < ns:
                    state[U((at.memory + j) * WIDTH + l)] = state[U((at.coming + j) * WIDTH + l)]
                elif ints[U(at.differs + j)] == 0 and abs(s) > 1e-9:
                    # what acted was a mean over the step; what outputs see is the force at its end
                    d = state[U((at.elongation + j) * WIDTH + l)]
                    f = law_bound(-1 - ints[U(at.code + j)], parameters(mats, own, at, j, l), d, s)
                    f = f if s > 0.0 else -f
                state[U((at.force + j) * WIDTH + l)] = f


def solved(mats, own, ints, state, count, now):
    """End step number `now` law by law."""
    at = layout(ints)
    left = busy(mats, own, ints, state, count)
    if left:
        settle(mats, own, ints, state, left)
    if at.way == QUIET:
        friction = spread(0.0)
        if at.laws > at.smooth:
            friction = load(state, (at.force + at.smooth) * WIDTH)
        apply(mats, own, ints, state, friction, friction)
    if left:
        finish(mats, own, ints, state, left)
    for l in range(count):
        if state[U(at.failed * WIDTH + l)] < 0.0:
            state[U(at.failed * WIDTH + l)] = now


def unsolved(mats, own, ints, state, count, now):
    """In the place of `solved` where all networks go the way CONTACT."""


# ---------------------------------------------------------------------------------------------- steps


def march(mats, own, ints, state, u, c, u_at, c_at, steps, width, first, count, now):
    """Run a group of `count` lanes in place for `steps` steps, the first of them number `now`.

    u (.., m, width) from row u_at and c (.., nc, width) from row c_at, flat; `width` 1: all lanes have the same inputs, else
    the group's are those from `first` on.
    """
    at = layout(ints)
    m, nc, nl = at.inputs, at.currents, at.laws
    for k in range(steps):
        for j in range(2 * m):
            take(state, at.start + j, u, (u_at + k) * m + j, width, first, count)
        for j in range(nc):
            take(state, at.current + j, c, (c_at + k) * nc + j, width, first, count)
        for j in range(nl * at.differ):
            store(state, (at.last + j) * WIDTH, load(state, (at.elongation + j) * WIDTH))
        sums(mats, own, at.matrix, at.rows, at.columns, state, at.step, at.rows)
        if at.way == CONTACT:
            touch(mats, own, ints, state)
        else:
            solved(mats, own, ints, state, count, now + k)


def outputs(mats, own, ints, state):
    """The outputs now, into their rows of the state."""
    at = layout(ints)
    sums(mats, own, at.out, at.out_rows, at.columns, state, at.outcome, at.out_rows)


def pool_of(mats, own, ints, group):
    size = layout(ints).size
    return mats[group * size * WIDTH : (group + 1) * size * WIDTH] if own else mats


def record(mats, ints, states, u, c, every, width, lanes, out):
    """A whole record: flat u (N*every+1, m, width) and c (N*every, nc, width); the lanes share inputs if width is 1.

    out (N+1, ny, lanes) holds the outputs at every `every`-th step. `states`: of the groups, one after another. The last
    numbers of `ints` say of every output whether it sees a current before its sample (`Plant.early`).
    """
    at = layout(ints)
    own = mats.shape[0] != at.size
    m, nc, ny, nl = at.inputs, at.currents, at.outputs, at.laws
    size = at.height * WIDTH
    early = at.differs + nl
    some_early = False
    for i in range(ny):
        some_early |= ints[U(early + i)] != 0
    last = c.shape[0] // max(nc * width, 1) - 1
    for group in range((lanes + WIDTH - 1) // WIDTH):
        first = group * WIDTH
        count = min(WIDTH, lanes - first)
        pool, state = pool_of(mats, own, ints, group), states[group * size : (group + 1) * size]
        for j in range(m):  # before the first step
            take(state, at.end + j, u, j, width, first, count)
        for k in range(out.shape[0]):
            if k > 0:
                begin = (k - 1) * every
                march(pool, own, ints, state, u, c, begin, begin, every, width, first, count, begin + 1)
            if some_early:
                outputs(pool, own, ints, state)
                for i in range(ny):
                    if ints[U(early + i)] != 0:
                        for l in range(count):
                            out[k, i, first + l] = state[U((at.outcome + i) * WIDTH + l)]
            for j in range(nc):  # a current acts from its sample on
                take(state, at.current + j, c, min(k * every, last) * nc + j, width, first, count)
            outputs(pool, own, ints, state)
            for i in range(ny):
                if ints[U(early + i)] == 0:
                    for l in range(count):
                        out[k, i, first + l] = state[U((at.outcome + i) * WIDTH + l)]


def advance(mats, ints, state, u, c, lanes):
    """Run ``u.shape[0] - 1`` steps in place: `state` (rows, lanes) of a `Plant`, u (K+1, m, lanes), c (K, nc, lanes)."""
    at = layout(ints)
    pools, own = mats.reshape(-1), mats.size != at.size
    flat_u, flat_c = u.reshape(-1), c.reshape(-1)
    work = np.zeros(at.height * WIDTH)
    for group in range((lanes + WIDTH - 1) // WIDTH):
        first = group * WIDTH
        count = min(WIDTH, lanes - first)
        for i in range(at.scratch):
            for l in range(count):
                work[U(i * WIDTH + l)] = state[i, first + l]
        pool = pool_of(pools, own, ints, group)
        march(pool, own, ints, work, flat_u, flat_c, 0, 0, u.shape[0] - 1, lanes, first, count, 1)
        for i in range(at.scratch):
            for l in range(count):
                state[i, first + l] = work[U(i * WIDTH + l)]


def measure(mats, ints, state, u, c, lanes, out):
    """Outputs now: out (ny, lanes) from u (m, lanes) and c (nc, lanes)."""
    at = layout(ints)
    pools, own = mats.reshape(-1), mats.size != at.size
    work = np.zeros(at.height * WIDTH)
    for group in range((lanes + WIDTH - 1) // WIDTH):
        first = group * WIDTH
        for l in range(min(WIDTH, lanes - first)):
            for j in range(at.inputs):
                state[at.end + j, first + l] = u[j, first + l]
            for j in range(at.currents):
                state[at.current + j, first + l] = c[j, first + l]
            for i in range(at.columns):
                work[U(i * WIDTH + l)] = state[i, first + l]
        outputs(pool_of(pools, own, ints, group), own, ints, work)
        for i in range(at.outputs):
            for l in range(min(WIDTH, lanes - first)):
                out[i, first + l] = work[U((at.outcome + i) * WIDTH + l)]


# ---------------------------------------------------------------------------------------- cars, roads


def drive(mats, ints, states, cars, ways, table, past, rings, ahead, settings, seen_out, room, begin, stop):
    """One control step of the groups of cars from `begin` to before `stop`; the number of cars that broke.

    ints[-9:] = cars, physics steps per control step, the columns of u that take the road's height, rate and acceleration
    (-1: none), whether the drive does more than hold its current, whether currents are asked for (and limited) or
    given, what an observation shows (`MEASURED`, `WHOLE`, `AHEAD`), and where the road drawn ahead begins now. `cars`,
    `ways`, `settings`: `layout`. table: the fixed profiles, one after another. past (currents kept, cars): newest first.
    rings (substeps, points, cars): the road drawn ahead, a ring for each physics step of a control step, and ahead
    (cars, points): the last of them, car by car. seen_out (cars, signals): the observations. `room`: for the inputs of a
    control step.
    """
    at = layout(ints)
    total, substeps = ints[-9], ints[-8]
    drives, asked, shows, now = ints[-4], ints[-3], ints[-2], ints[-1]
    own = mats.shape[0] != at.size
    m, nc = at.inputs, at.currents
    size, wide = at.height * WIDTH, cars.shape[1]
    flat = cars.reshape(-1)
    c_at = (substeps + 1) * m * WIDTH
    u, c = room[:c_at], room[c_at:]
    broken = 0
    for group in range(begin, stop):
        first = group * WIDTH
        count = min(WIDTH, total - first)
        pool, state = pool_of(mats, own, ints, group), states[group * size : (group + 1) * size]
        current = load(flat, CURRENT * wide + first)
        if asked:
            target = clip(load(flat, TARGET * wide + first), spread(settings[CURRENT_LIMIT]))
            current = current + clip(target - current, spread(settings[SLEW_LIMIT]))
            store(flat, CURRENT * wide + first, current)
        travel(ints, flat, ways.reshape(-1), table, rings.reshape(-1), ahead, u, mats[0], wide, first, count)
        for k in range(substeps * nc):
            if drives:
                for l in range(count):
                    c[k * WIDTH + l] = driven(flat, past, wide, first + l)
            else:
                store(c, k * WIDTH, current)
        march(pool, own, ints, state, u, c, 0, 0, substeps, WIDTH, 0, count, 1)
        outputs(pool, own, ints, state)
        broken += judge(ints, state, flat, settings, wide, first, count)
        for l in range(count):
            for j in range(5):
                seen_out[first + l, j] = state[U((at.outcome + j) * WIDTH + l)]
            seen_out[first + l, 5] = flat[U(CURRENT * wide + first + l)]
        if shows == WHOLE:
            for l in range(count):
                height = flat[U(HEIGHT * wide + first + l)]
                for j in range(6, seen_out.shape[1]):
                    lift = settings[U(LIFTED + j)] * height
                    seen_out[first + l, j] = state[U((at.outcome + j) * WIDTH + l)] - lift
        elif shows == AHEAD:
            look(ahead, (now + 1) % max(ahead.shape[1], 1), flat, wide, first, count, seen_out)
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


def judge(ints, state, cars, settings, wide, first, count):
    """Signals, costs and reward of a group after its control step; the number of cars that broke in it.

    A broken car's cost is that of the bounds it left.
    """
    at = layout(ints)
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
    by_a, by_l = settings[WEIGHTS] * (a * a), settings[WEIGHTS + 1] * (l * l)
    by_f, by_i = settings[WEIGHTS + 2] * (tyre * tyre), settings[WEIGHTS + 3] * (i * i)
    store(cars, COST * wide + first, by_a)
    store(cars, (COST + 1) * wide + first, by_l)
    store(cars, (COST + 2) * wide + first, by_f)
    store(cars, (COST + 3) * wide + first, by_i)
    store(cars, REWARD * wide + first, -(by_a + by_l + by_f + by_i))
    store(cars, BROKEN * wide + first, select(good, spread(0.0), spread(1.0)))
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


# -------------------------------------------------------------------------------------- law dispatch


def _no_law(which, p, d, v, d_last, z, h):
    return 0.0, z


def _no_bound(which, p, d, v):
    return 0.0


def _dispatch(functions: Sequence[Callable], fallback: Callable) -> Callable:
    """One compiled function that calls functions[which]."""
    names = fallback.__code__.co_varnames[: fallback.__code__.co_argcount]
    of_law = ", ".join(names[1:])
    lines = [f"def dispatch({', '.join(names)}):"]
    for code in range(len(functions)):
        lines.append(f"    if which == {code}:\n        return law_{code}({of_law})")
    lines.append(f"    return fallback({', '.join(names)})")
    scope: dict[str, Any] = {f"law_{code}": nb.njit(f, **_INNER) for code, f in enumerate(functions)}
    scope["fallback"] = nb.njit(fallback, **_INNER)
    exec("\n".join(lines), scope)
    return nb.njit(scope["dispatch"], **_INNER)


def _laws() -> tuple[list[type[el.Element]], list[type[el.Element]]]:
    smooth = [cls for cls in el.TYPES.values() if cls.law is not None]
    dry = [cls for cls in el.TYPES.values() if cls.bound is not None]
    return smooth, dry


def law_code(cls: type[el.Element]) -> int:
    """Code of an element's law in the kernel: >= 0 a smooth law, < 0 a set-valued one."""
    smooth, dry = _laws()
    return smooth.index(cls) if cls.law is not None else -1 - dry.index(cls)


def _stamp() -> int:
    """A number that changes with the kernel's and the laws' code."""
    smooth, dry = _laws()
    return _stamp_of((*((c.type, c.law) for c in smooth), *((c.type, c.bound) for c in dry)))


@functools.cache
def _stamp_of(laws: tuple[tuple[str, Any], ...]) -> int:
    digest = hashlib.sha256()
    own, package = (
        resources.files(str(__package__)),
        resources.files(el.__name__),
    )  # the package may lie in a zip
    files = [own / name for name in ("kernel.py", "lanes.py", "layout.py")]
    files += [f for f in sorted(package.iterdir(), key=lambda f: f.name) if f.name.endswith(".py")]
    for file in files:
        digest.update(file.read_bytes())
    for name, law in laws:
        digest.update(name.encode() + law.__code__.co_code + repr(law.__code__.co_consts).encode())
    return int.from_bytes(digest.digest()[:6], "big")


# ------------------------------------------------------------------------------------------- compiling


class Kernel(NamedTuple):
    """The compiled functions."""

    advance: Callable
    measure: Callable
    record: Callable
    drive: Callable


_CLOSED = (layout, sums, pooled, number, clip, take, apply, touch)
_LAWS = (parameters, held, seen, rub, push, eliminate, ask, answers, newton, settle, busy, finish, solved)
_STEPS = (march, outputs, pool_of, driven, travel, look, judge)
_ENTRIES = (advance, measure, record, drive)
#: put in where they are called: what returns a piece of an array cannot be a function of its own where nothing counts
#: references, and what is called once need not be compiled, optimised and linked twice
_INLINE = (pool_of, parameters, settle, busy, finish, solved, unsolved, march)
_INNER: dict[str, Any] = {
    "nogil": True, "error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True
}  # fmt: skip
_ENTRY: dict[str, Any] = {"nogil": True, "error_model": "numpy", "cache": True}
if hasattr(
    DefaultOptions, "_nrt"
):  # nothing inside makes an array, and calls that count no references are inlined
    _INNER["_nrt"] = False


@functools.cache
def _bind(stamp: int, laws: bool) -> Kernel:
    smooth, dry = _laws() if laws else ([], [])
    names: dict[str, Any] = {**vars(layout_module), **globals()}
    if laws:
        names["law_force"] = _dispatch([c.law for c in smooth], _no_law)  # type: ignore[misc]
        names["law_bound"] = _dispatch([c.bound for c in dry], _no_bound)  # type: ignore[misc]
    for plain in (*_CLOSED, *(_LAWS if laws else (unsolved,)), *_STEPS, *_ENTRIES):
        # compiled functions read constants and one another from `names`; the name of a function is part of its key
        # in numba's cache on disk: the stamp keeps old laws out
        twin = types.FunctionType(plain.__code__, names, plain.__name__)
        twin.__qualname__ = f"{plain.__name__}_{'laws' if laws else 'closed'}_{stamp:x}"
        name = "solved" if plain is unsolved else plain.__name__
        options = _ENTRY if plain in _ENTRIES else _INNER
        names[name] = nb.njit(twin, **options, inline="always" if plain in _INLINE else "never")
    return Kernel(names["advance"], names["measure"], names["record"], names["drive"])


def kernel(laws: bool | str = True) -> Kernel:
    """The compiled kernel with every law that is registered now, or without any: for networks of the way `CONTACT`."""
    return _bind(_stamp(), bool(laws))
