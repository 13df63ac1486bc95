"""The one compiled kernel: single cars, batches and long records all run through `advance`.

A step of length h is exact in the linear part (matrix exponential, inputs linear over the step, currents held).
Dry friction is set-valued and projected (Moreau, time stepping at velocity level: Acary and Brogliato, Springer
2008): its force is the one within its bound that stops the sliding, or the bound. Smooth laws enter as a force that
is linear over the step with its end value found implicitly (second order). Several laws that see one another are
solved by Gauss-Seidel sweeps.

Cars are *lanes*: the last axis of every array, so that one instruction works on many of them; a single car is one
lane. No operation is reordered between lanes, so a car in a batch is the same car alone, to the last bit.

The kernel is compiled in three variants: for `one` lane, for lanes that `share` their matrices, and for lanes each with
its `own`. Compiled code is cached on disk under a key made of the sources, so an upgrade never runs yesterday's physics.

A plant's numbers are a pool `mats` (R, 1 or lanes) and `state` (.., lanes), both flat inside the kernel. Laws are sorted,
smooth ones first. `sizes` in front of `ints`: n states, m inputs, nc currents, nl laws, ns of them smooth, whether the
quiet way is open, ny outputs, `rows` and `cols` of a step, whether a law's rate is a difference of its elongations.

| rows of `state` | |
|---|---|
| cols | what a step reads: x, inputs at its start and end, currents, forces, elongations (where rates are differences) |
| rows | what a step makes of it before the new forces act: x, then of every law what a quiet car needs (elongation of a smooth law, rate of a dry one), then of every law the other of the two |
| 9 nl | of every law: force, state z, elongation, rate; factor of the secant, force as it was tried (dry: its bound), what the law said to it, the next z, rate as it was tried |
| 3 | lanes in which laws act, those that are not settled yet, whether a lane moved |

| numbers of `mats` | |
|---|---|
| 1 | the step h [s] |
| cols x rows | the matrix of a step, column by column |
| nl x rows | what the forces at the end of the step add |
| 4 nl, nl | parameters of the laws; |elongation| below which a smooth law rests, yield of a dry one |
| cols x ny | the outputs, column by column (ny filled up to a multiple of 8) |
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

LAW_PARAMETERS = 4  # numbers a law may read
U = nb.uintp  # an unsigned index spares the code for negative ones


# ------------------------------------------------------------------------------------- law dispatch


def _chain(functions: Sequence[Callable], fallback: Callable) -> Callable:
    """One compiled function that calls functions[code]."""
    out: Callable = nb.njit(error_model="numpy")(fallback)
    for code, function in reversed(list(enumerate(functions))):
        out = _link(code, nb.njit(error_model="numpy")(function), out)
    return out


def _link(code: int, this: Callable, rest: Callable) -> Callable:
    @nb.njit(error_model="numpy")
    def dispatch(which, *args):
        if which == code:
            return this(*args)
        return rest(which, *args)

    return dispatch


def _no_law(which, p, d, v, d_last, z, h):
    return 0.0, z


def _no_bound(which, p, d, v):
    return 0.0


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
    # as resources: the package may lie in a zip
    parts = sorted(resources.files(el.__name__).iterdir(), key=lambda f: f.name)
    code = [f for f in parts if f.name.endswith(".py")]
    digest = hashlib.sha256()
    for file in (resources.files(__package__) / "kernel.py", *code):
        digest.update(file.read_bytes())
    for name, law in laws:
        digest.update(name.encode() + law.__code__.co_code + repr(law.__code__.co_consts).encode())
    return int.from_bytes(digest.digest()[:6], "big")


# ------------------------------------------------------------------------------------------- road noise

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S16, _S32, _S48 = (np.uint64(i) for i in (30, 27, 31, 16, 32, 48))
_LOW = np.uint64(0xFFFF)
_MEAN = 4 * 65535 / 2
_SIGMA = math.sqrt(4 * (65536.0**2 - 1) / 12)


@nb.njit(inline="always")
def noise(counter):
    """A zero-mean, unit-variance number from a counter: four 16-bit uniforms of one SplitMix64 word, summed.

    Nearly normal (excess kurtosis -0.3); the road is a sum of thousands of them, hence normal.
    """
    w = counter
    w = (w ^ (w >> _S30)) * _MIX_1
    w = (w ^ (w >> _S27)) * _MIX_2
    w = w ^ (w >> _S31)
    total = (
        np.int64(w & _LOW) + np.int64((w >> _S16) & _LOW) + np.int64((w >> _S32) & _LOW) + np.int64(w >> _S48)
    )
    return (np.float64(total) - _MEAN) / _SIGMA


@nb.njit(error_model="numpy")
def road_noise(seed, gain, pole, start, out):
    """Fill `out` with the rough road of one car [m], continuing from counter `seed` and height `start`."""
    r, counter = start, seed
    for k in range(out.shape[0]):
        counter = counter + _GOLDEN
        r = pole * r + gain * noise(counter)
        out[k] = r
    return counter


@nb.njit(error_model="numpy", cache=True)
def preview(rings, begin, heights, out):
    """Road ahead of cars relative to their `heights` [m]: out (N, points); rings (N, >= points) begin at `begin`."""
    size, count = rings.shape[1], out.shape[1]
    first = min(size - begin, count)
    for e in range(out.shape[0]):
        height = heights[e]
        for i in range(first):
            out[e, i] = rings[e, begin + i] - height
        for i in range(count - first):
            out[e, first + i] = rings[e, i] - height


# --------------------------------------------------------------------------------------------- kernel

law_force: Callable  # made of the laws that are registered when the kernel is compiled
law_bound: Callable
ONE = False  # compiled with True for a single lane: its matrices, states and inputs are plain vectors
OWN = False  # compiled with True where every lane has matrices of its own


def sums(mats, at, stride, cols, state, src, dst, rows, lanes):
    """Rows `dst`... of the state = a matrix, stored column by column, times its rows `src`... .

    Every row is summed in the order of its columns, however many lanes there are. `stride` is a multiple of 8 and
    `cols` of 4; up to 7 rows more than asked for may be written.
    """
    if ONE:  # eight rows at once
        for i in range(0, rows, 8):
            a0, a1, a2, a3, a4, a5, a6, a7 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            b = at + i
            for j in range(cols):
                v = state[U(src + j)]
                a0 += mats[U(b)] * v
                a1 += mats[U(b + 1)] * v
                a2 += mats[U(b + 2)] * v
                a3 += mats[U(b + 3)] * v
                a4 += mats[U(b + 4)] * v
                a5 += mats[U(b + 5)] * v
                a6 += mats[U(b + 6)] * v
                a7 += mats[U(b + 7)] * v
                b += stride
            o = dst + i
            state[U(o)] = a0
            state[U(o + 1)] = a1
            state[U(o + 2)] = a2
            state[U(o + 3)] = a3
            state[U(o + 4)] = a4
            state[U(o + 5)] = a5
            state[U(o + 6)] = a6
            state[U(o + 7)] = a7
        return
    w = lanes if OWN else 1
    for i in range(0, rows, 2):  # two rows by four columns at once
        y0 = state[(dst + i) * lanes : (dst + i + 1) * lanes]
        y1 = state[(dst + i + 1) * lanes : (dst + i + 2) * lanes]
        for j in range(0, cols, 4):
            b = at + j * stride + i
            x0 = state[(src + j) * lanes : (src + j + 1) * lanes]
            x1 = state[(src + j + 1) * lanes : (src + j + 2) * lanes]
            x2 = state[(src + j + 2) * lanes : (src + j + 3) * lanes]
            x3 = state[(src + j + 3) * lanes : (src + j + 4) * lanes]
            m00, m01 = mats[b * w : (b + 1) * w], mats[(b + 1) * w : (b + 2) * w]
            b += stride
            m10, m11 = mats[b * w : (b + 1) * w], mats[(b + 1) * w : (b + 2) * w]
            b += stride
            m20, m21 = mats[b * w : (b + 1) * w], mats[(b + 1) * w : (b + 2) * w]
            b += stride
            m30, m31 = mats[b * w : (b + 1) * w], mats[(b + 1) * w : (b + 2) * w]
            if OWN:
                if j == 0:
                    for l in range(lanes):
                        y0[l] = 0.0 + m00[l] * x0[l] + m10[l] * x1[l] + m20[l] * x2[l] + m30[l] * x3[l]
                        y1[l] = 0.0 + m01[l] * x0[l] + m11[l] * x1[l] + m21[l] * x2[l] + m31[l] * x3[l]
                else:
                    for l in range(lanes):
                        y0[l] = y0[l] + m00[l] * x0[l] + m10[l] * x1[l] + m20[l] * x2[l] + m30[l] * x3[l]
                        y1[l] = y1[l] + m01[l] * x0[l] + m11[l] * x1[l] + m21[l] * x2[l] + m31[l] * x3[l]
            else:
                a0, a1, a2, a3 = m00[0], m10[0], m20[0], m30[0]
                b0, b1, b2, b3 = m01[0], m11[0], m21[0], m31[0]
                if j == 0:
                    for l in range(lanes):
                        y0[l] = 0.0 + a0 * x0[l] + a1 * x1[l] + a2 * x2[l] + a3 * x3[l]
                        y1[l] = 0.0 + b0 * x0[l] + b1 * x1[l] + b2 * x2[l] + b3 * x3[l]
                else:
                    for l in range(lanes):
                        y0[l] = y0[l] + a0 * x0[l] + a1 * x1[l] + a2 * x2[l] + a3 * x3[l]
                        y1[l] = y1[l] + b0 * x0[l] + b1 * x1[l] + b2 * x2[l] + b3 * x3[l]


def solve(mats, ints, state, left, lanes):
    """Forces of all laws at the end of the step, of the `left` lanes in which laws act.

    Gauss-Seidel over the laws, a secant step in each; a single dry friction is eliminated: it follows the forces of
    the others at once. Lanes take turns, which keeps the processor busy: a visit is one long chain of operations.
    """
    lanes = 1 if ONE else lanes
    n, m, nc, nl, ns, rows, cols = ints[0], ints[1], ints[2], ints[3], ints[4], ints[7], ints[8]
    gap = nl * lanes
    f_at = (n + 2 * m + nc) * lanes
    # rows of the laws: force, state, elongation, rate; factor of the secant; force as it was tried, what the law said,
    # its next state, rate as it was tried
    laws = (cols + rows) * lanes
    acting = laws + 9 * gap  # lanes in which laws act, those that are not settled, whether a lane moved
    line, moved = acting + lanes, acting + 2 * lanes
    for i in range(left):
        l = int(state[U(acting + i)])
        state[U(line + i)] = l
        for j in range(nl):
            k = laws + j * lanes + l
            state[U(k)] = state[U(f_at + j * lanes + l)]
            if j >= ns:
                # the bound is that of the rate at the start of the step: a falling (Stribeck) curve taken at its end
                # would have several solutions
                p = numbers(mats, ints, j, l, lanes)
                state[U(k + 5 * gap)] = law_bound(
                    -1 - ints[U(10 + j)], p, state[U(k + 2 * gap)], state[U(k + 3 * gap)]
                )
    for sweep in range(200):
        for i in range(left):
            state[U(moved + int(state[U(line + i)]))] = 0.0
        if nl - ns > 1 or ns == 0:
            for j in range(ns, nl):
                for i in range(left):
                    rub(mats, ints, state, j, int(state[U(line + i)]), lanes)
        for j in range(ns):
            for i in range(left):
                push(mats, ints, state, sweep, j, int(state[U(line + i)]), lanes)
        keep = 0
        for i in range(left):
            l = int(state[U(line + i)])
            if state[U(moved + l)] > 0.0:
                state[U(line + keep)] = l
                keep += 1
        left = keep
        if left == 0:
            break


def numbers(mats, ints, j, l, lanes):
    """The parameters of law j of lane l."""
    w, a = (lanes, l) if OWN else (1, 0)
    b = (1 + ints[8] * ints[7] + ints[3] * ints[7] + j * LAW_PARAMETERS) * w + a
    return mats[U(b)], mats[U(b + w)], mats[U(b + 2 * w)], mats[U(b + 3 * w)]


def rub(mats, ints, state, j, l, lanes):
    """Dry friction j of lane l against the sliding that the other forces leave."""
    lanes = 1 if ONE else lanes
    w, a = (lanes, l) if OWN else (1, 0)
    n, nl, rows, cols = ints[0], ints[3], ints[7], ints[8]
    law = (cols + rows) * lanes + l
    k, gains = law + j * lanes, (1 + cols * rows + n + j) * w + a
    s = state[U((cols + n + j) * lanes + l)]
    for i in range(nl):
        if i != j:
            s += mats[U(gains + i * rows * w)] * state[U(law + i * lanes)]
    old, gap = state[U(k)], nl * lanes
    new = held(
        -1 - ints[U(10 + j)],
        numbers(mats, ints, j, l, lanes),
        s,
        mats[U(gains + j * rows * w)],
        state[U(k + 5 * gap)],
        state[U(k + 2 * gap)],
        state[U(k + 3 * gap)],
        ints[U(10 + nl + j)] == 0,
    )
    state[U(k)] = new
    if nl > 1 and abs(new - old) > 1e-9 * (1.0 + abs(new)):
        state[U(law + (9 * nl + 2) * lanes)] = 1.0


def push(mats, ints, state, sweep, j, l, lanes):
    """A secant step of smooth law j of lane l, and the single dry friction with it."""
    lanes = 1 if ONE else lanes
    w, a = (lanes, l) if OWN else (1, 0)
    n, nl, ns, rows, cols = ints[0], ints[3], ints[4], ints[7], ints[8]
    gap, column = nl * lanes, rows * w
    one = nl - ns == 1
    y, law = (cols + n) * lanes + l, (cols + rows) * lanes + l
    k = law + j * lanes
    # elongation, rate, and the rate at the single friction, as the forces at the end of the step make them
    gd = (1 + cols * rows + n + j) * w + a
    gs, ge = gd + nl * w, gd + (ns - j) * w
    d, s, e = state[U(y + j * lanes)], state[U(y + (nl + j) * lanes)], 0.0
    for i in range(ns if one else nl):
        f = state[U(law + i * lanes)]
        d += mats[U(gd + i * column)] * f
        s += mats[U(gs + i * column)] * f
        if one:
            e += mats[U(ge + i * column)] * f
    if one:
        r_at = law + ns * lanes
        t = held(
            -1 - ints[U(10 + ns)],
            numbers(mats, ints, ns, l, lanes),
            state[U(y + ns * lanes)] + e,
            mats[U(ge + ns * column)],
            state[U(r_at + 5 * gap)],
            state[U(r_at + 2 * gap)],
            state[U(r_at + 3 * gap)],
            ints[U(10 + nl + ns)] == 0,
        )
        d += mats[U(gd + ns * column)] * t
        s += mats[U(gs + ns * column)] * t
        state[U(r_at)] = t
    p = numbers(mats, ints, j, l, lanes)
    now, z = law_force(ints[U(10 + j)], p, d, s, state[U(k + 2 * gap)], state[U(k + gap)], mats[0])
    f, factor = state[U(k)], state[U(k + 4 * gap)]
    r = now - f
    if sweep > 0:
        # secant: step = r / (1 - slope); a law that resists motion has a slope below zero
        span, change = f - state[U(k + 5 * gap)], now - state[U(k + 6 * gap)]
        # alone, it also sees how the friction follows; one of many takes only its own share of the change
        share, whole = mats[U(gs + j * column)] * span, s - state[U(k + 8 * gap)]
        if ns > 1 and abs(whole) > 0.1 * abs(share):
            change *= share / whole
        rest = span - change
        if span != 0.0:
            guess = span / rest if span * rest > 0.05 * span * span else 1.0
            # many sweeps: only ever more careful, so that kinks cannot make it run in circles
            factor = guess if sweep < 20 else min(guess, factor)
            state[U(k + 4 * gap)] = factor
    state[U(k + 5 * gap)], state[U(k + 6 * gap)], state[U(k + 7 * gap)] = f, now, z
    state[U(k + 8 * gap)] = s
    if not abs(r) <= 1e-9 * (1.0 + abs(f)):
        state[U(k)] = f + r * (factor if factor > 0.0 else 1.0)
        if r == r:  # what is no number stays none
            state[U(law + (9 * nl + 2) * lanes)] = 1.0


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


def quiet(mats, ints, state, l, lanes):
    """Whether no law of lane l acts, and none has acted before, so that only its one friction counts."""
    lanes = 1 if ONE else lanes
    w, a = (lanes, l) if OWN else (1, 0)
    n, m, nc, nl, ns = ints[0], ints[1], ints[2], ints[3], ints[4]
    fast, rows, cols = ints[5], ints[7], ints[8]
    spans = 1 + cols * rows + nl * (rows + LAW_PARAMETERS)
    out = fast != 0
    for j in range(ns):
        out &= abs(state[U((cols + n + j) * lanes + l)]) <= mats[U((spans + j) * w + a)]
        out &= state[U((n + 2 * m + nc + j) * lanes + l)] == 0.0
    return out


def act(mats, ints, state, lanes):
    """Find the forces of the laws in those lanes in which they act; their number, and they in a row of the state."""
    lanes = 1 if ONE else lanes
    n, nl, fast, rows, cols = ints[0], ints[3], ints[5], ints[7], ints[8]
    if fast and not ONE:  # the rows that quiet cars leave out
        at = (n + nl) // 2 * 2
        sums(mats, 1 + at, rows, cols, state, 0, cols + at, n + 2 * nl - at, lanes)
    line = (cols + rows + 9 * nl) * lanes
    count = 0
    for l in range(lanes):
        if not quiet(mats, ints, state, l, lanes):
            state[U(line + count)] = l
            count += 1
    solve(mats, ints, state, count, lanes)
    return count


def finish(mats, ints, state, count, lanes):
    """End the step of the `count` lanes in which laws act."""
    lanes = 1 if ONE else lanes
    n, m, nc, nl, ns, rows, cols = ints[0], ints[1], ints[2], ints[3], ints[4], ints[7], ints[8]
    gains, gap, line = 1 + cols * rows, nl * lanes, (cols + rows + 9 * nl) * lanes
    for at in range(count):
        l = int(state[U(line + at)])
        w, a = (lanes, l) if OWN else (1, 0)
        law = (cols + rows) * lanes + l
        for i in range(n + 2 * nl):
            t = state[U((cols + i) * lanes + l)]
            for j in range(nl):
                t += mats[U((gains + j * rows + i) * w + a)] * state[U(law + j * lanes)]
            if i < n:
                state[U(i * lanes + l)] = t
            elif i < n + nl:  # elongations and rates; those of dry laws stand the other way round
                state[U(law + (2 if i < n + ns else 3) * gap + (i - n) * lanes)] = t
            else:
                state[U(law + (3 if i < n + nl + ns else 2) * gap + (i - n - nl) * lanes)] = t
        for j in range(nl):
            k = law + j * lanes
            f, s = state[U(k)], state[U(k + 3 * gap)]
            if j < ns:
                state[U(k + gap)] = state[U(k + 7 * gap)]
            elif ints[U(10 + nl + j)] == 0 and abs(s) > 1e-9:
                # what acted was a mean over the step; what outputs see is the force at its end
                f = law_bound(
                    -1 - ints[U(10 + j)], numbers(mats, ints, j, l, lanes), state[U(k + 2 * gap)], s
                )
                f = f if s > 0.0 else -f
            state[U((n + 2 * m + nc + j) * lanes + l)] = f


def march(mats, ints, state, u, c, u_at, c_at, steps, width, lanes):
    """Run `steps` steps in place; u (.., m, width) from row u_at and c (.., nc, width) from row c_at, flat.

    `width` is `lanes`, or 1 where all lanes have the same inputs.
    """
    lanes = 1 if ONE else lanes
    w, a = (lanes, 1) if OWN else (1, 0)
    n, m, nc, nl, ns = ints[0], ints[1], ints[2], ints[3], ints[4]
    fast, rows, cols = ints[5], ints[7], ints[8]
    f_at = n + 2 * m + nc
    last_d = cols + rows + 2 * nl
    gains = 1 + cols * rows
    params = gains + nl * rows
    quiet_at = params + nl * LAW_PARAMETERS
    hot = n + nl if fast and not ONE else n + 2 * nl
    differ = ints[9]
    narrow = ONE or width == 1
    for k in range(steps):
        for j in range(2 * m):
            if narrow:
                value = u[U((u_at + k) * m + j)]
                for l in range(lanes):
                    state[U((n + j) * lanes + l)] = value
            else:
                for l in range(lanes):
                    state[U((n + j) * lanes + l)] = u[U(((u_at + k) * m + j) * lanes + l)]
        for j in range(nc):
            if narrow:
                value = c[U((c_at + k) * nc + j)]
                for l in range(lanes):
                    state[U((n + 2 * m + j) * lanes + l)] = value
            else:
                for l in range(lanes):
                    state[U((n + 2 * m + j) * lanes + l)] = c[U(((c_at + k) * nc + j) * lanes + l)]
        for i in range(differ * nl * lanes):
            state[U((f_at + nl) * lanes + i)] = state[U(last_d * lanes + i)]
        sums(mats, 1, rows, cols, state, 0, cols, hot, lanes)
        busy, count = 1 - fast, 0
        if fast:
            for j in range(ns):
                d, f, q = (cols + n + j) * lanes, (f_at + j) * lanes, (quiet_at + j) * w
                span = mats[U(q)]
                for l in range(lanes):
                    if OWN:
                        span = mats[U(q + l)]
                    busy += (abs(state[U(d + l)]) > span) | (state[U(f + l)] != 0.0)
            if ns < nl:  # the friction of a quiet car
                s, f = (cols + n + ns) * lanes, (f_at + ns) * lanes
                top, yields = (params + ns * LAW_PARAMETERS) * w, (quiet_at + ns) * w
                level, give = mats[U(top)], mats[U(yields)]
                for l in range(lanes):
                    if OWN:
                        level, give = mats[U(top + l)], mats[U(yields + l)]
                    t = state[U(s + l)] * give
                    t = level if t > level else t
                    state[U(f + l)] = -level if t < -level else t
        if busy:
            count = act(mats, ints, state, lanes)
            if fast == 0:
                finish(mats, ints, state, count, lanes)
                continue
        f, g = (f_at + ns) * lanes, gains + ns * rows
        for i in range(n + nl):  # states, elongations of smooth laws, rate of the friction
            x = (i if i < n else last_d + i - n if i < n + ns else last_d + nl + ns) * lanes
            y = (cols + i) * lanes
            if ns == nl:
                for l in range(lanes):
                    state[U(x + l)] = state[U(y + l)]
            elif OWN:
                for l in range(lanes):
                    state[U(x + l)] = state[U(y + l)] + mats[U((g + i) * w + l)] * state[U(f + l)]
            else:
                gain = mats[U(g + i)]
                for l in range(lanes):
                    state[U(x + l)] = state[U(y + l)] + gain * state[U(f + l)]
        if busy:
            finish(mats, ints, state, count, lanes)


def outputs(mats, ints, state, dst, count, lanes):
    """The first `count` outputs now, into rows `dst`... of the state (room for a multiple of 8)."""
    rows, cols, nl, ny = ints[7], ints[8], ints[3], ints[6]
    stride = (ny + 7) // 8 * 8
    at = 1 + cols * rows + nl * (rows + LAW_PARAMETERS + 1)
    sums(mats, at, stride, cols, state, 0, dst, count, 1 if ONE else lanes)


def advance(mats, ints, state, u, c, lanes):
    """Run ``u.shape[0] - 1`` steps in place: `state` of a `Plant`, u (K+1, m, lanes), c (K, nc, lanes)."""
    march(
        *(mats.reshape(-1), ints, state.reshape(-1), u.reshape(-1), c.reshape(-1), 0, 0),
        *(u.shape[0] - 1, lanes, lanes),
    )


def measure(mats, ints, state, u, c, lanes, out):
    """Outputs now: out (ny, lanes) from u (m, lanes) and c (nc, lanes)."""
    n, m, nc, nl, ny, rows, cols = ints[0], ints[1], ints[2], ints[3], ints[6], ints[7], ints[8]
    at = cols + rows + 9 * nl + 3
    for l in range(lanes):
        for j in range(m):
            state[n + m + j, l] = u[j, l]
        for j in range(nc):
            state[n + 2 * m + j, l] = c[j, l]
    outputs(mats.reshape(-1), ints, state.reshape(-1), at, ny, lanes)
    for i in range(ny):
        for l in range(lanes):
            out[i, l] = state[at + i, l]


def record(mats, ints, state, u, c, every, width, lanes, out):
    """A whole record: flat u (N*every+1, m, width) and c (N*every, nc, width); the lanes share inputs if width is 1.

    out (N+1, ny, lanes) holds the outputs at every `every`-th step; `state` has room for them after its end.
    """
    lanes = 1 if ONE else lanes
    n, m, nc, nl, ny, rows, cols = ints[0], ints[1], ints[2], ints[3], ints[6], ints[7], ints[8]
    y = cols + rows + 9 * nl + 3
    for j in range(m + nc):  # before the first step
        for l in range(lanes):
            at = l if width > 1 else 0
            value = u[j * width + at] if j < m else c[(j - m) * width + at]
            state[U((n + m + j) * lanes + l)] = value
    for k in range(out.shape[0]):
        if k > 0:
            march(mats, ints, state, u, c, (k - 1) * every, (k - 1) * every, every, width, lanes)
            for j in range(nc):  # a current acts from its sample on
                for l in range(lanes):
                    at = min(k * every, c.shape[0] // (nc * width) - 1) * nc + j
                    state[U((n + 2 * m + j) * lanes + l)] = c[at * width + (l if width > 1 else 0)]
        outputs(mats, ints, state, y, ny, lanes)
        for i in range(ny):
            for l in range(lanes):
                out[k, i, l] = state[U((y + i) * lanes + l)]


def drive(mats, ints, states, cars, ways, table, belts):
    """One control step of a batch, block by block of `lanes` cars.

    ints[-8:] = lanes, physics steps per control step, the columns of u that take the road's height, rate and
    acceleration (-1: none), whether the drive does more than hold its current, past currents that are kept, and
    where the road drawn ahead begins now.
    cars (10 + outputs, N): 0 commanded current [A], 1 state of the drive's lag [A], 2 gain [m] and 3 pole of the rough
    road, 4 last height [m], 5 last rate [m/s], 6 pole of the lag (0: none), 7 saturation [A], 8 delay [steps], 9 height
    of the rough road [m], then the outputs. ways (3, N): next place in `table`, its end, and the rough road's counter.
    belts (N, ..): past currents, newest first, then the road drawn ahead, a ring for each physics step of a control
    step (`ahead`). In `states`, room for the inputs follows those of all blocks.
    """
    lanes, substeps, col_r, col_v, col_a = ints[-8], ints[-7], ints[-6], ints[-5], ints[-4]
    drives, depth, begin = ints[-3], ints[-2], ints[-1]
    lanes = 1 if ONE else lanes
    m, nc, nl, ny, rows, cols = ints[1], ints[2], ints[3], ints[6], ints[7], ints[8]
    total = cars.shape[1]
    blocks = (total + lanes - 1) // lanes
    y = (cols + rows + 9 * nl + 3) * lanes
    per_state = y + (ny + 7) // 8 * 8 * lanes
    per_mats = mats.shape[0] // blocks if OWN else 0
    u_at = blocks * per_state
    c_at = u_at + (substeps + 1) * m * lanes
    u, c = states[u_at:c_at], states[c_at : c_at + substeps * nc * lanes]
    h = mats[0]
    points = (belts.shape[1] - depth) // substeps
    plain = points == 0 and table.shape[0] == 0
    for b in range(blocks):
        first = b * lanes
        count = min(lanes, total - first)
        end = first + count
        pool = mats[b * per_mats : (b + 1) * per_mats] if OWN else mats
        state = states[b * per_state : (b + 1) * per_state]
        last, rate, rough = cars[4, first:end], cars[5, first:end], cars[9, first:end]
        gain, pole, counter = cars[2, first:end], cars[3, first:end], ways[2, first:end]
        for l in range(count):
            if col_r >= 0:
                u[col_r * lanes + l] = last[l]
            if col_v >= 0:
                u[col_v * lanes + l] = rate[l]
            if col_a >= 0:
                u[col_a * lanes + l] = 0.0
        for k in range(substeps):
            for l in range(count):
                word = np.uint64(counter[l]) + _GOLDEN
                counter[l] = np.int64(word)
                rough[l] = pole[l] * rough[l] + gain[l] * noise(word)
            # the height goes to the outputs' room first
            height = state[y : y + lanes]
            for l in range(count):
                height[l] = rough[l]
            if not plain:
                for l in range(count):
                    e = first + l
                    r = height[l]
                    if ways[0, e] < ways[1, e]:
                        r += table[ways[0, e]]
                        ways[0, e] += 1
                    elif ways[1, e] > 0:
                        r += table[ways[1, e] - 1]
                    if points > 0:
                        i = depth + k * points + begin
                        now = belts[e, i]
                        belts[e, i] = r
                        r = now
                    height[l] = r
            o = (k + 1) * m * lanes
            if col_r >= 0:
                to = u[o + col_r * lanes : o + (col_r + 1) * lanes]
                for l in range(count):
                    to[l] = height[l]
            if col_v >= 0 or col_a >= 0:
                for l in range(count):
                    v = (height[l] - last[l]) / h
                    if col_v >= 0:
                        u[o + col_v * lanes + l] = v
                    if col_a >= 0:
                        u[o + col_a * lanes + l] = (v - rate[l]) / h
                    rate[l] = v
            for l in range(count):
                last[l] = height[l]
        for k in range(substeps):
            for l in range(count):
                i = cars[0, first + l]
                if drives:
                    i = driven(cars, belts, depth, first + l)
                if nc > 0:
                    c[k * nc * lanes + l] = i
        march(pool, ints, state, u, c, 0, 0, substeps, lanes, lanes)
        outputs(pool, ints, state, cols + rows + 9 * nl + 3, ny, lanes)
        for i in range(ny):
            to, source = cars[10 + i, first:end], state[y + i * lanes : y + (i + 1) * lanes]
            for l in range(count):
                to[l] = source[l]
    if points > 0:
        ints[-1] = (begin + 1) % points


def driven(cars, belts, depth, e):
    """Current [A] of car e in the next physics step, after its drive's delay, lag and saturation."""
    i = cars[0, e]
    if depth > 0:
        for k in range(depth - 1, 0, -1):
            belts[e, k] = belts[e, k - 1]
        belts[e, 0] = i
        back = cars[8, e]
        low = int(back)
        part = back - low
        i = belts[e, low] if part == 0.0 else ((1.0 - part) * belts[e, low] + part * belts[e, low + 1])
    if cars[6, e] > 0.0:
        # mean over the step of the first-order lag, exact
        was = cars[1, e]
        cars[1, e] = i + (was - i) * cars[6, e]
        i = i + (was - i) * (1.0 - cars[6, e]) / -math.log(cars[6, e])
    if cars[7, e] < 1e8:
        i = cars[7, e] * math.tanh(i / cars[7, e])
    return i


