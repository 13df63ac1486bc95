"""Static balance of force laws at the start of a simulation: behind a massless node a law's force moves its own terminals."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .._common.arrays import Array
    from . import elements as el

#: largest relative difference between a force and the law's answer in balance
TIGHT = 1e-9
#: largest numbers of Newton steps, of halvings of a step, and of rounds law by law
STEPS, HALVINGS, ROUNDS = 40, 14, 200
#: relative shift of elongation and rate for a one-sided slope
AWAY = 1e-7
#: rate per force below which dry friction moves its terminals at once [m/(N s)]
AT_ONCE = -1e-12
#: largest change of a force in the search for a bracket [N]
FARTHEST = 1e15


@dataclass(frozen=True, eq=False)
class Balance:
    """Laws at an instant, as functions of their forces: masses and massless damped nodes have not moved yet.

    Laws with memory are relaxed: a hysteresis, or dry friction at an algebraic node, carries no force.
    """

    laws: Sequence[el.Element]  # the laws
    # elongation of each law per force of each law (laws, laws) [m/N]
    by_elongation: Array
    by_rate: Array  # rate of each law per force of each law (laws, laws) [m/(N s)]
    step: float  # physics step [s]

    @cached_property
    def smooth(self) -> list[int]:
        """Indices of the smooth laws."""
        return [j for j, e in enumerate(self.laws) if e.law is not None]

    @cached_property
    def dry(self) -> list[int]:
        """Indices of the dry frictions that move their terminals at once."""
        pairs = enumerate(self.laws)
        return [
            j for j, e in pairs if e.bound is not None and self.by_rate[j, j] < AT_ONCE
        ]

    @cached_property
    def numbers(self) -> list[Array]:
        """Parameters of each law."""
        return [np.array(e.law_parameters()) for e in self.laws]

    @cached_property
    def is_plain(self) -> bool:
        """Return whether no force moves a terminal of a law at once."""
        smooth = self.smooth
        return not (
            self.by_elongation[:, smooth].any()
            or self.by_rate[:, smooth].any()
            or self.dry
        )

    def _motion(
        self, unforced: tuple[Array, Array], force: Array
    ) -> tuple[Array, Array]:
        """Return elongations [m] and rates [m/s] (laws,) under forces (laws,) [N]."""
        elongation, rate = unforced
        return elongation + self.by_elongation @ force, rate + self.by_rate @ force

    def _answer(self, j: int, d: float, s: float) -> float:
        """Return the force [N] of smooth law j at an elongation [m] and rate [m/s]."""
        law = self.laws[j].law
        assert law is not None
        return float(law(self.numbers[j], d, s, d, 0.0, self.step)[0])

    def _lacking(self, unforced: tuple[Array, Array], force: Array) -> Array:
        """Return the answers of the smooth laws minus their forces [N]."""
        d, s = self._motion(unforced, force)
        return np.array([self._answer(j, d[j], s[j]) - force[j] for j in self.smooth])

    def solve(self, elongation: Array, rate: Array) -> Array:
        """Return the forces (laws,) [N] on which all laws agree, or the last ones tried, from the elongations [m] and rates [m/s] (laws,)
        without the forces of laws.

        Newton steps for all smooth laws at once come first. A law that does not agree then is bisected between a too small and a too
        large force.
        """
        force = np.zeros(len(self.laws))
        smooth = self.smooth
        unforced = (elongation, rate)
        if self.is_plain:
            force[smooth] = [self._answer(j, elongation[j], rate[j]) for j in smooth]
            return force
        with np.errstate(all="ignore"):  # trial forces may lead far away
            force = self._newton(unforced, force)
            for _ in range(ROUNDS):
                before = force.copy()
                for j in smooth:
                    force[j] = self._bisected(unforced, force, j)
                for j in self.dry:
                    force[j] = self._sliding(unforced, force, j)
                if np.all(np.abs(force - before) <= TIGHT * (1.0 + np.abs(force))):
                    break
        return force

    def _newton(self, unforced: tuple[Array, Array], force: Array) -> Array:
        """Return forces after Newton steps with one-sided slopes, each shortened until the error decreases."""
        smooth = self.smooth
        error = self._lacking(unforced, force)
        for _ in range(STEPS):
            if np.all(np.abs(error) <= TIGHT * (1.0 + np.abs(force[smooth]))):
                break
            try:
                way = np.linalg.solve(self._jacobian(unforced, force), error)
            except np.linalg.LinAlgError:
                break
            if not np.isfinite(way).all():
                break
            for k in range(HALVINGS):
                then = force.copy()
                then[smooth] += 0.5**k * way
                left = self._lacking(unforced, then)
                if np.linalg.norm(left) < np.linalg.norm(error):
                    break
            else:
                break
            force, error = then, left
        return force

    def _jacobian(self, unforced: tuple[Array, Array], force: Array) -> Array:
        """Return the derivatives of the forces minus the answers of the smooth laws by the forces."""
        d, s = self._motion(unforced, force)
        out, own = np.eye(len(self.smooth)), self.smooth
        for k, j in enumerate(own):
            here = self._answer(j, d[j], s[j])
            dd = AWAY * (1e-3 + abs(d[j]))
            ds = AWAY * (1e-2 + abs(s[j]))
            out[k] -= (
                (self._answer(j, d[j] + dd, s[j]) - here)
                / dd
                * self.by_elongation[j, own]
            )
            out[k] -= (
                (self._answer(j, d[j], s[j] + ds) - here) / ds * self.by_rate[j, own]
            )
        return out

    def _bisected(self, unforced: tuple[Array, Array], force: Array, j: int) -> float:
        """Return the force of smooth law j, the others fixed."""
        d, s = self._motion(unforced, force)

        def excess(change: float) -> float:
            there = (
                d[j] + self.by_elongation[j, j] * change,
                s[j] + self.by_rate[j, j] * change,
            )
            return float(self._answer(j, *there) - force[j] - change)

        low = high = 0.0
        reach = 1.0 + abs(force[j])
        if abs(excess(0.0)) <= TIGHT * reach:
            return float(force[j])
        if excess(0.0) > 0.0:
            while reach < FARTHEST and excess(high) > 0.0:
                low = high
                high = high + reach
                reach = 4.0 * reach
        else:
            while reach < FARTHEST and excess(low) < 0.0:
                low, high, reach = low - reach, low, 4.0 * reach
        middle = 0.5 * (low + high)
        while low < middle < high:
            low, high = (middle, high) if excess(middle) > 0.0 else (low, middle)
            middle = 0.5 * (low + high)
        return float(force[j] + middle)

    def _sliding(self, unforced: tuple[Array, Array], force: Array, j: int) -> float:
        """Return the force of dry friction j, the others fixed."""
        d, s = self._motion(unforced, force)
        bound = self.laws[j].bound
        assert bound is not None
        level = bound(self.numbers[j], d[j], s[j])
        return float(np.clip(force[j] - s[j] / self.by_rate[j, j], -level, level))
