"""A step law by law in the lanes with acting laws: sweeps over the laws, and the update from their forces."""

from __future__ import annotations

import math

from .contact import apply
from .lanes import bits, load, spread, store
from .law_forces import law_bound, law_force, parameters, push, seen, update_friction
from .layout import GENERAL, QUIET, WIDTH, layout
from .linear import U, clip, number, pooled
from .newton import newton

SWEEPS = 40  # largest number of Gauss-Seidel sweeps
INSTANTS = 200  # largest number of sweeps for the forces of one instant
QUICK = 20  # largest number of Newton steps among INSTANTS


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
        apply(mats, own, at, state, friction, friction)
    if left:
        finish(mats, own, ints, state, left)
    for l in range(count):
        if state[U(at.failed * WIDTH + l)] < 0.0:
            state[U(at.failed * WIDTH + l)] = now


def at_once(mats, own, ints, state, count):
    """Compute outputs with forces on which all laws agree at this instant: states, inputs and currents are
    fixed, massless terminals yield.

    Newton steps law by law; without quick convergence, every force is bisected, with a single friction
    following. A law whose rate is only a difference keeps its force. Without convergence there are no
    outputs.
    """
    at = layout(ints)
    nl, ns = at.laws, at.smooth
    elongation, rate = at.outcome + at.outputs, at.outcome + at.outputs + nl
    for l in range(count):
        for j in range(nl):
            state[U((at.acting + j) * WIDTH + l)] = state[U((at.force + j) * WIDTH + l)]
        turns, moved = 0, True
        while moved and turns < INSTANTS:
            turns, moved = turns + 1, False
            for j in range(nl):
                if ints[U(at.differs + j)]:
                    continue
                p = parameters(mats, own, at, j, l)
                column = at.out + (at.force + j) * at.out_rows
                by_d = number(mats, own, column + at.outputs + j, l)
                by_s = number(mats, own, column + at.outputs + nl + j, l)
                f = state[U((at.acting + j) * WIDTH + l)]
                if j >= ns:
                    new = f + yields(mats, own, ints, state, j, l, column, 0.0)
                elif turns > QUICK:
                    new = f + between(mats, own, ints, state, j, l, column)
                else:
                    d, s = (
                        state[U((elongation + j) * WIDTH + l)],
                        state[U((rate + j) * WIDTH + l)],
                    )
                    code, z = (
                        ints[U(at.code + j)],
                        state[U((at.memory + j) * WIDTH + l)],
                    )
                    last = state[U((at.elongation + j) * WIDTH + l)]
                    now = law_force(code, p, d, s, last, z, mats[0])[0]
                    away = 1e-7 * (1.0 + abs(f))
                    slope = (
                        law_force(
                            code, p, d + by_d * away, s + by_s * away, last, z, mats[0]
                        )[0]
                        - now
                    ) / away
                    new = f + (now - f) / (1.0 - slope if slope < 0.0 else 1.0)
                if abs(new - f) > 1e-10 * (1.0 + abs(f)):
                    moved = True
                    for i in range(at.out_rows):
                        state[U((at.outcome + i) * WIDTH + l)] += number(
                            mats, own, column + i, l
                        ) * (new - f)
                    state[U((at.acting + j) * WIDTH + l)] = new
        if moved:
            for i in range(at.outputs):
                state[U((at.outcome + i) * WIDTH + l)] = math.nan


def yields(mats, own, ints, state, j, l, column, away):
    """Return the instant yielding of dry friction j of lane l after the change `away` of the force in this
    column of the outputs."""
    at = layout(ints)
    row = at.outputs + at.laws + j
    by_own = number(mats, own, at.out + (at.force + j) * at.out_rows + row, l)
    if ints[U(at.differs + j)] or not by_own < 0.0:
        return 0.0
    d, s = (
        state[U((at.outcome + row - at.laws) * WIDTH + l)],
        state[U((at.outcome + row) * WIDTH + l)],
    )
    s += number(mats, own, column + row, l) * away
    level = law_bound(-1 - ints[U(at.code + j)], parameters(mats, own, at, j, l), d, s)
    f = state[U((at.acting + j) * WIDTH + l)]
    still = f - s / by_own
    return (level if still > level else (-level if still < -level else still)) - f


def between(mats, own, ints, state, j, l, column):
    """Return the instant change of the force of smooth law j of lane l, between a too small and a too large force."""
    low, high, reach = (
        0.0,
        0.0,
        1.0 + abs(state[U((layout(ints).acting + j) * WIDTH + l)]),
    )
    if lacks(mats, own, ints, state, j, l, column, 0.0) > 0.0:
        while reach < 1e15 and lacks(mats, own, ints, state, j, l, column, high) > 0.0:
            low, high, reach = high, high + reach, 4.0 * reach
    else:
        while reach < 1e15 and lacks(mats, own, ints, state, j, l, column, low) < 0.0:
            low, high, reach = low - reach, low, 4.0 * reach
    middle = 0.0
    for _ in range(120):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        if lacks(mats, own, ints, state, j, l, column, middle) > 0.0:
            low = middle
        else:
            high = middle
    return middle