# ------------------------------------------------------------------------------------------- compiling


class Kernel(NamedTuple):
    """The compiled functions."""

    advance: Callable
    measure: Callable
    record: Callable
    drive: Callable


_PLAIN: tuple[Callable, ...] = (sums, numbers, held, quiet, rub, push, solve, act, finish, march, outputs)
_PLAIN += (advance, measure, record, driven, drive)
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "cache": True}
if hasattr(
    DefaultOptions, "_nrt"
):  # nothing here makes an array, and calls that count no references are inlined
    _OPTIONS["_nrt"] = False


@functools.cache
def _bind(stamp: int, variant: str) -> Kernel:
    smooth, dry = _laws()
    names: dict[str, Any] = {
        **globals(),
        "ONE": variant == "one",
        "OWN": variant == "own",
        "law_force": _chain([c.law for c in smooth], _no_law),  # type: ignore[misc]
        "law_bound": _chain([c.bound for c in dry], _no_bound),  # type: ignore[misc]
    }
    for plain in _PLAIN:
        # compiled functions read constants and one another from `names`; the name of a function is part of its key
        # in numba's cache on disk: the stamp keeps old laws out
        twin = types.FunctionType(plain.__code__, names, plain.__name__)
        twin.__qualname__ = f"{plain.__name__}_{variant}_{stamp:x}"
        names[plain.__name__] = nb.njit(twin, **_OPTIONS)
    return Kernel(names["advance"], names["measure"], names["record"], names["drive"])


def kernel(variant: str) -> Kernel:
    """The compiled kernel with every law that is registered now.

    `variant`: "one" lane, lanes with "shared" matrices, or lanes each with its "own".
    """
    return _bind(_stamp(), variant)
