"""Smooth laws: numba-compilable functions ``law(p, d, v, d_last, z, h) -> (force, z_next)``.

Arguments are the parameters ``p``, the elongation ``d`` and rate ``v`` at the end of the step, the elongation
``d_last`` at the beginning, a state ``z`` and the step ``h``.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ._base import (
    GROUND,
    PROBE,
    Element,
    Motion,
    Setting,
    Start,
    beside,
    growing,
    held_still,
    parameter,
    plausible,
    register,
    rms,
)
from ._linear import LinearDamping, is_device

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..._common.arrays import Array
    from ..network import Network


TURN = 2.0 * math.pi  # [rad]
#: number of periods over the travel, or per turn, up to which every pitch is tried
PERIODS = 120
#: relative standard deviation of a damping up to which the damper is known to exist
SURE_DAMPER = 0.5


def _quadratic(
    p: Array, d: float, v: float, d_last: float, z: float, h: float
) -> tuple[float, float]:
    return p[0] * v * abs(v), z


def _degressive(
    p: Array, d: float, v: float, d_last: float, z: float, h: float
) -> tuple[float, float]:
    return p[0] * v / (1.0 + abs(v) / p[1]), z


def _asymmetric(
    p: Array, d: float, v: float, d_last: float, z: float, h: float
) -> tuple[float, float]:
    return (p[0] if v > 0.0 else p[1]) * v, z


def _cubic(
    p: Array, d: float, v: float, d_last: float, z: float, h: float
) -> tuple[float, float]:
    return p[0] * d * d * d, z


def _gas(
    p: Array, d: float, v: float, d_last: float, z: float, h: float
) -> tuple[float, float]:
    # the length of the column is bounded at 1 %: below, the law has no meaning
    return p[0] * (1.0 - max(1.0 + d / p[1], 0.01) ** (-p[2])), z


def _stop(
    p: Array, d: float, v: float, d_last: float, z: float, h: float
) -> tuple[float, float]:
    over = d - p[0] if d > 0.0 else d + p[0]
    touching = (d > p[0] and p[3] >= 0.0) or (d < -p[0] and p[3] <= 0.0)
    if not touching:
        return 0.0, z
    f = p[1] * over + p[2] * v
    return (max(f, 0.0) if d > 0.0 else min(f, 0.0)), z  # a stop pushes and never pulls


def _backlash(
    p: Array, d: float, v: float, d_last: float, z: float, h: float
) -> tuple[float, float]:
    half = 0.5 * p[0]
    return (
        p[1] * (d - half) if d > half else p[1] * (d + half) if d < -half else 0.0
    ), z


def _bouc_wen(
    p: Array, d: float, v: float, d_last: float, z: float, h: float
) -> tuple[float, float]:
    level, stiffness, exponent, shape = p[0], p[1], p[2], p[3]
    way = d - d_last
    if level <= 0.0 or way == 0.0:
        return z, z
    x = stiffness * abs(way) / level
    if exponent == 1.0:  # closed form: linear in the state on either side of zero
        u = z / level if way > 0.0 else -z / level
        if u < 0.0:
            a, u = 1.0 - 2.0 * shape, max(u, -1.0)  # du/dx = 1 + a u
            rest = max(1.0 + a * u, 1e-12)
            home = -u if abs(a) < 1e-9 else -math.log(rest) / a
            ahead = min(x, home)
            u = (
                0.0
                if home <= x
                else u + (ahead if abs(a) < 1e-9 else rest * math.expm1(a * ahead) / a)
            )
            x -= ahead
        if u >= 0.0:
            u = 1.0 - (1.0 - u) * math.exp(-x)
        z = level * u if way > 0.0 else -level * u
        return z, z
    # second-order exponential Runge-Kutta method in travel: saturation holds at any length of a step, and a
    # constant number of parts makes the force a smooth function of the travel
    u, parts = max(min(z / level if way > 0.0 else -z / level, 1.0), -1.0), 8
    x /= parts
    for _ in range(parts):  # du/dx = rest - slope u
        power = abs(u) ** exponent
        slope = exponent * (power / u if exponent > 1.0 else 1.0) if u > 0.0 else 0.0
        y = slope * x
        decay = x if y < 1e-8 else -math.expm1(-y) / slope
        m = min(
            u + (1.0 - power * (1.0 if u > 0.0 else 1.0 - 2.0 * shape)) * decay, 1.0
        )
        change = power * (1.0 if u > 0.0 else 1.0 - 2.0 * shape) - abs(
            m
        ) ** exponent * (1.0 if m > 0.0 else 1.0 - 2.0 * shape)
        better = m + (change + slope * (m - u)) * (
            0.5 * x if y < 1e-8 else (x - decay) / y
        )
        u = min(better, 1.0) if better > u else m
    z = level * u if way > 0.0 else -level * u
    return z, z


def _cogging(
    p: Array, d: float, v: float, d_last: float, z: float, h: float
) -> tuple[float, float]:
    return p[0] * math.sin(2.0 * math.pi * d / p[1] + p[2]), z


def _lift_off(
    p: Array, d: float, v: float, d_last: float, z: float, h: float
) -> tuple[float, float]:
    return -max(p[0] * d - p[1], 0.0), z


def _constant(
    p: Array, d: float, v: float, d_last: float, z: float, h: float
) -> tuple[float, float]:
    return p[0], z


def _gravity(
    p: Array, d: float, v: float, d_last: float, z: float, h: float
) -> tuple[float, float]:
    return p[0] * math.sin(d + p[1]), z


@register
class ConstantForce(Element):
    type = "constant_force"
    mechanism = "constant"
    equation = "F = F0"
    source = "gravity along a slope, a preload, a drive's offset"
    signature = (
        "a drift that grows with the square of time where nothing holds the terminals"
    )
    test = "Let go of the two parts at rest: they must be pulled together with {force}."
    plane = "elongation"
    law = staticmethod(_constant)
    force: float = parameter("N", 1.0, 2e4, minimum=-math.inf)

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        return super().stands(network, where) and not held_still(network, where)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        v = at.moves.v
        if (v.min() >= 0.0 or v.max() <= 0.0) and abs(v[-1]) < abs(v[0]):
            return []  # monotonic motion that slows down without reversal fits dry friction equally well
        return [Start({"force": at.small}, grows=("force",), signed=True)]


@register
class GravitySine(Element):
    type = "gravity_sine"
    mechanism = "elastic"
    equation = "F = G sin(d + d0), G = m g l: a pendulum's torque about its axis"
    source = "a pendulum; d0 = 0 hangs, pi stands"
    signature = "a stiffness that softens with amplitude, as the cosine does"
    test = "Hold the pendulum level: its torque must be {torque}, and half of that at 30 degrees."
    replaces = ("linear_stiffness",)  # the slope at rest is the stiffness
    law = staticmethod(_gravity)
    torque: float = parameter("N", 1e-3, 1e4)  # [N m] at a rotation
    rest: float = parameter(
        "rad", -math.pi, math.pi, default=0.0, minimum=-math.inf, fixed=True
    )

    def period(self) -> float:
        return TURN

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        # for a body that rotates against gravity
        turns = any(n in network.rotating for n in where)
        return turns and GROUND in where and super().stands(network, where)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        held = sum(e.linear()[0] for e in at.beside if e.type == "linear_stiffness")
        return [growing(torque=held or at.small / rms(np.sin(at.moves.d)))]


@register
class QuadraticDamping(Element):
    type = "quadratic_damping"
    mechanism = "viscous"
    equation = "F = c2 v |v|"
    source = "orifice flow; Wang and Su, Vehicle System Dynamics 46 (2008), hydraulic inerters"
    signature = "damping that grows with amplitude"
    test = (
        "Double the speed: the extra force must grow fourfold ({damping}), and vanish among the noise at "
        "a tenth."
    )
    plane = "rate"
    law = staticmethod(_quadratic)
    damping: float = parameter("N s^2/m^2", 10.0, 1e5)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [growing(damping=at.small / rms(at.moves.v**2))]


#: knee of degressive damping, as a share of the RMS rate, below which the law is dry friction
DRY = 0.05
#: share of the samples beyond the slip displacement from which a slider is seen to slip
SLIPPING = 0.01


@register
class DegressiveDamping(Element):
    type = "degressive_damping"
    mechanism = "viscous"
    equation = "F = c v / (1 + |v| / v_d), in place of the linear damper"
    source = (
        "Dixon, The Shock Absorber Handbook: blow-off valves; shear-thinning fluids"
    )
    signature = "damping that is smaller at high speed: half of that at rest at v_d, and a force of at most c v_d"
    test = "Double the speed: the force must grow by less than twice, the less the further beyond {knee}; near rest its slope is {damping}."
    plane = "rate"
    contains = ("linear_damping", "coulomb_friction")
    replaces = ("linear_damping",)  # the slope at rest is the damping
    shaped_by = "knee"
    law = staticmethod(_degressive)
    damping: float = parameter("N s/m", 10.0, 1e5)
    # from the typical rate to nine times the typical rate: below, the law approaches dry friction, above, a
    # linear damper
    knee: float = plausible(parameter("m/s", 1e-3, 1.0, open_end=True), reach=3.0)

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        # without a known damper, dry friction with rounded corners would be mistaken for this law
        dampers = [e.name for e in beside(network, where) if e.type == "linear_damping"]
        known = any(
            network.uncertainty.get(f"{name}.damping", 0.0) <= SURE_DAMPER
            for name in dampers
        )
        return known and super().stands(network, where)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        linear = sum(e.linear()[1] for e in at.beside if e.type == "linear_damping")
        force = linear * rms(at.moves.v) or at.small
        knee = 3.0 * rms(at.moves.v)
        # same RMS force as the linear damper, with deviations of either sign
        damping = force / rms(at.moves.v / (1.0 + np.abs(at.moves.v) / knee))
        return [Start({"damping": damping, "knee": knee}, signed=True)]

    @classmethod
    def special(
        cls, simple: str, values: Mapping[str, float], motion: Motion | None
    ) -> dict[str, float]:
        rate = rms(motion.v) if motion is not None else values["knee"]
        slope = values["damping"] / (1.0 + rate / values["knee"])
        return (
            {"level": slope * rate}
            if simple == "coulomb_friction"
            else {"damping": slope}
        )

    def differs_from_limit(self, motion: Motion) -> bool:
        """Return whether the knee is within the rates of the motion; for a much smaller knee the law is dry friction."""
        return self.knee > DRY * rms(motion.v)


@register
class AsymmetricDamping(Element):
    type = "asymmetric_damping"
    mechanism = "viscous"
    equation = "F = c_e v for v > 0 (extension), c_c v for v < 0 (compression), beside what stands there"
    source = "Dixon, The Shock Absorber Handbook: rebound and bump damping differ"
    signature = (
        "an even part in the force-velocity plane; a mean offset under vibration"
    )
    test = (
        "Vibrate the two parts without a mean load: they must creep to one side, the more the faster the "
        "motion."
    )
    plane = "rate"
    contains = ("linear_damping",)
    law = staticmethod(_asymmetric)
    extension: float = parameter("N s/m", -3000.0, 5000.0, minimum=-math.inf)
    compression: float = parameter("N s/m", -3000.0, 5000.0, minimum=-math.inf)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        c = at.small / rms(at.moves.v)
        sides = (
            {"extension": c, "compression": 0.0},
            {"extension": 0.0, "compression": c},
        )
        return [
            Start(
                {"extension": c, "compression": c},
                sides,
                ("extension", "compression"),
                signed=True,
            )
        ]

    @classmethod
    def sized(cls, start: Start, amplitude: Array) -> dict[str, float]:
        keys = ("extension", "compression")
        return {
            k: float(a) * start.values[k] for k, a in zip(keys, amplitude, strict=True)
        }

    @classmethod
    def special(
        cls, simple: str, values: Mapping[str, float], motion: Motion | None
    ) -> dict[str, float]:
        return {"damping": 0.5 * (values["extension"] + values["compression"])}

    def differing(self, beside: Sequence[Element]) -> tuple[str, str] | None:
        damped = any(isinstance(e, LinearDamping) for e in beside)
        return ("extension", "compression") if damped else None


@register
class CubicStiffness(Element):
    type = "cubic_stiffness"
    mechanism = "elastic"
    equation = "F = k3 d^3"
    source = "Duffing; progressive springs"
    signature = "stiffness that grows with amplitude, smoothly and without dissipation"
    test = (
        "Load the two parts slowly to half and to full travel: the extra force must grow eightfold "
        "({stiffness}), and the same on the way back."
    )
    law = staticmethod(_cubic)
    stiffness: float = parameter("N/m^3", 1e4, 1e9, minimum=-math.inf)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [
            Start(
                {"stiffness": at.small / rms(at.moves.d**3)},
                grows=("stiffness",),
                signed=True,
            )
        ]


@register
class GasSpring(Element):
    type = "gas_spring"
    mechanism = "elastic"
    equation = "F = F0 [1 - (1 + d/L)^(-n)]"
    source = "polytropic gas column about its static state"
    signature = "stiffer in compression than in extension, smoothly"
    test = (
        "Load the two parts slowly: compression must be stiffer than extension, with no loss over a full "
        "loop."
    )
    contains = ("linear_stiffness",)  # long
    shaped_by = "length"
    law = staticmethod(_gas)
    force: float = parameter("N", 50.0, 2e4)
    length: float = parameter("m", 0.02, 1.0, open_end=True)
    exponent: float = parameter("-", 1.0, 1.67, default=1.3, fixed=True)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        lengths = [s * at.moves.reach for s in (1.5, 4.0, 12.0)]
        return [
            Start(
                {"force": at.small * x / (1.3 * rms(at.moves.d)), "length": x},
                grows=("force",),
            )
            for x in lengths
        ]

    @classmethod
    def special(
        cls, simple: str, values: Mapping[str, float], motion: Motion | None
    ) -> dict[str, float]:
        return {"stiffness": values["force"] * values["exponent"] / values["length"]}


@register
class BumpStop(Element):
    type = "bump_stop"
    mechanism = "elastic"
    equation = "F = k (|d| - clearance) sgn d + c v in contact, never pulling; 0 else"
    source = (
        "deputy cylinder stroke of Table 1: +-100 mm / 4.056 = +-24.65 mm at the device"
    )
    signature = "nothing below a travel, a stiff spring beyond it"
    test = "Load the two parts slowly: nothing extra below {clearance}, a slope of {stiffness} beyond it."
    contains = ("linear_stiffness",)  # without clearance
    shaped_by = "clearance"
    choices: ClassVar[dict[str, tuple[str, ...]]] = {
        "side": ("both", "extension", "compression")
    }
    law = staticmethod(_stop)
    clearance: float = parameter("m", 1e-3, 0.1)
    stiffness: float = parameter("N/m", 1e4, 5e6)
    damping: float = parameter("N s/m", 0.0, 1e4, default=0.0, fixed=True)
    side: str = "both"

    def law_parameters(self) -> list[float]:
        side = {"both": 0.0, "extension": 1.0, "compression": -1.0}[self.side]
        return [self.clearance, self.stiffness, self.damping, side]

    def quiet(self) -> float:
        return self.clearance

    def support(self, motion: Motion) -> float:
        """Return the share of the samples in contact."""
        upper, lower, *_ = self.contact()
        return float(np.mean((motion.d > upper) | (motion.d < lower)))

    def contact(self) -> tuple[float, float, float, float]:
        upper = self.clearance if self.side != "compression" else math.inf
        lower = -self.clearance if self.side != "extension" else -math.inf
        return upper, lower, self.stiffness, self.damping

    @classmethod
    def variants(cls, network: Network, where: tuple[str, ...]) -> list[dict[str, str]]:
        return [{"side": side} for side in cls.choices["side"]]

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        d, side, out = at.moves.d, at.options["side"], []
        x = (
            np.abs(d)
            if side == "both"
            else np.maximum(d if side == "extension" else -d, 0.0)
        )
        for q in (0.5, 0.75, 0.9, 0.97, 0.995):
            gap = (
                float(np.quantile(x, q))
                if side == "both"
                else float(np.quantile(x, 0.5 + 0.5 * q))
            )
            over = np.maximum(x - gap, 0.0)
            if gap > 0 and over.max() > 1e-3 * at.moves.reach:
                out.append(
                    Start(
                        {"clearance": gap, "stiffness": at.small / rms(over)},
                        grows=("stiffness",),
                    )
                )
        return out


@register
class Backlash(Element):
    type = "backlash"
    mechanism = "play"
    equation = "F = k (|d| - gap/2) sgn d beyond half the gap, 0 within; in series with what stands there (by hand: a node between the two)"
    source = "play in a joint"
    signature = "lost motion: the same at every amplitude, most visible at small ones"
    test = (
        "Move one terminal slowly to and fro by little: the other must stand still over {gap} at each "
        "reversal."
    )
    series = True
    contains = ("series_compliance",)
    shaped_by = "gap"
    law = staticmethod(_backlash)
    gap: float = parameter("m", 1e-4, 0.02)
    stiffness: float = parameter("N/m", 1e5, 1e7, default=2e6, fixed=True)

    def quiet(self) -> float:
        return 0.5 * self.gap

    def contact(self) -> tuple[float, float, float, float]:
        return 0.5 * self.gap, -0.5 * self.gap, self.stiffness, 0.0

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        return bool(beside(network, where))

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        # the faces yield by a fiftieth of the play under the typical force: beside a damper, softer faces
        # would be a compliance
        gaps = [s * rms(at.moves.d) for s in (0.02, 0.2)]
        return [
            Start({"gap": gap, "stiffness": 50.0 * at.force / gap}, grows=("gap",))
            for gap in gaps
        ]


@register
class Hysteresis(Element):
    type = "hysteresis"
    mechanism = "dry_friction"
    equation = "F = z, dz/dt = k [v - (s |v| z + (1-s) v |z|) |z|^(n-1) / F_y^n]"
    source = "Bouc (1967), Wen (1976), with beta = gamma (s = 1/2); s = 1, n = 1 is Dahl's law"
    signature = (
        "loops in the force-travel plane whose corners are round, whatever the rate"
    )
    test = (
        "Run a loop of travel slowly and at twice the rate: both loops must be the same, with round "
        "corners and a height of twice {level}."
    )
    contains = ("coulomb_friction", "linear_stiffness")
    shaped_by = "stiffness"
    law = staticmethod(_bouc_wen)
    level: float = parameter("N", 5.0, 5000.0)
    stiffness: float = parameter("N/m", 1e3, 1e7)
    exponent: float = parameter("-", 0.5, 4.0, default=1.0, open_end=True, fixed=True)
    shape: float = parameter("-", 0.0, 1.0, default=0.5, fixed=True)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        e, d = at.small, rms(at.moves.d)
        return [growing(level=e, stiffness=e / (s * d)) for s in (0.03, 0.15, 0.6)]

    def support(self, motion: Motion) -> float:
        """Return the share of the samples beyond the slip displacement; below, the law is a spring."""
        slip = self.level / max(self.stiffness, 1e-300)
        return float(np.mean(np.abs(motion.d - np.median(motion.d)) > slip))

    def differs_from_limit(self, motion: Motion) -> bool:
        """Return whether the motion clearly exceeds the slip displacement; for smaller motions the law is a spring with rounded corners."""
        return self.support(motion) >= SLIPPING

    def curve(self, axis: Array) -> Array:
        p, z, last = np.array(self.law_parameters()), 0.0, float(axis[0])
        out = []
        for d in np.concatenate([axis, axis[::-1], axis]):
            f, z = _bouc_wen(p, d, 0.0, last, z, 1e-3)
            last = d
            out.append(f)
        return np.array(out[-len(axis) :])


@register
class CoggingForce(Element):
    type = "cogging_force"
    mechanism = "position_periodic"
    equation = "F = A sin(2 pi d / pitch + phase); turn 'whole': the pitch is the nearest whole fraction of a turn"
    source = "detent force of a permanent-magnet linear motor"
    signature = "periodic in travel, whatever the time"
    test = (
        "Move the two parts slowly through the whole travel, one way and back: the mean of both forces must swing by {amplitude} "
        "to either side every {pitch}, at the same places each time."
    )
    contains = ("linear_stiffness",)  # for a pitch longer than the travel
    periodic = ("pitch", "phase")
    choices: ClassVar[dict[str, tuple[str, ...]]] = {"turn": ("any", "whole")}
    law = staticmethod(_cogging)
    amplitude: float = parameter("N", 5.0, 1000.0)
    pitch: float = parameter("m", 1e-3, 0.05, open_end=True)
    phase: float = parameter(
        "rad",
        -math.pi,
        math.pi,
        default=0.0,
        minimum=-math.inf,
        spread=100.0,
        stride=1.0,
    )
    turn: str = "any"

    def law_parameters(self) -> list[float]:
        pitch = self.pitch
        if self.turn == "whole":
            pitch = TURN / max(round(TURN / pitch), 1)
        return [self.amplitude, pitch, self.phase]

    @classmethod
    def variants(cls, network: Network, where: tuple[str, ...]) -> list[dict[str, str]]:
        # a force that repeats with the angle has an integer number of periods per turn, except behind a gear
        turns = any(n in network.rotating for n in where)
        return [{"turn": "any"}, *([{"turn": "whole"}] if turns else [])]

    @classmethod
    def held(cls, options: Mapping[str, str]) -> tuple[str, ...]:
        return ("pitch",) if options.get("turn") == "whole" else ()

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        return super().stands(network, where) and is_device(network, where)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        d = at.moves.d
        span = float(np.ptp(d))
        if span <= 0:
            return []
        if at.options.get("turn") == "whole":
            # integer numbers of periods per turn: at least one period over the travel, and long enough for
            # the samples
            most = min(
                PERIODS,
                TURN / max(2.5 * float(np.median(np.abs(np.diff(d)))), 1e-9),
            )
            pitches = [
                TURN / k for k in range(max(1, math.ceil(TURN / span)), int(most) + 1)
            ]
        else:
            # neighbouring pitches differ by half a period over the span; less than one visible period is
            # no repetition
            pitches = [
                float(1 / cycles)
                for cycles in np.arange(1 / span, PERIODS / span, 0.5 / span)
            ]
        out = []
        for pitch in pitches:
            sine = {"amplitude": at.small, "pitch": pitch, "phase": 0.0}
            out.append(
                Start(
                    sine,
                    (sine, sine | {"phase": math.pi / 2}),
                    ("amplitude",),
                    signed=True,
                )
            )
        return out

    @classmethod
    def sized(cls, start: Start, amplitude: Array) -> dict[str, float]:
        sine, cosine = amplitude * start.values["amplitude"]
        return start.values | {
            "amplitude": math.hypot(sine, cosine),
            "phase": math.atan2(cosine, sine),
        }

    @classmethod
    def special(
        cls, simple: str, values: Mapping[str, float], motion: Motion | None
    ) -> dict[str, float]:
        slope = (
            2
            * math.pi
            * values["amplitude"]
            / values["pitch"]
            * math.cos(values["phase"])
        )
        size = PROBE * values["amplitude"] / values["pitch"]
        return {"stiffness": max(slope, size)}


@register
class TyreLiftOff(Element):
    type = "tyre_lift_off"
    mechanism = "elastic"
    equation = (
        "F = -max(k d - W, 0): a tyre cannot pull on the road beyond its static load W"
    )
    source = "unilateral contact of the tyre"
    signature = "dynamic tyre force cut off at the static load"
    test = (
        "Raise the excitation: the dynamic tyre force must stop at {load} of unloading."
    )
    law = staticmethod(_lift_off)
    stiffness: float = parameter("N/m", 5e4, 5e5)
    load: float = parameter("N", 500.0, 1e4)

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        driven = any(node in network.moved_nodes for node in where) and any(
            node in network.masses for node in where
        )
        spring = any(e.type == "linear_stiffness" for e in beside(network, where))
        return driven and spring and super().stands(network, where)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        stiffness = next(e for e in at.beside if e.type == "linear_stiffness").linear()[
            0
        ]
        loads = [
            float(np.quantile(stiffness * at.moves.d, q)) for q in (0.8, 0.93, 0.985)
        ]
        return [Start({"stiffness": stiffness, "load": w}) for w in loads if w > 0]

    @classmethod
    def tied(cls, network: Network, where: tuple[str, ...]) -> dict[str, str]:
        spring = next(e for e in beside(network, where) if e.type == "linear_stiffness")
        return {"stiffness": f"{spring.name}.stiffness"}
