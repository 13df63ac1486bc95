"""`isd-gym warm`: compile the kernel into the cache."""

from __future__ import annotations

import typer


def command() -> None:
    """Compile the kernel of simulations, policies and environments into the cache of this machine, or NUMBA_CACHE_DIR.

    Run it once on a new machine. Otherwise the first step takes tens of seconds, in every worker.

    Example: isd-gym warm
    """
    import time

    import numpy as np

    from ..benchmark.policies import find
    from ..benchmark.scoring import Conditions, drive
    from ..env import Sensors
    from ..physics.network import Network
    from ..physics.simulate import simulate

    def ready(what: str, begin: float) -> None:
        typer.echo(f"{what}: ready after {time.perf_counter() - begin:.1f} s")

    plant = Network.load("quarter-car-isd")
    # the kernel with every law: own models and the diagnosis need it
    more = plant.with_element(
        {
            "name": "more",
            "type": "cubic_stiffness",
            "between": ["body", "wheel"],
            "stiffness": 1.0,
        }
    )
    times = np.linspace(0.0, 0.05, 51)
    for what, network in (("simulation", plant), ("simulation with every law", more)):
        begin = time.perf_counter()
        simulate(network, times, {c.name: 0.0 * times for c in network.inputs})
        for episodes in (1, 2):
            brief = Conditions(episodes=episodes, duration=0.05)
            drive(find("passive", network), network, brief)
        ready(what, begin)
    for name in ("lqg-preview", "mpc-friction", "mpc"):
        begin = time.perf_counter()
        for episodes in (1, 2):
            noisy = Conditions(
                episodes=episodes,
                duration=0.05,
                sensors=Sensors(noise=1.0, road_error=1e-3),
            )
            drive(find(name, plant), plant, noisy)
        ready(name, begin)
