"""Safeguarded Newton iteration for all laws of a lane at once, used if sweeps do not converge."""

from __future__ import annotations

import math

from .law_forces import TIGHT, force_beside, held, parameters, seen
from .layout import WIDTH, layout
from .linear import U, number

ROUNDS = 40  # largest number of rounds of bracketing, law by law
GOOD = 1e-6  # relative error of a force below which a step counts as solved


def newton(mats, own, ints, state, l):
    """Solve for the forces of all laws of lane l at once: Newton steps with one-sided slopes, shortened until
    the error decreases.

    The result is accepted if the laws agree with it to `GOOD`; otherwise the state of the lane becomes NaN.
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
            state[U(step + j)] = state[U((at.answer + j) * WIDTH + l)] - f
            away = 1e-7 if turn % 2 == 0 else -1e-7  # alternate sides of a kink
            by_d, by_s, stick = slopes(mats, own, ints, state, j, l, away)
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
                state[U((at.acting + j) * WIDTH + l)] = (
                    state[U(start + j)] + share * state[U(step + j)]
                )
            error, which = answers(mats, own, ints, state, l)
            if error < worst:
                break
            share *= 0.5
        if (
            not error < worst
        ):  # no descent: a cautious step towards the answers of the laws
            for j in range(nl):
                state[U((at.acting + j) * WIDTH + l)] = state[U(start + j)]
            answers(mats, own, ints, state, l)
            for j in range(nl):
                answer = state[U((at.answer + j) * WIDTH + l)]
                state[U((at.acting + j) * WIDTH + l)] += (0.5 if turn % 3 else 0.05) * (
                    answer - state[U(start + j)]
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
        worst, who = bracketed(mats, own, ints, state, l)
        if worst < least:
            least, last = worst, who
    if not least <= GOOD:
        for j in range(nl):
            state[U((at.acting + j) * WIDTH + l)] = math.nan
        if state[U(at.failed * WIDTH + l)] == 0.0:
            state[U(at.failed * WIDTH + l)] = -1.0  # in this step
            state[U((at.failed + 1) * WIDTH + l)] = last


def slopes(mats, own, ints, state, j, l, away):
    """Return the slopes of law j of lane l: of a smooth law by elongation and rate, of friction that sticks by its rate.

    Differences of a smooth law are to the side of the sign of `away`, the relative distance.
    """
    at = layout(ints)
    n, nl = at.states, at.laws
    answer = state[U((at.answer + j) * WIDTH + l)]
    if j < at.smooth:
        dd = away * (1e-3 + abs(seen(mats, own, at, state, n + j, l, -1)))
        ds = away * (1e-2 + abs(seen(mats, own, at, state, n + nl + j, l, -1)))
        by_d = (force_beside(mats, own, ints, state, j, l, dd, 0.0)[0] - answer) / dd
        by_s = (force_beside(mats, own, ints, state, j, l, 0.0, ds)[0] - answer) / ds
        return by_d, by_s, 0.0
    gain = number(mats, own, at.gains + j * at.rows + n + j, l)
    if gain < 0.0 and abs(answer) < state[U((at.tried + j) * WIDTH + l)]:
        return 0.0, 0.0, -1.0 / gain
    return 0.0, 0.0, 0.0


def bracketed(mats, own, ints, state, l):
    """Solve for the forces of lane l law by law, by bisection between a too small and a too large force; return
    the result of `answers`.

    Slow, and safe for laws that resist motion, even with jumps: the force of a damped stop on a terminal
    without mass lies at the instant of contact. Friction follows without the effect of a reversal within the
    step.
    """
    at = layout(ints)
    nl, ns = at.laws, at.smooth
    worst, who = math.inf, 0
    for _ in range(ROUNDS):
        for j in range(ns, nl):
            state[U((at.acting + j) * WIDTH + l)] = resting(
                mats, own, ints, state, j, l
            )
        for j in range(ns):
            force = U((at.acting + j) * WIDTH + l)
            low = high = state[force]
            reach = 1.0 + abs(low)
            if excess(mats, own, ints, state, j, l) > 0.0:
                while reach < 1e15:
                    high += reach
                    reach *= 4.0
                    state[force] = high
                    if not excess(mats, own, ints, state, j, l) > 0.0:
                        break
                    low = high
            else:
                while reach < 1e15:
                    low -= reach
                    reach *= 4.0
                    state[force] = low
                    if not excess(mats, own, ints, state, j, l) < 0.0:
                        break
                    high = low
            for _ in range(120):
                state[force] = middle = 0.5 * (low + high)
                if not low < middle < high:
                    break
                if excess(mats, own, ints, state, j, l) > 0.0:
                    low = middle
                else:
                    high = middle
            excess(mats, own, ints, state, j, l)
        worst, who = answers(mats, own, ints, state, l)
        if worst <= TIGHT:
            break
    return worst, who


def excess(mats, own, ints, state, j, l):
    """Return the answer of smooth law j of lane l minus its acting force; the single friction follows."""
    at = layout(ints)
    if at.laws - at.smooth == 1:
        state[U((at.acting + at.smooth) * WIDTH + l)] = resting(
            mats, own, ints, state, at.smooth, l
        )
    return (
        force_beside(mats, own, ints, state, j, l, 0.0, 0.0)[0]
        - state[U((at.acting + j) * WIDTH + l)]
    )


def resting(mats, own, ints, state, j, l):
    """Return dry friction j of lane l against the other forces, without the effect of a reversal within the step, which jumps."""
    at = layout(ints)
    row = at.states + j
    gain = number(mats, own, at.gains + j * at.rows + row, l)
    rate, level = (
        seen(mats, own, at, state, row, l, j),
        state[U((at.tried + j) * WIDTH + l)],
    )
    return held(0, parameters(mats, own, at, j, l), rate, gain, level, 0.0, 0.0, False)


def answers(mats, own, ints, state, l):
    """Write the answers of all laws of lane l to the acting forces; return the largest relative difference and its law."""
    at = layout(ints)
    n, nl, ns = at.states, at.laws, at.smooth
    worst, who = 0.0, 0
    for j in range(nl):
        f, row = state[U((at.acting + j) * WIDTH + l)], n + j
        if j < ns:
            now, z = force_beside(mats, own, ints, state, j, l, 0.0, 0.0)
            state[U((at.coming + j) * WIDTH + l)] = z
        else:
            now = resting(mats, own, ints, state, j, l)
        state[U((at.answer + j) * WIDTH + l)] = now
        error = abs(now - f) / (1.0 + abs(f))
        if error > TIGHT and j < ns:
            # a law with a jump (a damped stop at contact) has any force within the jump
            least, most = now, now
            for side in range(2):
                near = (1.0 if side == 0 else -1.0) * 1e-9
                dd = near * (1e-3 + abs(seen(mats, own, at, state, row, l, -1)))
                ds = near * (1e-3 + abs(seen(mats, own, at, state, row + nl, l, -1)))
                there = force_beside(mats, own, ints, state, j, l, dd, ds)[0]
                least, most = min(least, there), max(most, there)
            if least <= f <= most:
                error = 0.0
        if not error <= worst:
            worst, who = error, j
    return worst, who


def eliminate(numbers, matrix, right, n):
    """Solve a small system of linear equations in place (rows contiguous), with pivoting."""
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(numbers[U(matrix + i * n + k)]) > abs(
                numbers[U(matrix + best * n + k)]
            ):
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
