"""What a step of the predictive controllers costs, and their quadratic program by three solvers (two minutes).

    python benchmarks/mpc.py --json benchmarks/mpc.json
    python docs/results.py              # the tables of the page, from the files

Step times: a controller drives one road, its observations are kept, and a fresh one answers the same observations
`REPLAYS` times. Three readings of the same steps: `wall`, what passed on the clock, with whatever else the machine was
doing; `cpu`, the thread's own time; `own`, the least wall time of each step over the replays, which a disturbance must
hit every time to spoil. The quantiles are over the steps. The trivial `lqg` stands beside them: where its 99.9 % is not
small, the machine is being measured and not the controller.

Solvers: the programs that came up in those drives, in their order, each solver warm-started as it can. Errors are
against the optimum itself, whose conditions (Karush, Kuhn, Tucker) are checked to 1e-8.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from isd_gym.baselines._qp import Osqp, Outcome, Program
from scipy.optimize import nnls

from isd_gym import Network, StageCost, baselines
from isd_gym._common.files import write_text
from isd_gym.benchmark.scoring import Conditions, Entry, drive


class Daqp:
    """DAQP, an active-set solver (`pip install daqp`), which starts from the active limits of the last solution."""

    INFINITE = 1e30  # DAQP's value for no limit

    def __init__(self, P: np.ndarray, A: np.ndarray) -> None:
        import daqp

        self._solver: Any = daqp.Model()
        m, n = A.shape
        self._solver.setup(
            np.ascontiguousarray(P),
            np.zeros(n),
            np.ascontiguousarray(A),
            np.ones(m),
            -np.ones(m),
        )

    def solve(
        self, q: np.ndarray, low: np.ndarray, high: np.ndarray, guess: np.ndarray
    ) -> Outcome:
        self._solver.update(
            f=q,
            bupper=np.minimum(high, self.INFINITE),
            blower=np.maximum(low, -self.INFINITE),
        )
        x, _, flag, _ = self._solver.solve()
        good = flag > 0 and bool(np.isfinite(x).all())
        return Outcome(np.array(x) if good else None, str(flag))


class Piqp:
    """PIQP, a proximal interior-point solver (`pip install piqp`)."""

    def __init__(self, P: np.ndarray, A: np.ndarray) -> None:
        import piqp

        self._solver: Any = piqp.DenseSolver()
        m, n = A.shape
        self._solver.setup(P, np.zeros(n), None, None, A, -np.ones(m), np.ones(m))
        self._good = piqp.PIQP_SOLVED

    def solve(
        self, q: np.ndarray, low: np.ndarray, high: np.ndarray, guess: np.ndarray
    ) -> Outcome:
        self._solver.update(c=q, h_l=low, h_u=high)
        status = self._solver.solve()
        x = np.array(self._solver.result.x)
        good = status == self._good and bool(np.isfinite(x).all())
        return Outcome(x if good else None, str(status))


SOLVERS: dict[str, Any] = {"osqp": Osqp, "daqp": Daqp, "piqp": Piqp}
SCHEMA = "isd-mpc-times/1"
REPLAYS = 7
SEED = 4000
ROADS = ("paper", "C")
#: label -> controller and options; the paper's controller at the horizon it is judged by
CONTROLLERS: dict[str, tuple[str, dict[str, Any]]] = {
    "lqg": ("lqg", {}),
    "mpc-paper, horizon 20": ("mpc-paper", {"horizon": 20}),
    "mpc": ("mpc", {}),
    "mpc, daqp": ("mpc", {"solver": Daqp}),
    "mpc, piqp": ("mpc", {"solver": Piqp}),
    "mpc-friction": ("mpc-friction", {}),
    "mpc-friction-preview": ("mpc-friction-preview", {}),
}


class Recorded:
    """A program that keeps what it is asked."""

    def __init__(self, inner: Program) -> None:
        self.inner, self.asked = inner, []

    def solve(self, q, low, high, guess):
        self.asked.append(tuple(np.array(v) for v in (q, low, high, guess)))
        return self.inner.solve(q, low, high, guess)


def observations(controller: Any, road: str, steps: int) -> np.ndarray:
    """What the controller sees while it drives (steps, 6+)."""
    env = gym.make(
        "ISDSuspension-v0", road=road, observation=controller.observation
    ).unwrapped
    obs, _ = env.reset(seed=SEED)
    controller.reset()
    seen = []
    for _ in range(steps):
        seen.append(obs.copy())
        obs, *_ = env.step(np.array([controller.act(obs)]))
    return np.array(seen)


def quantiles(seconds: np.ndarray) -> dict[str, float]:
    """Median, 99.9 % and greatest [ms]."""
    return {
        "median": 1e3 * float(np.median(seconds)),
        "p99_9": 1e3 * float(np.quantile(seconds, 0.999)),
        "max": 1e3 * float(seconds.max()),
    }


def readings(wall: np.ndarray, cpu: np.ndarray) -> dict[str, Any]:
    """The three readings of nanoseconds (replays, steps)."""
    return {
        "wall": quantiles(1e-9 * wall.ravel()),
        "cpu": quantiles(1e-9 * cpu.ravel()),
        "own": quantiles(1e-9 * wall.min(axis=0)),
    }


def step_times(
    name: str, options: dict[str, Any], road: str, steps: int
) -> dict[str, Any]:
    seen = observations(baselines.make(name, **options), road, steps)
    wall, cpu = np.empty((2, REPLAYS, steps), np.int64)
    for r in range(REPLAYS):
        controller = baselines.make(name, **options)
        controller.reset()
        for k, obs in enumerate(seen):
            begin, thread = time.perf_counter_ns(), time.thread_time_ns()
            controller.act(obs)
            cpu[r, k], wall[r, k] = (
                time.thread_time_ns() - thread,
                time.perf_counter_ns() - begin,
            )
    return readings(wall, cpu) | {"steps": steps, "fallbacks": controller.fallbacks}


def optimum(
    P: np.ndarray,
    q: np.ndarray,
    A: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    x: np.ndarray,
) -> np.ndarray:
    """The optimum of min 1/2 x'Px + q'x, low <= Ax <= high, from a point near it, with proof: the limits that push are
    held exactly, and the conditions of Karush, Kuhn and Tucker are checked, which suffice for a convex program."""
    n, size = len(P), np.abs(q).max()

    def pushing(x: np.ndarray, near: float) -> tuple[np.ndarray, float]:
        rows = A @ x
        side = np.where(rows > high - near, 1.0, np.where(rows < low + near, -1.0, 0.0))
        on = np.flatnonzero(side)
        push, missing = (
            nnls(A[on].T * side[on], -(P @ x + q))
            if len(on)
            else (np.zeros(0), np.linalg.norm(P @ x + q))
        )
        return on[push > 0.0], missing / size

    held = list(pushing(x, 1e-6)[0])
    limit = np.where(A @ x > 0.5 * (low + high), high, low)
    for _ in range(len(A)):
        K = np.block([[P, A[held].T], [A[held], np.zeros((len(held),) * 2)]])
        x = np.linalg.lstsq(K, np.concatenate([-q, limit[held]]), rcond=None)[0][:n]
        passed = np.maximum(A @ x - high, low - A @ x)
        if passed.max() < 1e-9:
            break
        worst = int(np.argmax(passed))  # a limit that is touched but hardly pushes
        limit[worst] = high[worst] if (A @ x)[worst] > high[worst] else low[worst]
        held.append(worst)
    missing = pushing(x, 1e-9)[1]
    if missing > 1e-8 or passed.max() > 1e-9:
        raise ArithmeticError(
            f"no optimum: gradient off by {missing:.1e}, limits passed by {passed.max():.1e}"
        )
    return x


def compare(P: np.ndarray, A: np.ndarray, asked: list[tuple]) -> dict[str, Any]:
    """Every solver on the same problems."""
    first = Daqp(P, A)
    best = np.array(
        [optimum(P, q, A, l, h, first.solve(q, l, h, g).x) for q, l, h, g in asked]
    )
    objective = lambda x, q: 0.5 * x @ P @ x + q @ x  # noqa: E731
    # no change of current has cost 0, so the optimum is negative: the mean optimum is the possible gain
    gain = -float(np.mean([objective(x, asked[k][0]) for k, x in enumerate(best)]))
    out: dict[str, Any] = {}
    for solver in SOLVERS:
        wall, cpu = np.empty((2, REPLAYS, len(asked)), np.int64)
        failures, gaps, moves, beyond = 0, [], [], []
        for r in range(REPLAYS):
            solved = SOLVERS[solver](P, A)
            for k, (q, low, high, guess) in enumerate(asked):
                begin, thread = time.perf_counter_ns(), time.thread_time_ns()
                x = solved.solve(q, low, high, guess).x
                cpu[r, k], wall[r, k] = (
                    time.thread_time_ns() - thread,
                    time.perf_counter_ns() - begin,
                )
                if r:
                    continue
                if x is None:
                    failures += 1
                    continue
                gaps.append(objective(x, q) - objective(best[k], q))
                moves.append(abs(np.clip(x[0], low[0], high[0]) - best[k, 0]))
                beyond.append(np.maximum(A @ x - high, low - A @ x).max())
        out[solver] = readings(wall, cpu) | {
            "failures": failures,
            "objective_error": float(np.max(np.abs(gaps))) / gain,
            "first_move_error": {
                "rms": float(np.sqrt(np.mean(np.square(moves)))),
                "max": float(np.max(moves)),
            },
            "limit_passed": float(max(np.max(beyond), 0.0)),
        }
    sizes = {"problems": len(asked), "variables": len(P), "limits": len(A)}
    return sizes | {"solvers": out}


def programs(steps: int) -> dict[str, Any]:
    out = {}
    for label, road in (
        ("mpc-paper, horizon 20", "paper"),
        ("mpc", "paper"),
        ("mpc", "C"),
    ):
        name, options = CONTROLLERS[label]
        controller: Any = baselines.make(name, **options)
        controller._programs[0] = hard = Recorded(controller._programs[0])
        observations(controller, road, steps)
        if len(hard.asked) > 20:
            out[f"{label}, road {road}"] = compare(
                controller._P, controller._rows, hard.asked
            )
    return out


def closed_loop(episodes: int, duration: float) -> dict[str, Any]:
    """Cost of `mpc` by solver on the same roads."""
    net = Network.load("quarter-car-isd")
    conditions = Conditions(episodes=episodes, seed=SEED, duration=duration)
    out = {}
    for solver in SOLVERS:
        entry = Entry(
            f"mpc, {solver}", lambda s=solver: baselines.make("mpc", solver=SOLVERS[s])
        )
        run = drive(entry, net, conditions)
        out[solver] = {
            "cost": float(run.cost(StageCost()).mean()),
            "fallbacks": run.fallbacks,
        }
    return {"episodes": episodes, "duration": duration, "seed": SEED, "solvers": out}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "-"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", type=Path)
    parser.add_argument("--steps", type=int, default=4000)
    args = parser.parse_args()
    result: dict[str, Any] = {
        "schema": SCHEMA,
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
        "versions": {s: _version(s) for s in SOLVERS},
        "replays": REPLAYS,
        "seed": SEED,
        "steps": {},
    }
    print(
        f"{'ms per step':<38}"
        + "".join(f"{k:>9} med.   99.9 %" for k in ("wall", "cpu", "own"))
    )
    for road in ROADS:
        for label, (name, options) in CONTROLLERS.items():
            found = step_times(name, options, road, args.steps)
            result["steps"][f"{label}, road {road}"] = found
            cells = "".join(
                f"{found[k]['median']:14.3f} {found[k]['p99_9']:8.3f}"
                for k in ("wall", "cpu", "own")
            )
            print(f"{label + ', road ' + road:<38}{cells}")
    result["programs"] = programs(args.steps)
    for what, found in result["programs"].items():
        print(
            f"\n{what}: {found['problems']} programs, {found['variables']} variables, {found['limits']} limits"
        )
        for solver, s in found["solvers"].items():
            print(f"  {solver:<6} own {1e3 * s['own']['median']:7.1f} {1e3 * s['own']['p99_9']:7.1f} us, objective off by "
                  f"{s['objective_error']:.1e}, first move {s['first_move_error']['max']:.1e} A, limits passed by "
                  f"{s['limit_passed']:.1e}, failures {s['failures']}")  # fmt: skip
    result["closed_loop"] = closed_loop(4, 10.0)
    print(
        "\nclosed loop: "
        + ", ".join(
            f"{s} J {r['cost']:.5f}"
            for s, r in result["closed_loop"]["solvers"].items()
        )
    )
    if args.json:
        write_text(args.json, json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
