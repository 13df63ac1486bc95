"""The one compiled kernel: single cars, batches and long records all run through `advance`.

A step of length h is exact in the linear part (matrix exponential, inputs linear over the step, currents held).
Dry friction is set-valued and projected (Moreau, time stepping at velocity level: Acary and Brogliato, Springer
2008): its force is the one within its bound that stops the sliding, or the bound. Smooth laws enter as a force that
is linear over the step with its end value found implicitly (second order). Several laws that see one another are
solved by Gauss-Seidel sweeps.

Cars are *lanes*: the last axis of every array, so that one instruction works on many of them; a single car is one
lane. No operation is reordered between lanes, so a car in a batch is the same car alone, to the last bit.
The number of states is a constant of the compiled code (the number of axes of the argument `size`), and so is
whether lanes have matrices of their own or there is but one (axes of `tag`: 1, 2, else 0); all other sizes are arguments. Compiled code is cached
on disk under a key made of the sources, so an upgrade never runs yesterday's physics.
"""

from __future__ import annotations

import functools
import hashlib
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numba as nb
import numpy as np

from . import elements as el

LAW_PARAMETERS = 4  # numbers a law may read


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
    digest = hashlib.sha256(Path(__file__).read_bytes())
    digest.update(Path(el.__file__).read_bytes())
    for group in _laws():
        for cls in group:
            function: Any = cls.law if cls.law is not None else cls.bound
            digest.update(
                cls.type.encode() + function.__code__.co_code + repr(function.__code__.co_consts).encode()
            )
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


# --------------------------------------------------------------------------------------------- kernel


law_force: Callable  # bound when the kernel is compiled, from the laws registered by then
law_bound: Callable


def solve(q, l, kinds, differ, P, GD, GS, d_free, s_free, f, z, d, s, z_next, h):
    """Forces of all laws of one lane at the end of the step, by Gauss-Seidel over the laws, a secant in each."""
    a = l * q
    nl = kinds.shape[0]
    for _ in range(200):
        change = 0.0
        for j in range(nl):
            di, si = d_free[j, l], s_free[j, l]
            for i in range(nl):
                if i != j:
                    di += GD[j * nl + i, a] * f[i, l]
                    si += GS[j * nl + i, a] * f[i, l]
            gd, gs, old = GD[j * nl + j, a], GS[j * nl + j, a], f[j, l]
            new = old
            if kinds[j] < 0:
                # the bound is that of the rate at the start of the step: a falling (Stribeck) curve taken at
                # its end would have several solutions
                level = law_bound(
                    -1 - kinds[j], P[j * LAW_PARAMETERS : (j + 1) * LAW_PARAMETERS, a], d[j, l], s[j, l]
                )
                if gs < 0.0:
                    hold = -si / gs
                    new = min(max(hold, -level), level)
                    if abs(hold) > level and differ[j] == 0:
                        # it slides at the end of the step: mean bound over the step, and the old sign up to the
                        # instant of reversal, so that a step with a reversal is of second order too
                        sign, was = (1.0 if hold > 0.0 else -1.0), s[j, l]
                        for _ in range(4):
                            end = si + gs * new
                            mean = 0.5 * (
                                level
                                + law_bound(
                                    -1 - kinds[j],
                                    P[j * LAW_PARAMETERS : (j + 1) * LAW_PARAMETERS, a],
                                    d[j, l],
                                    end,
                                )
                            )
                            part = was / (was - end) if was * end < 0.0 else 0.0
                            new = sign * mean * (1.0 - 2.0 * part)
                else:  # prescribed motion: nothing yields
                    new = level if si > 0.0 else (-level if si < 0.0 else 0.0)
            else:
                last_f, last_r = new, 0.0
                for trial in range(50):
                    force, z_next[j, l] = law_force(
                        kinds[j],
                        P[j * LAW_PARAMETERS : (j + 1) * LAW_PARAMETERS, a],
                        di + gd * new,
                        si + gs * new,
                        d[j, l],
                        z[j, l],
                        h,
                    )
                    r = force - new
                    if abs(r) <= 1e-9 * (1.0 + abs(new)):
                        break
                    # the residual falls at least as fast as -1 for a law that resists motion
                    slope = (r - last_r) / (new - last_f) if trial > 0 and new != last_f else -1.0
                    last_f, last_r = new, r
                    new += -r / slope if slope < -0.05 else r
            f[j, l] = new
            change = max(change, abs(new - old) / (1.0 + abs(new)))
        if change <= 1e-8 or nl == 1:
            break
    for j in range(nl):
        di, si = d_free[j, l], s_free[j, l]
        for i in range(nl):
            di += GD[j * nl + i, a] * f[i, l]
            si += GS[j * nl + i, a] * f[i, l]
        z[j, l] = z_next[j, l]
        d[j, l], s[j, l] = di, si


