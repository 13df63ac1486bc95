"""Discretisation of networks for the kernel, and simulation over records.

`Plant` is a network (or several networks of the same structure, one per lane) at a step; `simulate` runs a
model over given inputs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.linalg import expm

from .._common.arrays import is_smooth
from .._common.errors import InputError, shown
from .._common.units import HELD, convert
from . import elements as el
from ._balance import Balance
from ._kernel.layout import CONTACT, GENERAL, QUIET, WAY, WIDTH, Layout, aligned, layout
from .network import MOTIONS, Assembly, Channel, Network, assemble_all

__all__ = [
    "simulate",
]


PHYSICS_STEP = 1e-3  # s
#: physics steps over the time scale of the motion in a fit: 126 steps per period. The error by dry friction is of first order: where
#: friction dominates, outputs are off by about 1 % of their deviation
FINE = 0.05
#: sampling steps over the time scale of the motion above which samples are sparse: fewer than 21 samples per period
COARSE = 0.3
#: number of samples below which the time scale of outputs says nothing
_FEWEST = 64
#: course of displacements and forces between samples
Interpolation = Literal["linear", "smooth", "spline", "auto"]
#: parts of the base vector for the motion of a node, each the derivative of the preceding part
PARTS = ("r", "v", "alpha")
_TOLD = dict(zip(MOTIONS, PARTS, strict=True))
_DISCRETE = 200  # discrete networks that are kept
_SEPARATE = 1e-6  # relative coupling of devices below which a closed form is used
_AT_ONCE = 1e-12  # smaller velocities are rounding [m/s per N or A]; corresponds to a damper of 1e12 N s/m


@dataclass(frozen=True)
class _Discrete:
    """A network at a step: its numbers in the order of the kernel, and the blocks of its matrix.

    The state at the end of a step is A x + U0 u(start) + U1 u(end) + B c + G0 f(start) + G1 f(end), with the
    laws f in the order of the assembly.
    """

    blocks: tuple[np.ndarray, ...]  # matrices A, U0, U1, B, G0 and G1
    # matrices of the outputs, for x, u, c and the forces of the laws
    outputs: tuple[np.ndarray, ...]
    #: elongations [m/N] and rates [m/(s N)] of the laws per force, in the order of the kernel
    yields: tuple[np.ndarray, np.ndarray]
    numbers: np.ndarray  # pool of numbers, without the laws' parameters if each lane has its own (`layout`)
    ints: np.ndarray  # integers of the kernel (`layout`)
    order: tuple[int, ...]  # index of each law in the assembly

    @property
    def layout(self) -> Layout:
        """Places of the numbers in the kernel's arrays."""
        return layout(self.ints.tolist())

    def structure(self) -> tuple[int, ...]:
        """Return the part of the integers that all lanes of a plant share: sizes and codes, without the way through a step."""
        ints = self.ints.tolist()
        return (*ints[:WAY], *ints[WAY + 1 :])


def _columns(asm: Assembly) -> list[int]:
    """Return the used columns of the base vector that are linear over the step: r, v, alpha, F."""
    start = asm.columns("r").start
    stop = asm.columns("F").stop
    used = (
        np.any(asm.rate != 0, axis=0)
        | np.any(asm.outputs != 0, axis=0)
        | np.any(asm.elongation != 0, axis=0)
        | np.any(asm.elongation_rate != 0, axis=0)
    )
    return [j for j in range(start, stop) if used[j]]


def _instant(asm: Assembly) -> bool:
    """Return whether friction or a current moves a massless terminal instantly, in a rate that some law reads."""
    from ._kernel.compiled import law_code

    c, f = asm.columns("I"), asm.columns("f")
    seen = asm.elongation_rate[~np.array(asm.by_difference, bool)]
    dry = [
        j
        for j, e in zip(range(f.start, f.stop), asm.laws, strict=True)
        if law_code(type(e)) < 0
    ]
    return bool(
        np.abs(np.hstack([seen[:, c], seen[:, dry]])).max(initial=0.0) > _AT_ONCE
    )


def side_by_side(asm: Assembly) -> tuple[object, ...]:
    """Return the properties that assemblies must share to be lanes of one `Plant`."""
    laws = tuple(type(e).__name__ for e in asm.laws)
    return asm.size, laws, asm.by_difference, asm.outputs_by_difference, _instant(asm)


