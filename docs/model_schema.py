"""Schema of models (`isd-model/1`), made from the element classes: ``python docs/model_schema.py``, after an element was added or changed."""

from __future__ import annotations

import json
import math
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from isd_gym._common.units import CONDITIONS
from isd_gym.records import schemas

DRAFT = "https://json-schema.org/draft/2020-12/schema"
ANGULAR = ("angle", "angular_velocity", "angular_acceleration")
MOTION = ("displacement", "velocity", "acceleration", *ANGULAR)


def model_schema() -> dict[str, Any]:
    """Return the schema of `isd-model/1` with every registered element type.

    Returns:
        The schema.
    """
    from isd_gym.physics.elements import TYPES
    from isd_gym.physics.network import SCHEMA
    from isd_gym.physics.network._bodies import MASSES

    types = sorted(TYPES)
    return {
        "$schema": DRAFT,
        "$id": "urn:isd-gym:isd-model-1",
        "title": "Suspension model: masses, two-terminal elements, channels",
        "type": "object",
        "required": ["schema", "elements"],
        "additionalProperties": False,
        "properties": {
            "schema": {"const": SCHEMA},
            "name": {"type": "string"},
            "description": {"type": "string"},
            "masses": {
                "description": "mass [kg] of each node that has one",
                "type": "object",
                "propertyNames": {"not": {"const": "ground"}, "minLength": 1},
                "additionalProperties": {
                    "type": "number",
                    "minimum": MASSES[0],
                    "maximum": MASSES[1],
                },
            },
            "inertias": {
                "description": "moment of inertia [kg m^2] of each node that turns and has one",
                "type": "object",
                "propertyNames": {"not": {"const": "ground"}, "minLength": 1},
                "additionalProperties": {
                    "type": "number",
                    "minimum": MASSES[0],
                    "maximum": MASSES[1],
                },
            },
            "bodies": {
                "description": "rigid bodies by name: the name is the node at the centre of gravity, every point a node that "
                "moves by z - x pitch + y roll (ISO 8855: x forward, y left, z up)",
                "type": "object",
                "propertyNames": {"not": {"const": "ground"}, "minLength": 1},
                "additionalProperties": {"$ref": "#/$defs/body"},
            },
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
                "additionalProperties": {
                    "type": "number",
                    "minimum": 0,
                    "maximum": 100,
                },
            },
        },
        "$defs": {
            "name": {"type": "string", "minLength": 1},
            "pair": {
                "description": "two nodes: first, second",
                "type": "array",
                "items": {"$ref": "#/$defs/name"},
                "minItems": 2,
                "maxItems": 2,
                "uniqueItems": True,
            },
            "body": _body(),
            "lever": _lever(),
            "input": _input(),
            "output": _output(),
        }
        | {kind: _element(TYPES[kind]) for kind in types},
    }


def _body() -> dict[str, Any]:
    """Return the schema of a rigid body."""
    from isd_gym.physics.network import AXES
    from isd_gym.physics.network._bodies import FARTHEST, MASSES

    inertia = {
        "type": "number",
        "minimum": MASSES[0],
        "maximum": MASSES[1],
        "description": "[kg m^2]",
    }
    place = {"type": "number", "minimum": -FARTHEST, "maximum": FARTHEST}
    return {
        "description": "a mass that turns about the axes for which it has an inertia",
        "type": "object",
        "required": ["mass"],
        "additionalProperties": False,
        "properties": {
            "mass": {
                "type": "number",
                "minimum": MASSES[0],
                "maximum": MASSES[1],
                "description": "[kg]",
            },
            "inertia": {
                "type": "object",
                "additionalProperties": False,
                "properties": dict.fromkeys(AXES, inertia),
            },
            "points": {
                "type": "object",
                "propertyNames": {"not": {"const": "ground"}, "minLength": 1},
                "additionalProperties": {
                    "type": "object",
                    "additionalProperties": False,
                    "properties": {
                        "x": place
                        | {"description": "[m] in front of the centre of gravity"},
                        "y": place
                        | {"description": "[m] to the left of the centre of gravity"},
                    },
                },
            },
        },
    }


def _lever() -> dict[str, Any]:
    """Return the schema of a lever."""
    from isd_gym.physics.network._bodies import LEVER_UNITS, RATIOS

    size = {"type": "number", "minimum": RATIOS[0], "maximum": RATIOS[1]}
    opposite = {"type": "number", "minimum": -RATIOS[1], "maximum": -RATIOS[0]}
    return {
        "type": "object",
        "required": ["name", "between", "ratio", "unit"],
        "additionalProperties": False,
        "properties": {
            "name": {"$ref": "#/$defs/name"},
            "between": {
                "$ref": "#/$defs/pair",
                "not": {"contains": {"const": "ground"}},
            },
            "ratio": {"anyOf": [size, opposite]},
            "unit": {"enum": list(LEVER_UNITS)},
        },
    }


