"""A suspension as a network: masses, named nodes, and two-terminal elements between them.

`Network` is the model (`isd-model/1`, a JSON file); `assemble` turns it into equations of motion without any
hand derivation, and `linearise` into a state space with named signals, for controllers and frequency responses.

Assembly. With the displacements q of the free nodes, the moved nodes r(t) and the incidence E of everything that is
not linear (motors, friction, force laws f)::

    M q'' + C q' + K q + M_r r'' + C_r r' + K_r r + E f = F

M is singular where nodes have no mass. Its singular value decomposition splits q into directions that carry
momentum (two states each) and the rest; among the rest, those with damping are first-order states and those
without are algebraic. The momentum p = a' + S^-1 U^T M_r r' is the state instead of the velocity, so that r'' is
needed by no state, only by outputs.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from . import elements as el
from .errors import InputError

SCHEMA = "isd-model/1"
GROUND = "ground"
#: quantity of a channel -> its SI unit
UNITS = {
    "displacement": "m",
    "velocity": "m/s",
    "acceleration": "m/s^2",
    "force": "N",
    "current": "A",
}


@dataclass(frozen=True)
class Channel:
    """An input or output: a quantity `at` a node, `between` two nodes, or of an `element`.

    `factor` turns the channel's own unit into SI; `offset` is true where an unknown constant rides on it.
    """

    name: str
    quantity: str
    unit: str
    at: str | None = None
    between: tuple[str, str] | None = None
    element: str | tuple[str, ...] | None = None  # several: the sum of their forces
    offset: bool = False

    @property
    def elements(self) -> tuple[str, ...]:
        """The elements the channel belongs to."""
        return (self.element,) if isinstance(self.element, str) else self.element or ()

    def to_dict(self) -> dict[str, Any]:
        out: dict[str, Any] = {"name": self.name, "quantity": self.quantity}
        if self.at is not None:
            out["at"] = self.at
        if self.between is not None:
            out["between"] = list(self.between)
        if self.element is not None:
            out["element"] = self.element if isinstance(self.element, str) else list(self.element)
        out["unit"] = self.unit
        if self.offset:
            out["offset"] = "free"
        return out


@dataclass(frozen=True)
class Network:
    """A suspension model: `masses` [kg] by node, `elements`, `inputs`, `outputs`, `uncertainty` (relative sigma).

    Immutable and validated on construction; `with_parameters` and `with_element` return changed copies.
    Raises `InputError` with one line that names the place.
    """

    name: str
    masses: Mapping[str, float]
    elements: tuple[el.Element, ...]
    inputs: tuple[Channel, ...] = ()
    outputs: tuple[Channel, ...] = ()
    uncertainty: Mapping[str, float] = field(default_factory=dict)
    description: str = ""

    # ------------------------------------------------------------------------------------ reading

    @classmethod
    def load(cls, source: str | Path | Mapping[str, Any] | Network) -> Network:
        """A built-in name ('quarter-car-isd'), a JSON file, a dict, or a network as it is."""
        if isinstance(source, Network):
            return source
        if isinstance(source, Mapping):
            return cls.from_dict(source)
        text_name = str(source)
        builtin = resources.files("isd_gym") / "networks" / f"{text_name}.json"
        if "/" not in text_name and builtin.is_file():
            text = builtin.read_text()
        else:
            path = Path(source)
            if not path.exists():
                known = builtin_networks()
                near = get_close_matches(text_name, known, 1)
                asked = f" (did you mean '{near[0]}'?)" if near else ""
                raise InputError(f"no model '{source}'{asked}: neither a file nor one of {', '.join(known)}")
            try:
                text = path.read_text()
            except (OSError, UnicodeDecodeError) as error:
                why = "it is a folder" if path.is_dir() else error
                raise InputError(f"cannot read model '{source}': {why}") from None
        try:
            data = json.loads(text)
        except json.JSONDecodeError as error:
            raise InputError(f"model '{source}': not JSON, line {error.lineno}: {error.msg}") from None
        try:
            return cls.from_dict(data)
        except InputError as error:
            raise InputError(f"model '{source}': {error}") from None

    @classmethod
    def from_dict(cls, data: Any) -> Network:
        known = {"schema", "name", "description", "masses", "elements", "inputs", "outputs", "uncertainty"}
        _check_keys(data, known, {"schema", "elements"}, "the model")
        if data["schema"] != SCHEMA:
            raise InputError(f"schema is {data['schema']!r}, expected '{SCHEMA}'")
        masses = data.get("masses", {})
        if not isinstance(masses, Mapping):
            raise InputError("masses must be an object of node: kg")
        for key in ("elements", "inputs", "outputs"):
            if not isinstance(data.get(key, []), list):
                raise InputError(f"{key} must be a list")
        uncertainty = data.get("uncertainty", {})
        if not isinstance(uncertainty, Mapping):
            raise InputError("uncertainty must be an object of parameter: relative sigma")
        return cls(
            name=str(data.get("name", "model")),
            description=str(data.get("description", "")),
            masses=dict(masses),
            elements=tuple(_read_element(e, i) for i, e in enumerate(data["elements"])),
            inputs=tuple(_read_channel(c, "inputs", i) for i, c in enumerate(data.get("inputs", []))),
            outputs=tuple(_read_channel(c, "outputs", i) for i, c in enumerate(data.get("outputs", []))),
            uncertainty=dict(uncertainty),
        )

    def to_dict(self) -> dict[str, Any]:
        out: dict[str, Any] = {"schema": SCHEMA, "name": self.name}
        if self.description:
            out["description"] = self.description
        return out | {
            "masses": dict(self.masses),
            "elements": [e.to_dict() for e in self.elements],
            "inputs": [c.to_dict() for c in self.inputs],
            "outputs": [c.to_dict() for c in self.outputs],
            "uncertainty": dict(self.uncertainty),
        }

    def dumps(self) -> str:
        """The model as JSON text, one element or channel a line."""
        lines = []
        for key, value in self.to_dict().items():
            if isinstance(value, list):
                rows = ",\n  ".join(json.dumps(v) for v in value)
                lines.append(f' "{key}": [\n  {rows}]' if value else f' "{key}": []')
            else:
                lines.append(f' "{key}": {json.dumps(value)}')
        return "{\n" + ",\n".join(lines) + "\n}\n"

    def save(self, path: str | Path) -> None:
        from .files import write_text

        write_text(path, self.dumps())

    # --------------------------------------------------------------------------------- validation

    def __post_init__(self) -> None:
        self._check_masses()
        if not self.elements:
            raise InputError("the model has no elements")
        _unique([e.name for e in self.elements], "element")
        _unique([c.name for c in self.inputs + self.outputs], "channel")
        if "time" in {c.name for c in self.inputs + self.outputs}:
            raise InputError("a channel cannot be called 'time'")
        by_name = {e.name: e for e in self.elements}
        motors = {e.name for e in self.elements if isinstance(e, el.Motor)}
        outputs = {c.name for c in self.outputs}
        for e in self.elements:
            if e.place == "between" and len(set(e.where)) != 2:
                raise InputError(f"element '{e.name}' stands between '{e.where[0]}' and itself")
            if e.place == "element" and e.where[0] not in motors:
                raise InputError(f"element '{e.name}': no motor '{e.where[0]}'")
            if e.place == "channel" and e.where[0] not in outputs:
                raise InputError(f"element '{e.name}': no output '{e.where[0]}'")
        nodes = set(self.nodes)
        for kind, channels in (("input", self.inputs), ("output", self.outputs)):
            for c in channels:
                for node in [c.at, *(c.between or ())]:
                    if node is not None and node not in nodes | {GROUND}:
                        raise InputError(f"{kind} '{c.name}': no node '{node}'")
                if c.at == GROUND:
                    raise InputError(f"{kind} '{c.name}': the ground does not move")
                for name in c.elements:
                    if name not in by_name:
                        raise InputError(f"{kind} '{c.name}': no element '{name}'")
        for c in self.inputs:
            self._check_input(c, motors)
        for c in self.outputs:
            self._check_output(c, by_name)
        _unique([c.at for c in self.inputs if c.quantity == "displacement"], "moved node")
        known = self.parameters
        for key, sigma in self.uncertainty.items():
            if key not in known:
                raise InputError(f"uncertainty: no parameter '{key}'")
            if isinstance(sigma, bool) or not isinstance(sigma, int | float) or not 0 <= sigma < math.inf:
                raise InputError(f"uncertainty: '{key}' must be a relative sigma >= 0, not {sigma!r}")
        self._check_connected()

    def _check_masses(self) -> None:
        for node, mass in self.masses.items():
            if node == GROUND:
                raise InputError("the ground has no mass: remove it from masses")
            if (
                isinstance(mass, bool)
                or not isinstance(mass, int | float)
                or not math.isfinite(mass)
                or mass <= 0
            ):
                raise InputError(f"masses: '{node}' must be a positive number of kg, not {mass!r}")

    def _check_input(self, c: Channel, motors: set[str]) -> None:
        if c.quantity == "current":
            if c.element not in motors:
                raise InputError(f"input '{c.name}': a current needs \"element\": the name of a motor")
        elif c.quantity in ("displacement", "force"):
            if c.at is None:
                raise InputError(f"input '{c.name}': a {c.quantity} needs \"at\": a node")
        else:
            raise InputError(
                f"input '{c.name}': a {c.quantity} cannot be an input (displacement, force, current)"
            )
        if c.offset:
            raise InputError(f"input '{c.name}': only outputs have an offset")

    def _check_output(self, c: Channel, by_name: Mapping[str, el.Element]) -> None:
        if c.quantity == "force":
            if (c.element is None) == (c.at is None):
                raise InputError(f'output \'{c.name}\': a force is that of an "element" or "at" a moved node')
            if c.at is not None and c.at not in self.moved_nodes:
                raise InputError(f"output '{c.name}': force at '{c.at}', which is not a moved node")
            for name in c.elements:
                if by_name[name].place != "between":
                    raise InputError(f"output '{c.name}': '{name}' has no force of its own")
        elif c.quantity in ("displacement", "velocity", "acceleration"):
            if (c.between is None) == (c.at is None):
                raise InputError(f'output \'{c.name}\': a {c.quantity} is "at" a node or "between" two')
        else:
            raise InputError(f"output '{c.name}': a {c.quantity} cannot be an output")

    def _check_connected(self) -> None:
        links: dict[str, list[str]] = {n: [] for n in self.nodes}
        for e in self.elements:
            if e.place == "between":
                for this, other in (e.where, e.where[::-1]):
                    if this != GROUND:
                        links[this].append(other)
        held = set(self.masses) | set(self.moved_nodes) | {c.at for c in self.inputs if c.quantity == "force"}
        for node, others in links.items():
            if node not in held and len(others) < 2:
                raise InputError(
                    f"node '{node}' floats: it has no mass and no input and hangs on one element "
                    f"(give it a mass, an input, or call it 'ground')"
                )
        reached, frontier = set(), [*self.masses, *self.moved_nodes, GROUND]
        while frontier:
            node = frontier.pop()
            if node not in reached:
                reached.add(node)
                frontier += links.get(node, [])
        for node in links:
            if node not in reached:
                raise InputError(
                    f"node '{node}' floats: nothing ties it to a mass, a moved node or the ground"
                )

    # ------------------------------------------------------------------------------------- access

    @cached_property
    def nodes(self) -> tuple[str, ...]:
        """All nodes but the ground: masses first, then in order of appearance, moved nodes last."""
        seen = dict.fromkeys(self.masses)
        for e in self.elements:
            if e.place == "between":
                seen |= dict.fromkeys(e.where)
        moved = self.moved_nodes
        return tuple(n for n in seen if n != GROUND and n not in moved) + moved

    @cached_property
    def moved_nodes(self) -> tuple[str, ...]:
        return tuple(str(c.at) for c in self.inputs if c.quantity == "displacement")

    @cached_property
    def _assembly(self) -> Assembly:
        return _assemble(self, ())

    @cached_property
    def parameters(self) -> dict[str, float]:
        """Every number of the model by its path: 'body.mass', 'oil.stiffness', ..."""
        out = {f"{node}.mass": float(m) for node, m in self.masses.items()}
        for e in self.elements:
            for f in el.parameter_fields(type(e)):
                out[f"{e.name}.{f.name}"] = getattr(e, f.name)
        return out

    def unit_of(self, path: str) -> str:
        """Unit of a parameter path."""
        owner, _, name = path.rpartition(".")
        for e in self.elements:
            if e.name == owner:
                for f in el.parameter_fields(type(e)):
                    if f.name == name:
                        if isinstance(e, el.SensorBias):
                            return next(c.unit for c in self.outputs if c.name == e.where[0])
                        return f.metadata["unit"]
        if name == "mass" and owner in self.masses:
            return "kg"
        raise InputError(f"no parameter '{path}'; there are {', '.join(self.parameters)}")

    def element(self, name: str) -> el.Element:
        for e in self.elements:
            if e.name == name:
                return e
        raise InputError(f"no element '{name}'; there are {', '.join(e.name for e in self.elements)}")

    def with_parameters(self, values: Mapping[str, float]) -> Network:
        """A copy with the parameters at the given paths replaced."""
        masses = dict(self.masses)
        kinds = {e.name: type(e) for e in self.elements}
        changes: dict[str, dict[str, Any]] = {}
        for path, value in values.items():
            owner, _, name = path.rpartition(".")
            if path not in self.parameters:
                raise InputError(f"no parameter '{path}'; there are {', '.join(self.parameters)}")
            if owner in kinds and name in {f.name for f in el.parameter_fields(kinds[owner])}:
                changes.setdefault(owner, {})[name] = float(value)
            else:
                masses[owner] = float(value)
        elements = tuple(replace(e, **changes[e.name]) if e.name in changes else e for e in self.elements)
        # numbers alone do not change what was checked of the structure
        out = copy(self)
        for name in ("parameters", "_assembly"):
            out.__dict__.pop(name, None)
        out.__dict__.update(masses=masses, elements=elements)
        out._check_masses()
        return out

    def with_element(self, element: el.Element | Mapping[str, Any], *, at: int | None = None) -> Network:
        """A copy with one more element, appended (or at a position in the list)."""
        if not isinstance(element, el.Element):
            element = _read_element(element, len(self.elements))
        listed = list(self.elements)
        listed.insert(len(listed) if at is None else at, element)
        return replace(self, elements=tuple(listed))

    def without_element(self, name: str) -> Network:
        """A copy without an element, and without the uncertainty of its parameters."""
        self.element(name)
        return replace(
            self,
            elements=tuple(e for e in self.elements if e.name != name),
            uncertainty={k: v for k, v in self.uncertainty.items() if k.rpartition(".")[0] != name},
        )

    def free_name(self, stem: str) -> str:
        """`stem`, or stem_2, stem_3, ...: a name no element or node has yet."""
        taken = {e.name for e in self.elements} | set(self.nodes)
        names = (stem if i == 1 else f"{stem}_{i}" for i in range(1, 10_000))
        return next(n for n in names if n not in taken)


def builtin_networks() -> list[str]:
    """Names of the models that come with the package."""
    folder = resources.files("isd_gym") / "networks"
    return sorted(p.name.removesuffix(".json") for p in folder.iterdir() if p.name.endswith(".json"))


def _unique(names: Iterable[str | None], what: str) -> None:
    seen = set()
    for name in names:
        if name in seen:
            raise InputError(f"two {what}s are called '{name}'")
        seen.add(name)


def _check_keys(data: Any, known: set[str], needed: set[str], where: str) -> None:
    if not isinstance(data, Mapping):
        raise InputError(f"{where} must be a JSON object, not {type(data).__name__}")
    for key in data:
        if key not in known:
            raise InputError(f"{where}: unknown key '{key}' (known: {', '.join(sorted(known))})")
    for key in sorted(needed):
        if key not in data:
            raise InputError(f"{where}: '{key}' is missing")


def _name_of(data: Any, what: str, index: int) -> str:
    if isinstance(data, Mapping) and isinstance(data.get("name"), str) and data["name"]:
        return data["name"]
    raise InputError(f'{what}[{index}] needs a "name"')


def _nodes_of(value: Any, where: str) -> tuple[str, str]:
    if isinstance(value, list | tuple) and len(value) == 2 and all(isinstance(n, str) and n for n in value):
        return value[0], value[1]
    raise InputError(f'{where}: "between" must be a list of two node names, not {value!r}')


def _read_element(data: Any, index: int) -> el.Element:
    name = _name_of(data, "elements", index)
    where = f"element '{name}'"
    kind = data.get("type")
    if kind not in el.TYPES:
        raise InputError(f"{where}: unknown type {kind!r} (known: {', '.join(sorted(el.TYPES))})")
    cls = el.TYPES[kind]
    own = {f.name for f in fields(cls)} - {"name", "where"}
    needed = {f.name for f in fields(cls) if f.name in own and f.default is f.default_factory}
    _check_keys(data, {"name", "type", cls.place} | own, {cls.place} | needed, where)
    place = data[cls.place]
    if cls.place == "between":
        terminals: tuple[str, ...] = _nodes_of(place, where)
    elif isinstance(place, str):
        terminals = (place,)
    else:
        raise InputError(f'{where}: "{cls.place}" must be a name, not {place!r}')
    return cls(name=name, where=terminals, **{k: data[k] for k in own if k in data})


def _read_channel(data: Any, kind: str, index: int) -> Channel:
    from .units import convert

    name = _name_of(data, kind, index)
    where = f"{kind[:-1]} '{name}'"
    _check_keys(
        data, {"name", "quantity", "unit", "at", "between", "element", "offset"}, {"quantity", "unit"}, where
    )
    quantity = data["quantity"]
    if quantity not in UNITS:
        raise InputError(f"{where}: unknown quantity {quantity!r} (known: {', '.join(UNITS)})")
    try:
        convert(1.0, data["unit"], UNITS[quantity])
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    if data.get("offset", "none") not in ("free", "none"):
        raise InputError(f'{where}: "offset" must be "free" or "none", not {data["offset"]!r}')
    if "at" in data and not isinstance(data["at"], str):
        raise InputError(f'{where}: "at" must be the name of a node, not {data["at"]!r}')
    element = data.get("element")
    if (
        isinstance(element, list)
        and element
        and kind == "outputs"
        and all(isinstance(e, str) for e in element)
    ):
        element = tuple(element)
    elif element is not None and not isinstance(element, str):
        raise InputError(
            f'{where}: "element" must be a name (or, of an output, a list of names), not {element!r}'
        )
    return Channel(
        name=name,
        quantity=quantity,
        unit=data["unit"],
        at=data.get("at"),
        element=element,
        between=_nodes_of(data["between"], where) if "between" in data else None,
        offset=data.get("offset") == "free",
    )


# ============================================================================================ assembly


@dataclass(frozen=True)
class Assembly:
    """The equations of a network, with every law's force f an input of the linear part.

    The columns of all matrices are the base vector (x, r, v, alpha, F, I, f): states, displacement [m], velocity and
    acceleration of the moved nodes, force inputs [N], currents [A], law forces [N]. ``dx/dt = rate @ base``.
    `elongation` and `elongation_rate` have one row per law; rows of `by_difference` laws hang on an algebraic node, whose
    velocity is the difference of its positions.
    """

    network: Network
    size: tuple[int, int, int, int, int]  # states, moved nodes, force inputs, currents, laws
    laws: tuple[el.Element, ...]
    rate: np.ndarray
    elongation: np.ndarray
    elongation_rate: np.ndarray
    by_difference: tuple[bool, ...]
    outputs: np.ndarray
    outputs_by_difference: tuple[bool, ...]
    position: np.ndarray  # of the free nodes
    velocity: np.ndarray

    def columns(self, part: str) -> slice:
        n, r, f, i, k = self.size
        widths = {"x": n, "r": r, "v": r, "alpha": r, "F": f, "I": i, "f": k}
        start = 0
        for name, width in widths.items():
            if name == part:
                return slice(start, start + width)
            start += width
        raise KeyError(part)


def assemble(network: Network, extra: Sequence[Channel] = ()) -> Assembly:
    """Equations of motion of any network, and the rows of its outputs (and of `extra` channels after them).

    Raises `InputError` where the massless part is singular or an output asks for what the network does not define
    (the acceleration of a massless node).
    """
    return _assemble(network, extra) if extra else network._assembly


def _assemble(network: Network, extra: Sequence[Channel]) -> Assembly:
    moved = network.moved_nodes
    free = tuple(n for n in network.nodes if n not in moved)
    index = {n: i for i, n in enumerate(free + moved)}
    n_free, n_moved = len(free), len(moved)
    total = n_free + n_moved

    def incidence(pair: tuple[str, str]) -> np.ndarray:
        row = np.zeros(total)
        for node, sign in zip(pair, (1.0, -1.0), strict=True):
            if node != GROUND:
                row[index[node]] += sign
        return row

    M, C, K = (np.zeros((total, total)) for _ in range(3))
    for node, mass in network.masses.items():
        M[index[node], index[node]] += mass
    between = [e for e in network.elements if e.place == "between"]
    for e in between:
        row = incidence(e.between)
        k, c, b = e.linear()
        K += k * np.outer(row, row)
        C += c * np.outer(row, row)
        M += b * np.outer(row, row)
        if isinstance(e, el.TerminalInertia):
            node = e.between[0 if e.terminal == "first" else 1]
            if node != GROUND:
                M[:, index[node]] += e.mass * row
    laws = tuple(e for e in between if e.law is not None or e.bound is not None)
    law_rows = np.array([incidence(e.between) for e in laws]).reshape(len(laws), total)
    forces = [c for c in network.inputs if c.quantity == "force"]
    currents = [c for c in network.inputs if c.quantity == "current"]

    # -- split the free directions
    U, s, Vt = np.linalg.svd(M[:n_free, :n_free]) if n_free else (np.eye(0), np.zeros(0), np.eye(0))
    rho = int(np.sum(s > 1e-10 * s[0])) if n_free and s[0] > 0 else 0
    S = s[:rho, None]
    Ua, Uz, Va, Vz = U[:, :rho], U[:, rho:], Vt[:rho].T, Vt[rho:].T
    Mf, Cf, Kf = (X[:n_free, :n_free] for X in (M, C, K))
    Mr, Cr, Kr = (X[:n_free, n_free:] for X in (M, C, K))
    if Uz.size and np.abs(Uz.T @ Mr).max(initial=0.0) > 1e-9 * np.abs(M).max():
        raise InputError("an inertia between a massless node and a moved node is not supported here")
    P, t, Qt = np.linalg.svd(Uz.T @ Cf @ Vz)
    tau = int(np.sum(t > 1e-10 * max(np.abs(Cf).max(initial=0.0), 1e-300))) if t.size else 0
    T = t[:tau, None]
    P1, P2, Q1, Q2 = P[:, :tau], P[:, tau:], Qt[:tau].T, Qt[tau:].T

    n = 2 * rho + tau
    size = (n, n_moved, len(forces), len(currents), len(laws))
    widths = np.cumsum([0, n, n_moved, n_moved, n_moved, len(forces), len(currents), len(laws)])
    at = [slice(a, b) for a, b in zip(widths[:-1], widths[1:], strict=True)]
    x_, r_, v_, alpha_, F_, I_, f_ = at
    width = widths[-1]

    def select(columns: slice, rows: int, start: int = 0) -> np.ndarray:
        out = np.zeros((rows, width))
        out[np.arange(rows), columns.start + start + np.arange(rows)] = 1.0
        return out

    r, v, alpha = select(r_, n_moved), select(v_, n_moved), select(alpha_, n_moved)
    # what pushes on the nodes besides M, C and K: forces in, motors and laws out (positive in tension)
    push = np.zeros((total, width))
    for j, channel in enumerate(forces):
        push[index[str(channel.at)], F_.start + j] += 1.0
    motor_force: dict[str, np.ndarray] = {}
    for e in between:
        if isinstance(e, el.Motor):
            motor_force[e.name] = np.zeros(width)
            for j, channel in enumerate(currents):
                if channel.element == e.name:
                    motor_force[e.name][I_.start + j] = e.thrust_constant * e.ratio
            push -= np.outer(incidence(e.between), motor_force[e.name])
    push[:, f_] -= law_rows.T
    push_free = push[:n_free]

    a, p, y = select(x_, rho), select(x_, rho, rho), select(x_, tau, 2 * rho)
    a1 = p - (Ua.T @ Mr @ v) / S
    known = Cf @ Va @ a1 + Kf @ (Va @ a + Vz @ Q1 @ y) + Cr @ v + Kr @ r - push_free
    Kww = P2.T @ Uz.T @ Kf @ Vz @ Q2
    if Kww.size:
        scale = np.abs(Kf).max()
        sv = np.linalg.svd(Kww, compute_uv=False)
        if scale == 0.0 or sv[-1] < 1e-12 * scale:
            direction = Vz @ Q2 @ np.linalg.svd(Kww)[2][-1]
            names = ", ".join(f"'{m}'" for m, w in zip(free, direction, strict=True) if abs(w) > 0.1)
            raise InputError(
                f"the massless part is singular: nothing holds {names} (add a spring, damper or mass)"
            )
        w = -np.linalg.solve(Kww, P2.T @ Uz.T @ known)
    else:
        w = np.zeros((Q2.shape[1], width))
    z = Q1 @ y + Q2 @ w
    q = Va @ a + Vz @ z
    y1 = -(P1.T @ Uz.T @ (known + Kf @ Vz @ Q2 @ w)) / T
    q1 = Va @ a1 + Vz @ Q1 @ y1  # without the algebraic directions: see by_difference
    a2 = -(Ua.T @ (known + Kf @ Vz @ Q2 @ w + Cf @ Vz @ Q1 @ y1 + Mr @ alpha)) / S
    p1 = a2 + (Ua.T @ Mr @ alpha) / S
    rate = np.vstack([a1, p1, y1])

    position, velocity = np.vstack([q, r]), np.vstack([q1, v])
    acceleration = np.vstack([Va @ a2, alpha])
    algebraic = np.concatenate([np.abs(Vz @ Q2).sum(axis=1), np.zeros(n_moved)]) > 1e-9
    basis_z = np.vstack([Vz, np.zeros((n_moved, Vz.shape[1]))])
    basis_w = np.vstack([Vz @ Q2, np.zeros((n_moved, Q2.shape[1]))])

    def hangs_on(row: np.ndarray, basis: np.ndarray) -> bool:
        return bool(np.abs(row @ basis).max(initial=0.0) > 1e-9)

    def motion(row: np.ndarray, quantity: str, where: str) -> tuple[np.ndarray, bool]:
        if quantity == "displacement":
            return row @ position, False
        if quantity == "velocity":
            if hangs_on(row, basis_w):
                return row @ position, True
            return row @ velocity, False
        if hangs_on(row, basis_z):
            raise InputError(f"{where}: the acceleration of a massless node is not defined")
        return row @ acceleration, False

    def force_of(e: el.Element, where: str) -> np.ndarray:
        row = incidence(e.between)
        if e in laws:
            return select(f_, 1, laws.index(e))[0]
        if isinstance(e, el.Motor):
            return motor_force[e.name]
        if isinstance(e, el.TerminalInertia):
            node = e.between[0 if e.terminal == "first" else 1]
            return e.mass * motion(incidence((node, GROUND)), "acceleration", where)[0]
        k, c, b = e.linear()
        out = k * (row @ position)
        if c:
            rate_row, difference = motion(row, "velocity", where)
            if difference:
                raise InputError(f"{where}: the velocity of an algebraic node is not defined")
            out = out + c * rate_row
        return out + b * motion(row, "acceleration", where)[0] if b else out

    rows, differences = [], []
    for channel in (*network.outputs, *extra):
        where = f"output '{channel.name}'"
        if channel.element is not None:
            row, difference = np.zeros(width), False
            for name in channel.elements:
                row = row + force_of(network.element(name), where)
        elif channel.quantity == "force":
            row, difference = np.zeros(width), False
            for e in between:
                sign = incidence(e.between)[index[str(channel.at)]]
                if sign:
                    row = row + sign * force_of(e, where)
            mass = network.masses.get(str(channel.at), 0.0)
            row = row + mass * acceleration[index[str(channel.at)]]
        else:
            pair = channel.between or (str(channel.at), GROUND)
            row, difference = motion(incidence(pair), channel.quantity, where)
        rows.append(row)
        differences.append(difference)

    by_difference = tuple(hangs_on(row, basis_w) for row in law_rows)
    return Assembly(
        network=network,
        size=size,
        laws=laws,
        rate=rate,
        elongation=law_rows @ position,
        elongation_rate=law_rows @ velocity,
        by_difference=by_difference,
        outputs=np.array(rows).reshape(len(rows), width),
        outputs_by_difference=tuple(differences),
        position=position,
        velocity=np.where(algebraic[:, None], 0.0, velocity),
    )


@dataclass(frozen=True)
class StateSpace:
    """``dx/dt = A x + B u``, ``y = C x + D u``, SI units, with the names of inputs u and outputs y."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def response(self, frequency: np.ndarray) -> np.ndarray:
        """Complex frequency response, shape (len(frequency), outputs, inputs), at `frequency` [Hz]."""
        s = 2j * np.pi * np.asarray(frequency, float)
        eye = np.eye(len(self.A))
        return np.array([self.C @ np.linalg.solve(si * eye - self.A, self.B) + self.D for si in s])