def _step_matrices(
    assemblies: Sequence[Assembly], B: np.ndarray, step: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the state after a step by the state, by held inputs, and by inputs that rise from zero to one
    (networks, states, .)."""
    lanes, n, k = B.shape
    if not n:
        return np.zeros((lanes, 0, 0)), np.zeros((lanes, 0, k)), np.zeros((lanes, 0, k))
    x = assemblies[0].columns("x")
    big = np.zeros((lanes, n + 2 * k, n + 2 * k))
    big[:, :n, :n] = np.stack([asm.rate[:, x] for asm in assemblies]) * step
    big[:, :n, n : n + k] = B * step
    big[:, n : n + k, n + k :] = np.eye(k)
    with np.errstate(all="ignore"):
        phi = expm(big) if np.isfinite(big).all() else big
    if not np.isfinite(phi).all():
        name = assemblies[0].network.name
        raise InputError(
            f"model '{name}' cannot be stepped by {step:g} s: its linear part overflows"
        )
    return phi[:, :n, :n], phi[:, :n, n : n + k], phi[:, :n, n + k :]


@lru_cache(maxsize=_DISCRETE)
def discretise(asm: Assembly, step: float, columns: tuple[int, ...]) -> _Discrete:
    """Return the exact discretisation of the linear part at a step [s]: first-order hold for `columns` of the
    base vector, zero-order hold for currents and friction. Raise `InputError` for matrices that are not
    finite."""
    return _discretise([asm], step, columns)[0]


def _discretise(
    assemblies: Sequence[Assembly], step: float, columns: tuple[int, ...]
) -> list[_Discrete]:
    """Return the discretisations of assemblies of one structure (`side_by_side`)."""
    from ._kernel.compiled import law_code

    asm = assemblies[0]
    n = asm.size[0]
    lanes = len(assemblies)
    instant = _instant(asm)
    x = asm.columns("x")
    u = list(columns)
    c = asm.columns("I")
    f = asm.columns("f")
    rate = np.stack([a.rate for a in assemblies])
    B = np.concatenate([rate[:, :, u], rate[:, :, c], rate[:, :, f]], axis=2)
    m, nc = len(u), c.stop - c.start
    Ad, hold, late = _step_matrices(assemblies, B, step)
    early = hold - late
    U0 = early[:, :, :m]
    U1 = late[:, :, :m]
    G0 = early[:, :, m + nc :]
    G1 = late[:, :, m + nc :].copy()
    codes = tuple(law_code(type(e)) for e in asm.laws)
    dry = np.array([code < 0 for code in codes], bool)
    G1[:, :, dry] += G0[:, :, dry]  # dry friction holds its force over the whole step
    G0[:, :, dry] = 0.0
    order = np.argsort(dry, kind="stable")
    codes = tuple(codes[j] for j in order)
    dry = dry[order]
    nl, ns = len(codes), int(np.sum(~dry))
    start, end = G0[:, :, order], G1[:, :, order]
    E = np.stack([a.elongation[order] for a in assemblies])
    R = np.stack([a.elongation_rate[order] for a in assemblies])
    differ = np.array(asm.by_difference, bool)[order]
    O = np.stack([a.outputs for a in assemblies])
    if instant:
        O = np.concatenate([O, E, np.where(differ[:, None], 0.0, R)], axis=1)
    R[:, differ] = E[:, differ] / step
    own = [f.start + j for j in order]
    blank = np.zeros((lanes, n, nl * bool(differ.any())))
    held = hold[:, :, m : m + nc]
    states = np.concatenate([Ad, U0, U1, held, blank, start[:, :, :ns]], axis=2)

    def seen(by: np.ndarray) -> np.ndarray:
        """Return the rows of the laws' elongations or rates, without the forces at the end of the step."""
        at = by[:, :, x] @ states
        at[:, :, n + m : n + 2 * m] += by[:, :, u]
        at[:, :, n + 2 * m : n + 2 * m + nc] += by[:, :, c]
        return at

    D, S = seen(E), seen(R)
    if differ.any():
        last = n + 2 * m + nc
        S[:, :, last : last + nl] -= np.diag(differ / step)
    GD = E[:, :, x] @ end + E[:, :, own]
    GS = R[:, :, x] @ end + R[:, :, own]
    smooth = ~dry[:, None]
    rows = np.concatenate(
        [states, np.where(smooth, D, S), np.where(smooth, S, D)], axis=1
    )
    gains = np.concatenate(
        [end, np.where(smooth, GD, GS), np.where(smooth, GS, GD)], axis=1
    )
    nothing = np.zeros((lanes, O.shape[1], m + blank.shape[2]))
    parts = [
        O[:, :, x],
        nothing[:, :, :m],
        O[:, :, u],
        O[:, :, c],
        nothing[:, :, m:],
        O[:, :, own],
    ]
    seen_outside = np.concatenate(parts, axis=2)
    padded = -(-rows.shape[1] // 4) * 4
    outputs = len(asm.outputs)
    linear = np.concatenate(
        [np.full((lanes, 1), step), _stored(rows), _stored(gains)], axis=1
    )
    outside = _stored(seen_outside)
    currents = _pad(held)
    out = []
    for k, a in enumerate(assemblies):
        laws = [a.laws[j] for j in order]
        way, of_laws, parameters = _law_numbers(
            laws, ns, GD[k], GS[k], bool(differ.any()), instant
        )
        sizes = (
            n,
            m,
            nc,
            nl,
            ns,
            way,
            outputs,
            padded,
            seen_outside.shape[2],
            int(differ.any()),
        )
        out.append(
            _Discrete(
                blocks=(Ad[k], U0[k], U1[k], currents[k], G0[k], G1[k]),
                outputs=(
                    a.outputs[:, x],
                    a.outputs[:, u],
                    _pad(a.outputs[:, c]),
                    a.outputs[:, f],
                ),
                yields=(GD[k], GS[k]),
                numbers=np.concatenate(
                    [linear[k], of_laws, outside[k], parameters.ravel()]
                ),
                ints=np.array(
                    [*sizes, parameters.shape[1], instant, *codes, *differ], np.int64
                ),
                order=tuple(int(j) for j in order),
            )
        )
    return out


def _law_numbers(
    laws: Sequence[el.Element],
    ns: int,
    GD: np.ndarray,
    GS: np.ndarray,
    differ: bool,
    instant: bool,
) -> tuple[int, np.ndarray, np.ndarray]:
    """Return the way through a step for these laws, its numbers, and the laws' parameters (law, number)."""
    lists = [e.law_parameters() for e in laws]
    parameters = np.zeros((len(laws), max(map(len, lists), default=0)))
    for row, numbers in zip(parameters, lists, strict=True):
        row[: len(numbers)] = numbers
    nl = len(laws)
    devices = max(ns, nl - ns, 1)
    # in addition to the general way: constant frictions with yielding motion, and stops without contact
    constant = all(type(e).bound is el.CoulombFriction.bound for e in laws[ns:])
    levels = parameters[ns:, 0] if constant and nl > ns else np.zeros(nl - ns)
    spans = np.array([e.quiet() for e in laws[:ns]]) - np.abs(GD[:ns, ns:]) @ levels
    stops = [e.contact() for e in laws[:ns]]
    several = devices > 1 and None not in stops and _are_separate(ns, GD, GS)
    found = [
        _closed_form(
            stops[p] if p < ns and (several or ns == 1) else None, ns, GD, GS, p, levels
        )
        for p in range(devices)
    ]
    closes = all(ok for _, ok in (found if several else found[:1]))
    way = CONTACT
    if (
        differ
        or not constant
        or not closes
        or (instant and (ns or devices > 1))
        or (nl - ns > 1 and not several)
    ):
        way = GENERAL
    elif ns and not several and (ns > 1 or stops[0] is None):
        way = QUIET if (spans > 0).all() else GENERAL
    closed = np.concatenate([numbers for numbers, _ in found])
    return way, np.concatenate([np.maximum(spans, 0.0), closed]), parameters


def _are_separate(ns: int, GD: np.ndarray, GS: np.ndarray) -> bool:
    """Return whether the forces of each device, stop p and friction p, hardly move another device within a step."""
    device = np.concatenate([np.arange(ns), np.arange(len(GD) - ns)])
    across = device[:, None] != device
    for yields in (GD, GS):
        own = np.abs(np.diag(yields))
        if (np.abs(yields) > _SEPARATE * np.sqrt(own[:, None] * own))[across].any():
            return False
    return True


def _closed_form(
    stop: tuple[float, float, float, float] | None,
    ns: int,
    GD: np.ndarray,
    GS: np.ndarray,
    p: int,
    levels: np.ndarray,
) -> tuple[np.ndarray, bool]:
    """Return the numbers of device p (a stop, if any, and a friction) for the closed form (`layout`), and
    whether the form exists."""
    dry = ns + p
    rubs = dry < len(GD)
    own = GS[dry, dry] if rubs else -1.0
    level = levels[p] if rubs else 0.0
    closed = np.array(
        [np.inf, -np.inf, 0.0, 0.0, 0.0, level, -1.0 / own if own < 0 else 0.0, 0.0]
    )
    if own >= 0 or stop is None:
        return closed, bool(own < 0)
    upper, lower, stiffness, damping = stop
    rest = 1.0 - stiffness * GD[p, p] - damping * GS[p, p]
    by_friction, slip = 0.0, own
    if rubs:
        by_friction = (stiffness * GD[p, dry] + damping * GS[p, dry]) / rest
        slip = own + GS[dry, p] * by_friction
    closed[:5] = upper, lower, stiffness / rest, damping / rest, by_friction
    closed[7] = -1.0 / slip if slip < 0 else 0.0
    return closed, bool(rest > 0 and slip < 0)


def _with_laws(part: _Discrete, laws: Sequence[el.Element]) -> _Discrete:
    """Return a discrete network with other parameters of its laws; the linear part is unchanged."""
    at = part.layout
    way, of_laws, parameters = _law_numbers(
        [laws[i] for i in part.order],
        at.smooth,
        *part.yields,
        bool(at.differ),
        bool(at.instant),
    )
    numbers = part.numbers.copy()
    ints = part.ints.copy()
    numbers[at.spans : at.out], numbers[at.own :] = of_laws, parameters.ravel()
    ints[WAY] = way
    return replace(part, numbers=numbers, ints=ints)


def _linear_part(network: Network) -> tuple[Any, ...]:
    """Return everything that the linear equations of a network depend on, without the parameters of its laws."""
    elements = (
        (type(e), e.name, e.where)
        if e.place == "between" and e.parts() and not any(e.linear())
        else e
        for e in network.elements
    )
    ties = (network.bodies, network.levers)
    return (
        *network.masses.items(),
        network.turning,
        *ties,
        network.inputs,
        network.outputs,
        *elements,
    )


def _pad(block: np.ndarray) -> np.ndarray:
    """Return a block with at least one column: a current may be driven in a car without a motor."""
    return block if block.shape[-1] else np.zeros((*block.shape[:-1], 1))


def _stored(matrices: np.ndarray) -> np.ndarray:
    """Return matrices (networks, rows, columns) column by column, padded with zeros to a multiple of four rows."""
    lanes, high, wide = matrices.shape
    out = np.zeros((lanes, wide, -(-high // 4) * 4))
    out[:, :, :high] = matrices.swapaxes(1, 2)
    return out.reshape(lanes, -1)


class Plant:
    """Networks prepared for the kernel at a step [s]: one network shared by all lanes, or one per lane with
    the same structure.

    `u_columns` are the inputs of the base vector that the kernel reads, in order; `labels` names them as
    (part, channel) with part 'r', 'v', 'alpha' or 'F'. `at` gives the places in `mats`, `ints` and a state
    (`layout`). `extra` are further output channels.
    """

    def __init__(
        self,
        networks: Network | Sequence[Network],
        step: float = PHYSICS_STEP,
        *,
        lanes: int = 1,
        extra: Sequence[Channel] = (),
    ) -> None:
        if not (isinstance(step, int | float) and math.isfinite(step) and step > 0):
            raise InputError(
                f"the step must be a positive number of seconds, not {step!r}"
            )
        several = not isinstance(networks, Network)
        self.networks: list[Network] = list(networks) if several else [networks]  # type: ignore[list-item,arg-type]
        self.lanes = len(self.networks) if several else lanes
        self.step = float(step)
        self.extra = tuple(extra)
        # many lanes may share a network, or differ only in the parameters of their laws
        keys = {id(net): (net, _linear_part(net)) for net in self.networks}
        distinct: dict[tuple[Any, ...], Network] = {}
        for net, key in keys.values():
            distinct.setdefault(key, net)
        linear = dict(
            zip(distinct, assemble_all([*distinct.values()], self.extra), strict=True)
        )
        once: dict[int, Assembly] = {}
        for net, key in keys.values():
            once[id(net)] = linear[key]
            if net is not distinct[key]:
                laws = tuple(
                    part
                    for e in net.elements
                    if e.place == "between"
                    for part in e.parts()
                )
                once[id(net)] = replace(linear[key], network=net, laws=laws)
        self.assemblies = [once[id(net)] for net in self.networks]
        first = self.assemblies[0]
        used = tuple(sorted({c for asm in linear.values() for c in _columns(asm)}))
        self.u_columns = used
        self.channels = (*first.network.outputs, *extra)
        self._by_difference = first.outputs_by_difference
        parts = []
        moving = first.network.moving
        force = [c for c in first.network.inputs if c.quantity == "force"]
        for column in used:
            for part, channels in (
                ("r", moving),
                ("v", moving),
                ("alpha", moving),
                ("F", force),
            ):
                span = first.columns(part)
                if span.start <= column < span.stop:
                    parts.append((part, channels[column - span.start].name))
        #: part of the base vector of the input at every moved node
        self.told = {c.name: _TOLD[c.quantity] for c in moving}
        self.labels: tuple[tuple[str, str], ...] = tuple(parts)
        #: inputs that are held over a step: currents, then logged channels
        self.currents = [
            c for kind in HELD for c in first.network.inputs if c.quantity == kind
        ]
        stepped = {
            id(asm.rate): (asm, part)
            for asm, part in self._discretised([*linear.values()])
        }
        whole = {}
        for asm in once.values():
            like, discrete = stepped[id(asm.rate)]
            whole[id(asm)] = discrete if asm is like else _with_laws(discrete, asm.laws)
        self._pack([whole[id(asm)] for asm in self.assemblies], several)

    def _discretised(
        self, assemblies: Sequence[Assembly]
    ) -> list[tuple[Assembly, _Discrete]]:
        """Return assemblies with their discretisations, those of one structure computed side by side."""
        if len(assemblies) == 1:
            return [
                (assemblies[0], discretise(assemblies[0], self.step, self.u_columns))
            ]
        groups: dict[tuple[object, ...], list[Assembly]] = {}
        for asm in assemblies:
            groups.setdefault(side_by_side(asm), []).append(asm)
        found = [
            (own, _discretise(own, self.step, self.u_columns))
            for own in groups.values()
        ]
        return [pair for own, parts in found for pair in zip(own, parts, strict=True)]

    def _pack(self, parts: Sequence[_Discrete], several: bool) -> None:
        from ._kernel.compiled import kernel_of

        first = parts[0]
        for other in parts[1:]:
            if other.structure() != first.structure():
                raise InputError(
                    "the lanes' networks differ in structure, not only in parameters"
                )
        self.ints = first.ints.copy()
        self.ints[WAY] = min(int(p.ints[WAY]) for p in parts)
        self.at = at = layout(self.ints.tolist())
        self.groups = -(-self.lanes // WIDTH)
        self.n = at.states
        self.n_laws = at.laws
        self.n_outputs = at.outputs
        self.order = first.order
        if several:
            self.mats = aligned(self.groups, at.size, WIDTH)
            # unused lanes need valid numbers, too
            self.mats[:] = parts[0].numbers[:, None]
            for lane, part in enumerate(parts):
                self.place(self.mats, lane, part)
        else:
            self.mats = first.numbers[:, None].copy()
        self.kernel = kernel_of(self.at)

    def place(self, mats: np.ndarray, lane: int, part: _Discrete) -> None:
        """Write the numbers of a lane into an array (groups, numbers, 8), in which every lane has separate
        numbers."""
        at = self.at
        group, l = divmod(lane, WIDTH)
        mats[group, : at.own, l] = part.numbers[: at.own]
        count = at.size - at.own  # the parameters of a lane's laws are contiguous
        mats[group, at.own :].reshape(-1)[l * count : (l + 1) * count] = part.numbers[
            at.own :
        ]

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k != "kernel"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        from ._kernel.compiled import kernel_of

        self.__dict__.update(state)
        self.kernel = kernel_of(self.at)

    def state(
        self,
        initial: np.ndarray | None = None,
        inputs: np.ndarray | None = None,
        held: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return a new state (rows, lanes) of the kernel.

        `initial` (n,) or (n, lanes) is in the coordinates of the assembly, `inputs` (inputs, 1 or lanes)
        in the order of `labels`, `held` (held inputs, 1 or lanes) of currents and logged channels; None
        for rest and zero.
        """
        state = np.zeros((self.at.height, self.lanes))
        if initial is not None and self.n:
            state[: self.n] = np.asarray(initial, float).reshape(self.n, -1)
        if self.n_laws and (initial is not None or inputs is not None):
            self._start_laws(
                state,
                np.zeros((len(self.u_columns), 1)) if inputs is None else inputs,
                held,
            )
        return state

    def grouped(self, state: np.ndarray) -> np.ndarray:
        """Return a state (rows, lanes) in groups of lanes (groups, rows, 8)."""
        grouped = aligned(self.groups, len(state), WIDTH)
        for group in range(self.groups):
            some = state[:, group * WIDTH : (group + 1) * WIDTH]
            grouped[group, :, : some.shape[1]] = some
        return grouped

    @property
    def memory(self) -> list[int]:
        """Rows of the kernel's state for the states of the hysteresis laws."""
        laws = self.assemblies[0].laws
        return [
            self.at.memory + j
            for j, i in enumerate(self.order)
            if isinstance(laws[i], el.Hysteresis)
        ]

    def _start_laws(
        self, state: np.ndarray, inputs: np.ndarray, held: np.ndarray | None
    ) -> None:
        """Set elongations, rates and forces of the initial state and the first inputs, in static balance.

        The rate of a law at an algebraic node is a difference of elongations. Its terminals start at rest.
        """
        at, order = self.at, list(self.order)
        x = state[: at.states]
        f, z, d, s = (
            state[row : row + at.laws]
            for row in (at.force, at.memory, at.elongation, at.rate)
        )
        span = self.assemblies[0].columns("f")
        own = np.arange(span.start, span.stop)[order]
        # most lanes differ in the parameters of laws alone, many of them only in the initial state
        rows: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        balances: dict[tuple[int, int], Balance] = {}
        # lane with the same balance
        solved: dict[tuple[int, int, bytes, bytes], int] = {}
        for lane in range(self.lanes):
            asm = self.assemblies[lane if len(self.assemblies) > 1 else 0]
            if id(asm.rate) not in rows:
                still = np.array(asm.by_difference, bool)[:, None]
                moved = np.where(still, 0.0, asm.elongation_rate)[order]
                rows[id(asm.rate)] = asm.elongation[order], moved
            E, R = rows[id(asm.rate)]
            given = np.zeros(E.shape[1])
            given[asm.columns("x")] = x[:, lane]
            given[list(self.u_columns)] = inputs[:, lane if inputs.shape[1] > 1 else 0]
            if held is not None:
                given[asm.columns("I")] = held[:, lane if held.shape[1] > 1 else 0]
            network = (id(asm.laws), id(asm.rate))
            unforced = (E @ given, R @ given)
            key = (*network, unforced[0].tobytes(), unforced[1].tobytes())
            if key in solved:
                state[at.states :, lane] = state[at.states :, solved[key]]
                continue
            solved[key] = lane
            if network not in balances:
                laws = [asm.laws[i] for i in order]
                balances[network] = Balance(laws, E[:, own], R[:, own], self.step)
            balance = balances[network]
            given[own] = f[:, lane] = balance.solve(*unforced)
            d[:, lane], s[:, lane] = E @ given, R @ given
            for j in balance.smooth:
                law = balance.laws[j].law
                p = balance.numbers[j]
                _, after = law(  # type: ignore[misc]
                    p, d[j, lane], s[j, lane], d[j, lane], 0.0, self.step
                )
                z[j, lane] = after

    def order_of(self, part: str, name: str) -> int:
        """Return how often an input is differentiated for a part 'r', 'v', 'alpha' or 'F' of the base vector."""
        return PARTS.index(part) - PARTS.index(self.told[name]) if part in PARTS else 0

    @property
    def differentiated(self) -> set[str]:
        """Names of the inputs whose derivatives act on the network."""
        return {name for part, name in self.labels if self.order_of(part, name)}

    def _unsolved(self, states: np.ndarray) -> list[tuple[int, str] | None]:
        """Return the index of the first unsolved step and the name of the unsolved law for every lane; None for a solved lane."""
        out: list[tuple[int, str] | None] = []
        for lane in range(self.lanes):
            group, l = divmod(lane, WIDTH)
            step, law = states[group, self.at.failed : self.at.failed + 2, l]
            laws = self.assemblies[0].laws
            out.append((int(step), laws[self.order[int(law)]].name) if step else None)
        return out

    def run(
        self,
        inputs: Mapping[str, np.ndarray],
        *,
        every: int = 1,
        samples: int,
        initial: np.ndarray | None = None,
        derivatives: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
    ) -> np.ndarray:
        """Simulate, and return the outputs (samples, outputs, lanes) [SI] at every `every`-th step.

        Inputs [SI] have values at every physics step, (every*(samples-1)+1,) or with a lane axis.
        `derivatives` are known velocities and accelerations [SI] of moved nodes; differences otherwise.
        """
        total = every * (samples - 1) + 1
        shared = all(np.ndim(v) == 1 for v in inputs.values())
        width = 1 if shared else self.lanes

        def wide(values: np.ndarray) -> np.ndarray:
            values = np.asarray(values, float)
            return values[:, None] if values.ndim == 1 else values

        u = np.zeros((total, len(self.labels), width))
        for j, (part, name) in enumerate(self.labels):
            order = self.order_of(part, name)  # number of derivatives of the input
            if not order:
                u[:, j] = wide(inputs[name])
            elif derivatives is not None and name in derivatives:
                u[:, j] = wide(derivatives[name][order - 1])
            else:
                r = wide(inputs[name])
                v = np.gradient(r, self.step, axis=0)
                u[:, j] = v if order == 1 else np.gradient(v, self.step, axis=0)
        c = np.zeros((max(total - 1, 1), len(self.currents), width))
        for j, channel in enumerate(self.currents):
            values = effective_current(
                self.networks[0],
                str(channel.element),
                wide(inputs[channel.name]),
                self.step,
            )
            c[:, j] = values[: len(c)]
        out = np.empty((samples, self.n_outputs, self.lanes))
        states = self.grouped(self.state(initial, u[0], c[0]))
        self.kernel.record(
            self.mats.reshape(-1), self.ints, states.reshape(-1), u.reshape(-1), c.reshape(-1),
            every, width, self.lanes, out,
        )  # fmt: skip
        self.unsolved = self._unsolved(states)
        for j, difference in enumerate(self._by_difference):
            if difference:
                out[:, j] = np.gradient(out[:, j], self.step * every, axis=0)
        return out


def effective_current(
    network: Network, motor: str, command: np.ndarray, step: float
) -> np.ndarray:
    """Return the current (n, lanes) [A] behind a motor's drive for a command (n, lanes) [A] that is held over
    each step [s], with the effects in the order of `DRIVE_ORDER` and unknown effects last."""
    out = np.asarray(command, float)
    drive = [
        e for e in network.elements if e.place == "element" and e.where[0] == motor
    ]
    kinds = el.DRIVE_ORDER
    for e in sorted(
        drive,
        key=lambda e: next(
            (k for k, t in enumerate(kinds) if isinstance(e, t)), len(kinds)
        ),
    ):
        out = e.apply(out, step)
    return out


def sense(
    network: Network, outputs: Mapping[str, np.ndarray], step: float
) -> dict[str, np.ndarray]:
    """Return outputs (n, ...) by channel as the sensors of the network report them, with delay, gain and
    bias."""
    seen = dict(outputs)
    for e in network.elements:
        if e.place == "channel" and e.where[0] in seen:
            seen[e.where[0]] = e.apply(seen[e.where[0]], step)
    return seen


def upsample(values: np.ndarray, every: int, hold: bool = False) -> np.ndarray:
    """Return a record (n, ...) at a multiple of its sampling rate (every*(n-1)+1, ...): linear between
    samples, or each value held until the next."""
    if every == 1:
        return np.asarray(values, float)
    if hold:
        return np.repeat(values, every)[: every * (len(values) - 1) + 1]
    n = len(values)
    return np.interp(np.arange(every * (n - 1) + 1) / every, np.arange(n), values)


#: largest number of steps of a simulation: more than a day at 1 ms suggests a wrong unit of time
_MOST_STEPS = 1e8


def pace(values: np.ndarray, step: float) -> float:
    """Return the time scale [s] of a signal (n,): the inverse of the circular frequency below which half of
    its power lies."""
    # the import takes longer than the simulation of most records
    from scipy.signal import welch

    f, s = welch(values - values.mean(), 1.0 / step, nperseg=min(len(values), 4096))
    total = np.cumsum(s)
    middle = float(np.interp(0.5 * total[-1], total, f)) if total[-1] > 0 else 0.0
    return 1.0 / (2 * math.pi * max(middle, float(f[1])))


def simulate(
    model: Network | str | Path | Mapping[str, Any],
    time: np.ndarray,
    inputs: Mapping[str, np.ndarray],
    *,
    step: float = PHYSICS_STEP,
    initial: np.ndarray | None = None,
    extra: Sequence[Channel] = (),
    interpolation: Interpolation = "linear",
) -> dict[str, np.ndarray]:
    """Return the outputs of a model for uniformly sampled inputs; all values are in the units of the channels.

    The physics runs at the largest integer fraction of the sampling step that is at most `step`.
    Displacements and forces are linear between samples; currents are held. If the velocity or acceleration of
    a moved node acts on the network, a cubic spline through the samples is differentiated.

    Straight lines between samples attenuate an input: by 4 % at nine samples per period, by 0.4 % at 30. A diagnosis therefore takes cubic
    splines through inputs without much noise or jumps, and through all inputs where an output has fewer than 21 samples per period. To
    reproduce its simulations, choose 'auto'.

    Args:
        model: The model, or the name of a built-in model, a file, or the content of a file.
        time: Time stamps (n,) [s].
        inputs: Samples (n,) by channel.
        step: Largest physics step [s].
        initial: State in the coordinates of the assembly; None for rest.
        extra: Further output channels, after those of the model.
        interpolation: Displacements and forces between samples: 'linear', 'spline' (cubic), 'smooth' for a spline through each input
            without much noise or jumps (`is_smooth`) and straight lines through the others, or 'auto' for 'smooth', and 'spline' with
            small physics steps where samples are sparse.

    Returns:
        Samples (n,) of the outputs by channel.

    Raises:
        InputError: A channel is missing, the time is not uniform, or the simulation diverges; the message
            names the time and the unsolved law.
    """
    network = Network.load(model)
    time = np.asarray(time, float)
    if time.ndim != 1 or len(time) < 2 or not np.all(np.isfinite(time)):
        raise InputError("time must be a row of at least two finite samples")
    if np.abs(time).max() > 1e12:
        raise InputError(f"time must lie within 1e12 s, not at {np.abs(time).max():g}")
    dt = (time[-1] - time[0]) / (len(time) - 1)
    if dt <= 0 or np.abs(np.diff(time) - dt).max() > 0.01 * dt:
        raise InputError("time must be uniformly sampled and increasing")
    if not step > 0:
        raise InputError(f"the physics step must be positive, not {step}")
    if (dt / step) * len(time) > _MOST_STEPS:
        raise InputError(
            f"{dt * len(time):.4g} s would take more than {_MOST_STEPS:g} steps of {step:g} s: give a larger step"
        )
    if interpolation == "auto":
        run = partial(simulate, network, time, inputs, initial=initial, extra=extra)
        return _simulate_as_needed(run, time, step)
    if interpolation not in ("linear", "smooth", "spline"):
        raise InputError(
            f"interpolation must be linear, smooth, spline or auto, not {shown(interpolation)}"
        )
    every = max(1, math.ceil(dt / step - 1e-9))
    plant = Plant(network, dt / every, extra=extra)
    if initial is not None and (
        isinstance(initial, Mapping) or np.size(initial) != plant.n
    ):
        raise InputError(
            f"initial must be a state ({plant.n},) in the coordinates of the assembly; isd_gym.diagnosis.simulation.state_of makes a state from motions of nodes"
        )
    needs = plant.differentiated
    fine, slopes = {}, {}
    for c in network.inputs:
        if c.name not in inputs:
            raise InputError(f"input '{c.name}' is missing")
        values = np.asarray(inputs[c.name], float)
        if values.shape != time.shape or not np.all(np.isfinite(values)):
            raise InputError(f"input '{c.name}' must hold {len(time)} finite samples")
        values = convert(values, c.unit, c.si)
        fine[c.name] = upsample(values, every, hold=c.quantity in HELD)
        is_splined = interpolation == "spline" or (
            interpolation == "smooth" and is_smooth(values, dt)
        )
        is_splined = is_splined and c.quantity not in HELD
        if c.name in needs or is_splined:
            # the import takes longer than the simulation of most records
            from scipy.interpolate import CubicSpline

            spline = CubicSpline(np.arange(len(values)) * dt, values)
            at = np.arange(len(fine[c.name])) * (dt / every)
            fine[c.name] = spline(at)
            if c.name in needs:
                slopes[c.name] = (spline(at, 1), spline(at, 2))
    with np.errstate(all="ignore"):
        out = plant.run(
            fine, every=every, samples=len(time), initial=initial, derivatives=slopes
        )
    sound = np.isfinite(out).all(axis=(1, 2))
    if not sound.all():
        failure = plant.unsolved[0]
        at = (
            time[0] + plant.step * failure[0]
            if failure
            else time[int(np.argmin(sound))]
        )
        why = (
            f"the force of '{failure[1]}' cannot be found"
            if failure
            else "the motion overflows"
        )
        raise InputError(
            f"model '{network.name}' fails at t = {at:.6g} s: {why} (try a smaller step, or check the stability of the model)"
        )
    named = {
        c.name: convert(out[:, j, 0], c.si, c.unit)
        for j, c in enumerate(plant.channels)
    }
    return sense(network, named, dt)


def _simulate_as_needed(
    run: Callable[..., dict[str, np.ndarray]], time: np.ndarray, step: float
) -> dict[str, np.ndarray]:
    """Return the outputs of `run` with splines through smooth inputs, and through all where an output shows that the samples are sparse."""
    outputs = run(step=step, interpolation="smooth")
    dt = (time[-1] - time[0]) / (len(time) - 1)
    scale = min((pace(y, dt) for y in outputs.values()), default=math.inf)
    if len(time) < _FEWEST or dt <= COARSE * scale:
        return outputs
    fine = max(min(step, FINE * scale), dt * len(time) / _MOST_STEPS)
    return run(step=fine, interpolation="spline")