def _about(quantities: tuple[str, ...], more: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a channel about an axis of a body."""
    from isd_gym.physics.network import AXES

    return _channel(
        {"body": {"$ref": "#/$defs/name"}, "axis": {"enum": list(AXES)}},
        quantities,
        more,
    )


def _element(cls: type) -> dict[str, Any]:
    """Return the schema of an element: its place, and each parameter with unit, limits and plausible range."""
    place = (
        {"$ref": "#/$defs/pair"} if cls.place == "between" else {"$ref": "#/$defs/name"}
    )  # type: ignore[attr-defined]
    properties: dict[str, Any] = {
        "name": {"$ref": "#/$defs/name"},
        "type": {"const": cls.type},  # type: ignore[attr-defined]
        cls.place: place,  # type: ignore[attr-defined]
    }
    required = ["name", "type", cls.place]  # type: ignore[attr-defined]
    for f in fields(cls):
        if f.name in ("name", "where"):
            continue
        if "unit" in f.metadata:
            low, high = f.metadata["range"]
            spec: dict[str, Any] = {
                "type": "number",
                "description": f"[{f.metadata['unit']}]",
            }
            if math.isfinite(low) and math.isfinite(high):
                spec["description"] += f", usually {low:g} to {high:g}"
            if math.isfinite(f.metadata["minimum"]):
                spec["exclusiveMinimum" if f.metadata["open"] else "minimum"] = (
                    f.metadata["minimum"]
                )
            else:
                spec["minimum"] = -f.metadata["maximum"]
            spec["maximum"] = f.metadata["maximum"]
        elif "knots" in f.metadata:
            row = {"type": "array", "items": {"type": "number"}}
            spec = {"description": f"[{f.metadata['knots']}]", **row}
            if f.metadata["knots"] == "N":
                spec = {
                    "description": "[N]",
                    "type": "array",
                    "items": {"anyOf": [{"type": "number"}, row]},
                }
                required.append(f.name)
        elif f.name in cls.choices:  # type: ignore[attr-defined]
            spec = {"enum": list(cls.choices[f.name])}  # type: ignore[attr-defined]
        else:
            named = (
                "an element whose force is the load"
                if cls.loaded
                else "an input that acts on no node"
            )  # type: ignore[attr-defined]
            spec = {"type": "string", "description": f"name of {named}"}
        if f.default is MISSING:
            required.append(f.name)
        elif "knots" not in f.metadata:
            spec["default"] = f.default
        properties[f.name] = spec
    return {
        "description": f"{cls.equation} ({cls.source})",  # type: ignore[attr-defined]
        "type": "object",
        "required": required,
        "additionalProperties": False,
        "properties": properties,
    }


def _units(quantity: str) -> list[str]:
    """Return every spelling of the units of a quantity."""
    from isd_gym._common.units import _SPELLINGS, QUANTITIES, TABLE

    si = QUANTITIES[quantity][1]
    own = [unit for unit, (base, _) in TABLE.items() if base == si]
    return own + [spelling for spelling, unit in _SPELLINGS.items() if unit in own]


def _channel(
    place: dict[str, Any], quantities: tuple[str, ...], more: dict[str, Any]
) -> dict[str, Any]:
    """Return the schema of a channel of one of `quantities` at `place`."""
    return {
        "type": "object",
        "required": ["name", "quantity", "unit", *place],
        "additionalProperties": False,
        "properties": {
            "name": {"$ref": "#/$defs/name"},
            "quantity": {"enum": list(quantities)},
            "unit": {"type": "string"},
            **place,
            **more,
        },
        "allOf": [
            {
                "if": {"properties": {"quantity": {"const": q}}},
                "then": {"properties": {"unit": {"enum": _units(q)}}},
            }
            for q in quantities
        ],
    }


def _input() -> dict[str, Any]:
    name, no_offset = {"$ref": "#/$defs/name"}, {"offset": {"const": "none"}}
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
            _channel({"at": name}, (*MOTION, "force", "torque"), no_offset | road),
            _about((*ANGULAR, "torque"), no_offset | road),
            _channel({"element": name}, ("current", "voltage"), no_offset),
            _channel({}, CONDITIONS, no_offset),
        ],
    }


def _output() -> dict[str, Any]:
    name = {"$ref": "#/$defs/name"}
    several = {"oneOf": [name, {"type": "array", "items": name, "minItems": 1}]}
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
            _channel({"at": name}, (*MOTION, "force", "torque"), offset),
            _about(ANGULAR, offset),
            _channel({"between": {"$ref": "#/$defs/pair"}}, MOTION, offset),
            _channel({"element": several}, ("force", "torque"), offset),
        ],
    }


def dumps(schema: dict[str, Any]) -> str:
    """Return a schema as the text of its file.

    Args:
        schema: The schema.

    Returns:
        JSON text.
    """
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    file = Path(schemas.__file__).parent / "isd-model-1.json"
    file.write_text(dumps(model_schema()), encoding="utf-8")
