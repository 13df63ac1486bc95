"""A step in closed form and without branches: at most one stop (or play) and one constant friction, the car's case."""

from __future__ import annotations

from .lanes import fused, load, select, some, spread, store
from .layout import CONTACT, WIDTH
from .linear import U, clip, pooled


def touch(mats, own, at, state):
    """End a step of at most one stop (or play) and one constant friction, which may stick.

    Clear of the stop the friction is ``clip(-r / g)``. On it, the force of the stop is linear in the friction; with it
    put in, so is the rate, and the friction a clip again. A stop that would pull is not touched.
    """
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
    apply(mats, own, at, state, push, friction)


def apply(mats, own, at, state, push, friction):
    """States, and what tells a quiet car of each law, with the forces that were found of the stop and of the friction."""
    n, nl, ns = at.states, at.laws, at.smooth
    stop, rub = at.gains, at.gains + ns * at.rows
    pushes, rubs = ns > 0 and at.way == CONTACT and some(push != 0.0), nl > ns
    if own:
        for i in range(n):
            x = load(state, (at.step + i) * WIDTH)
            if rubs:
                x = fused(load(mats, (rub + i) * WIDTH), friction, x)
            if pushes:
                x = fused(load(mats, (stop + i) * WIDTH), push, x)
            store(state, i * WIDTH, x)
    else:
        for i in range(n):
            x = load(state, (at.step + i) * WIDTH)
            if rubs:
                x = fused(spread(mats[U(rub + i)]), friction, x)
            if pushes:
                x = fused(spread(mats[U(stop + i)]), push, x)
            store(state, i * WIDTH, x)
    for i in range(n, n + nl):
        x = load(state, (at.step + i) * WIDTH)
        if rubs:
            x = fused(pooled(mats, own, rub + i), friction, x)
        if pushes:
            x = fused(pooled(mats, own, stop + i), push, x)
        store(state, ((at.elongation if i < n + ns else at.rate) + i - n) * WIDTH, x)
