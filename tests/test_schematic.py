"""A network drawn: all parts are drawn in the right places, without overlaps."""

import re
import xml.etree.ElementTree as ET

import pytest
from builders import channel, damper, element, model, spring
from program import assert_one_line, printed, run

from isd_gym import Network
from isd_gym.physics.network import builtin_networks
from isd_gym.view.report import schematic

SVG = "http://www.w3.org/2000/svg"
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


def marks(drawing, part):
    """The elements of the SVG of a part."""
    root = ET.fromstring(drawing.svg())
    return [
        m for g in root.iter(f"{{{SVG}}}g") if g.get("data-part") == part for m in g
    ]


def words(drawing, part=None):
    """(text, x, y, size, anchor) of the words of a part, or of all."""
    found = (
        ET.fromstring(drawing.svg()).iter(f"{{{SVG}}}text")
        if part is None
        else marks(drawing, part)
    )
    told = [m for m in found if m.tag == f"{{{SVG}}}text"]
    return [
        (
            m.text,
            *(float(m.get(k)) for k in ("x", "y", "font-size")),
            m.get("text-anchor"),
        )
        for m in told
    ]


def ends(drawing, part):
    """Heights of the upper and lower end of an element's wires, or of a node."""
    ys = []
    for m in marks(drawing, part):
        ys += [float(m.get(k)) for k in ("y1", "y2") if m.get(k)]
        if m.tag == f"{{{SVG}}}rect":
            ys += [float(m.get("y")), float(m.get("y")) + float(m.get("height"))]
    return min(ys), max(ys)


@pytest.mark.parametrize("source", [*builtin_networks(), BRIDGE], ids=str)
def test_everything_is_drawn_between_its_nodes(source):
    network = Network.load(source)
    made = schematic.draw(network)
    home = {n: b.name for b in network.bodies for n in b.nodes[1:]}
    for part in (
        *(f"node:{n}" for n in network.nodes),
        *(f"el:{e.name}" for e in network.elements),
    ):
        assert marks(made, part), part
    for c in (*network.inputs, *network.outputs):
        assert c.elements or marks(made, f"ch:{c.name}"), c.name
    for e in network.elements:
        upper, lower = ends(made, f"el:{e.name}")
        bars = sorted(ends(made, f"node:{home.get(n, n)}") for n in e.where)
        assert (upper, lower) == pytest.approx(
            (bars[0][1] if bars[0][1] <= upper else bars[0][0], bars[1][0])
        )
        assert e.name.replace("_", " ") in " ".join(
            text for text, *_ in words(made, f"el:{e.name}")
        )


@pytest.mark.parametrize("name", builtin_networks())
def test_words_do_not_cover_one_another(name):
    def box(text, x, y, size, anchor):
        wide = 0.92 * schematic.LETTER * len(text) * size / schematic.SMALL
        left = x - {"start": 0, "middle": 0.5, "end": 1}[anchor] * wide
        return left, y - 0.75 * size, left + wide, y + 0.1 * size

    told = words(schematic.draw(Network.load(name)))
    boxes = [box(*w) for w in told]
    for i, a in enumerate(boxes):
        for j, b in enumerate(boxes[:i]):
            apart = a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]
            assert apart, (told[i][0], told[j][0])


def test_series_is_below_one_another_and_parallel_beside():
    made = schematic.draw(Network.load("quarter-car-isd"))
    upper, lower = ends(made, "el:inerter")
    assert ends(made, "el:oil")[1] <= upper < lower <= ends(made, "el:damper")[0]
    for other in ("leak", "seal", "end_stop", "motor"):
        assert ends(made, f"el:{other}") == (upper, lower)
    assert ends(made, "el:main_spring") == (
        ends(made, "el:oil")[0],
        ends(made, "el:damper")[1],
    )
    assert ends(made, "node:body") < ends(made, "node:wheel") < ends(made, "node:road")


def test_values_are_written_as_one_writes_them():
    told = {text for text, *_ in words(schematic.draw(Network.load("quarter-car-isd")))}
    values = {
        "709 kN/m",
        "1293 N·s/m",
        "24.65 mm",
        "1 MN/m",
        "ratio 4.056",
        "body  345 kg",
    }
    assert values | {"← current [A]", "→ tyre force [N]"} <= told


def test_what_was_found_stands_out():
    made = schematic.draw(Network.load("quarter-car-isd"), found=["seal"])
    assert "#d55e00" in {m.get("stroke") for m in marks(made, "el:seal")}
    assert "#d55e00" not in {m.get("stroke") for m in marks(made, "el:leak")}
    # a spring from the body to the ground turns nothing upside down
    base = Network.load("quarter-car-isd")
    anchor = spring("body", "ground", 1e4, "strap")
    made = schematic.draw(base.with_element(anchor), found=["strap"])
    assert ends(made, "node:body") < ends(made, "node:wheel") < ends(made, "node:road")
    assert ends(made, "node:body")[1] <= ends(made, "el:strap")[0]


def test_draw_writes_an_svg(tmp_path):
    out = tmp_path / "car.svg"
    printed("networks quarter-car-isd --draw", out)
    drawn = schematic.draw(Network.load("quarter-car-isd")).svg()
    assert out.read_text() == drawn + "\n"


def test_svg_is_xml_whatever_the_names_are():
    root = ET.fromstring(schematic.draw(Network.load(BRIDGE)).svg())
    assert "bridge & <co>" in "".join(root.itertext())
    assert not re.search(r"nan|inf", schematic.draw(Network.load(BRIDGE)).svg())


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["quarter-car-isd", "--draw", "car.jpg"], ".svg"),
        (["--draw", "car.svg"], "wants a network"),
        (["quarter-car-isd", "--draw", "no/such/car.svg"], "no folder"),
        (["nothing", "--draw", "car.svg"], "no model"),
    ],
)
def test_draw_refuses_bad_input(tmp_path, args, says):
    assert_one_line(run("networks", *args, cwd=tmp_path), says)
    assert list(tmp_path.iterdir()) == []
