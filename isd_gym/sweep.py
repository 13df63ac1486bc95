"""Sweeps: policies x conditions x roads from one readable file, done by `engine`, merged to paired intervals.

A grid (TOML or JSON):

    policies = ["isd-passive", "lqg", "mpc-friction", "runs/ppo/policy"]
    episodes = 32          # roads of a condition, seeds from `seed`
    batch = 8              # of them in one item: what is lost when a worker dies
    duration = 20.0        # s

    [axes]                 # every combination is a condition
    speed = [10.0, 20.0]   # m/s
    road = ["paper", "C"]

    [[conditions]]         # and these, under their own names
    name = "body 20 % heavier"
    factors = { "body.mass" = 1.2 }

A condition may name `network`, `road`, `speed` [m/s], `factors` (on parameters of the plant), `model` (what controllers
believe in, the unaltered network unless given), `preview` [s], `noise` (standard deviations of the sensors' white noise, as
a multiple of `NOISE`) and `delay` (control steps by which signals come late). The conventional passive car of each condition
is driven as well: changes are paired with it.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import tomllib
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from .engine import Outcome, Task, shard, stored
from .engine import run as run_tasks
from .errors import InputError, shown
from .inputs import parse_json, read_bytes
from .network import Network

SCHEMA = "isd-sweep/1"
#: conditions and items of a grid, and the size of any number in it
CONDITIONS, ITEMS, LARGEST = 10_000, 1_000_000, 1e100
#: one sigma of white noise on each measured signal; the current is the controller's own and is known
NOISE = {
    "body_acceleration": 0.1,  # m/s^2
    "suspension_travel": 5e-4,  # m
    "suspension_travel_rate": 0.02,  # m/s
    "device_travel": 1e-4,  # m
    "device_travel_rate": 0.01,  # m/s
}


@dataclass(frozen=True)
class Condition:
    """What is driven, see the module."""

    name: str = ""
    network: str = "quarter-car-isd"
    road: str = "paper"
    speed: float = 20.0  # m/s
    factors: Mapping[str, float] = field(default_factory=dict)
    model: str | None = None
    preview: float | None = None  # s
    noise: float = 0.0
    delay: int = 0  # control steps

    def __post_init__(self) -> None:
        where = f"condition {shown(self.name)}" if self.name else "a condition"
        if not (_number(self.speed) and self.speed > 0):
            raise InputError(f"{where}: speed must be a positive number of m/s, not {self.speed!r}")
        if not (_number(self.noise) and self.noise >= 0):
            raise InputError(f"{where}: noise must be 0 or more, not {self.noise!r}")
        if not (isinstance(self.delay, int) and 0 <= self.delay <= 100):
            raise InputError(f"{where}: delay must be 0 to 100 whole control steps, not {self.delay!r}")
        if self.preview is not None and not (_number(self.preview) and self.preview >= 0):
            raise InputError(f"{where}: preview must be 0 s or more, not {self.preview!r}")
        try:
            for key, value in (("network", self.network), ("road", self.road), ("model", self.model or "")):
                if not isinstance(value, str):
                    raise InputError(f"{key} must be a name, not {shown(value)}")
            _check_road(self.road, _changed(self.road))
            self.plant()
            _network(self.model or self.network, _changed(self.model or self.network))
        except InputError as error:
            raise InputError(f"{where}: {error}") from None

    def plant(self) -> Network:
        """The car that is driven."""
        nominal = _network(self.network, _changed(self.network))
        if not isinstance(self.factors, Mapping) or not all(
            _number(f) and f > 0 for f in self.factors.values()
        ):
            raise InputError("factors must be parameters of the network and positive numbers")
        known = nominal.parameters
        for key in self.factors:
            if key not in known:
                raise InputError(f"no parameter '{key}' (there are {', '.join(known)})")
        return nominal.with_parameters({k: known[k] * f for k, f in self.factors.items()})


def _number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < LARGEST  # neither infinite nor nan, nor a whole number that no float holds


@lru_cache(maxsize=256)
def _network(source: str, changed: float) -> Network:
    return Network.load(source)


@lru_cache(maxsize=256)
def _check_road(source: str, changed: float) -> None:
    from .road import road

    road(source)


def _changed(source: str) -> float:
    """When the file of that name was last changed, so that it is read once for all conditions; 0 for what is no file."""
    try:
        return os.path.getmtime(source)
    except (OSError, ValueError):
        return 0.0


@dataclass(frozen=True)
class Grid:
    """A sweep: all `policies` in all `conditions` on the roads of seeds `seed` to ``seed + episodes - 1``."""

    policies: tuple[str, ...]
    conditions: tuple[Condition, ...]
    episodes: int = 32
    seed: int = 0
    batch: int = 8
    duration: float = 20.0  # s

    def __post_init__(self) -> None:
        for name, least in (("episodes", 1), ("seed", 0), ("batch", 1)):
            value = getattr(self, name)
            if not (isinstance(value, int) and not isinstance(value, bool) and least <= value < 2**53):
                raise InputError(f"{name} must be a whole number from {least} on, not {shown(value)}")
        if not (_number(self.duration) and self.duration > 0):
            raise InputError(f"duration must be a positive number of seconds, not {self.duration!r}")
        if not self.policies or not all(isinstance(p, str) for p in self.policies):
            raise InputError("policies must be a list of names, at least one")
        if len(set(self.policies)) != len(self.policies):
            raise InputError("a policy is named twice")
        name, count = Counter(c.name for c in self.conditions).most_common(1)[0]
        if count > 1:
            raise InputError(f"two conditions are called {shown(name)}")
        items = len(self.conditions) * (len(self.policies) + 1) * -(-self.episodes // self.batch)
        if items > ITEMS:
            raise InputError(f"it has more than {ITEMS} items")

    @classmethod
    def load(cls, path: str | Path) -> Grid:
        """Read a grid; `InputError` with the file and the key for whatever is wrong in it."""
        path = Path(path)
        data = read_bytes(path)
        try:
            if path.suffix == ".json":
                return cls.from_dict(parse_json(data, "it is"))
            return cls.from_dict(tomllib.loads(data.decode("utf-8-sig")))
        except (ValueError, RecursionError) as error:  # InputError among them
            why = (
                "not UTF-8" if isinstance(error, UnicodeDecodeError) else (str(error).splitlines() or [""])[0]
            )
            raise InputError(f"grid '{path}': {why}") from None

    @classmethod
    def from_dict(cls, data: Any) -> Grid:
        """A grid from plain data, see the module."""
        if not isinstance(data, dict):
            raise InputError("it must be a table of keys")
        own = {f.name for f in fields(cls)} | {"axes", "schema"}
        _known(data, own, "")
        if data.get("schema", SCHEMA) != SCHEMA:
            raise InputError(f"its schema is not '{SCHEMA}'")
        keys = {f.name for f in fields(Condition)}
        made: list[Condition] = []
        axes = data.get("axes", {})
        if not isinstance(axes, dict):
            raise InputError("axes must be a table of lists")
        _known(axes, keys - {"name"}, "axes: ")
        for key, values in axes.items():
            if not isinstance(values, list) or not values:
                raise InputError(f"axes: '{key}' must be a list of values, at least one")
        conditions = data.get("conditions", [])
        if not isinstance(conditions, list):
            raise InputError("conditions must be a list of tables")
        count = math.prod(len(values) for values in axes.values()) + len(conditions)
        if count > CONDITIONS:
            raise InputError(f"it has {count:.4g} conditions, at most {CONDITIONS} are handled")
        if axes or not conditions:
            for values in itertools.product(*axes.values()):
                chosen = dict(zip(axes, values, strict=True))
                name = ", ".join(f"{k} {_short(v)}" for k, v in chosen.items()) or "nominal"
                made.append(Condition(**chosen, name=name))
        for i, given in enumerate(conditions):
            if not isinstance(given, dict) or not isinstance(given.get("name"), str):
                raise InputError(f"conditions[{i}] must be a table with a name")
            _known(given, keys, f"condition {shown(given['name'])}: ")
            made.append(Condition(**given))
        rest = {k: v for k, v in data.items() if k in own - {"axes", "schema", "conditions", "policies"}}
        policies = data.get("policies", [])
        if not isinstance(policies, list):
            raise InputError("policies must be a list of names, at least one")
        return cls(tuple(policies), tuple(made), **rest)

    def tasks(self) -> list[Task]:
        """Every item; the passive car of each condition first."""
        out = []
        for condition in self.conditions:
            for policy in dict.fromkeys(("passive", *self.policies)):
                for first in range(self.seed, self.seed + self.episodes, self.batch):
                    count = min(self.batch, self.seed + self.episodes - first)
                    out.append(self._task(condition, policy, first, count))
        return out

    def _task(self, condition: Condition, policy: str, seed: int, episodes: int) -> Task:
        given = {k: v for k, v in asdict(condition).items() if k != "name" and v not in (None, {})}
        roads = {"seed": seed, "episodes": episodes, "duration": self.duration}
        return Task("isd_gym.sweep:drive_item", {"policy": policy, **roads, "condition": given})


def _short(value: Any) -> str:
    if isinstance(value, dict):
        return "; ".join(f"{k} x {v:g}" for k, v in value.items())
    return f"{value:g}" if _number(value) else str(value)


def _known(data: Mapping[str, Any], known: set[str], where: str) -> None:
    from difflib import get_close_matches

    for key in data:
        if key not in known:
            near = get_close_matches(str(key), sorted(known), 1)
            hint = f"did you mean '{near[0]}'?" if near else f"there are {', '.join(sorted(known))}"
            raise InputError(f"{where}no key '{key}'; {hint}")


class Sensors:
    """What the controller sees of clean observations (cars, n): late by `delay` control steps, and with white noise."""

    def __init__(self, noise: float, delay: int, seed: int) -> None:
        self.sigma = noise * np.array([*NOISE.values()])
        self.delay = delay
        self.rng = np.random.default_rng(seed)
        self.past: list[np.ndarray] = []

    def __call__(self, observations: np.ndarray, step: int) -> np.ndarray:
        out = observations.copy()
        signals = len(self.sigma)
        self.past = [*self.past[-self.delay :], observations[:, :signals].copy()] if self.delay else []
        if self.delay:
            out[:, :signals] = self.past[0]
        if self.sigma.any():
            out[:, :signals] += self.sigma * self.rng.standard_normal((len(out), signals))
        return out


def drive_item(
    policy: str, seed: int, episodes: int, duration: float, condition: dict[str, Any]
) -> dict[str, Any]:
    """One item of a sweep: what `isd_gym.scoring.measures` says of each episode, and the fallbacks. No signals: it is small."""
    from .cost import StageCost
    from .policies import find
    from .scoring import drive, measures

    c = Condition(**condition)
    plant = c.plant()
    ahead: dict[str, Any] = {} if c.preview is None else {"preview": c.preview}
    entry = find(policy, plant, model=Network.load(c.model or c.network), **ahead)
    sensors = Sensors(c.noise, c.delay, seed) if c.noise or c.delay else None
    run = drive(
        entry,
        plant,
        road=c.road,
        speed=c.speed,
        episodes=episodes,
        seed=seed,
        duration=duration,
        corrupt=sensors,
    )
    found = measures(run, StageCost())
    return {
        "measures": {name: [float(v) for v in values] for name, (values, _) in found.items()},
        "units": {name: unit for name, (_, unit) in found.items()},
        "fallbacks": run.fallbacks,
    }


def merge(grid: Grid, results: Mapping[str, Any]) -> dict[str, Any]:
    """What is there of a sweep (results by the tasks' keys) as `isd-sweep/1`: every quantity with its paired change.

    A policy some of whose items are missing is left out of its condition and counted in `missing`.
    """
    from .scoring import compare

    conditions, missing = [], 0
    for condition in grid.conditions:
        rows: list[dict[str, Any]] = []
        whole: dict[str, dict[str, np.ndarray]] = {}
        for policy in dict.fromkeys(("passive", *grid.policies)):
            tasks = [
                t
                for t in Grid(
                    (policy,), (condition,), grid.episodes, grid.seed, grid.batch, grid.duration
                ).tasks()
                if t.arguments["policy"] == policy
            ]
            parts = [results[t.key] for t in tasks if t.key in results]
            missing += len(tasks) - len(parts)
            if len(parts) < len(tasks) or (policy != "passive" and "passive" not in whole):
                continue
            own = {
                name: np.concatenate([p["measures"][name] for p in parts]) for name in parts[0]["measures"]
            }
            whole[policy] = own
            row: dict[str, Any] = {"policy": policy}
            for name, values in own.items():
                row[name] = compare(name, values, whole["passive"][name], parts[0]["units"][name])
            row["fallbacks"] = sum(p["fallbacks"] for p in parts)
            if policy in grid.policies:
                rows.append(row)
        given = {k: v for k, v in asdict(condition).items() if v not in (None, {})}
        conditions.append({**given, "policies": rows})
    return {
        "schema": SCHEMA,
        "episodes": grid.episodes,
        "seed": grid.seed,
        "duration": {"value": grid.duration, "unit": "s"},
        "conditions": conditions,
        "missing": missing,
    }


def sweep(
    grid: Grid,
    out: str | Path,
    *,
    jobs: int = 1,
    which: str | None = None,
    engine: str = "local",
    address: str | None = None,
    progress: Callable[[int, int], None] | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> tuple[dict[str, Any], Outcome]:
    """Do what is left of a grid (or of shard `which` of it, "i/n") in folder `out`; the merged sweep, and what came of the items.

    Items are files in ``out/items``; the merged sweep is ``out/sweep.json``, as far as there are items.
    """
    from .files import write_text

    tasks = grid.tasks()
    folder = Path(out) / "items"
    outcome = run_tasks(
        shard(tasks, which), folder, jobs=jobs, engine=engine, address=address, progress=progress, say=say
    )
    merged = merge(grid, stored(tasks, folder))
    write_text(Path(out) / "sweep.json", json.dumps(merged, indent=1, allow_nan=False) + "\n")
    return merged, outcome


def command(
    grid: Annotated[Path, typer.Argument(help="The grid: policies, conditions, roads (TOML or JSON).")],
    out: Annotated[
        Path,
        typer.Option("--out", help="Folder of the results; what is in it is not done again.", metavar="DIR"),
    ],
    jobs: Annotated[int, typer.Option("--jobs", help="Processes of this machine.", min=1)] = 1,
    which: Annotated[
        str | None,
        typer.Option(
            "--shard", help="Only every n-th item: 0/8 ... 7/8 in an array of 8 jobs.", metavar="I/N"
        ),
    ] = None,
    engine: Annotated[str, typer.Option("--engine", help="local, or ray for a Ray cluster.")] = "local",
    address: Annotated[
        str | None,
        typer.Option("--address", help="Of the Ray cluster; the one of this machine unless given."),
    ] = None,
) -> None:
    """Drive policies through a grid of conditions, on many cores or machines; called again it goes on where it stopped.

    Prints the change of J against the passive car of every condition with its 95 % paired interval. The exit status is 1
    where something is missing.

    Example: isd-gym sweep grid.toml --out runs/sweep --jobs 2
    """
    import sys

    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn

    made = Grid.load(grid)
    bar = Progress(
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
    )
    with bar:
        line = bar.add_task("", total=None)
        merged, outcome = sweep(
            made,
            out,
            jobs=jobs,
            which=which,
            engine=engine,
            address=address,
            progress=lambda done, all: bar.update(line, completed=done, total=all),
            say=lambda text: typer.echo(text, err=True),
        )
    _print(merged)
    if outcome.failed:
        typer.echo(
            f"{len(outcome.failed)} items are missing: {next(iter(outcome.failed.values()))}", err=True
        )
        raise typer.Exit(1)
    if merged["missing"] and which is None:
        typer.echo(f"{merged['missing']} items are missing", err=True)
        raise typer.Exit(1)


def _print(merged: Mapping[str, Any]) -> None:
    import sys

    from rich import box
    from rich.console import Console
    from rich.table import Table

    names = list(dict.fromkeys(row["policy"] for c in merged["conditions"] for row in c["policies"]))
    names = [n for n in names if n != "passive"]
    table = Table(box=box.SIMPLE_HEAD, title="change of J against passive [%]", title_justify="left")
    table.add_column("condition")
    for name in names:
        table.add_column(name, justify="right", no_wrap=True)
    for c in merged["conditions"]:
        by = {row["policy"]: row["cost"] for row in c["policies"]}
        cells = []
        for name in names:
            q = by.get(name)
            known = q is not None and "change" in q
            cells.append(
                f"{100 * q['change']:+.1f} [{100 * q['low']:+.1f}, {100 * q['high']:+.1f}]"
                if q and known
                else ""
            )
        table.add_row(c["name"], *cells)
    Console(width=None if sys.stdout.isatty() else 118).print(table)
    if merged["missing"]:
        typer.echo(f"{merged['missing']} items are not there yet")


def warm() -> None:
    """Compile what policies and environments need, once, into the cache of this machine (or NUMBA_CACHE_DIR).

    On a fresh node the first step otherwise costs tens of seconds, in every worker at once.

    Example: isd-gym warm
    """
    from .policies import find
    from .scoring import drive

    plant = Network.load("quarter-car-isd")
    for name in ("passive", "mpc-friction", "mpc"):
        for episodes in (1, 2):
            drive(find(name, plant), plant, episodes=episodes, duration=0.05)
        typer.echo(f"{name}: ready")
