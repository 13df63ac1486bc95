"""Grids of sweeps: policies x conditions x roads in one readable file (TOML or JSON).

    policies = ["isd-passive", "lqg", "mpc-friction", "runs/ppo/policy"]
    episodes = 32          # scoring roads per condition; seeds from `seed`, if given
    batch = 8              # roads per item: the loss when a worker dies
    duration = 20.0        # s

    [axes]                 # every combination is a condition
    speed = [10.0, 20.0]   # m/s
    road = ["paper", "C"]

    [[conditions]]         # further conditions with names
    name = "body 20 % heavier"
    factors = { "body.mass" = 1.2 }

    [random]               # further conditions, uniform over ranges and choices (a Halton sequence:
    reproducible)
    count = 64
    speed = [10.0, 35.0]
    road = ["A", "C"]
    factors = { "body.mass" = [0.8, 1.3] }

A condition may set `network`, `road`, `speed` [m/s], `factors` (on parameters of the plant), `model` (of the
controllers; by default the unchanged network), `preview` [s], the attributes of `isd_gym.env.Sensors`
(`noise`, `delay`, `road_error`, `road_lag`, `road_range`), and a smaller number of `episodes` (one is enough
for a bump). The conventional passive car is driven in each condition, too: changes are paired with the
passive car.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

from ... import benchmark
from ..._common.errors import InputError, hint, shown
from ..._common.inputs import is_number, is_whole, parse_json, read_bytes
from ...env import Sensors
from ...physics.network import Network
from ...physics.road import road as find_road

SCHEMA = "isd-sweep/1"
#: largest numbers of conditions and items, largest whole number, and largest size of a file of a grid [bytes]
CONDITIONS, ITEMS, MOST, BELONGING = 10_000, 1_000_000, 2**53, 2**30
#: beside the benchmark, since `isd-gym train --randomize robust` draws from the ranges of the robust track
BUILT_IN = Path(benchmark.__file__).parent / "grids"
SENSES = tuple(f.name for f in fields(Sensors))
#: keys of [random]: ranges of numbers, and choices
RANGES, CHOICES = (
    ("speed", "preview", "noise", "road_error", "road_lag", "road_range"),
    ("road", "network"),
)


@dataclass(frozen=True)
class Condition:
    """A condition of a sweep.

    Attributes:
        name: Name.
        network: Built-in network or model file.
        road: Road.
        speed: Speed [m/s].
        factors: Factors on parameters of the plant, by path.
        model: Model of the controllers; None for the network without factors.
        preview: Preview of the road [s]; None for the default.
        noise: Noise of the sensors (`Sensors`) [-].
        delay: Delay of the sensors [control steps].
        road_error: Error of the previewed road [m].
        road_lag: Age of the previewed road [s].
        road_range: Range of the previewed road [m].
        episodes: Number of episodes; None for the number of the grid.

    Raises:
        InputError: A value is invalid.
    """

    name: str = ""
    network: str = "quarter-car-isd"
    road: str = "paper"
    speed: float = 20.0
    factors: Mapping[str, float] = field(default_factory=dict)
    model: str | None = None
    preview: float | None = None
    noise: float = 0.0
    delay: int = 0
    road_error: float = 0.0
    road_lag: float = 0.0
    road_range: float = math.inf
    episodes: int | None = None

    def __post_init__(self) -> None:
        where = f"condition {shown(self.name)}" if self.name else "a condition"
        if not (is_number(self.speed) and self.speed > 0):
            raise InputError(
                f"{where}: speed must be a positive number of m/s, not {shown(self.speed)}"
            )
        if self.preview is not None and not (
            is_number(self.preview) and self.preview >= 0
        ):
            raise InputError(
                f"{where}: preview must be 0 s or more, not {shown(self.preview)}"
            )
        if self.episodes is not None and not is_whole(self.episodes, 1, MOST):
            raise InputError(
                f"{where}: episodes must be a whole number of 1 or more, not {shown(self.episodes)}"
            )
        try:
            _ = self.sensors
            for key, value in (
                ("network", self.network),
                ("road", self.road),
                ("model", self.model or ""),
            ):
                if not isinstance(value, str):
                    raise InputError(f"{key} must be a name, not {shown(value)}")
            _road(self.road)
            self.plant()
            _network(self.model or self.network)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None

    @property
    def sensors(self) -> Sensors:
        """Sensors of the controllers."""
        return Sensors(**{name: getattr(self, name) for name in SENSES})

    def plant(self) -> Network:
        """Return the driven car.

        Returns:
            The network with its factors.

        Raises:
            InputError: A factor is invalid.
        """
        nominal = _network(self.network)
        if not isinstance(self.factors, Mapping) or not all(
            is_number(f) and f > 0 for f in self.factors.values()
        ):
            raise InputError(
                "factors must be parameters of the network and positive numbers"
            )
        known = nominal.parameters
        for key in self.factors:
            if key not in known:
                raise InputError(f"no parameter '{key}' (there are {', '.join(known)})")
        return nominal.with_parameters(
            {k: known[k] * f for k, f in self.factors.items()}
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the values that differ from the defaults.

        Returns:
            Plain data.
        """
        usual = {f.name: f.default for f in fields(self)}
        return {
            k: dict(v) if isinstance(v, Mapping) else v
            for k, v in asdict(self).items()
            if v != usual[k] and v != {} and k != "name"
        }