def lacks(mats, own, ints, state, j, l, column, change):
    """Return the answer of smooth law j of lane l minus its changed force; a single friction follows at once."""
    at = layout(ints)
    nl, ns = at.laws, at.smooth
    to_d, to_s = at.outputs + j, at.outputs + nl + j
    d = (
        state[U((at.outcome + to_d) * WIDTH + l)]
        + number(mats, own, column + to_d, l) * change
    )
    s = (
        state[U((at.outcome + to_s) * WIDTH + l)]
        + number(mats, own, column + to_s, l) * change
    )
    if nl - ns == 1:
        friction_row = at.out + (at.force + ns) * at.out_rows
        follows = yields(mats, own, ints, state, ns, l, column, change)
        d += number(mats, own, friction_row + to_d, l) * follows
        s += number(mats, own, friction_row + to_s, l) * follows
    now = law_force(
        ints[U(at.code + j)], parameters(mats, own, at, j, l), d, s,
        state[U((at.elongation + j) * WIDTH + l)], state[U((at.memory + j) * WIDTH + l)], mats[0],
    )[0]  # fmt: skip
    return now - state[U((at.acting + j) * WIDTH + l)] - change


def as_it_is(mats, own, ints, state, count):
    """Replace `at_once` if all networks use the way CONTACT."""


def unsolved(mats, own, ints, state, count, now):
    """Replace `solved` if all networks use the way CONTACT."""


def busy(mats, own, ints, state, count):
    """Return the lanes (as bits) in which laws must be solved; in the other lanes the friction is a clip."""
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


def settle(mats, own, ints, state, left):
    """Solve for the forces of all laws at the end of the step in the lanes `left` (bits); unsolved forces become NaN.

    Gauss-Seidel over the laws, with one secant step each. A single dry friction is eliminated: it follows the
    forces of the other laws at once. Lanes alternate to keep the processor busy, since each visit is one long
    chain of operations.
    """
    at = layout(ints)
    nl, ns = at.laws, at.smooth
    for l in range(WIDTH):
        if left >> l & 1:
            lost = False
            for j in range(nl):
                force = state[U((at.force + j) * WIDTH + l)]
                lost = lost or math.isnan(force)
                state[U((at.acting + j) * WIDTH + l)] = force
                if j >= ns:
                    # the bound belongs to the rate at the start of the step: a falling (Stribeck) curve at
                    # the end of the step would have several solutions
                    state[U((at.tried + j) * WIDTH + l)] = law_bound(
                        -1 - ints[U(at.code + j)],
                        parameters(mats, own, at, j, l),
                        state[U((at.elongation + j) * WIDTH + l)],
                        state[U((at.rate + j) * WIDTH + l)],
                    )
            if lost:  # a failed solution is not tried again in every step
                left &= ~(1 << l)
    for sweep in range(SWEEPS):
        moved = 0
        if nl - ns > 1 or ns == 0:
            for j in range(ns, nl):
                for l in range(WIDTH):
                    if left >> l & 1:
                        moved |= update_friction(mats, own, ints, state, j, l) << l
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


def finish(mats, own, ints, state, left):
    """End the step of the lanes `left` (bits) with the solved forces."""
    at = layout(ints)
    n, nl, ns = at.states, at.laws, at.smooth
    for l in range(WIDTH):
        if left >> l & 1:
            for i in range(n + 2 * nl):
                t = seen(mats, own, at, state, i, l, -1)
                if i < n:
                    to = i
                elif (
                    i < n + nl
                ):  # elongations and rates; dry laws have the reverse order
                    to = (at.elongation if i < n + ns else at.rate) + i - n
                else:
                    to = (at.rate if i < n + nl + ns else at.elongation) + i - n - nl
                state[U(to * WIDTH + l)] = t
            for j in range(nl):
                f, s = (
                    state[U((at.acting + j) * WIDTH + l)],
                    state[U((at.rate + j) * WIDTH + l)],
                )
                if j < ns:
                    state[U((at.memory + j) * WIDTH + l)] = state[
                        U((at.coming + j) * WIDTH + l)
                    ]
                elif ints[U(at.differs + j)] == 0 and abs(s) > 1e-9:
                    # the acting force was a mean over the step; outputs use the force at its end
                    d = state[U((at.elongation + j) * WIDTH + l)]
                    f = law_bound(
                        -1 - ints[U(at.code + j)], parameters(mats, own, at, j, l), d, s
                    )
                    f = f if s > 0.0 else -f
                state[U((at.force + j) * WIDTH + l)] = f
