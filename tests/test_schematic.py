"""A network drawn: all parts are drawn in the right places, without overlaps."""

import re
import xml.etree.ElementTree as ET

import builders
import pytest
from builders import channel, damper, element, model, spring
from program import refused
from typer.testing import CliRunner

from isd_gym import _commands as cli
from isd_gym.physics.network import Network, builtin_networks
from isd_gym.view._report import schematic

BRIDGE = model(
    "bridge & <co>",
    [
        spring("a", "p", 1e4, "k1"),
        spring("a", "q", 1e4, "k2"),
        damper("p", "q", 100, "across"),
        damper("p", "ground", 100, "c1"),
        element("c2", "cubic_stiffness", "q", "ground", stiffness=1e6),
        spring("tuned", "a", 1e4, "kt"),
    ],
    [channel("push", "force", "a")],
    [channel("gap", "displacement", "p", "q", unit="mm")],
    masses={"a": 10, "tuned": 3},
)


def parts(drawing):
    return {s.part for s in drawing.strokes} | {w.part for w in drawing.words}


def ends(drawing, name):
    """Heights of the upper and lower end of an element's wires."""
    ys = [y for s in drawing.strokes if s.part == f"el:{name}" for _, y in s.points]
    return min(ys), max(ys)


def level(drawing, node):
    ys = [y for s in drawing.strokes if s.part == f"node:{node}" for _, y in s.points]
    return min(ys), max(ys)


@pytest.mark.parametrize("source", [*builtin_networks(), BRIDGE], ids=str)
def test_everything_is_drawn_between_its_nodes(source):
    network = Network.load(source)
    made = schematic.draw(network)
    wanted = {f"node:{n}" for n in network.nodes}
    wanted |= {f"el:{e.name}" for e in network.elements if e.place == "between"}
    wanted |= {f"ch:{c.name}" for c in (*network.inputs, *network.outputs) if not c.elements}
    assert wanted <= parts(made)
    for e in network.elements:
        upper, lower = ends(made, e.name)
        bars = sorted((level(made, n) for n in e.where), key=lambda b: b[0])
        edge = bars[0][1] if e.where and bars[0][1] < bars[1][0] else bars[0][0]
        assert upper == pytest.approx(edge, abs=10)
        assert bars[0][0] - 1e-6 <= upper and lower <= bars[1][1] + 1e-6
        text = " ".join(w.text for w in made.words if w.part == f"el:{e.name}")
        assert e.name.replace("_", " ") in text
    for x, y in (p for s in made.strokes for p in s.points):
        assert 0 <= x <= made.width and 0 <= y <= made.height


@pytest.mark.parametrize("name", builtin_networks())
def test_words_do_not_cover_one_another(name):
    made = schematic.draw(Network.load(name))

    def box(w):
        wide = 0.92 * schematic.LETTER * len(w.text) * w.size / schematic.SMALL
        left = w.x - {"start": 0, "middle": 0.5, "end": 1}[w.anchor] * wide
        return left, w.y - 0.75 * w.size, left + wide, w.y + 0.1 * w.size

    boxes = [box(w) for w in made.words]
    for i, a in enumerate(boxes):
        for j, b in enumerate(boxes[:i]):
            apart = a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]
            assert apart, (made.words[i].text, made.words[j].text)


def test_series_is_below_one_another_and_parallel_beside():
    made = schematic.draw(Network.load("quarter-car-isd"))
    upper, lower = ends(made, "inerter")
    assert ends(made, "oil")[1] <= upper < lower <= ends(made, "damper")[0]
    for other in ("leak", "seal", "end_stop", "motor"):
        assert ends(made, other) == ends(made, "inerter")
    assert ends(made, "main_spring") == (ends(made, "oil")[0], ends(made, "damper")[1])
    assert level(made, "body") < level(made, "wheel") < level(made, "road")


def test_values_are_written_as_one_writes_them():
    words = [w.text for w in schematic.draw(Network.load("quarter-car-isd")).words]
    values = {"709 kN/m", "1293 N·s/m", "24.65 mm", "1 MN/m", "ratio 4.056", "body  345 kg"}
    assert values | {"← current [A]", "→ tyre force [N]"} <= set(words)


def test_what_was_found_stands_out():
    made = schematic.draw(Network.load("quarter-car-isd"), found=["seal"])
    colours = {s.part: s.colour for s in made.strokes}
    assert colours["el:seal"] == "found" and colours["el:leak"] == "ink"
    # a spring from the body to the ground turns nothing upside down
    base = Network.load("quarter-car-isd")
    anchor = spring("body", "ground", 1e4, "strap")
    made = schematic.draw(base.with_element(anchor), found=["strap"])
    assert level(made, "body") < level(made, "wheel") < level(made, "road")
    assert level(made, "body")[1] <= ends(made, "strap")[0]


@pytest.mark.parametrize(("suffix", "begins"), [(".svg", b"<svg"), (".png", b"\x89PNG"), (".pdf", b"%PDF")])
def test_draw_writes_what_the_name_says(tmp_path, suffix, begins):
    out = tmp_path / f"car{suffix}"
    done = CliRunner().invoke(cli.app, ["networks", "quarter-car-isd", "--draw", str(out)])
    assert done.exit_code == 0, done.output
    assert out.read_bytes().startswith(begins)
    again = tmp_path / f"again{suffix}"
    schematic.draw(Network.load("quarter-car-isd")).save(again)
    assert again.read_bytes() == out.read_bytes()


def test_svg_is_xml_whatever_the_names_are():
    root = ET.fromstring(schematic.draw(Network.load(BRIDGE)).svg())
    assert "bridge & <co>" in "".join(root.itertext())
    assert not re.search(r"nan|inf", schematic.draw(Network.load(BRIDGE)).svg())


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["quarter-car-isd", "--draw", "car.jpg"], r"car\.jpg.*\.svg, \.png or \.pdf"),
        (["--draw", "car.svg"], "wants a network"),
        (["quarter-car-isd", "--draw", "no/such/car.svg"], "no folder"),
        (["nothing", "--draw", "car.svg"], "no model"),
    ],
)
def test_draw_refuses_bad_input(tmp_path, monkeypatch, args, says):
    monkeypatch.chdir(tmp_path)
    refused(says, CliRunner().invoke, cli.app, ["networks", *args], catch_exceptions=False)
    assert list(tmp_path.iterdir()) == []


def test_what_turns_has_its_own_units():
    parts = [spring("arm", "ground", 0.2, "gravity"), damper("arm", "ground", 2e-4, "bearing")]
    arm = builders.network("pendulum", parts, [], ["angle angle arm"], inertias={"arm": 0.0033})
    words = " ".join(w.text for w in schematic.draw(arm).words)
    for text in ("0.2 N·m/rad", "N·m·s/rad", "0.0033 kg m²"):
        assert text in words, text
    assert "N/m" not in words