def linearise(
    network: Network | str | Path | Mapping[str, Any],
    *,
    outputs: Sequence[Channel] = (),
    damping: Mapping[str, float] | None = None,
    laws: bool = False,
) -> StateSpace:
    """State space of a network about rest, for controllers and frequency responses.

    `outputs` adds channels to the network's own. A law counts as a linear damper of `damping[element name]`
    [N s/m] (statistical linearisation of friction, equation 9), else by its slope at rest; with `laws=True` its
    force is an input of that name instead. Velocities and accelerations of moved nodes appear as inputs
    ``road'`` and ``road''`` where something acts through them.
    """
    network = Network.load(network)
    asm = assemble(network, outputs)
    X, f = asm.columns("x"), asm.columns("f")
    rate, out = asm.rate, asm.outputs
    if any(asm.outputs_by_difference):
        raise InputError("the velocity of an algebraic node has no state-space form")
    if not laws and asm.laws:
        slopes_k, slopes_c = np.zeros(len(asm.laws)), np.zeros(len(asm.laws))
        for j, e in enumerate(asm.laws):
            if damping is not None and e.name in damping:
                slopes_c[j] = damping[e.name]
            elif e.law is not None:
                p, d, h = np.array(e.law_parameters()), 1e-7, 1e-9
                slopes_k[j] = (e.law(p, d, 0.0, 0.0, 0.0, h)[0] - e.law(p, -d, 0.0, 0.0, 0.0, h)[0]) / (2 * d)
                slopes_c[j] = (e.law(p, 0.0, d, 0.0, 0.0, h)[0] - e.law(p, 0.0, -d, 0.0, 0.0, h)[0]) / (2 * d)
        # f = Kd d + Kc v with d, v = rows @ base and base containing f: solve for f
        rows = slopes_k[:, None] * asm.elongation + slopes_c[:, None] * asm.elongation_rate
        gain = np.linalg.solve(np.eye(len(asm.laws)) - rows[:, f], rows)
        rate, out = rate + rate[:, f] @ gain, out + out[:, f] @ gain
    names: list[str] = []
    keep: list[int] = []
    moved = [c.name for c in network.inputs if c.quantity == "displacement"]
    groups = [
        ("r", moved),
        ("v", [f"{m}'" for m in moved]),
        ("alpha", [f"{m}''" for m in moved]),
        ("F", [c.name for c in network.inputs if c.quantity == "force"]),
        ("I", [c.name for c in network.inputs if c.quantity == "current"]),
        ("f", [e.name for e in asm.laws] if laws else []),
    ]
    for part, labels in groups:
        for j, label in enumerate(labels):
            column = asm.columns(part).start + j
            if part not in ("v", "alpha") or np.any(rate[:, column]) or np.any(out[:, column]):
                names.append(label)
                keep.append(column)
    return StateSpace(
        A=rate[:, X].copy(),
        B=rate[:, keep],
        C=out[:, X].copy(),
        D=out[:, keep],
        inputs=tuple(names),
        outputs=tuple(c.name for c in (*network.outputs, *outputs)),
    )
