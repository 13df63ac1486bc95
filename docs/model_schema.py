"""Schema of models (`isd-model/1`), made from the element classes: ``python docs/model_schema.py``, after an element was added or changed."""

from __future__ import annotations

import json
import math
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import Any

from isd_gym._common.units import _SPELLINGS, CONDITIONS, QUANTITIES, TABLE
from isd_gym.physics.elements import TYPES
from isd_gym.physics.network import AXES, SCHEMA
from isd_gym.physics.network._bodies import FARTHEST, LEVER_UNITS, MASSES, RATIOS
from isd_gym.records import schemas

DRAFT = "https://json-schema.org/draft/2020-12/schema"
ANGULAR = ("angle", "angular_velocity", "angular_acceleration")
MOTION = ("displacement", "velocity", "acceleration", *ANGULAR)


NAME, PAIR = {"$ref": "#/$defs/name"}, {"$ref": "#/$defs/pair"}


def _number(low: float, high: float, **more: str) -> dict[str, Any]:
    return {"type": "number", "minimum": low, "maximum": high, **more}


def _object(properties: dict[str, Any], *required: str, **head: str) -> dict[str, Any]:
    """Return the schema of an object with these properties only; `head` comes before its type."""
    return {
        **head,
        "type": "object",
        **({"required": list(required)} if required else {}),
        "additionalProperties": False,
        "properties": properties,
    }


def _by_node(values: dict[str, Any], **head: str) -> dict[str, Any]:
    """Return the schema of values by node; `head` comes before its type."""
    return {
        **head,
        "type": "object",
        "propertyNames": {"not": {"const": "ground"}, "minLength": 1},
        "additionalProperties": values,
    }


def model_schema() -> dict[str, Any]:
    """Return the schema of `isd-model/1` with every registered element type.

    Returns:
        The schema.
    """
    types = sorted(TYPES)
    properties = {
        "schema": {"const": SCHEMA},
        "name": {"type": "string"},
        "description": {"type": "string"},
        "masses": _by_node(
            _number(*MASSES), description="mass [kg] of each node that has one"
        ),
        "inertias": _by_node(
            _number(*MASSES),
            description="moment of inertia [kg m^2] of each node that turns and has one",
        ),
        "bodies": _by_node(
            {"$ref": "#/$defs/body"},
            description="rigid bodies by name: the name is the node at the centre of gravity, every point a node that "
            "moves by z - x pitch + y roll (ISO 8855: x forward, y left, z up)",
        ),
        "levers": {
            "description": "motion of the first node is ratio times motion of the second",
            "type": "array",
            "items": {"$ref": "#/$defs/lever"},
        },
        "elements": {
            "type": "array",
            "minItems": 1,
            "items": {
                "type": "object",
                "required": ["name", "type"],
                "properties": {"type": {"enum": types}},
                # validation follows one branch, so that an error names the wrong key
                "allOf": [
                    {
                        "if": {
                            "properties": {"type": {"const": kind}},
                            "required": ["type"],
                        },
                        "then": {"$ref": f"#/$defs/{kind}"},
                    }
                    for kind in types
                ],
            },
        },
        "inputs": {"type": "array", "items": {"$ref": "#/$defs/input"}},
        "outputs": {"type": "array", "items": {"$ref": "#/$defs/output"}},
        "uncertainty": {
            "description": "relative one-sigma of a parameter, by its path ('body.mass', 'oil.stiffness')",
            "type": "object",
            "propertyNames": {"pattern": r"^.+\..+$"},
            "additionalProperties": _number(0, 100),
        },
    }
    head = {
        "$schema": DRAFT,
        "$id": "urn:isd-gym:isd-model-1",
        "title": "Suspension model: masses, two-terminal elements, channels",
    }
    parts = {
        "name": {"type": "string", "minLength": 1},
        "pair": {
            "description": "two nodes: first, second",
            "type": "array",
            "items": NAME,
            "minItems": 2,
            "maxItems": 2,
            "uniqueItems": True,
        },
        "body": _body(),
        "lever": _lever(),
        "input": _input(),
        "output": _output(),
    }
    elements = {kind: _element(TYPES[kind]) for kind in types}
    made = _object(properties, "schema", "elements", **head)
    return {**made, "$defs": parts | elements}


def _body() -> dict[str, Any]:
    """Return the schema of a rigid body."""
    inertia, reach = _number(*MASSES, description="[kg m^2]"), (-FARTHEST, FARTHEST)
    point = {
        "x": _number(*reach, description="[m] in front of the centre of gravity"),
        "y": _number(*reach, description="[m] to the left of the centre of gravity"),
    }
    properties = {
        "mass": _number(*MASSES, description="[kg]"),
        "inertia": _object(dict.fromkeys(AXES, inertia)),
        "points": _by_node(_object(point)),
    }
    what = "a mass that turns about the axes for which it has an inertia"
    return _object(properties, "mass", description=what)


def _lever() -> dict[str, Any]:
    """Return the schema of a lever."""
    low, high = RATIOS
    properties = {
        "name": NAME,
        "between": {**PAIR, "not": {"contains": {"const": "ground"}}},
        "ratio": {"anyOf": [_number(low, high), _number(-high, -low)]},
        "unit": {"enum": list(LEVER_UNITS)},
    }
    return _object(properties, *properties)


