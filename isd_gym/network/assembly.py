"""Equations of motion of a network, assembled without any hand derivation, and their state space.

With the displacements q of the free nodes, the moved nodes r(t) and the incidence E of everything that is
not linear (motors, friction, force laws f)::

    M q'' + C q' + K q + M_r r'' + C_r r' + K_r r + E f = F

M is singular where nodes have no mass. Its singular value decomposition splits q into directions that carry
momentum (two states each) and the rest; among the rest, those with damping are first-order states and those
without are algebraic. The momentum p = a' + S^-1 U^T M_r r' is the state instead of the velocity, so that r'' is
needed by no state, only by outputs.

Where a node is moved by its velocity or its acceleration, which tell its place only up to constants, what is tied to it
is seen from a frame that moves with it: q = q_rel + 1 r, and every mass feels -m r'' (`frames`). Then no r is needed where
nothing but dampers ties it to the ground, and no r' where nothing does; momentum is kept where r' is known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .. import elements as el
from ..errors import InputError
from ..units import TURNING
from .model import GROUND, MOTIONS, Channel, Network


@dataclass(frozen=True)
class Assembly:
    """The equations of a network, with every law's force f an input of the linear part.

    The columns of all matrices are the base vector (x, r, v, alpha, F, I, f): states, displacement [m], velocity and
    acceleration of the moved nodes, force inputs [N], currents [A], law forces [N]. ``dx/dt = rate @ base``.
    `elongation` and `elongation_rate` have one row per law; rows of `by_difference` laws hang on an algebraic node, whose
    velocity is the difference of its positions.

    `outputs` has one row per channel; those of `outputs_by_difference` hang on an algebraic node too.
    """

    network: Network
    channels: tuple[Channel, ...]  # of the outputs
    size: tuple[int, int, int, int, int]  # states, moved nodes, force inputs, currents, laws
    laws: tuple[el.Element, ...]
    rate: np.ndarray
    elongation: np.ndarray
    elongation_rate: np.ndarray
    by_difference: tuple[bool, ...]
    outputs: np.ndarray
    outputs_by_difference: tuple[bool, ...]
    position: np.ndarray  # of the free nodes
    velocity: np.ndarray

    def columns(self, part: str) -> slice:
        """Columns of a `part` of the base vector: 'x', 'r', 'v', 'alpha', 'F', 'I' or 'f'."""
        n, r, f, i, k = self.size
        widths = {"x": n, "r": r, "v": r, "alpha": r, "F": f, "I": i, "f": k}
        start = 0
        for name, width in widths.items():
            if name == part:
                return slice(start, start + width)
            start += width
        raise KeyError(part)


def assemble(network: Network, extra: Sequence[Channel] = ()) -> Assembly:
    """Equations of motion of any network, and the rows of its outputs (and of `extra` channels after them).

    Raises `InputError` where the massless part is singular or an output asks for what the network does not define
    (the acceleration of a massless node).

    network: as it is, masses and all.
    """
    return _assemble(network, extra) if extra else network._assembly


def _assemble(network: Network, extra: Sequence[Channel]) -> Assembly:
    moved = network.moved_nodes
    free = tuple(n for n in network.nodes if n not in moved)
    index = {n: i for i, n in enumerate(free + moved)}
    n_free, n_moved = len(free), len(moved)
    total = n_free + n_moved

    def incidence(pair: tuple[str, str]) -> np.ndarray:
        row = np.zeros(total)
        for node, sign in zip(pair, (1.0, -1.0), strict=True):
            if node != GROUND:
                row[index[node]] += sign
        return row

    riding = frames(network)
    M, C, K = (np.zeros((total, total)) for _ in range(3))
    for node, mass in network.masses.items():
        M[index[node], index[node]] += mass
    between = [e for e in network.elements if e.place == "between"]
    for e in between:
        row = incidence(e.between)
        k, c, b = e.linear()
        K += k * np.outer(row, row)
        C += c * np.outer(row, row)
        M += b * np.outer(row, row)
        if isinstance(e, el.TerminalInertia):
            node = e.between[0 if e.terminal == "first" else 1]
            if node != GROUND:
                M[:, index[node]] += e.mass * row
    laws = tuple(part for e in between for part in e.parts())
    law_rows = np.array([incidence(e.between) for e in laws]).reshape(len(laws), total)
    forces = [c for c in network.inputs if c.quantity == "force"]
    currents = [c for c in network.inputs if c.quantity == "current"]

    # -- split the free directions
    U, s, Vt = np.linalg.svd(M[:n_free, :n_free]) if n_free else (np.eye(0), np.zeros(0), np.eye(0))
    rho = int(np.sum(s > 1e-10 * s[0])) if n_free and s[0] > 0 else 0
    S = s[:rho, None]
    Ua, Uz, Va, Vz = U[:, :rho], U[:, rho:], Vt[:rho].T, Vt[rho:].T
    Mf, Cf, Kf = (X[:n_free, :n_free] for X in (M, C, K))
    frame = np.zeros((n_free, n_moved))  # one where a free node is seen from the frame of a moved one
    for node, j in riding.items():
        frame[index[node], j] = 1.0
    Mr, Cr, Kr = (X[:n_free, n_free:] + X[:n_free, :n_free] @ frame for X in (M, C, K))
    if riding:  # what cancels does so exactly
        for X in (Mr, Cr, Kr):
            X[np.abs(X) < 1e-12 * np.abs(M if X is Mr else C if X is Cr else K).max(initial=0.0)] = 0.0
    told = np.array([MOTIONS.index(c.quantity) for c in network.moving], int)  # 0: r, 1: r', 2: r''
    Mv = Mr * (told < 2)  # of momentum: where r' is known
    if Uz.size and np.abs(Uz.T @ Mr).max(initial=0.0) > 1e-9 * np.abs(M).max():
        raise InputError("an inertia between a massless node and a moved node is not supported here")
    P, t, Qt = np.linalg.svd(Uz.T @ Cf @ Vz)
    tau = int(np.sum(t > 1e-10 * max(np.abs(Cf).max(initial=0.0), 1e-300))) if t.size else 0
    T = t[:tau, None]
    P1, P2, Q1, Q2 = P[:, :tau], P[:, tau:], Qt[:tau].T, Qt[tau:].T

    n = 2 * rho + tau
    size = (n, n_moved, len(forces), len(currents), len(laws))
    widths = np.cumsum([0, n, n_moved, n_moved, n_moved, len(forces), len(currents), len(laws)])
    at = [slice(a, b) for a, b in zip(widths[:-1], widths[1:], strict=True)]
    x_, r_, v_, alpha_, F_, I_, f_ = at
    width = widths[-1]

    def select(columns: slice, rows: int, start: int = 0) -> np.ndarray:
        out = np.zeros((rows, width))
        out[np.arange(rows), columns.start + start + np.arange(rows)] = 1.0
        return out

    r, v, alpha = select(r_, n_moved), select(v_, n_moved), select(alpha_, n_moved)
    # what pushes on the nodes besides M, C and K: forces in, motors and laws out (positive in tension)
    push = np.zeros((total, width))
    for j, channel in enumerate(forces):
        push[index[str(channel.at)], F_.start + j] += 1.0
    motor_force: dict[str, np.ndarray] = {}
    for e in between:
        if isinstance(e, el.Motor):
            motor_force[e.name] = np.zeros(width)
            for j, channel in enumerate(currents):
                if channel.element == e.name:
                    motor_force[e.name][I_.start + j] = e.thrust_constant * e.ratio
            push -= np.outer(incidence(e.between), motor_force[e.name])
    push[:, f_] -= law_rows.T
    push_free = push[:n_free]

    a, p, y = select(x_, rho), select(x_, rho, rho), select(x_, tau, 2 * rho)
    a1 = p - (Ua.T @ Mv @ v) / S
    known = Cf @ Va @ a1 + Kf @ (Va @ a + Vz @ Q1 @ y) + Cr @ v + Kr @ r - push_free
    Kww = P2.T @ Uz.T @ Kf @ Vz @ Q2
    if Kww.size:
        scale = np.abs(Kf).max()
        sv = np.linalg.svd(Kww, compute_uv=False)
        if scale == 0.0 or sv[-1] < 1e-12 * scale:
            direction = Vz @ Q2 @ np.linalg.svd(Kww)[2][-1]
            names = ", ".join(f"'{m}'" for m, w in zip(free, direction, strict=True) if abs(w) > 0.1)
            raise InputError(
                f"the massless part is singular: nothing holds {names} (add a spring, damper or mass)"
            )
        w = -np.linalg.solve(Kww, P2.T @ Uz.T @ known)
    else:
        w = np.zeros((Q2.shape[1], width))
    z = Q1 @ y + Q2 @ w
    q = Va @ a + Vz @ z
    y1 = -(P1.T @ Uz.T @ (known + Kf @ Vz @ Q2 @ w)) / T
    q1 = Va @ a1 + Vz @ Q1 @ y1  # without the algebraic directions: see by_difference
    a2 = -(Ua.T @ (known + Kf @ Vz @ Q2 @ w + Cf @ Vz @ Q1 @ y1 + Mr @ alpha)) / S
    p1 = a2 + (Ua.T @ Mv @ alpha) / S
    rate = np.vstack([a1, p1, y1])

    position, velocity = np.vstack([q + frame @ r, r]), np.vstack([q1 + frame @ v, v])
    acceleration = np.vstack([Va @ a2 + frame @ alpha, alpha])
    algebraic = np.concatenate([np.abs(Vz @ Q2).sum(axis=1), np.zeros(n_moved)]) > 1e-9
    basis_z = np.vstack([Vz, np.zeros((n_moved, Vz.shape[1]))])
    basis_w = np.vstack([Vz @ Q2, np.zeros((n_moved, Q2.shape[1]))])

    def hangs_on(row: np.ndarray, basis: np.ndarray) -> bool:
        return bool(np.abs(row @ basis).max(initial=0.0) > 1e-9)

    def motion(row: np.ndarray, quantity: str, where: str) -> tuple[np.ndarray, bool]:
        if quantity == "displacement":
            return row @ position, False
        if quantity == "velocity":
            if hangs_on(row, basis_w):
                return row @ position, True
            return row @ velocity, False
        if hangs_on(row, basis_z):
            raise InputError(f"{where}: the acceleration of a massless node is not defined")
        return row @ acceleration, False

    def force_of(e: el.Element, where: str) -> np.ndarray:
        row = incidence(e.between)
        if e.parts():
            return np.asarray(sum(select(f_, 1, laws.index(part))[0] for part in e.parts()))
        if isinstance(e, el.Motor):
            return motor_force[e.name]
        if isinstance(e, el.TerminalInertia):
            node = e.between[0 if e.terminal == "first" else 1]
            return e.mass * motion(incidence((node, GROUND)), "acceleration", where)[0]
        k, c, b = e.linear()
        out = k * (row @ position)
        if c:
            rate_row, difference = motion(row, "velocity", where)
            if difference:
                raise InputError(f"{where}: the velocity of an algebraic node is not defined")
            out = out + c * rate_row
        return out + b * motion(row, "acceleration", where)[0] if b else out

    rows, differences = [], []
    for channel in (*network.outputs, *extra):
        where = f"output '{channel.name}'"
        if channel.element is not None:
            row, difference = np.zeros(width), False
            for name in channel.elements:
                row = row + force_of(network.element(name), where)
        elif channel.quantity == "force":
            row, difference = np.zeros(width), False
            for e in between:
                sign = incidence(e.between)[index[str(channel.at)]]
                if sign:
                    row = row + sign * force_of(e, where)
            mass = network.masses.get(str(channel.at), 0.0)
            row = row + mass * acceleration[index[str(channel.at)]]
        else:
            pair = channel.between or (str(channel.at), GROUND)
            row, difference = motion(incidence(pair), channel.quantity, where)
        rows.append(row)
        differences.append(difference)

    by_difference = tuple(hangs_on(row, basis_w) for row in law_rows)
    elongation, elongation_rate = law_rows @ position, law_rows @ velocity
    if told.any():
        unknown = [(r_.start + j, "displacement") for j in np.flatnonzero(told > 0)]
        unknown += [(v_.start + j, "velocity") for j in np.flatnonzero(told > 1)]
        for e, d in zip(laws, elongation, strict=True):
            if e.plane == "rate" and GROUND in e.where:
                d[[column for column, lacking in unknown if lacking == "displacement"]] = 0.0
        rows = [np.where(np.abs(row) < 1e-12 * np.abs(row).max(initial=0.0), 0.0, row) for row in rows]
        _complete(network, unknown, rate, elongation, elongation_rate, rows)
    if not all(np.isfinite(m).all() for m in (rate, position, velocity, *rows)):
        raise InputError(TOO_FAR_APART)
    return Assembly(
        network=network,
        channels=(*network.outputs, *extra),
        size=size,
        laws=laws,
        rate=rate,
        elongation=elongation,
        elongation_rate=elongation_rate,
        by_difference=by_difference,
        outputs=np.array(rows).reshape(len(rows), width),
        outputs_by_difference=tuple(differences),
        position=position,
        velocity=np.where(algebraic[:, None], 0.0, velocity),
    )


def frames(network: Network) -> dict[str, int]:
    """Free nodes that are seen from the frame of a moved one: node -> number of the input that moves it (of `moving`).

    network: the model. Raises `InputError` where a part of the network has a moved node that is told by its velocity or
    acceleration, and another moved node besides.
    """
    out: dict[str, int] = {}
    for j, c in enumerate(network.moving):
        if c.quantity == "displacement":
            continue
        part = network.tied[str(c.at)]
        other = next((o for o in network.moving if o is not c and network.tied[str(o.at)] == part), None)
        if other is not None:
            raise InputError(
                f"input '{c.name}': the {c.spoken} of '{c.at}' says nothing of its distance from '{other.at}', which "
                f"'{other.name}' moves and the network ties to it: give both as displacements, or leave one out"
            )
        out |= {n: j for n, p in network.tied.items() if p == part and n != c.at}
    return out


def _complete(
    network: Network, unknown: Sequence[tuple[int, str]], rate: Any, d: Any, v: Any, outputs: Sequence[Any]
) -> None:
    """Raise `InputError` where equations or outputs need what the velocity or the acceleration of a node does not tell.

    unknown: columns of the base vector that are not known, and what each is.
    """
    moving = [c for c in network.moving if c.quantity != "displacement"]

    def first(rows: Any) -> tuple[int, str] | None:
        """Row and what it lacks."""
        for k, row in enumerate(rows):
            for column, lacking in unknown:
                if abs(row[column]) > 1e-9 * max(np.abs(row).max(), 1e-300):
                    return k, lacking
        return None

    dynamics = first(rate) or first(d) or first(v)
    if dynamics is not None:
        for c in moving:
            part = network.tied[str(c.at)]
            ties = [e for e in network.elements if e.place == "between" and GROUND in e.where]
            ties = [e for e in ties if network.tied[next(n for n in e.where if n != GROUND)] == part]
            lacking = dynamics[1]
            ties = [
                e for e in ties if e.law is not None or e.bound is not None or any(e.linear()[:2])
            ] or ties
            if ties:
                what = {("displacement", True): "angle", ("velocity", True): "angular velocity"}.get(
                    (lacking, c.si in TURNING), lacking
                )
                raise InputError(
                    f"input '{c.name}': element '{ties[0].name}' ties '{ties[0].where[0]}' to '{ties[0].where[1]}', and needs "
                    f"the {what} of '{c.at}', which its {c.spoken.replace('_', ' ')} does not tell: measure that too and "
                    "give it as the input instead"
                )
        raise InputError(f"input '{moving[0].name}': the {dynamics[1]} of '{moving[0].at}' is missing")
    seen = first(outputs)
    if seen is not None:
        every = {k: c for k, c in enumerate(network.outputs)}
        name = f"output '{every[seen[0]].name}'" if seen[0] in every else "a channel"
        node = every[seen[0]].at if seen[0] in every else None
        raise InputError(
            f"{name}: the {seen[1]} {f'of {node!r} ' if node else ''}against the ground is not told by input "
            f"'{moving[0].name}', the {moving[0].spoken.replace('_', ' ')} of '{moving[0].at}': measure it \"between\" "
            "that node and another"
        )


@dataclass(frozen=True)
class StateSpace:
    """``dx/dt = A x + B u``, ``y = C x + D u``, SI units, with the names of inputs u and outputs y."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def response(self, frequency: np.ndarray) -> np.ndarray:
        """Complex frequency response, shape (len(frequency), outputs, inputs), at `frequency` [Hz]."""
        s = 2j * np.pi * np.asarray(frequency, float)
        eye = np.eye(len(self.A))
        return np.array([self.C @ np.linalg.solve(si * eye - self.A, self.B) + self.D for si in s])


