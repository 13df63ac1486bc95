"""A step in closed form and without branches: devices with at most one stop (or play) and one constant friction each.

A car has one device at each corner. The devices hardly interact within a step: the effect of a device's force
on another device is below a millionth of the effect on the device itself, and is computed from the known
forces.
"""

from __future__ import annotations

from .lanes import fused, load, select, some, spread, store
from .layout import CLOSED, CONTACT, WIDTH
from .linear import U, clip, pooled, sums


def contact(mats, own, at, state):
    """Run a step with at most one device."""
    sums(mats, own, at.matrix, at.rows, at.step_columns, state, at.step, at.rows)
    push, friction = touch(mats, own, at, state, 0)
    apply(mats, own, at, state, push, friction)


def contacts(mats, own, at, state):
    """Run a step with several devices, in place of `contact`.

    Columns of stops without contact, and rows that only a stop in contact needs, are left out of the linear
    part. Each device uses the other devices' forces of the last step; the states use all forces of this step.
    """
    n, nl, ns = at.states, at.laws, at.smooth
    pushes = False
    for j in range(ns):
        pushes = pushes or some(load(state, (at.force + j) * WIDTH) != 0.0)
    columns = at.step_columns if pushes else at.step_columns - ns
    sums(mats, own, at.matrix, at.rows, columns, state, at.step, (n + nl + 3) // 4 * 4)
    for i in range(nl):
        store(
            state,
            (at.first + i) * WIDTH,
            among_others(mats, own, at, state, n + i, i if i < ns else i - ns, pushes),
        )
    for p in range(at.devices):
        push, friction = touch(mats, own, at, state, p)
        if p < ns:
            store(state, (at.acting + p) * WIDTH, push)
            pushes = pushes or some(push != 0.0)
        if ns + p < nl:
            store(state, (at.acting + ns + p) * WIDTH, friction)
    begin, i = 0 if pushes else ns, 0
    while i + 4 <= n:
        a, b = (
            load(state, (at.step + i) * WIDTH),
            load(state, (at.step + i + 1) * WIDTH),
        )
        c, d = (
            load(state, (at.step + i + 2) * WIDTH),
            load(state, (at.step + i + 3) * WIDTH),
        )
        k = at.gains + begin * at.rows + i
        for j in range(begin, nl):
            x = load(state, (at.acting + j) * WIDTH)
            a = fused(pooled(mats, own, k), x, a)
            b = fused(pooled(mats, own, k + 1), x, b)
            c = fused(pooled(mats, own, k + 2), x, c)
            d = fused(pooled(mats, own, k + 3), x, d)
            k += at.rows
        store(state, i * WIDTH, a)
        store(state, (i + 1) * WIDTH, b)
        store(state, (i + 2) * WIDTH, c)
        store(state, (i + 3) * WIDTH, d)
        i += 4
    while i < n:
        x = load(state, (at.step + i) * WIDTH)
        for j in range(begin, nl):
            x = fused(
                pooled(mats, own, at.gains + j * at.rows + i),
                load(state, (at.acting + j) * WIDTH),
                x,
            )
        store(state, i * WIDTH, x)
        i += 1
    for i in range(nl):
        p = i if i < ns else i - ns
        x = load(state, (at.first + i) * WIDTH)
        if ns + p < nl:
            gain = pooled(mats, own, at.gains + (ns + p) * at.rows + n + i)
            x = fused(gain, load(state, (at.acting + ns + p) * WIDTH), x)
        if pushes and p < ns:
            x = fused(
                pooled(mats, own, at.gains + p * at.rows + n + i),
                load(state, (at.acting + p) * WIDTH),
                x,
            )
        store(state, ((at.elongation if i < ns else at.rate) + i) * WIDTH, x)


def among_others(mats, own, at, state, row, p, pushes):
    """Return a row of the step with the forces of all devices except p in the last step."""
    ns = at.smooth
    x = load(state, (at.step + row) * WIDTH)
    for j in range(0 if pushes else ns, at.laws):
        if j != p and j != ns + p:
            x = fused(
                pooled(mats, own, at.gains + j * at.rows + row),
                load(state, (at.force + j) * WIDTH),
                x,
            )
    return x


def beside(mats, own, at, state, p):
    """Return the rate of stop p without the forces of its device."""
    return load(state, (at.other + p) * WIDTH)


def beside_others(mats, own, at, state, p):
    """Return the rate of stop p in place of `beside`, for rows that `contacts` left out."""
    row, x = at.states + at.laws + p, spread(0.0)
    for j in range(at.step_columns):
        x = fused(
            pooled(mats, own, at.matrix + j * at.rows + row), load(state, j * WIDTH), x
        )
    store(state, (at.step + row) * WIDTH, x)
    return among_others(mats, own, at, state, row, p, True)


def touch(mats, own, at, state, p):
    """Return the forces of the stop (or play) and of the constant friction of device p; the friction may stick.

    Without contact, the friction is ``clip(-r / g)``. In contact, the force of the stop is linear in the
    friction; after substitution the rate is linear, too, and the friction is a clip again. A stop that would
    pull is out of contact.
    """
    n, nl, ns = at.states, at.laws, at.smooth
    closed, stop, dry = CLOSED * p, p, ns + p
    friction, push = spread(0.0), spread(0.0)
    level, rate = spread(0.0), spread(0.0)
    rubs = nl > dry
    if rubs:
        level = pooled(mats, own, at.level + closed)
        rate = load(state, (at.first + dry) * WIDTH)
        friction = clip(rate * pooled(mats, own, at.give + closed), level)
    if ns > stop:
        upper, lower = (
            pooled(mats, own, at.upper + closed),
            pooled(mats, own, at.lower + closed),
        )
        free, yields = load(state, (at.first + stop) * WIDTH), spread(0.0)
        if rubs:
            yields = pooled(mats, own, at.gains + dry * at.rows + n + stop)
        place = fused(yields, friction, free)
        meets = (place > upper) | (place < lower)
        if some(meets):
            extended = place > 0.0
            beyond = free - select(extended, upper, lower)
            alone = beyond * pooled(mats, own, at.per_elongation + closed)
            alone = fused(
                beside(mats, own, at, state, p),
                pooled(mats, own, at.per_rate + closed),
                alone,
            )
            shared = pooled(mats, own, at.per_friction + closed)
            held, slip, own_slip = friction, spread(0.0), spread(0.0)
            if rubs:
                slip = pooled(
                    mats, own, at.gains + stop * at.rows + n + dry
                )  # effect of the stop on the sliding
                own_slip = pooled(mats, own, at.gains + dry * at.rows + n + dry)
                held = clip(
                    fused(slip, alone, rate)
                    * pooled(mats, own, at.give_stopped + closed),
                    level,
                )
            force = fused(shared, held, alone)
            touches = meets & (select(extended, force, -force) > 0.0)
            friction = select(touches, held, friction)
            push = select(touches, force, push)
            # a damped stop pushes from the instant of contact; if it would at once push itself clear, the
            # stop is only just met
            own_yield = pooled(mats, own, at.gains + stop * at.rows + n + stop)
            limit = select(extended, upper, lower)
            rest = fused(yields, friction, free) - limit
            gap = fused(own_yield, push, rest)
            short = touches & (select(extended, gap, -gap) < 0.0)
            if some(short):
                push = select(short, -rest / own_yield, push)
            if rubs:
                # if the sliding reverses within the step, friction has the old sign up to the reversal
                was = load(state, (at.rate + dry) * WIDTH)
                end = fused(own_slip, friction, fused(slip, push, rate))
                turns = touches & ~short & (abs(friction) >= level) & (was * end < 0.0)
                if some(turns):
                    bound = friction
                    for _ in range(3):
                        part = select(was * end < 0.0, was / (was - end), spread(0.0))
                        friction = select(turns, bound * (1.0 - 2.0 * part), friction)
                        push = select(turns, fused(shared, friction, alone), push)
                        push = select(
                            turns & (select(extended, push, -push) <= 0.0),
                            spread(0.0),
                            push,
                        )
                        end = fused(own_slip, friction, fused(slip, push, rate))
                    # the acting force was a mean over the step; outputs use the force at its end
                    seen = select(end > 0.0, level, -level)
                    store(
                        state,
                        (at.force + dry) * WIDTH,
                        select(turns & (abs(end) > 1e-9), seen, friction),
                    )
                else:
                    store(state, (at.force + dry) * WIDTH, friction)
        elif rubs:
            store(state, (at.force + dry) * WIDTH, friction)
        store(state, (at.force + stop) * WIDTH, push)
    elif rubs:
        store(state, (at.force + dry) * WIDTH, friction)
    return push, friction


def apply(mats, own, at, state, push, friction):
    """Update states, and the signals by which a quiet car is recognised, with the forces of the stop and of the friction."""
    n, nl, ns = at.states, at.laws, at.smooth
    stop, friction_row = at.gains, at.gains + ns * at.rows
    pushes, rubs = ns > 0 and at.way == CONTACT and some(push != 0.0), nl > ns
    if own:
        for i in range(n):
            x = load(state, (at.step + i) * WIDTH)
            if rubs:
                x = fused(load(mats, (friction_row + i) * WIDTH), friction, x)
            if pushes:
                x = fused(load(mats, (stop + i) * WIDTH), push, x)
            store(state, i * WIDTH, x)
    else:
        for i in range(n):
            x = load(state, (at.step + i) * WIDTH)
            if rubs:
                x = fused(spread(mats[U(friction_row + i)]), friction, x)
            if pushes:
                x = fused(spread(mats[U(stop + i)]), push, x)
            store(state, i * WIDTH, x)
    for i in range(n, n + nl):
        x = load(state, (at.step + i) * WIDTH)
        if rubs:
            x = fused(pooled(mats, own, friction_row + i), friction, x)
        if pushes:
            x = fused(pooled(mats, own, stop + i), push, x)
        store(state, ((at.elongation if i < n + ns else at.rate) + i - n) * WIDTH, x)
