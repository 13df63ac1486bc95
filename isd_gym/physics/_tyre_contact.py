"""Contact of tyre and road: how often a linear tyre would pull on a rough road, and a warning of it.

The tyres of the built-in cars are linear springs. A real tyre cannot pull on the road: where the dynamic load exceeds the
static load, the wheel lifts off. The element ``tyre_lift_off`` beside the spring of the tyre cuts the force off.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .._common.errors import InputError, TyreContactWarning, plain
from . import elements as el
from .network import Channel
from .network._linear import transfer

if TYPE_CHECKING:
    from collections.abc import Iterable

    from .road import Road
    from .vehicle import Vehicle

LARGEST_SHARE = 0.01  # of the time with a pulling tyre, above which a warning is given
# of the tyre load [Hz]; wheel hop is near 11 Hz
FREQUENCIES = np.geomspace(0.1, 100.0, 60)


def pulling_share(car: Vehicle, ground: Road, speed: float) -> float:
    """Return the share of the time in which the tyre that pulls most often has a negative total load; 0 for
    tyres that lift off.

    The load is normally distributed, with the variance of the linear car without friction and current.
    Fixed profiles are not counted.
    """
    if ground.roughness == 0.0:
        return 0.0
    from scipy.integrate import trapezoid

    loads = tuple(
        Channel(c.named("tyre_load"), "force", "N", at=c.road) for c in car.corners
    )
    response = transfer(replace(car.network, outputs=loads), FREQUENCIES)
    inputs = [channel.name for channel in car.network.inputs]
    density = ground.psd(FREQUENCIES / speed) / speed  # over frequency [m^2/Hz]
    share = 0.0
    for i, (corner, static) in enumerate(
        zip(car.corners, car.static_tyre_loads, strict=True)
    ):
        lifts_off = any(
            isinstance(e, el.TyreLiftOff) and corner.road in e.where
            for e in car.network.elements
        )
        if static is None or lifts_off:
            continue
        gain = np.abs(response[:, i, inputs.index(corner.road_input)])
        deviation = math.sqrt(float(trapezoid(gain**2 * density, FREQUENCIES)))
        share = max(share, 0.5 * math.erfc(static / (math.sqrt(2.0) * deviation)))
    return share


def warn_of_pulling_tyres(car: Vehicle, roads: Iterable[Road], speed: float) -> None:
    """Warn of roads on which a tyre would pull for more than `LARGEST_SHARE` of the time at the highest speed [m/s]."""
    ground = max(roads, key=lambda road: road.roughness)
    try:
        share = pulling_share(car, ground, speed)
    except (
        InputError,
        np.linalg.LinAlgError,
    ):  # without linear equations the share is not known
        return
    if share > LARGEST_SHARE:
        warnings.warn(
            f"on road {plain(ground.name)} at {speed:g} m/s the linear tyres of {plain(car.network.name)} would pull on the "
            f"road for {100 * share:.0f} % of the time: add the element tyre_lift_off to the network, or take a smoother "
            "road (docs/explanation/road.md)",
            TyreContactWarning,
            stacklevel=2,
        )