def advance(size, tag, mats, ints, state, u, c, lanes):
    """Run ``u.shape[0] - 1`` steps in place. u (K+1, m, lanes), c (K, nc, lanes)."""
    n, q = size.ndim, 1 if tag.ndim == 1 else 0
    lanes = 1 if tag.ndim == 2 else lanes
    m, nc, nl, fast = ints[0], ints[1], ints[2], ints[3]
    kinds, differ = ints[5 : 5 + nl], ints[5 + nl : 5 + 2 * nl]
    h = mats[0, 0]
    o = 1
    A = mats[o : o + n * n]
    o += n * n
    U0 = mats[o : o + n * m]
    o += n * m
    U1 = mats[o : o + n * m]
    o += n * m
    B = mats[o : o + n * nc]
    o += n * nc
    G0 = mats[o : o + n * nl]
    o += n * nl
    G1 = mats[o : o + n * nl]
    o += n * nl
    D = mats[o : o + nl * n]
    o += nl * n
    DU = mats[o : o + nl * m]
    o += nl * m
    DC = mats[o : o + nl * nc]
    o += nl * nc
    S = mats[o : o + nl * n]
    o += nl * n
    SU = mats[o : o + nl * m]
    o += nl * m
    SC = mats[o : o + nl * nc]
    o += nl * nc
    GD = mats[o : o + nl * nl]
    o += nl * nl
    GS = mats[o : o + nl * nl]
    o += nl * nl
    P = mats[o : o + nl * LAW_PARAMETERS]
    o += nl * LAW_PARAMETERS
    quiet = mats[o : o + nl]
    x = state[:n]
    w = n
    f = state[w : w + nl]
    w += nl
    z = state[w : w + nl]
    w += nl
    d = state[w : w + nl]
    w += nl
    s = state[w : w + nl]
    w += nl
    y = state[w : w + n]
    w += n
    df = state[w : w + nl]
    w += nl
    sf = state[w : w + nl]
    w += nl
    z_next = state[w : w + nl]
    dry = -1  # the one friction of the quiet way
    for j in range(nl):
        if kinds[j] < 0:
            dry = j
    # m and nc are at least 1 (padded with zeros), so the first of each rides in the innermost loop
    for k in range(u.shape[0] - 1):
        for i in range(n):
            for l in range(lanes):
                t = (
                    U0[i * m, l * q] * u[k, 0, l]
                    + U1[i * m, l * q] * u[k + 1, 0, l]
                    + B[i * nc, l * q] * c[k, 0, l]
                )
                for j in range(n):
                    t += A[i * n + j, l * q] * x[j, l]
                y[i, l] = t
        for j in range(1, m):
            for i in range(n):
                for l in range(lanes):
                    y[i, l] += U0[i * m + j, l * q] * u[k, j, l] + U1[i * m + j, l * q] * u[k + 1, j, l]
        for j in range(1, nc):
            for i in range(n):
                for l in range(lanes):
                    y[i, l] += B[i * nc + j, l * q] * c[k, j, l]
        if fast == 0:
            for j in range(nl):
                if kinds[j] >= 0:
                    for i in range(n):
                        for l in range(lanes):
                            y[i, l] += G0[i * nl + j, l * q] * f[j, l]
        busy = fast == 0
        for j in range(nl):
            if fast == 0 or kinds[j] >= 0:
                for l in range(lanes):
                    t = DU[j * m, l * q] * u[k + 1, 0, l] + DC[j * nc, l * q] * c[k, 0, l]
                    for i in range(n):
                        t += D[j * n + i, l * q] * y[i, l]
                    df[j, l] = t
                for i in range(1, m):
                    for l in range(lanes):
                        df[j, l] += DU[j * m + i, l * q] * u[k + 1, i, l]
                for i in range(1, nc):
                    for l in range(lanes):
                        df[j, l] += DC[j * nc + i, l * q] * c[k, i, l]
                if fast:
                    touched = 0
                    for l in range(lanes):
                        touched += (abs(df[j, l]) > quiet[j, l * q]) | (f[j, l] != 0.0)
                    busy = busy or touched > 0
        for j in range(nl):
            if busy or kinds[j] < 0:
                for l in range(lanes):
                    t = SU[j * m, l * q] * u[k + 1, 0, l] + SC[j * nc, l * q] * c[k, 0, l]
                    for i in range(n):
                        t += S[j * n + i, l * q] * y[i, l]
                    sf[j, l] = t
                for i in range(1, m):
                    for l in range(lanes):
                        sf[j, l] += SU[j * m + i, l * q] * u[k + 1, i, l]
                for i in range(1, nc):
                    for l in range(lanes):
                        sf[j, l] += SC[j * nc + i, l * q] * c[k, i, l]
                if differ[j]:
                    for l in range(lanes):
                        sf[j, l] -= d[j, l] / h
        if not busy:
            if dry >= 0:
                for l in range(lanes):
                    level = P[dry * LAW_PARAMETERS, l * q]
                    t = -sf[dry, l] / GS[dry * nl + dry, l * q]
                    t = level if t > level else t
                    f[dry, l] = -level if t < -level else t
                for j in range(nl):
                    if kinds[j] >= 0:
                        for l in range(lanes):
                            d[j, l] = df[j, l] + GD[j * nl + dry, l * q] * f[dry, l]
                for i in range(n):
                    for l in range(lanes):
                        x[i, l] = y[i, l] + G1[i * nl + dry, l * q] * f[dry, l]
            else:
                for j in range(nl):
                    for l in range(lanes):
                        d[j, l] = df[j, l]
                for i in range(n):
                    for l in range(lanes):
                        x[i, l] = y[i, l]
            continue
        for l in range(lanes):
            at_rest = fast == 1  # a quiet car goes the quiet way, whatever its neighbours do
            for j in range(nl):
                if kinds[j] >= 0 and (abs(df[j, l]) > quiet[j, l * q] or f[j, l] != 0.0):
                    at_rest = False
            if at_rest:
                t = 0.0
                if dry >= 0:
                    level = P[dry * LAW_PARAMETERS, l * q]
                    t = -sf[dry, l] / GS[dry * nl + dry, l * q]
                    t = level if t > level else t
                    t = -level if t < -level else t
                    f[dry, l] = t
                    for j in range(nl):
                        if kinds[j] >= 0:
                            d[j, l] = df[j, l] + GD[j * nl + dry, l * q] * t
                    for i in range(n):
                        x[i, l] = y[i, l] + G1[i * nl + dry, l * q] * t
                else:
                    for j in range(nl):
                        d[j, l] = df[j, l]
                    for i in range(n):
                        x[i, l] = y[i, l]
                continue
            if fast:  # the quiet way leaves out what it does not need
                for j in range(nl):
                    if kinds[j] < 0:
                        t = DU[j * m, l * q] * u[k + 1, 0, l] + DC[j * nc, l * q] * c[k, 0, l]
                        for i in range(1, m):
                            t += DU[j * m + i, l * q] * u[k + 1, i, l]
                        for i in range(1, nc):
                            t += DC[j * nc + i, l * q] * c[k, i, l]
                        for i in range(n):
                            t += D[j * n + i, l * q] * y[i, l]
                        df[j, l] = t
                for j in range(nl):
                    if kinds[j] >= 0 and f[j, l] != 0.0:
                        for i in range(n):
                            t = G0[i * nl + j, l * q] * f[j, l]
                            y[i, l] += t
                            for r in range(nl):
                                df[r, l] += D[r * n + i, l * q] * t
                                sf[r, l] += S[r * n + i, l * q] * t
            solve(q, l, kinds, differ, P, GD, GS, df, sf, f, z, d, s, z_next, h)
            for i in range(n):
                t = y[i, l]
                for j in range(nl):
                    t += G1[i * nl + j, l * q] * f[j, l]
                x[i, l] = t
            for j in range(
                nl
            ):  # what acted was a mean over the step; what outputs see is the force at its end
                if kinds[j] < 0 and differ[j] == 0 and abs(s[j, l]) > 1e-9:
                    t = law_bound(
                        -1 - kinds[j],
                        P[j * LAW_PARAMETERS : (j + 1) * LAW_PARAMETERS, l * q],
                        d[j, l],
                        s[j, l],
                    )
                    f[j, l] = t if s[j, l] > 0.0 else -t