def _about(quantities: tuple[str, ...], more: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a channel about an axis of a body."""
    place = {"body": NAME, "axis": {"enum": list(AXES)}}
    return _channel(place, quantities, more)


def _parameter(field: Field[Any]) -> dict[str, Any]:
    """Return the schema of a number with unit, limits and plausible range."""
    limits = field.metadata
    low, high = limits["range"]
    usual = math.isfinite(low) and math.isfinite(high)
    text = f"[{limits['unit']}]" + (f", usually {low:g} to {high:g}" if usual else "")
    key, least = "minimum", -limits["maximum"]
    if math.isfinite(limits["minimum"]):
        key = "exclusiveMinimum" if limits["open"] else "minimum"
        least = limits["minimum"]
    return {
        "type": "number",
        "description": text,
        key: least,
        "maximum": limits["maximum"],
    }


def _element(cls: Any) -> dict[str, Any]:
    """Return the schema of an element: its place and its parameters."""
    properties: dict[str, Any] = {
        "name": NAME,
        "type": {"const": cls.type},
        cls.place: PAIR if cls.place == "between" else NAME,
    }
    required = [*properties]
    for f in fields(cls):
        if f.name in ("name", "where"):
            continue
        if "unit" in f.metadata:
            spec = _parameter(f)
        elif "knots" in f.metadata:
            row = {"type": "array", "items": {"type": "number"}}
            spec = {"description": f"[{f.metadata['knots']}]", **row}
            if f.metadata["knots"] == "N":
                spec["items"] = {"anyOf": [{"type": "number"}, row]}
                required.append(f.name)
        elif f.name in cls.choices:
            spec = {"enum": list(cls.choices[f.name])}
        elif cls.loaded:
            spec = {
                "type": "string",
                "description": "name of an element whose force is the load",
            }
        else:
            spec = {
                "type": "string",
                "description": "name of an input that acts on no node",
            }
        if f.default is MISSING:
            required.append(f.name)
        elif "knots" not in f.metadata:
            spec["default"] = f.default
        properties[f.name] = spec
    what = f"{cls.equation} ({cls.source})"
    return _object(properties, *required, description=what)


def _units(quantity: str) -> list[str]:
    """Return every spelling of the units of a quantity."""
    si = QUANTITIES[quantity][1]
    own = [unit for unit, (base, _) in TABLE.items() if base == si]
    return own + [spelling for spelling, unit in _SPELLINGS.items() if unit in own]


def _channel(
    place: dict[str, Any], quantities: tuple[str, ...], more: dict[str, Any]
) -> dict[str, Any]:
    """Return the schema of a channel of one of `quantities` at `place`."""
    properties = {
        "name": NAME,
        "quantity": {"enum": list(quantities)},
        "unit": {"type": "string"},
        **place,
        **more,
    }
    units = [
        {
            "if": {"properties": {"quantity": {"const": q}}},
            "then": {"properties": {"unit": {"enum": _units(q)}}},
        }
        for q in quantities
    ]
    return {
        **_object(properties, "name", "quantity", "unit", *place),
        "allOf": units,
    }


def _input() -> dict[str, Any]:
    no_offset = {"offset": {"const": "none"}}
    road = {
        "measured": {
            "type": "boolean",
            "description": "false: a displacement that nobody measures",
        }
    }
    return {
        "description": "a displacement, velocity or acceleration moves its node (angles where it turns); a force or torque "
        "acts at it; a current or voltage drives a motor; a temperature, pressure or speed without a place is what coefficients "
        "may depend on",
        "oneOf": [
            _channel({"at": NAME}, (*MOTION, "force", "torque"), no_offset | road),
            _about((*ANGULAR, "torque"), no_offset | road),
            _channel({"element": NAME}, ("current", "voltage"), no_offset),
            _channel({}, CONDITIONS, no_offset),
        ],
    }


def _output() -> dict[str, Any]:
    several = {"oneOf": [NAME, {"type": "array", "items": NAME, "minItems": 1}]}
    offset = {
        "offset": {
            "enum": ["free", "record", "none"],
            "description": "unknown constant of the sensor, fitted: free: one for all records; record: one for each record",
        },
        "noise": {
            "type": "number",
            "exclusiveMinimum": 0,
            "description": "RMS in the channel's unit, from the sensor's sheet",
        },
    }
    return {
        "description": "motion at a node or between two; force of an element (or the sum of several), or at a moved node",
        "oneOf": [
            _channel({"at": NAME}, (*MOTION, "force", "torque"), offset),
            _about(ANGULAR, offset),
            _channel({"between": PAIR}, MOTION, offset),
            _channel({"element": several}, ("force", "torque"), offset),
        ],
    }


def dumps(schema: dict[str, Any]) -> str:
    """Return a schema as the text of its file."""
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    file = Path(schemas.__file__).parent / "isd-model-1.json"
    file.write_text(dumps(model_schema()), encoding="utf-8")
