"""Steps, and loops over steps: records (`record`), a few steps of many lanes (`advance`), outputs (`measure`)."""

from __future__ import annotations

import numpy as np

from .contact import contact
from .lanes import fused, load, select, spread, store
from .layout import CONTACT, WIDTH, layout
from .linear import U, clip, pooled, sums, take
from .solve import at_once, solved


def march(
    mats, own, at, ints, state, u, c, u_at, c_at, steps, width, first, count, now
):
    """Run a group of `count` lanes in place for `steps` steps, the first of which has number `now`.

    u (.., m, width) from row u_at and c (.., nc, width) from row c_at are flat. With `width` 1 all lanes
    share the inputs; otherwise the inputs of the group start at `first`.
    """
    m, nc, nl = at.inputs, at.currents, at.laws
    for k in range(steps):
        for j in range(2 * m):
            take(state, at.start + j, u, (u_at + k) * m + j, width, first, count)
        for j in range(nc):
            take(state, at.current + j, c, (c_at + k) * nc + j, width, first, count)
        for j in range(nl * at.differ):
            store(
                state, (at.last + j) * WIDTH, load(state, (at.elongation + j) * WIDTH)
            )
        if at.way == CONTACT:
            contact(mats, own, at, state)
        else:
            sums(
                mats, own, at.matrix, at.rows, at.step_columns, state, at.step, at.rows
            )
            solved(mats, own, ints, state, count, now + k)


def outputs(mats, own, at, ints, state, count):
    """Write the present outputs into their rows of the state; the forces of the laws are the forces between the steps.

    If friction or a current moves the terminals of a law instantly (`instant`: massless terminals), the
    forces at the end of the step do not belong to one instant: friction acted in the mean over the step, and
    the current has just changed. In this case the forces are solved again for the instant.
    """
    sums(mats, own, at.out, at.out_rows, at.columns, state, at.outcome, at.out_rows)
    if at.instant:
        if at.way == CONTACT:
            rate, gain = (
                load(state, (at.outcome + at.outputs + at.laws) * WIDTH),
                spread(0.0),
            )
            for j in range(at.laws):  # one friction
                old = load(state, (at.force + j) * WIDTH)
                column = at.out + (at.force + j) * at.out_rows
                gain = pooled(mats, own, column + at.outputs + at.laws)
                still = select(gain < 0.0, fused(-gain, old, rate) / -gain, old)
                change = clip(still, pooled(mats, own, at.level)) - old
                for i in range(at.outputs):
                    to = (at.outcome + i) * WIDTH
                    store(
                        state,
                        to,
                        fused(pooled(mats, own, column + i), change, load(state, to)),
                    )
        else:
            at_once(mats, own, ints, state, count)


def pool_of(mats, own, at, group):
    """Return the numbers of a group."""
    return (
        mats[group * at.size * WIDTH : (group + 1) * at.size * WIDTH] if own else mats
    )


def record(mats, ints, states, u, c, every, width, lanes, out):
    """Run a whole record: flat u (N*every+1, m, width) and c (N*every, nc, width); lanes share inputs if width is 1.

    out (N+1, ny, lanes) receives the outputs at every `every`-th step. `states` are the states of the groups,
    contiguous.
    """
    at = layout(ints)
    own = mats.shape[0] != at.size
    m, nc, ny = at.inputs, at.currents, at.outputs
    size = at.height * WIDTH
    last = c.shape[0] // max(nc * width, 1) - 1
    for group in range((lanes + WIDTH - 1) // WIDTH):
        first = group * WIDTH
        count = min(WIDTH, lanes - first)
        pool, state = (
            pool_of(mats, own, at, group),
            states[group * size : (group + 1) * size],
        )
        for j in range(m):  # before the first step
            take(state, at.end + j, u, j, width, first, count)
        for k in range(out.shape[0]):
            if k > 0:
                begin = (k - 1) * every
                march(
                    pool,
                    own,
                    at,
                    ints,
                    state,
                    u,
                    c,
                    begin,
                    begin,
                    every,
                    width,
                    first,
                    count,
                    begin + 1,
                )
            for j in range(nc):  # a current acts from its sample onwards
                take(
                    state,
                    at.current + j,
                    c,
                    min(k * every, last) * nc + j,
                    width,
                    first,
                    count,
                )
            outputs(pool, own, at, ints, state, count)
            for i in range(ny):
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
        pool = pool_of(pools, own, at, group)
        march(
            pool,
            own,
            at,
            ints,
            work,
            flat_u,
            flat_c,
            0,
            0,
            u.shape[0] - 1,
            lanes,
            first,
            count,
            1,
        )
        for i in range(at.scratch):
            for l in range(count):
                state[i, first + l] = work[U(i * WIDTH + l)]


def measure(mats, ints, state, u, c, lanes, out):
    """Write the present outputs into out (ny, lanes) from u (m, lanes) and c (nc, lanes)."""
    at = layout(ints)
    pools, own = mats.reshape(-1), mats.size != at.size
    work = np.zeros(at.height * WIDTH)
    for group in range((lanes + WIDTH - 1) // WIDTH):
        first = group * WIDTH
        count = min(WIDTH, lanes - first)
        for l in range(count):
            for j in range(at.inputs):
                state[at.end + j, first + l] = u[j, first + l]
            for j in range(at.currents):
                state[at.current + j, first + l] = c[j, first + l]
            for i in range(at.scratch):
                work[U(i * WIDTH + l)] = state[i, first + l]
        outputs(pool_of(pools, own, at, group), own, at, ints, work, count)
        for i in range(at.outputs):
            for l in range(count):
                out[i, first + l] = work[U((at.outcome + i) * WIDTH + l)]