#: what is said of a network whose equations are not finite
TOO_FAR_APART = "the model's numbers lie too far apart: its equations are not finite"


def _slopes(laws: Sequence[el.Element], damping: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness [N/m] and damping [N s/m] of each law at rest, or of `damping` where it names the law."""
    slopes_k, slopes_c = np.zeros(len(laws)), np.zeros(len(laws))
    for j, e in enumerate(laws):
        if e.name in damping:
            slopes_c[j] = damping[e.name]
        elif e.law is not None:
            p, d, h = np.array(e.law_parameters()), 1e-7, 1e-9
            slopes_k[j] = (e.law(p, d, 0.0, 0.0, 0.0, h)[0] - e.law(p, -d, 0.0, 0.0, 0.0, h)[0]) / (2 * d)
            slopes_c[j] = (e.law(p, 0.0, d, 0.0, 0.0, h)[0] - e.law(p, 0.0, -d, 0.0, 0.0, h)[0]) / (2 * d)
    return slopes_k, slopes_c


def linearise(
    network: Network | str | Path | Mapping[str, Any],
    *,
    outputs: Sequence[Channel] = (),
    damping: Mapping[str, float] | None = None,
    laws: bool = False,
) -> StateSpace:
    """State space of a network about rest, for controllers and frequency responses.

    `outputs` adds channels to the network's own. A law counts as a linear damper of `damping[element name]`
    [N s/m] (statistical linearisation of friction, equation 9), else by its slope at rest; with `laws=True` its
    force is an input of that name instead. Velocities and accelerations of moved nodes appear as inputs
    ``road'`` and ``road''`` where something acts through them.

    network: a network, a built-in one's name, a file or its content.
    """
    network = Network.load(network)
    asm = assemble(network, outputs)
    X, f = asm.columns("x"), asm.columns("f")
    rate, out = asm.rate, asm.outputs
    if any(asm.outputs_by_difference):
        raise InputError("the velocity of an algebraic node has no state-space form")
    if not laws and asm.laws:
        try:
            slopes_k, slopes_c = _slopes(asm.laws, damping or {})
            # f = Kd d + Kc v with d, v = rows @ base and base containing f: solve for f
            rows = slopes_k[:, None] * asm.elongation + slopes_c[:, None] * asm.elongation_rate
            gain = np.linalg.solve(np.eye(len(asm.laws)) - rows[:, f], rows)
        except (ArithmeticError, np.linalg.LinAlgError):  # a law without a slope, or one that nothing holds
            raise InputError(TOO_FAR_APART) from None
        rate, out = rate + rate[:, f] @ gain, out + out[:, f] @ gain
        if not (np.isfinite(rate).all() and np.isfinite(out).all()):
            raise InputError(TOO_FAR_APART)
    names: list[str] = []
    keep: list[int] = []
    told = {c.name: MOTIONS.index(c.quantity) for c in network.moving}
    groups = [
        ("r", [name if at == 0 else "" for name, at in told.items()]),
        ("v", [name + "'" * (1 - at) if at < 2 else "" for name, at in told.items()]),
        ("alpha", [name + "'" * (2 - at) for name, at in told.items()]),
        ("F", [c.name for c in network.inputs if c.quantity == "force"]),
        ("I", [c.name for c in network.inputs if c.quantity == "current"]),
        ("f", [e.name for e in asm.laws] if laws else []),
    ]
    for part, labels in groups:
        for j, label in enumerate(labels):
            column = asm.columns(part).start + j
            derived = label == "" or label.endswith("'")
            if not derived or np.any(rate[:, column]) or np.any(out[:, column]):
                names.append(label)
                keep.append(column)
    return StateSpace(
        A=rate[:, X].copy(),
        B=rate[:, keep],
        C=out[:, X].copy(),
        D=out[:, keep],
        inputs=tuple(names),
        outputs=tuple(c.name for c in (*network.outputs, *outputs)),
    )
