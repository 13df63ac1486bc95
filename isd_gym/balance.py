"""Static balance of force laws at the start of a simulation: behind a massless node a law's force moves its own terminals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from . import elements as el
    from .arrays import Array

#: largest relative difference between a force and the law's answer in balance
TIGHT = 1e-9
#: largest numbers of Newton steps, of halvings of a step, and of rounds law by law
STEPS, HALVINGS, ROUNDS = 40, 14, 200
#: relative shift of elongation and rate for a one-sided slope
AWAY = 1e-7
#: rate per force of dry friction above which friction does not move its terminals at once [m/(N s)]
AT_ONCE = -1e-12
#: largest change of a force in the search for a bracket [N]
FARTHEST = 1e15


def balanced_forces(
    laws: Sequence[el.Element],
    elongation: Array,
    rate: Array,
    by_elongation: Array,
    by_rate: Array,
    step: float,
) -> Array:
    """Return the forces on which all laws agree while masses and massless damped nodes have not moved yet.

    Laws with memory are relaxed: a hysteresis, or dry friction at an algebraic node, carries no force. Newton steps for all smooth laws
    at once come first. A law whose Newton steps do not converge is bisected between a too small and a too large force.

    Args:
        laws: The laws (laws,).
        elongation: Elongations without the forces of laws (laws,) [m].
        rate: Rates without the forces of laws (laws,) [m/s].
        by_elongation: Elongation of each law per force of each law (laws, laws) [m/N].
        by_rate: Rate of each law per force of each law (laws, laws) [m/(N s)].
        step: Physics step [s].

    Returns:
        Forces (laws,) [N]; not in balance where no balance was found.
    """
    numbers = [np.array(e.law_parameters()) for e in laws]
    smooth = [j for j, e in enumerate(laws) if e.law is not None]
    dry = [j for j, e in enumerate(laws) if e.bound is not None and by_rate[j, j] < AT_ONCE]

    def motion(f: Array) -> tuple[Array, Array]:
        return elongation + by_elongation @ f, rate + by_rate @ f

    def answer(j: int, d: float, s: float) -> float:
        law: Callable[..., tuple[float, float]] = laws[j].law  # type: ignore[assignment]
        return law(numbers[j], d, s, d, 0.0, step)[0]

    def error(f: Array) -> Array:
        d, s = motion(f)
        return np.array([answer(j, d[j], s[j]) - f[j] for j in smooth])

    def newton(f: Array) -> Array:
        own = np.ix_(smooth, smooth)
        e = error(f)
        for _ in range(STEPS):
            if np.all(np.abs(e) <= TIGHT * (1.0 + np.abs(f[smooth]))):
                break
            d, s = motion(f)
            slopes = np.zeros((2, len(smooth)))
            for k, j in enumerate(smooth):
                here = answer(j, d[j], s[j])
                dd, ds = AWAY * (1e-3 + abs(d[j])), AWAY * (1e-2 + abs(s[j]))
                slopes[:, k] = (answer(j, d[j] + dd, s[j]) - here) / dd, (answer(j, d[j], s[j] + ds) - here) / ds
            matrix = (
                np.eye(len(smooth)) - slopes[0][:, None] * by_elongation[own] - slopes[1][:, None] * by_rate[own]
            )
            try:
                way = np.linalg.solve(matrix, e)
            except np.linalg.LinAlgError:
                break
            for k in range(HALVINGS):
                then = f.copy()
                then[smooth] += 0.5**k * way
                left = error(then)
                if np.linalg.norm(left) < np.linalg.norm(e):
                    f, e = then, left
                    break
            else:
                break
        return f

    def alone(f: Array, j: int) -> float:
        """Return the force of one smooth law, the others fixed."""
        d, s = motion(f)

        def excess(change: float) -> float:
            there = answer(j, d[j] + by_elongation[j, j] * change, s[j] + by_rate[j, j] * change)
            return there - f[j] - change

        low = high = 0.0
        reach = 1.0 + abs(f[j])
        if abs(excess(0.0)) <= TIGHT * reach:
            return float(f[j])
        if excess(0.0) > 0.0:
            while reach < FARTHEST and excess(high) > 0.0:
                low, high, reach = high, high + reach, 4.0 * reach
        else:
            while reach < FARTHEST and excess(low) < 0.0:
                low, high, reach = low - reach, low, 4.0 * reach
        middle = 0.5 * (low + high)
        while low < middle < high:
            low, high = (middle, high) if excess(middle) > 0.0 else (low, middle)
            middle = 0.5 * (low + high)
        return float(f[j] + middle)

    def slid(f: Array, j: int) -> float:
        """Return the force of a dry friction that yields at once, the others fixed."""
        d, s = motion(f)
        bound: Callable[..., float] = laws[j].bound  # type: ignore[assignment]
        level = bound(numbers[j], d[j], s[j])
        return float(np.clip(f[j] - s[j] / by_rate[j, j], -level, level))

    force = np.zeros(len(laws))
    if not (by_elongation[:, smooth].any() or by_rate[:, smooth].any() or dry):
        force[smooth] = error(force)
        return force
    force = newton(force)
    for _ in range(ROUNDS):
        before = force.copy()
        for j in smooth:
            force[j] = alone(force, j)
        for j in dry:
            force[j] = slid(force, j)
        if np.all(np.abs(force - before) <= TIGHT * (1.0 + np.abs(force))):
            break
    return force