def measure(size, tag, mats, ints, state, u, c, lanes, out):
    """Outputs now: out (ny, lanes) from u (m, lanes) and c (nc, lanes)."""
    n, q = size.ndim, 1 if tag.ndim == 1 else 0
    lanes = 1 if tag.ndim == 2 else lanes
    m, nc, nl, ny = ints[0], ints[1], ints[2], ints[4]
    o = mats.shape[0] - ny * (n + m + nc + nl)
    X = mats[o : o + ny * n]
    o += ny * n
    U = mats[o : o + ny * m]
    o += ny * m
    C = mats[o : o + ny * nc]
    o += ny * nc
    F = mats[o : o + ny * nl]
    x = state[:n]
    f = state[n : n + nl]
    for i in range(ny):
        for l in range(lanes):
            t = 0.0
            for j in range(n):
                t += X[i * n + j, l * q] * x[j, l]
            out[i, l] = t
        for j in range(m):
            for l in range(lanes):
                out[i, l] += U[i * m + j, l * q] * u[j, l]
        for j in range(nc):
            for l in range(lanes):
                out[i, l] += C[i * nc + j, l * q] * c[j, l]
        for j in range(nl):
            for l in range(lanes):
                out[i, l] += F[i * nl + j, l * q] * f[j, l]


