"""Left and right track of a road: coherence of an isotropic surface, shaping filters, wheel positions and delays.

A surface is isotropic if every straight line over the surface has the same statistics, whatever its direction (Dodds
and Robson 1973). The single-track spectral density then determines the cross-spectral density of two parallel tracks.

Let k = 2 pi n be the angular spatial frequency [rad/m] and S(k) = I / (k^2 + k_c^2) the two-sided density of a single
track, with I = (2 pi)^2 G(n0) n0^2 / 2. The autocovariance at the distance r is proportional to exp(-k_c r). At the
lateral distance b (the track width) the points of the two tracks are sqrt(s^2 + b^2) apart. The Fourier transform over
s of exp(-k_c sqrt(s^2 + b^2)), divided by the same transform for b = 0, is the normalised cross-spectral density

    gamma(k) = x K1(x),   x = b sqrt(k^2 + k_c^2),   K1: modified Bessel function of the second kind.

With k_c = 0 (waviness 2 at all wavelengths) the argument is x = 2 pi n b, the formula of Dodds and Robson.
gamma is real; the ordinary coherence is gamma^2.

Decomposition. Half the sum s = (left + right) / 2 and half the difference d = (left - right) / 2 are uncorrelated,
because both tracks have the same density and gamma is real. Their densities are

    S_s = S (1 + gamma) / 2,   S_d = S (1 - gamma) / 2,   left = s + d,   right = s - d.

Rational approximation. gamma is approximated by a sum of real poles p_i with weights w_i of sum 1,

    gamma(x) ~ sum_i w_i p_i^2 / (x^2 + p_i^2)   =>   1 - gamma ~ sum_i w_i x^2 / (x^2 + p_i^2),

and hence, with P_i = sqrt(k_c^2 + (p_i / b)^2),

    S_d = sum_i (I w_i / 2) / (k^2 + P_i^2),   S_s = I / (k^2 + k_c^2) - S_d.

S_s + S_d = S holds without error: the approximation changes gamma alone, never the density of a track. The
difference has no pole at k_c: a road without cut-off has a random walk in s, and d remains bounded.

Discretisation. Both densities are sums of real poles, so samples at the distance h have the autocovariance of
first-order processes with the poles a_i = exp(-P_i h). With u = 4 sin^2(k h / 2) the density of the samples is

    Phi(u) = sum_i B_i / (u + v_i),   B_i = A_i sinh(P_i h) / P_i,   v_i = 4 sinh^2(P_i h / 2),

where A_i are the coefficients of 1 / (k^2 + P_i^2). The zeros u = -mu_j of Phi give the zeros exp(-q_j) of the minimum
phase factor, mu_j = 4 sinh^2(q_j / 2), and partial fractions of the factor give the gains of

    r_i,next = a_i r_i + g_i xi,   track part = sum_i r_i,   xi: white noise of unit variance, one for each of s and d.

The samples have exactly the autocovariance of the continuous process, for every speed and step. P_i h = 0 is no
singularity, and only differences of exponents enter: short steps and roads without cut-off are well conditioned.

References:
    C. J. Dodds and J. D. Robson, "The description of road surface roughness", J. Sound and Vibration 31, 1973.
    K. Bogsjo, "Coherence of road roughness in left and right wheel-path", Vehicle System Dynamics 46, 2008.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from .._common.errors import InputError, shown

__all__ = [
    "WheelPositions",
    "delayed",
    "innovations",
    "track_filters",
]


#: poles p_i and weights w_i of the normalised cross-spectral density: least maximum of the relative error of 1 - gamma for
#: 0.03 <= x <= 300 (0.003 to 30 cycle/m at a track width of 1.6 m); `tests/test_road_tracks.py` repeats the fit
COHERENCE_POLES = (0.0616719, 0.36458450, 1.47371465, 8.54813673)
COHERENCE_WEIGHTS = (0.00386171, 0.10422879, 0.96151732, -0.06960782)
SUM_STATES = len(COHERENCE_POLES) + 1  # first-order states of s
DIFFERENCE_STATES = len(COHERENCE_POLES)  # first-order states of d
TRACK_STATES = SUM_STATES + DIFFERENCE_STATES
NARROWEST, WIDEST = 0.1, 10.0  # track widths [m]
_SNAP = 1e-9  # relative distance from a whole number of steps that is rounding


def innovations(
    poles: np.ndarray, coefficients: np.ndarray, spacing: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the first-order sections, driven by one white noise, whose sum has the sampled density of a process.

    The process has the two-sided density ``sum_i coefficients_i / (k^2 + poles_i^2)``, which must be positive; the
    derivation is that of this module, "Discretisation".

    Args:
        poles: P_i [rad/m] (n,), distinct; zero is allowed (a random walk).
        coefficients: A_i [m^2 rad/m] (n,), of either sign.
        spacing: Distance h between samples [m].

    Returns:
        Discrete poles a_i (n,) and gains g_i [m] (n,) of ``r_i,next = a_i r_i + g_i xi``.
    """
    exponents = poles * spacing
    bounded = np.maximum(exponents, 1e-150)  # sinh(e) / e is 1 for small e
    halves = coefficients * spacing * np.sinh(bounded) / bounded
    scale = float(bounded.max()) ** 2  # the unknown u / scale is of the order of 1
    places = (2 * np.sinh(0.5 * exponents)) ** 2 / scale
    others = ~np.eye(len(poles), dtype=bool)
    numerator = halves @ np.array([_polynomial(places[row]) for row in others])
    zeros = 2 * np.arcsinh(0.5 * np.sqrt(-scale * np.roots(numerator).astype(complex)))
    discrete = np.exp(-exponents)
    at_nyquist = math.sqrt(np.sum(halves / (4 + scale * places)))
    first = at_nyquist * np.prod(1 + discrete) / np.prod(1 + np.exp(-zeros))
    above = np.prod(-np.expm1(exponents[:, None] - zeros), axis=1)
    below = np.prod(-np.expm1(exponents[:, None] - exponents), axis=1, where=others)
    return discrete, np.real(first * above / below)