#: read once for all conditions
_network, _road = lru_cache(Network.load), lru_cache(find_road)


@dataclass(frozen=True)
class Grid:
    """A sweep: all policies in all conditions on the same roads.

    Attributes:
        policies: Names of policies.
        conditions: Conditions.
        episodes: Number of roads per condition.
        seed: Seed of the first road; None for the scoring roads.
        batch: Number of roads per item.
        duration: Length of a road [s].
        random: Table [random] of the file.
    """

    policies: tuple[str, ...]
    conditions: tuple[Condition, ...]
    episodes: int = 32
    seed: int | None = None
    batch: int = 8
    duration: float = 20.0
    random: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, least in (
            ("episodes", 1),
            *([("seed", 0)] if self.seed is not None else []),
            ("batch", 1),
        ):
            if not is_whole(value := getattr(self, name), least, MOST):
                raise InputError(
                    f"{name} must be a whole number from {least} on, not {shown(value)}"
                )
        if not (is_number(self.duration) and self.duration > 0):
            raise InputError(
                f"duration must be a positive number of seconds, not {shown(self.duration)}"
            )
        if not self.policies or not all(isinstance(p, str) for p in self.policies):
            raise InputError("policies must be a list of names, at least one")
        if len(set(self.policies)) != len(self.policies):
            raise InputError("a policy is named twice")
        name, count = Counter(c.name for c in self.conditions).most_common(1)[0]
        if count > 1:
            raise InputError(f"two conditions are called {shown(name)}")
        episodes = max(c.episodes or self.episodes for c in self.conditions)
        if (
            len(self.conditions) * (len(self.policies) + 1) * -(-episodes // self.batch)
            > ITEMS
        ):
            raise InputError(f"it has more than {ITEMS} items")

    @classmethod
    def load(cls, path: str | Path) -> Grid:
        """Read a grid.

        Args:
            path: A file, or the name of a built-in grid.

        Returns:
            The grid.

        Raises:
            InputError: The file cannot be read or has an invalid entry; the message names file and key.
        """
        path = Path(path)
        if str(path) in built_in() and not path.exists():
            path = BUILT_IN / f"{path}.toml"
        data = read_bytes(path)
        try:
            if path.suffix == ".json":
                return cls.from_dict(parse_json(data, "it is"))
            return cls.from_dict(tomllib.loads(data.decode("utf-8-sig")))
        except (ValueError, RecursionError) as error:  # InputError among them
            why = (
                "not UTF-8"
                if isinstance(error, UnicodeDecodeError)
                else (str(error).splitlines() or [""])[0]
            )
            raise InputError(f"grid '{path}': {why}") from None

    @classmethod
    def from_dict(cls, data: Any) -> Grid:
        """Return a grid from the content of a file.

        Args:
            data: Plain data.

        Returns:
            The grid.

        Raises:
            InputError: An entry is invalid; the message names the key.
        """
        if not isinstance(data, dict):
            raise InputError("it must be a table of keys")
        own = {f.name for f in fields(cls)} | {"axes", "schema"}
        _known(data, own, "")
        if data.get("schema", SCHEMA) != SCHEMA:
            raise InputError(f"its schema is not '{SCHEMA}'")
        given = data.get("conditions", [])
        if not isinstance(given, list):
            raise InputError("conditions must be a list of tables")
        drawn = data.get("random", {})
        made: list[Condition] = []
        if data.get("axes") or not (given or drawn):
            made += _crossed(data.get("axes", {}))
        if len(made) + len(given) > CONDITIONS:
            raise InputError(
                f"it has {len(made) + len(given)} conditions, at most {CONDITIONS} are handled"
            )
        keys = {f.name for f in fields(Condition)}
        for i, one in enumerate(given):
            if not isinstance(one, dict) or not isinstance(one.get("name"), str):
                raise InputError(f"conditions[{i}] must be a table with a name")
            _known(one, keys, f"condition {shown(one['name'])}: ")
            made.append(Condition(**one))
        if drawn:
            made += draw(drawn)
        rest = {
            k: v
            for k, v in data.items()
            if k in own - {"axes", "schema", "conditions", "policies"}
        }
        policies = data.get("policies", [])
        if not isinstance(policies, list):
            raise InputError("policies must be a list of names, at least one")
        return cls(tuple(policies), tuple(made), **rest)

    @property
    def driven(self) -> tuple[str, ...]:
        """Names of all driven policies in a condition; the passive car comes first."""
        return tuple(dict.fromkeys(("passive", *self.policies)))

    def all_items(self) -> list[dict[str, Any]]:
        """Return every item; the passive car of each condition comes first.

        Returns:
            Arguments of `drive_item`.
        """
        out = []
        for condition in self.conditions:
            for policy in self.driven:
                out += self.items(condition, policy)
        return out

    def items(self, condition: Condition, policy: str) -> list[dict[str, Any]]:
        """Return the items of a policy in a condition, in the order of their roads.

        Args:
            condition: The condition.
            policy: The policy.

        Returns:
            Arguments of `drive_item`.
        """
        given = condition.to_dict()
        given.pop("episodes", None)
        files = belongings(
            (policy, condition.network, condition.road, condition.model or "")
        )
        out = []
        stop = condition.episodes or self.episodes
        for first in range(0, stop, self.batch):
            item = {
                "policy": policy,
                "seed": self.seed,
                "first": first,
                "episodes": min(self.batch, stop - first),
                "duration": self.duration,
                "condition": given,
            }
            out.append(item | {"files": files} if files else item)
        return out


def built_in() -> list[str]:
    """Return the names of the grids in the package.

    Returns:
        Names, sorted.
    """
    return sorted(p.stem for p in BUILT_IN.glob("*.toml"))


def belongings(names: Sequence[str]) -> dict[str, str]:
    """Return digests of the names that are files or folders; another content makes another item.

    Args:
        names: Names of policies, networks and roads.

    Returns:
        Digest by name.
    """
    out = {}
    for name in filter(None, names):
        path, digest = Path(name), hashlib.sha256()
        try:
            parts = (
                sorted(p for p in path.glob("*") if p.is_file())
                if path.is_dir()
                else [path]
            )
            for part in parts:
                digest.update(part.name.encode() + b"\0" + read_bytes(part, BELONGING))
        except (OSError, ValueError):  # not a valid file name
            continue
        if parts:
            out[name] = digest.hexdigest()[:16]
    return out


def _crossed(axes: Any) -> list[Condition]:
    if not isinstance(axes, dict):
        raise InputError("axes must be a table of lists")
    _known(axes, {f.name for f in fields(Condition)} - {"name"}, "axes: ")
    for key, values in axes.items():
        if not isinstance(values, list) or not values:
            raise InputError(f"axes: '{key}' must be a list of values, at least one")
    if (count := math.prod(len(values) for values in axes.values())) > CONDITIONS:
        raise InputError(
            f"it has {count:.4g} conditions, at most {CONDITIONS} are handled"
        )
    made = []
    for values in itertools.product(*axes.values()):
        chosen = dict(zip(axes, values, strict=True))
        name = ", ".join(f"{k} {_short(v)}" for k, v in chosen.items()) or "nominal"
        made.append(Condition(**chosen, name=name))
    return made


def draw(given: Any) -> list[Condition]:
    """Return the conditions of a table [random]: points of a Halton sequence over its ranges and choices.

    Args:
        given: The table.

    Returns:
        `count` conditions from point `first`.

    Raises:
        InputError: The table is invalid.

    References:
        Halton, "On the efficiency of certain quasi-random sequences of points in evaluating multi-dimensional
            integrals", Numerische Mathematik, 1960.
    """
    from scipy.stats import qmc

    if not isinstance(given, dict):
        raise InputError("random must be a table")
    _known(given, {"count", "first", "factors", *RANGES, *CHOICES}, "random: ")
    for key, least, most in (("count", 1, CONDITIONS), ("first", 0, 2**30)):
        if not is_whole(value := given.get(key, 1), least, most):
            raise InputError(
                f"random: {key} must be a whole number from {least} to {most}, not {shown(value)}"
            )
    factors = given.get("factors", {})
    if not isinstance(factors, dict):
        raise InputError("random: factors must be a table of ranges")
    ranges: dict[Any, Any] = {k: given[k] for k in RANGES if k in given} | {
        ("factors", k): v for k, v in factors.items()
    }
    for key, span in ranges.items():
        if not (
            isinstance(span, list)
            and len(span) == 2
            and all(map(is_number, span))
            and span[0] <= span[1]
        ):
            what = key if isinstance(key, str) else key[1]
            raise InputError(f"random: '{what}' must be [low, high], not {shown(span)}")
    choices = {k: given[k] for k in CHOICES if k in given}
    for key, values in choices.items():
        if not (isinstance(values, list) and values):
            raise InputError(f"random: '{key}' must be a list of names, at least one")
    if "count" not in given or not (ranges or choices):
        raise InputError("random: it needs a count, and ranges or choices to draw from")
    # point 0 is the corner of all lower ends
    count, first = (
        given["count"],
        given.get("first", 1),
    )
    points = qmc.Halton(len(ranges) + len(choices), scramble=False)
    points.fast_forward(first) if first else None
    made = []
    for i, point in enumerate(points.random(count)):
        chosen: dict[str, Any] = {}
        for u, (key, span) in zip(point, ranges.items(), strict=False):
            value = float(f"{span[0] + u * (span[1] - span[0]):.4g}")
            if isinstance(key, str):
                chosen[key] = value
            else:
                chosen.setdefault("factors", {})[key[1]] = value
        for u, (key, values) in zip(point[len(ranges) :], choices.items(), strict=True):
            chosen[key] = values[int(u * len(values))]
        made.append(Condition(name=f"random {first + i}", **chosen))
    return made


def _short(value: Any) -> str:
    if isinstance(value, dict):
        return "; ".join(f"{k} x {v:g}" for k, v in value.items())
    return f"{value:g}" if is_number(value) else str(value)


def _known(data: Mapping[str, Any], known: set[str], where: str) -> None:
    for key in data:
        if key not in known:
            raise InputError(f"{where}no key '{key}'; {hint(key, sorted(known))}")
