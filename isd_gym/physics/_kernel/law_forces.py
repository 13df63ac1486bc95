"""Force of a law, and one secant step: dry friction `held` or sliding, smooth laws by their functions."""

from __future__ import annotations

from .layout import WIDTH, layout
from .linear import U, number

TIGHT = 1e-9  # relative change of a force below which a law has converged


def law_force(which, p, d, v, d_last, z, h):
    """Return the force [N] and the next memory of smooth law `which`; replaced by the registered laws in `compiled`."""
    return 0.0, z


def law_bound(which, p, d, v):
    """Return the bound [N] of dry friction `which`; replaced by the registered laws in `compiled`."""
    return 0.0


def parameters(mats, own, at, j, l):
    """Return the parameters of law j in lane l."""
    begin = (
        at.own * WIDTH + (l * at.laws + j) * at.parameters
        if own
        else at.own + j * at.parameters
    )
    return mats[begin : begin + at.parameters]


def seen(mats, own, at, state, row, l, skip):
    """Return row `row` of the step in lane l with the forces of all laws except `skip`."""
    s = state[U((at.step + row) * WIDTH + l)]
    for i in range(at.laws):
        if i != skip:
            s += (
                number(mats, own, at.gains + i * at.rows + row, l)
                * state[U((at.acting + i) * WIDTH + l)]
            )
    return s


def held(kind, p, rate, gain, level, d, was, slides):
    """Return the mean force over the step of a dry friction whose rate [m/s] without friction is `rate`, and `was` at the start.

    `gain` [m/(N s)] is the rate per force. The friction holds if possible. If it slides at the end of the
    step, the force is the mean bound over the step, with the old sign up to the instant of reversal, so that
    a step with a reversal is of second order, too (except if the rate is only a difference: `slides` false).
    """
    if gain >= 0.0:  # prescribed motion: no yielding
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


def force_beside(mats, own, ints, state, j, l, dd, ds):
    """Return force and next memory of smooth law j of lane l under the acting forces, with elongation and rate
    changed by dd and ds."""
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


def update_friction(mats, own, ints, state, j, l):
    """Update dry friction j of lane l for the sliding under the other forces; return 1 if the force changed."""
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
    """Run a secant step of smooth law j of lane l, with the single dry friction; return 1 if the force changed."""
    at = layout(ints)
    n, nl, ns = at.states, at.laws, at.smooth
    single = nl - ns == 1
    k = at.acting + j
    # elongation, rate, and the rate at the single friction, from the forces at the end of the step
    d, s, e = (
        state[U((at.first + j) * WIDTH + l)],
        state[U((at.other + j) * WIDTH + l)],
        0.0,
    )
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
        # secant: step = r / (1 - slope); a law that resists motion has a negative slope
        span = f - state[U((at.tried + j) * WIDTH + l)]
        change = now - state[U((at.answer + j) * WIDTH + l)]
        # alone, the law includes the following friction; among many laws, each uses only its own share of the
        # change
        share = number(mats, own, at.gains + j * at.rows + n + nl + j, l) * span
        whole = s - state[U((at.tried_rate + j) * WIDTH + l)]
        if ns > 1 and abs(whole) > 0.1 * abs(share):
            change *= share / whole
        rest = span - change
        if span != 0.0:
            guess = span / rest if span * rest > 0.05 * span * span else 1.0
            # after many sweeps the factor only decreases, so that kinks cannot cause a cycle
            factor = guess if sweep < 20 else min(guess, factor)
            state[U((at.factor + j) * WIDTH + l)] = factor
    state[U((at.tried + j) * WIDTH + l)] = f
    state[U((at.answer + j) * WIDTH + l)] = now
    state[U((at.coming + j) * WIDTH + l)] = z
    state[U((at.tried_rate + j) * WIDTH + l)] = s
    if abs(r) <= TIGHT * (1.0 + abs(f)):
        return 0
    state[U(k * WIDTH + l)] = f + r * (factor if factor > 0.0 else 1.0)
    return 1