def _polynomial(places: np.ndarray) -> list[float]:
    """Return the coefficients of the product of (u + place) over `places`, highest power first."""
    out = [1.0]
    for place in places.tolist():
        out = [
            high + place * low
            for high, low in zip([*out, 0.0], [0.0, *out], strict=True)
        ]
    return out


@lru_cache(maxsize=1024)
def track_filters(
    level: float, cutoff: float, width: float, spacing: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the first-order sections of a rough road with a left and a right track.

    States 0 to `SUM_STATES` - 1 are driven by the noise of the sum, the others by the noise of the
    difference:

        r_i,next = poles_i r_i + gains_i xi_sum         i < SUM_STATES
        r_i,next = poles_i r_i + gains_i xi_difference  i >= SUM_STATES
        left, right = s + d, s - d;  s = r_0 + r_1 + ... + r_4,  d = r_5 + ... + r_8, summed in this order

    Args:
        level: G(n0) n0^2 [m]; the one-sided density is level / (n^2 + cutoff^2).
        cutoff: n_c [cycle/m]; 0 for a random walk.
        width: Track width [m].
        spacing: Distance between samples [m]: speed times step.

    Returns:
        Poles (TRACK_STATES,) and gains [m] (TRACK_STATES,), read-only.

    Raises:
        InputError: The track width is implausible.
    """
    if not NARROWEST <= width <= WIDEST:
        raise InputError(f"track width {width:g} m: give {NARROWEST:g} to {WIDEST:g} m")
    intensity = (2 * math.pi) ** 2 * 0.5 * level
    slow = 2 * math.pi * cutoff
    poles = np.hypot(slow, np.array(COHERENCE_POLES) / width)
    parts = 0.5 * intensity * np.array(COHERENCE_WEIGHTS)
    if intensity == 0.0:
        discrete = np.exp(-spacing * np.concatenate([[slow], poles, poles]))
        gains = np.zeros(TRACK_STATES)
    else:
        common = innovations(
            np.append(slow, poles), np.append(intensity, -parts), spacing
        )
        opposite = innovations(poles, parts, spacing)
        discrete, gains = (
            np.concatenate(both) for both in zip(common, opposite, strict=True)
        )
    discrete.flags.writeable = gains.flags.writeable = False
    return discrete, gains


@dataclass(frozen=True)
class WheelPositions:
    """Positions of the wheels of a car in the order of the car's road inputs, in the axes of ISO 8855.

    Wheels with the same y run in one track. Otherwise the wheels with y > 0 run in the left track and the
    wheels with y < 0 in the right track; the track width is the distance between the mean y of both sides.

    Raises:
        InputError: No wheels, unequal numbers of x and y, positions that are not finite, or more than two
            tracks.
    """

    x: tuple[float, ...]  # distance of each wheel in front of the centre of gravity [m]
    # distance of each wheel to the left of the centre of gravity [m]
    y: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check the positions."""
        if not self.x or len(self.x) != len(self.y):
            raise InputError(
                f"wheels: {len(self.x)} positions x and {len(self.y)} positions y; give both for each"
            )
        if not all(math.isfinite(v) and abs(v) < 1e3 for v in (*self.x, *self.y)):
            raise InputError(
                "wheels: a position is not finite, or a kilometre away; give metres"
            )
        if max(self.y) - min(self.y) > _SNAP and not (
            min(self.y) < 0 < max(self.y) and all(self.y)
        ):
            listed = ", ".join(f"{y:g}" for y in sorted(set(self.y)))
            raise InputError(
                f"wheels: a road has one track or a left (y > 0) and a right one (y < 0), not {shown(listed)} m"
            )
        if self.tracks == 2 and not NARROWEST <= self.width <= WIDEST:
            raise InputError(
                f"wheels: track width {self.width:g} m: give {NARROWEST:g} to {WIDEST:g} m"
            )

    @cached_property
    def tracks(self) -> int:
        """Number of tracks, 1 or 2."""
        return 2 if max(self.y) - min(self.y) > _SNAP else 1

    @cached_property
    def track(self) -> tuple[int, ...]:
        """Track of each wheel: 0 for the only or the left track, 1 for the right track."""
        return tuple(int(self.tracks == 2 and y < 0) for y in self.y)

    @cached_property
    def width(self) -> float:
        """Track width [m]; 0 with one track."""
        if self.tracks == 1:
            return 0.0
        return float(
            np.mean([y for y in self.y if y > 0])
            - np.mean([y for y in self.y if y < 0])
        )

    @cached_property
    def behind(self) -> tuple[float, ...]:
        """Distance of each wheel behind the foremost wheel [m]."""
        return tuple(max(self.x) - x for x in self.x)

    @cached_property
    def leaders(self) -> tuple[int, ...]:
        """Index of the foremost wheel of each track."""
        return tuple(
            min(
                (behind, i)
                for i, behind in enumerate(self.behind)
                if self.track[i] == t
            )[1]
            for t in range(self.tracks)
        )

    def delays(self, speed: float, step: float) -> np.ndarray:
        """Return the delay of each wheel behind the foremost wheel.

        Args:
            speed: Speed [m/s].
            step: Step [s].

        Returns:
            Delays [steps] (wheels,), including fractions. A delay within rounding error of an integer is that
                integer.
        """
        steps = np.array(self.behind) / (speed * step)
        whole = np.round(steps)
        return np.where(
            np.abs(steps - whole) <= _SNAP * np.maximum(whole, 1.0), whole, steps
        )


#: a car of one wheel, or of wheels side by side in one track
ONE_WHEEL = WheelPositions((0.0,), (0.0,))


def delayed(heights: np.ndarray, delay: float) -> np.ndarray:
    """Return heights that arrive `delay` steps later: 0 before the start, linear interpolation between steps.

    With the whole part l and the fraction f of the delay the result is ``(1 - f) heights[k - l] + f heights[k - l - 1]``,
    and ``heights[k - l]`` where f is 0. Interpolation has the gain sqrt(1 - 2 f (1 - f) (1 - cos(2 pi F step))) at the
    frequency F, at worst cos(pi F step) at f = 1/2: with a step of 1 ms that is 0.998 at 20 Hz and 0.951 at 100 Hz.

    Args:
        heights: Heights [m] (n,), 0 at the start.
        delay: Delay [steps], not negative.

    Returns:
        Delayed heights [m] (n,).
    """
    low = int(delay)
    part = delay - low
    padded = np.concatenate([np.zeros(low + 1), heights])[: len(heights) + 1]
    if part == 0.0:
        return padded[1:]
    return (1.0 - part) * padded[1:] + part * padded[:-1]
