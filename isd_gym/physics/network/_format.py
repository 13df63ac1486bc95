"""File format `isd-model/1`: conversion between JSON and `Network`, with one-line errors that name the place."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import fields
from difflib import get_close_matches
from importlib import resources
from typing import TYPE_CHECKING, Any, cast

from ..._common.errors import InputError, hint, shown
from ..._common.inputs import is_number, parse_json, read_bytes
from ..._common.units import QUANTITIES, TURNING, si_of
from .. import elements as el
from ._bodies import AXES, LEVER_UNITS, Body, Lever, angle_node, body_of
from ._model import ELEMENTS, Channel, Network, Offset, check_name

if TYPE_CHECKING:
    from pathlib import Path


SCHEMA = "isd-model/1"
TEXT_LENGTH = 4000  # largest length of a model's name and description


def builtin_networks() -> list[str]:
    """Return the names of the models in the package.

    Returns:
        Names, sorted.
    """
    folder = resources.files("isd_gym.physics") / "networks"
    return sorted(
        p.name.removesuffix(".json")
        for p in folder.iterdir()
        if p.name.endswith(".json")
    )


def read(source: str | Path | Mapping[str, Any]) -> Network:
    """Read a model."""
    if isinstance(source, Mapping):
        return from_dict(source)
    text_name = str(source)
    where = f"model {shown(text_name, 200)}"
    known = builtin_networks()
    if text_name in known:
        builtin = resources.files("isd_gym.physics") / "networks" / f"{text_name}.json"
        data = parse_json(builtin.read_bytes(), where)
    else:
        # an existence test covers impossible file names, too
        if not os.path.exists(source):
            near = get_close_matches(text_name[:200], known, 1)
            asked = f" (did you mean '{near[0]}'?)" if near else ""
            raise InputError(
                f"no model {shown(text_name, 200)}{asked}: neither a file nor one of {', '.join(known)}"
            )
        if os.path.isdir(source):
            raise InputError(f"cannot read {where}: it is a folder")
        if text_name.lower().endswith(".fmu"):
            raise InputError(
                f"{where}: the equations inside an FMU are hidden; describe the model as a network (isd-model/1)"
            )
        data = parse_json(read_bytes(source), where)
    try:
        return from_dict(data)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def from_dict(data: Any) -> Network:
    """Return the model of a JSON object."""
    known = {f.name for f in fields(Network)} - {"turning"} | {"schema", "inertias"}
    _check_keys(data, known, {"schema", "elements"}, "the model")
    if data["schema"] != SCHEMA:
        raise InputError(f"schema is {shown(data['schema'])}, expected '{SCHEMA}'")
    masses = data.get("masses", {})
    inertias = data.get("inertias", {})
    for key, value, unit in (
        ("masses", masses, "kg"),
        ("inertias", inertias, "kg m^2"),
    ):
        if not isinstance(value, Mapping):
            raise InputError(f"{key} must be an object of node: {unit}")
    for node in inertias:
        if node in masses:
            raise InputError(
                f"inertias: '{node}' has a mass already; a rotational node has only an inertia"
            )
    for key in ("elements", "levers", "inputs", "outputs"):
        if not isinstance(data.get(key, []), list):
            raise InputError(f"{key} must be a list")
        if len(data.get(key, [])) > ELEMENTS:
            raise InputError(
                f"the model has {len(data[key])} {key}, at most {ELEMENTS} are handled"
            )
    uncertainty = data.get("uncertainty", {})
    if not isinstance(uncertainty, Mapping):
        raise InputError("uncertainty must be an object of parameter: relative sigma")
    network = Network(
        name=_text(data, "name", "model"),
        description=_text(data, "description", ""),
        masses={**masses, **inertias},
        turning=frozenset(inertias),
        bodies=_read_bodies(data.get("bodies", {})),
        levers=tuple(_read_lever(v, i) for i, v in enumerate(data.get("levers", []))),
        elements=tuple(read_element(e, i) for i, e in enumerate(data["elements"])),
        inputs=tuple(
            read_channel(c, "inputs", i) for i, c in enumerate(data.get("inputs", []))
        ),
        outputs=tuple(
            read_channel(c, "outputs", i) for i, c in enumerate(data.get("outputs", []))
        ),
        uncertainty=dict(uncertainty),
    )
    _check_masses_are_used(network)
    return network


def _check_masses_are_used(network: Network) -> None:
    """Refuse a mass that nothing else of the model names, such as one with a misspelt name."""
    used = {node for e in network.elements for node in e.where}
    used |= {node for lever in network.levers for node in lever.between}
    used |= {
        node
        for c in network.inputs + network.outputs
        for node in (c.at, *(c.between or ()))
        if node
    }
    for node in network.masses:
        if node not in used:
            free = sorted(used & set(network.nodes) - set(network.masses))
            raise InputError(f"masses: no element is at '{node}'; {hint(node, free)}")


def to_dict(network: Network) -> dict[str, Any]:
    """Return the JSON object of a model (`isd-model/1`)."""
    out: dict[str, Any] = {"schema": SCHEMA, "name": network.name}
    if network.description:
        out["description"] = network.description
    out["masses"] = {
        n: m for n, m in network.masses.items() if n not in network.turning
    }
    if network.turning:
        out["inertias"] = {
            n: m for n, m in network.masses.items() if n in network.turning
        }
    if network.bodies:
        out["bodies"] = {b.name: b.to_dict() for b in network.bodies}
    out["elements"] = [e.to_dict() for e in network.elements]
    if network.levers:
        out["levers"] = [v.to_dict() for v in network.levers]
    return out | {
        "inputs": [c.to_dict() for c in network.inputs],
        "outputs": [c.to_dict() for c in network.outputs],
        "uncertainty": dict(network.uncertainty),
    }


def dumps(network: Network) -> str:
    """Return a model as JSON text, one element or channel per line."""
    lines = []
    for key, value in to_dict(network).items():
        if isinstance(value, list):
            rows = ",\n  ".join(json.dumps(v) for v in value)
            lines.append(f' "{key}": [\n  {rows}]' if value else f' "{key}": []')
        else:
            lines.append(f' "{key}": {json.dumps(value)}')
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _text(data: Mapping[str, Any], key: str, usual: str) -> str:
    value = data.get(key, usual)
    if not isinstance(value, str) or len(value) > TEXT_LENGTH:
        raise InputError(
            f"{key} must be a text of at most {TEXT_LENGTH} characters, not {shown(value)}"
        )
    return value


def _check_keys(data: Any, known: set[str], needed: set[str], where: str) -> None:
    if not isinstance(data, Mapping):
        raise InputError(f"{where} must be a JSON object, not {type(data).__name__}")
    for key in data:
        if key not in known:
            raise InputError(
                f"{where}: unknown key {shown(key)} (known: {', '.join(sorted(known))})"
            )
    for key in sorted(needed):
        if key not in data:
            raise InputError(f"{where}: '{key}' is missing")


def _name_of(data: Any, what: str, index: int) -> str:
    if isinstance(data, Mapping) and isinstance(data.get("name"), str) and data["name"]:
        return check_name(data["name"], f"{what}[{index}]")
    raise InputError(f'{what}[{index}] needs a "name"')


def _nodes_of(value: Any, where: str) -> tuple[str, str]:
    if (
        isinstance(value, list | tuple)
        and len(value) == 2
        and all(isinstance(n, str) and n for n in value)
    ):
        return value[0], value[1]
    raise InputError(
        f'{where}: "between" must be a list of two node names, not {shown(value)}'
    )


def _read_bodies(data: Any) -> tuple[Body, ...]:
    """Return the rigid bodies of a model file in the order of the file; raise `InputError` for an invalid entry."""
    if not isinstance(data, Mapping):
        raise InputError(
            f"bodies must be an object of body by name, not {type(data).__name__}"
        )
    out = []
    for name, entry in data.items():
        where = f"body {shown(name)}"
        check_name(name, "bodies")
        _check_keys(entry, {"mass", "inertia", "points"}, {"mass"}, where)
        inertia = entry.get("inertia", {})
        points = entry.get("points", {})
        _check_keys(inertia, set(AXES), set(), f'{where}: "inertia"')
        if None in inertia.values():
            raise InputError(
                f"{where}: an inertia must be a number of kg m^2, not null; leave it out where there is none"
            )
        if not isinstance(points, Mapping):
            raise InputError(
                f'{where}: "points" must be an object of point by name, not {type(points).__name__}'
            )
        for point, at in points.items():
            check_name(point, f"{where}: points")
            _check_keys(at, {"x", "y"}, set(), f"{where}: point {shown(point)}")
        out.append(body_of(name, entry))
    return tuple(out)


def _read_lever(data: Any, index: int) -> Lever:
    """Return the lever of an entry of a model file; raise `InputError` for an invalid entry."""
    name = _name_of(data, "levers", index)
    where = f"lever '{name}'"
    if "unit" not in data:
        raise InputError(
            f"{where}: 'unit' is missing: that of its ratio, one of {', '.join(LEVER_UNITS)}"
        )
    _check_keys(data, {"name", "between", "ratio", "unit"}, {"between", "ratio"}, where)
    return Lever(name, _nodes_of(data["between"], where), data["ratio"], data["unit"])


def read_element(data: Any, index: int) -> el.Element:
    """Return an element of a model file."""
    name = _name_of(data, "elements", index)
    where = f"element '{name}'"
    kind = data.get("type")
    if isinstance(kind, str) and kind not in el.TYPES:
        el.discover()  # an installed package may offer the type
    if not isinstance(kind, str) or kind not in el.TYPES:
        raise InputError(
            f"{where}: unknown type {shown(kind)} (known: {', '.join(sorted(el.TYPES))})"
        )
    cls = el.TYPES[kind]
    own = {f.name for f in fields(cls)} - {"name", "where"}
    needed = {
        f.name for f in fields(cls) if f.name in own and f.default is f.default_factory
    }
    _check_keys(data, {"name", "type", cls.place} | own, {cls.place} | needed, where)
    place = data[cls.place]
    if cls.place == "between":
        terminals: tuple[str, ...] = _nodes_of(place, where)
    elif isinstance(place, str):
        terminals = (place,)
    else:
        raise InputError(f'{where}: "{cls.place}" must be a name, not {shown(place)}')
    return cls(name=name, where=terminals, **{k: data[k] for k in own if k in data})


def read_channel(data: Any, kind: str, index: int) -> Channel:
    """Return an input or output of a model file; kind ('inputs' or 'outputs') and index of the entry are for messages."""
    name = _name_of(data, kind, index)
    where = f"{kind[:-1]} '{name}'"
    _check_keys(
        data, {f.name for f in fields(Channel)} | {"body"}, {"quantity", "unit"}, where
    )
    quantity = data["quantity"]
    if not isinstance(quantity, str) or quantity not in QUANTITIES:
        raise InputError(
            f"{where}: unknown quantity {shown(quantity)} (known: {', '.join(QUANTITIES)})"
        )
    base, si = QUANTITIES[quantity]
    try:
        found = si_of(data["unit"])
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    if found != si:
        other = next((q for q, (_, unit) in QUANTITIES.items() if unit == found), None)
        hint = f' (that is the unit of "quantity": "{other}")' if other else ""
        raise InputError(
            f"{where}: unit '{data['unit']}' cannot be converted to '{si}'{hint}"
        )
    noise = data.get("noise")
    if noise is not None and not (is_number(noise) and noise > 0):
        raise InputError(
            f'{where}: "noise" must be a positive RMS in the channel\'s unit, not {shown(noise)}'
        )
    offset = data.get("offset", "none")
    if not isinstance(offset, str) or offset not in ("free", "record", "none"):
        raise InputError(
            f'{where}: "offset" must be "free" (one for all records), "record" (one for each) or "none", '
            f"not {shown(offset)}"
        )
    if not isinstance(data.get("measured", True), bool):
        raise InputError(
            f'{where}: "measured" must be true or false, not {shown(data["measured"])}'
        )
    if "at" in data and not isinstance(data["at"], str):
        raise InputError(
            f'{where}: "at" must be the name of a node, not {shown(data["at"])}'
        )
    at, axis = (
        _axis_of(data, quantity, where)
        if "body" in data or "axis" in data
        else (data.get("at"), None)
    )
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
            f'{where}: "element" must be a name (or, of an output, a list of names), not {shown(element)}'
        )
    return Channel(
        name=name,
        quantity=base,
        unit=data["unit"],
        at=at,
        element=element,
        between=_nodes_of(data["between"], where) if "between" in data else None,
        offset=None if offset == "none" else cast("Offset", offset),
        noise=None if noise is None else float(noise),
        measured=data.get("measured", True),
        axis=axis,
    )


def _axis_of(data: Mapping[str, Any], quantity: str, where: str) -> tuple[str, str]:
    """Return the node that is the angle of a body about an axis, and the axis."""
    body, axis = data.get("body"), data.get("axis")
    if not isinstance(body, str) or axis not in AXES:
        raise InputError(
            f'{where}: a motion about an axis has "body": a body and "axis": {" or ".join(AXES)}, not {shown(body)} and '
            f"{shown(axis)}"
        )
    if {"at", "between", "element"} & set(data):
        raise InputError(
            f'{where}: "body" and "axis" are sufficient: leave out "at", "between" and "element"'
        )
    if QUANTITIES[quantity][1] not in TURNING:
        raise InputError(
            f'{where}: "{quantity}" is no motion about an axis; for that of the centre of gravity write "at": "{body}"'
        )
    return angle_node(body, axis), axis
