"""The shipped JSON Schemas say what the programs read and write."""

import copy
import json
import runpy
from pathlib import Path

import pytest
from program import printed, read_json, refused

from isd_gym import InputError, Network
from isd_gym.physics import elements
from isd_gym.physics.network import builtin_networks
from isd_gym.records import schemas

jsonschema = pytest.importorskip("jsonschema")

MODEL = json.dumps(Network.load("quarter-car-isd").to_dict())
DIAGNOSIS = """
{"schema": "isd-diagnosis/1",
 "verdict": "missing_effect",
 "effects": [{"effect": "coulomb_friction", "between": ["piston", "joint"], "confidence": 0.99,
              "parameters": {"level": {"value": 502.0, "low": 495.0, "high": 509.0, "unit": "N"}}}],
 "alternatives": [{"effects": ["stribeck_friction"], "where": [["piston", "joint"]], "excess": 0.01, "weight": 0.3, "error": 0.02, "file": "set_2.json"}],
 "where": [{"channel": "suspension_travel", "share": 0.71, "band_hz": [0.8, 2.0]}],
 "parameters": {"body.mass": {"prior": 345.0, "value": 351.2, "low": 349.9, "high": 352.4, "unit": "kg"}},
 "gap": {"held_out": {"before": {"suspension_travel": 0.31}, "refit": {"suspension_travel": 0.22}, "after": {"suspension_travel": 0.051}, "noise_floor": {"suspension_travel": 0.050}},
         "closed": 0.99},
 "next_experiment": null}
"""


def valid(name, document):
    return jsonschema.Draft202012Validator(schemas.load(name)).is_valid(document)


@pytest.mark.parametrize("name", schemas.NAMES)
def test_schemas_are_schemas(name):
    jsonschema.Draft202012Validator.check_schema(schemas.load(name))


def test_the_shipped_model_schema_is_made_from_the_elements(monkeypatch):
    # other tests may have registered elements of their own
    own = {
        k: cls
        for k, cls in elements.TYPES.items()
        if cls.__module__.startswith(elements.__name__)
    }
    monkeypatch.setattr(elements, "TYPES", own)
    made = runpy.run_path(str(Path(__file__).parents[1] / "docs" / "model_schema.py"))
    now = json.loads(made["dumps"](made["model_schema"]()))
    assert schemas.load("isd-model/1") == now, (
        "an element changed: run python docs/model_schema.py"
    )


@pytest.mark.parametrize("name", builtin_networks())
def test_built_in_networks_are_valid(name):
    jsonschema.validate(Network.load(name).to_dict(), schemas.load("isd-model/1"))


def _set(*path, value):
    def change(model):
        place = model
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = value

    return change


#: what schema and reader refuse, and the words of the reader
WRONG = [
    (_set("colour", value="red"), "unknown key 'colour'"),
    (_set("masses", "ground", value=1.0), ""),
    (_set("masses", "body", value=0.0), "'body' must be a positive number of kg"),
    (_set("elements", value=[]), ""),
    (_set("elements", 0, "type", value="spring"), "main_spring.*unknown type 'spring'"),
    (
        _set("elements", 0, "stiffness", value=-1.0),
        "main_spring.*stiffness must be >= 0",
    ),
    (_set("elements", 0, "between", value=["body"]), ""),
    (_set("outputs", 0, "between", value=["body", "wheel"]), ""),
    (
        _set("outputs", 0, "unit", value="mm"),
        "body_acceleration.*cannot be converted to",
    ),
    (_set("inputs", 0, "quantity", value="acceleration"), ""),
    (_set("inputs", 0, "quantity", value="current"), ""),
    (_set("outputs", 0, "offset", value=True), ""),
    (_set("uncertainty", "body.mass", value=-0.1), ""),
    (
        lambda m: m["elements"][0].pop("stiffness"),
        "main_spring.*'stiffness' is missing",
    ),
    (lambda m: m["inputs"][0].pop("unit"), ""),
]


@pytest.mark.parametrize(("change", "words"), WRONG)
def test_schema_and_reader_refuse_the_same(change, words):
    model = json.loads(MODEL)
    change(model)
    assert not valid("isd-model/1", model)
    refused(words, Network.load, model)


@pytest.mark.parametrize("unit", ["mm", "in", "m"])
def test_schema_and_reader_accept_the_same_units(unit):
    model = json.loads(MODEL)
    model["outputs"][1] |= {"unit": unit, "offset": "free"}
    assert valid("isd-model/1", model)
    assert Network.load(model).outputs[1].offset


def test_score_json_of_a_half_car_is_valid(tmp_path):
    file = tmp_path / "score.json"
    words = "score passive lqg --network half-car-isd --point body_rear"
    printed(words, "--episodes 2 --duration 1 --json", file)
    score = read_json(file)
    jsonschema.validate(score, schemas.load("isd-score/1"))
    assert score["comfort_point"] == "body_rear"
    score["policies"][1]["tyre_load_rear_rms"] = 3.0
    assert not valid("isd-score/1", score)


def test_a_verdict_and_its_effects_agree():
    diagnosis = json.loads(DIAGNOSIS)
    assert not valid("isd-diagnosis/1", diagnosis | {"effects": []})
    assert not valid("isd-diagnosis/1", diagnosis | {"verdict": "ambiguous"})
    assert valid("isd-diagnosis/1", diagnosis | {"verdict": "ambiguous", "effects": []})
    nowhere = copy.deepcopy(diagnosis)
    del nowhere["effects"][0]["between"]
    assert not valid("isd-diagnosis/1", nowhere)
    refused("no schema 'isd-data/1': there are isd-model/1", schemas.load, "isd-data/1")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda d: d["effects"][0].pop("effect"),
            r"it: effects\[0\]: 'effect' is a required property",
        ),
        (
            lambda d: d.update(effects="x" * 10_000),
            r"it: effects: 'xxx.* is not of type 'array'",
        ),
    ],
)
def test_a_document_of_another_structure_is_refused_in_a_line(change, message):
    document = json.loads(DIAGNOSIS)
    schemas.check(document, "isd-diagnosis/1", "it")
    change(document)
    with pytest.raises(InputError, match=message) as caught:
        schemas.check(document, "isd-diagnosis/1", "it")
    assert len(str(caught.value)) < 300
