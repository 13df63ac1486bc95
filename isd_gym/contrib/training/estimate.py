"""Estimate and law of the LQG as a `Filter`: memory that a policy need not learn."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.errors import InputError
from isd_gym.agents._memory import Filter, tuples
from isd_gym.baselines import noisy
from isd_gym.baselines.lqg import Lqg, LqgSettings
from isd_gym.env._environment import ISDSuspensionVectorEnv
from isd_gym.physics._prediction import N_SENSORS
from isd_gym.physics._vehicle import SLEW_LIMIT

if TYPE_CHECKING:
    from isd_gym.physics.network import Network

CARS, STEPS, FORGET = 32, 1500, 300  # drive that gives the spread of the state
SEED = 800_000  # seed of roads without other use


def lqg_filter(
    network: Network, control_step: float = 5e-3, preview: float = 0.0, noise: float = 0.0
) -> Filter:
    """Return filter and law of `isd_gym.baselines.lqg` for a network, in coordinates of unit spread under the LQG.

    Args:
        network: The car.
        control_step: Control step [s].
        preview: Known road ahead [s].
        noise: Sensor noise that the filter assumes [-], see `isd_gym.baselines.noisy`.

    Returns:
        The filter.

    Raises:
        InputError: The network is no car, or has no motor.
    """
    controller = Lqg(
        network, control_step=control_step, settings=LqgSettings(preview=preview, sensors=noisy(noise))
    )
    m = controller.prediction
    if m.thrust == 0.0:
        raise InputError(f"network '{network.name}' has no motor")
    back = np.linalg.cholesky(_spread(controller, network, control_step))
    T = np.linalg.inv(back)
    dry = m.friction
    levels, S = m.levels()[dry], m.S[dry]
    matrices = dict(
        A=T @ m.A @ back,
        B=(T @ m.B)[:, None],
        G=T @ m.G[:, dry] * levels,
        S=S @ back,
        K=-(S @ m.G[:, dry] + m.SF[np.ix_(dry, dry)]) * levels,
        C=m.C[:N_SENSORS] @ back,
        D=m.D[:N_SENSORS, None],
        F=m.F[:N_SENSORS, dry] * levels,
        L=T @ controller.estimator.gain,
        law=(controller._law @ back)[None],
        rate=(controller._rate @ back / controller.settings.width)[None],
    )
    if preview > 0:
        matrices |= dict(
            road=(T @ m.P)[:, None],
            law_ahead=controller._law_ahead[None],
            rate_ahead=(controller._rate_ahead / controller.settings.width)[None],
        )
    plain: dict[str, Any] = {k: tuples(np.asarray(v).tolist()) for k, v in matrices.items()}
    return Filter(**plain, force=(float(controller._force),), slew=SLEW_LIMIT)


def _spread(controller: Lqg, network: Network, control_step: float) -> np.ndarray:
    """Return the second moments (n, n) of the estimate while `controller` drives `network`."""
    env = ISDSuspensionVectorEnv(
        CARS,
        network=network,
        control_step=control_step,
        observation=controller.observation,
        preview=controller.preview or None,
        autoreset_mode="disabled",
    )
    obs, _ = env.reset(seed=SEED)
    controller.reset_batch(CARS)
    seen = []
    for k in range(STEPS):
        obs, *_ = env.step(controller.act_batch(obs)[:, None])
        if k >= FORGET:
            seen.append(controller.estimator.x.T.copy())
    x = np.concatenate(seen)
    moments = x.T @ x / len(x)
    size = np.sqrt(np.diag(moments))
    # a small diagonal term: two coordinates may move together
    return moments + 1e-6 * np.diag(size**2)