def record(size, tag, mats, ints, state, u, c, lanes, every, shared, out):
    """A whole record: u (N*every+1, m, L), c (N*every, nc, L), L = 1 if the lanes share their inputs.

    out (N+1, ny, lanes) holds the outputs at every `every`-th step.
    """
    m, nc = u.shape[1], c.shape[1]
    ub, cb = np.empty((every + 1, m, lanes)), np.empty((every, nc, lanes))
    cm = np.zeros((nc, lanes))
    rows = out.shape[0]
    for k in range(rows):
        for j in range(m):
            for i in range(every + 1):
                at = min(k * every + i, u.shape[0] - 1)
                for l in range(lanes):
                    ub[i, j, l] = u[at, j, l * (1 - shared)]
        for j in range(nc):
            for i in range(every):
                at = min(k * every + i, c.shape[0] - 1)
                for l in range(lanes):
                    cb[i, j, l] = c[at, j, l * (1 - shared)]
            for l in range(lanes):
                cm[j, l] = cb[0, j, l]
        measure(size, tag, mats, ints, state, ub[0], cm, lanes, out[k])
        if k < rows - 1:
            advance(size, tag, mats, ints, state, ub, cb, lanes)


def drive(size, tag, mats, ints, states, cars, counters, road, ways, table, commands, ahead, out):
    """One control step of a batch, block by block of `lanes` cars; outputs to out (ny, N).

    ints[-5:] = lanes, physics steps per control step, and the columns of u that take the road's height, rate and
    acceleration (-1: none). cars (9, N): 0 commanded current [A], 1 state of the drive's lag [A], 2 gain [m] and
    3 pole of the rough road, 4 last height [m], 5 last rate [m/s], 6 pole of the lag (0: none), 7 saturation [A],
    8 delay [steps]. counters, road (N,): the rough road's counter and height [m]. ways (2, N): next place in `table`
    and its end. commands (N, D): past currents, newest first. ahead (N, P): the road that has been drawn ahead.
    """
    q = 1 if tag.ndim == 1 else 0
    lanes, substeps, col_r, col_v, col_a = ints[-5], ints[-4], ints[-3], ints[-2], ints[-1]
    m, nc, ny = ints[0], ints[1], ints[4]
    total = cars.shape[1]
    blocks = (total + lanes - 1) // lanes
    per_state = states.shape[0] // blocks
    size_mats = mats.shape[0] // blocks if q else mats.shape[0]
    per_mats = size_mats if q else 0
    u, c = np.zeros((substeps + 1, m, lanes)), np.zeros((substeps, nc, lanes))
    y = np.empty((ny, lanes))
    h = mats[0, 0]
    look = ahead.shape[1]
    for b in range(blocks):
        first = b * lanes
        count = min(lanes, total - first)
        pool = mats[b * per_mats : b * per_mats + size_mats]
        state = states[b * per_state : (b + 1) * per_state]
        for l in range(count):
            e = first + l
            if col_r >= 0:
                u[0, col_r, l] = cars[4, e]
            if col_v >= 0:
                u[0, col_v, l] = cars[5, e]
                if col_a >= 0:
                    u[0, col_a, l] = 0.0
        for k in range(substeps):
            for l in range(count):
                e = first + l
                counters[e] = counters[e] + _GOLDEN
                road[e] = cars[3, e] * road[e] + cars[2, e] * noise(counters[e])
            for l in range(count):
                e = first + l
                r = road[e]
                if ways[0, e] < ways[1, e]:
                    r += table[ways[0, e]]
                    ways[0, e] += 1
                elif ways[1, e] > 0:
                    r += table[ways[1, e] - 1]
                if look > 0:
                    now = ahead[e, 0]
                    for i in range(look - 1):
                        ahead[e, i] = ahead[e, i + 1]
                    ahead[e, look - 1] = r
                    r = now
                if col_r >= 0:
                    u[k + 1, col_r, l] = r
                if col_v >= 0:
                    u[k + 1, col_v, l] = (r - cars[4, e]) / h
                if col_a >= 0:
                    u[k + 1, col_a, l] = ((r - cars[4, e]) / h - cars[5, e]) / h
                cars[5, e] = (r - cars[4, e]) / h
                cars[4, e] = r
        depth = commands.shape[1]
        for k in range(substeps):
            for l in range(count):
                e = first + l
                i = cars[0, e]
                if depth > 0:
                    commands[e, 1:] = commands[e, :-1].copy()
                    commands[e, 0] = i
                    back = cars[8, e]
                    low = int(back)
                    part = back - low
                    i = (
                        commands[e, low]
                        if part == 0.0
                        else ((1.0 - part) * commands[e, low] + part * commands[e, low + 1])
                    )
                if cars[6, e] > 0.0:
                    # mean over the step of the first-order lag, exact
                    was = cars[1, e]
                    cars[1, e] = i + (was - i) * cars[6, e]
                    i = i + (was - i) * (1.0 - cars[6, e]) / -math.log(cars[6, e])
                if cars[7, e] < 1e8:
                    i = cars[7, e] * math.tanh(i / cars[7, e])
                if nc > 0:
                    c[k, 0, l] = i
        advance(size, tag, pool, ints, state, u, c, lanes)
        measure(size, tag, pool, ints, state, u[substeps], c[substeps - 1], lanes, y)
        for i in range(ny):
            for l in range(count):
                out[i, first + l] = y[i, l]


# ------------------------------------------------------------------------------------------- compiling


class Kernel(NamedTuple):
    """The compiled functions; `size` arguments are arrays with as many axes as there are states."""

    advance: Callable
    measure: Callable
    record: Callable
    drive: Callable


_PLAIN = {f.__name__: f for f in (solve, advance, measure, record, drive)}


@functools.cache
def _bind(stamp: int) -> dict[str, Any]:
    smooth, dry = _laws()
    names: dict[str, Any] = {
        "law_force": _chain([c.law for c in smooth], _no_law),  # type: ignore[misc]
        "law_bound": _chain([c.bound for c in dry], _no_bound),  # type: ignore[misc]
    }
    for name, plain in _PLAIN.items():
        # the name of a function is part of its key in numba's cache on disk: the stamp keeps old laws out
        plain.__qualname__ = f"{name}_{stamp:x}"
        names[name] = nb.njit(plain, nogil=True, error_model="numpy", cache=True)
    return names


def kernel() -> Kernel:
    """The compiled kernel with every law that is registered now."""
    names = _bind(_stamp())
    # compilation is lazy and reads the module's globals: they must be those of the laws registered now
    globals().update(names)
    return Kernel(names["advance"], names["measure"], names["record"], names["drive"])
