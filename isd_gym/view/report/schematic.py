"""Schematic of a network: a row for each node, and a wire with a symbol for each element between two rows.

Elements in series share a column, elements in parallel stand side by side: each element takes the first column that is free
between its two rows. The drawing is SVG, in the colours of the reader's page where it is part of a page.
"""

from __future__ import annotations

import math
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from ..._common.errors import InputError
from ..._common.files import write_text
from ..._common.units import practical
from ...physics import elements as el
from ...physics.network import GROUND, Channel, Lever, Network
from .plots import BLUE, INK, MUTED, VERMILLION, channel_text, number, themed, unit_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    #: text, colour, and whether it is bold
    Words = list[tuple[str, str, bool]]

HALF = 23.0  # half the height of a symbol [px]
TALL = 84.0  # least distance of two rows [px]
BOX = 34.0  # height of a mass [px]
LINE = 13.0  # distance of two lines of text [px]
LETTER = 6.1  # mean width of a letter of the small print [px]
SMALL = 11.0  # size of the small print [px]
SYMBOL = 44.0  # width of a symbol with its margins [px]
MARGIN = 10.0  # margin of the sheet [px]
PAPER = "#ffffff"
MOVES = ("displacement", "velocity", "acceleration")

# paths of symbols, about the middle of an element
_SPRING = "M0-23v5l8 3-16 6 16 6-16 6 16 6-16 6 8 3v5"
_POT = "M-9-6v18h18v-18M0 12v11M0-23v25M-7 2h14"
_ARROW = "M-13 13l26-26m-6 1l6-1-1 6"
_PLATES = "M0-23v9h-3v24M0 23v-9h3v-24M-3-8l-5 4M-3-4l-5 4M-3 0l-5 4M-3 4l-5 4"
SYMBOLS = {
    "linear_stiffness": _SPRING,
    "series_compliance": _SPRING,
    "cubic_stiffness": _SPRING + _ARROW,
    "linear_damping": _POT,
    "quadratic_damping": _POT + _ARROW,
    "asymmetric_damping": _POT + _ARROW,
    "inertance": "M0-23v26M-9-12v24h18v-24M0 12v11M0-12l3 2M0-8l3 2M0-4l3 2M0 0l3 2M3-3a4 4 0 1 0 8 0a4 4 0 1 0-8 0",
    "coulomb_friction": _PLATES,
    "stribeck_friction": _PLATES,
    "bump_stop": "M0-23v14M-9-9h18M-7 9h14l-4-12h-6zM0 9v14",
    "backlash": "M0-23v19M-6-4h12M-9-10h5M4-10h5M-9-10v20h18v-20M0 10v13",
    "lever": "M0-23v11h-11v12h22v12h-11v11M0 0l-5 8h10z",
    "motor": "M0-23v11M0 12v11M-12 0a12 12 0 1 0 24 0a12 12 0 1 0-24 0",
}
_BOX = "M0-23v11M0 12v11M-11-12h22v24h-22z"
#: letters in symbols; other elements without a symbol have an f
LETTERS = {
    "motor": "M", "gas_spring": "p", "hysteresis": "z", "cogging_force": "~", "terminal_inertia": "m",
    "tabulated_force": "F",
}  # fmt: skip


class Drawing:
    """A drawing as SVG marks of the parts of a network, and the box that the marks fill."""

    def __init__(self, title: str) -> None:
        """Start an empty drawing."""
        self.title = title
        self.parts: dict[str, list[str]] = {}
        self.left, self.right, self.foot = 0.0, 0.0, 0.0

    def _add(self, part: str, mark: str, xs: Sequence[float], foot: float) -> None:
        self.parts.setdefault(part, []).append(mark)
        self.left, self.right = min(self.left, *xs), max(self.right, *xs)
        self.foot = max(self.foot, foot)

    def path(
        self, part: str, x: float, y: float, d: str, colour: str, width: float = 1.4
    ) -> None:
        """Draw a path about a point."""
        mark = f'<path transform="translate({x:.1f} {y:.1f})" d="{d}" fill="none" stroke="{colour}" stroke-width="{width}"/>'
        self._add(part, mark, (x - HALF, x + HALF), y)

    def line(
        self, part: str, start: tuple[float, float], end: tuple[float, float], colour: str = INK,
        width: float = 1.4, dash: str = "none",
    ) -> None:  # fmt: skip
        """Draw a straight line."""
        (x0, y0), (x1, y1) = start, end
        place = f'x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}"'
        mark = f'<line {place} stroke="{colour}" stroke-width="{width}" stroke-dasharray="{dash}"/>'
        self._add(part, mark, (x0, x1), max(y0, y1))

    def box(self, part: str, left: float, right: float, top: float) -> None:
        """Draw the box of a mass."""
        place = (
            f'x="{left:.1f}" y="{top:.1f}" width="{right - left:.1f}" height="{BOX}"'
        )
        mark = f'<rect {place} fill="{PAPER}" stroke="{INK}" stroke-width="1.6"/>'
        self._add(part, mark, (left, right), top + BOX)

    def word(
        self, part: str, x: float, y: float, text: str, colour: str = INK, anchor: str = "start",
        weight: str = "normal", size: float = SMALL,
    ) -> float:  # fmt: skip
        """Write a text, and return its right end."""
        wide = LETTER * len(text) * size / SMALL
        begin = x - wide * {"start": 0.0, "middle": 0.5, "end": 1.0}[anchor]
        look = f'font-size="{size}" font-weight="{weight}" text-anchor="{anchor}" fill="{colour}"'
        halo = f'paint-order="stroke" stroke="{PAPER}" stroke-width="3"'
        mark = f'<text x="{x:.1f}" y="{y:.1f}" {look} {halo}>{escape(text)}</text>'
        self._add(part, mark, (begin, begin + wide), y)
        return begin + wide

    def arrow(self, part: str, x: float, low: float, high: float, ends: str) -> None:
        """Draw a vertical arrow; `ends` are 'up' or 'both'."""
        heads = f"M0 0V{high - low:.1f}m-3 5l3-5 3 5" + (
            "M-3-5l3 5 3-5" if ends == "both" else ""
        )
        self.path(part, x, low, heads, BLUE, 1.2)

    def svg(self, *, inline: bool = False) -> str:
        """Return the drawing as SVG."""
        wide = self.right - self.left + 2 * MARGIN
        tall = self.foot + MARGIN
        marks = (
            f'<g data-part="{escape(name)}">{"".join(m)}</g>'
            for name, m in self.parts.items()
        )
        size = f'width="{wide:.0f}" height="{tall:.0f}" viewBox="{self.left - MARGIN:.0f} 0 {wide:.0f} {tall:.0f}"'
        # in a page the drawing shrinks to the width of the text, as long as its words remain readable
        style = (
            f'style="min-width:{0.8 * wide:.0f}px"'
            if inline
            else f'style="background:{PAPER}"'
        )
        look = 'class="schematic" role="img" font-family="system-ui, sans-serif" stroke-linejoin="round"'
        text = f'<svg xmlns="http://www.w3.org/2000/svg" {size} {style} {look}><title>{escape(self.title)}</title>{"".join(marks)}</svg>'
        return themed(text) if inline else text

    def save(self, path: str | Path) -> None:
        """Write the drawing as an SVG file."""
        check_suffix(Path(path))
        write_text(Path(path), self.svg() + "\n")


def check_suffix(path: Path) -> None:
    """Check that a file name has the suffix of a drawing."""
    if path.suffix.lower() != ".svg":
        raise InputError(f"cannot draw to '{path}': end the name in .svg")


# --------------------------------------------------------------------------------------------------- words


def _values_text(e: el.Element | Lever, network: Network) -> list[str]:
    """Return the parameters of an element or lever with their units, one a line."""
    if not isinstance(e, el.Element):
        unit = "" if e.unit in ("m/m", "rad/rad") else f" {e.unit}"
        return [f"ratio {number(e.ratio, _digits(e.ratio))}{unit}"]
    if isinstance(e, el.TabulatedForce) and e.scale == 1.0:
        return [
            f"table over {' and '.join(k for k in ('elongation', 'rate') if getattr(e, k))}"
        ]
    out = []
    for f in el.parameter_fields(type(e)):
        value = getattr(e, f.name)
        if isinstance(value, int | float):
            # rotational elements have other units than the class states
            unit = unit_text(network.unit_of(f"{e.name}.{f.name}"))
            factor, unit = practical(float(value), unit)
            scaled = number(factor * value, _digits(value))
            out.append(
                f"{scaled} {unit}" if unit else f"{channel_text(f.name)} {scaled}"
            )
    return out[:3]


def _briefly(e: el.Element, network: Network) -> str:
    """Return an element without terminals and its parameters in words, such as ``sensor gain 1.13``."""
    name = el.spoken(e.type)
    values = (v.removeprefix(f"{name.split()[-1]} ") for v in _values_text(e, network))
    return " ".join([name, *values])


def _digits(value: float) -> int:
    """Return the number of significant digits of a value, from one to four."""
    for n in (1, 2, 3):
        if value == 0 or math.isclose(float(f"{value:.{n - 1}e}"), value, rel_tol=1e-9):
            return n
    return 4


def _channel(c: Channel) -> str:
    unit = unit_text(c.unit)
    text = f"{channel_text(c.name)} [{unit}]" if unit else channel_text(c.name)
    return text if getattr(c, "measured", True) else f"{text}, not measured"


class _Labels:
    """Texts of a network; `found` are the names of highlighted elements."""

    def __init__(self, network: Network, found: Iterable[str]) -> None:
        self.network, self.found = network, set(found)

    def colour(self, name: str, other: str = INK) -> str:
        return VERMILLION if name in self.found else other

    def output(self, c: Channel) -> tuple[str, str]:
        """Return an output with the effects at its sensor, and its colour."""
        sensors = [
            e
            for e in self.network.elements
            if e.place == "channel" and e.where[0] == c.name
        ]
        text = ", ".join([_channel(c), *(_briefly(e, self.network) for e in sensors)])
        return text, VERMILLION if self.found & {e.name for e in sensors} else BLUE

    def element(self, e: el.Element | Lever) -> Words:
        """Return the lines beside an element: name, values, effects at the element and its channels."""
        net = self.network
        lines = [(channel_text(e.name), self.colour(e.name), True)]
        lines += [
            (text, self.colour(e.name, MUTED), False) for text in _values_text(e, net)
        ]
        for other in net.elements:
            if other.place == "element" and other.where[0] == e.name:
                lines.append(
                    (_briefly(other, net), self.colour(other.name, MUTED), False)
                )
        lines += [
            (f"← {_channel(c)}", BLUE, False)
            for c in net.inputs
            if e.name in c.elements
        ]
        for c in net.outputs:
            if e.name in c.elements:
                text, colour = self.output(c)
                lines.append((f"→ {text}", colour, False))
        return lines

    def mass(self, node: str, mass: float) -> str:
        unit = "kg m²" if node in self.network.turning else "kg"
        texts = [f"{channel_text(node)}  {number(mass, _digits(mass))} {unit}"]
        for body in self.network.bodies:
            if body.name == node:
                texts += [
                    f"{axis} {number(i, _digits(i))} kg m²"
                    for axis, i in body.inertias.items()
                ]
        return ", ".join(texts)


# -------------------------------------------------------------------------------------------------- the layout


class _Layout:
    """Rows of nodes, and columns of elements. Points and angles of a body belong to the row of their body."""

    def __init__(self, network: Network, labels: _Labels) -> None:
        self.network, self.labels = network, labels
        self.masses = {**network.masses, **{b.name: b.mass for b in network.bodies}}
        self.home = {n: b.name for b in network.bodies for n in b.nodes[1:]}
        between: list[el.Element | Lever] = [
            e for e in network.elements if e.place == "between"
        ]
        self.elements = {e.name: e for e in (*between, *network.levers)}
        self.ends = {
            n: tuple(self.home.get(k, k) for k in e.between)
            for n, e in self.elements.items()
        }
        self.top, self.bottoms = self._poles()
        near = self._neighbours(self.elements)
        self.groups = _components(near, {self.top, *self.bottoms})
        self.row = self._rows(near)
        self.x: dict[str, float] = {}  # position of each element

    def _neighbours(self, names: Iterable[str]) -> dict[str, set[str]]:
        near: dict[str, set[str]] = {}
        for name in names:
            first, second = self.ends[name]
            near.setdefault(first, set()).add(second)
            near.setdefault(second, set()).add(first)
        return near

    def _poles(self) -> tuple[str, list[str]]:
        """Return the top node, and the bottom nodes: the ground or the moved node; for a car with bodies, all moved nodes.

        Found elements are ignored, so that the arrangement of the model stays the same.
        """
        known = [n for n in self.ends if n not in self.labels.found] or list(self.ends)
        near = self._neighbours(known)
        moved = [
            str(c.at)
            for c in self.network.inputs
            if c.at in near and c.quantity in MOVES
        ]
        bottom = GROUND if GROUND in near else moved[0] if moved else min(near)
        bottoms = (
            list(dict.fromkeys([bottom, *moved])) if self.network.bodies else [bottom]
        )
        far = dict.fromkeys(bottoms, 0)
        ring = set(bottoms)
        for distance in range(1, len(near)):
            ring = {m for n in ring for m in near[n]} - set(far)
            far |= dict.fromkeys(sorted(ring), distance)
        # among the most distant nodes: a mass, such as a car's body
        inner = [n for n in far if n not in bottoms]
        top = max(
            inner, key=lambda n: (n in self.masses, far[n], self.masses.get(n, 0.0))
        )
        return top, bottoms

    def _rows(self, near: dict[str, set[str]]) -> dict[str, int]:
        """Return the row of each node: in each group by the voltages of a network of resistors."""
        level = (
            dict.fromkeys(near, 0.5)
            | dict.fromkeys(self.bottoms, 1.0)
            | {self.top: 0.0}
        )
        inner = [n for group in self.groups for n in group]
        for _ in range(200):
            for n in inner:
                level[n] = sum(level[m] for m in near[n]) / len(near[n])
        row = {self.top: 0}
        for group in self.groups:
            order = sorted(group, key=lambda n: (round(level[n], 6), n))
            row |= {n: k for k, n in enumerate(order, start=1)}
        return row | dict.fromkeys(self.bottoms, max(row.values()) + 1)

    def span(self, name: str) -> tuple[int, int]:
        """Return the upper and the lower row of an element."""
        first, second = sorted(self.row[n] for n in self.ends[name])
        return first, second

    def height(self, row: int) -> float:
        """Return the distance from a row to the next row."""
        lines = [
            len(self.labels.element(e))
            for n, e in self.elements.items()
            if self.span(n) == (row, row + 1)
        ]
        return max([TALL, *(30.0 + LINE * count for count in lines)])

    def members(self, group: set[str]) -> list[str]:
        """Return the elements at the nodes of a group, long elements first; without nodes, those from the top to the bottom."""
        poles = {self.top, *self.bottoms}
        names = [
            n
            for n, ends in self.ends.items()
            if set(ends) & group or (not group and set(ends) <= poles)
        ]
        return sorted(names, key=lambda n: self.span(n)[0] - self.span(n)[1])

    def place(self, names: Sequence[str], x: float) -> float:
        """Place elements in columns from x on, and return the right end of the columns."""
        columns: list[list[str]] = []
        for name in names:
            upper, lower = self.span(name)
            free = (
                column
                for column in columns
                if all(
                    upper >= self.span(n)[1] or lower <= self.span(n)[0] for n in column
                )
            )
            column = next(free, [])
            if not column:
                columns.append(column)
            column.append(name)
        named: set[str] = set(self.masses)
        for column in columns:
            nodes = {end for name in column for end in self.ends[name]} - named
            named |= nodes
            # names stand left of their bars
            x += max([LETTER * len(n) for n in nodes], default=0.0)
            self.x |= dict.fromkeys(column, x + SYMBOL / 2)
            texts = [
                text
                for name in column
                for text, _, _ in self.labels.element(self.elements[name])
            ]
            x += SYMBOL + LETTER * max(map(len, texts))
        return x

    def at(self, node: str) -> list[float]:
        """Return the positions of the elements at a node; of all elements at a body for a free point or an angle."""
        own = [
            self.x[n]
            for n, e in self.elements.items()
            if node in e.between and n in self.x
        ]
        return own or [
            self.x[n]
            for n, ends in self.ends.items()
            if self.home.get(node, node) in ends
        ]


def _components(near: dict[str, set[str]], poles: set[str]) -> list[set[str]]:
    """Return the groups of nodes that hang together without the poles."""
    groups: list[set[str]] = []
    for start in near:
        if start in poles or any(start in group for group in groups):
            continue
        group, fresh = {start}, {start}
        while fresh:
            fresh = {m for n in fresh for m in near[n]} - group - poles
            group |= fresh
        groups.append(group)
    return groups


class _Sheet:
    """The drawing of a layout, group by group from the left."""

    def __init__(self, network: Network, found: Iterable[str]) -> None:
        self.network = network
        self.labels = _Labels(network, found)
        self.layout = layout = _Layout(network, self.labels)
        title = (
            f"{network.name}: {network.description}"
            if network.description
            else network.name
        )
        self.out = Drawing(title)
        self.out.word("", 0.0, 20.0, network.name, weight="bold", size=14.0)
        self.y: dict[int, float] = {}
        y = 56.0
        for row in range(max(layout.row.values()) + 1):
            self.y[row] = y
            is_thick = any(
                layout.row[n] == row and n in layout.masses for n in layout.row
            )
            y += layout.height(row) + BOX * is_thick
        self.end: dict[str, float] = {}  # right end of each node and its texts
        self.drawn: set[str] = set()
        self.x = 0.0

    def draw(self) -> Drawing:
        layout = self.layout
        for group in (*layout.groups, set[str]()):
            names = layout.members(group)
            self.x = layout.place(names, self.x)
            for name in names:
                self.draw_element(name)
            self.draw_nodes(group)
        self.draw_nodes({layout.top, *layout.bottoms})
        return self.out

    def edges(self, node: str) -> tuple[float, float]:
        """Return the heights of the upper and the lower edge of a node."""
        node = self.layout.home.get(node, node)
        y = self.y[self.layout.row[node]]
        return y, y + BOX * (node in self.layout.masses)

    def draw_element(self, name: str) -> None:
        layout = self.layout
        out = self.out
        e = self.layout.elements[name]
        upper, lower = sorted(layout.ends[name], key=layout.row.__getitem__)
        top = self.edges(upper)[1]
        bottom = self.edges(lower)[0]
        bottom = max(bottom, top + TALL)  # both ends may have one row
        x = layout.x[name]
        y = 0.5 * (top + bottom)
        part = f"el:{name}"
        colour = self.labels.colour(name)
        out.line(part, (x, top), (x, y - HALF), colour)
        out.line(part, (x, y + HALF), (x, bottom), colour)
        kind = e.type if isinstance(e, el.Element) else "lever"
        out.path(part, x, y, SYMBOLS.get(kind, _BOX), colour)
        if kind not in SYMBOLS or kind in LETTERS:
            out.word(
                part, x, y + 4, LETTERS.get(kind, "f"), colour, "middle", "bold", 12.0
            )
        lines = self.labels.element(e)
        at = y - 0.5 * LINE * (len(lines) - 1) + 4
        for text, ink, is_bold in lines:
            out.word(
                part, x + 18, at, text, ink, weight="bold" if is_bold else "normal"
            )
            at += LINE

    def draw_nodes(self, nodes: set[str]) -> None:
        """Draw nodes with their points, then the channels of these nodes."""
        for node in sorted(nodes):
            self.draw_node(node)
        self.drawn |= nodes | {
            n for n, home in self.layout.home.items() if home in nodes
        }
        for c in (*self.network.inputs, *self.network.outputs):
            if c.at is not None and self.layout.home.get(c.at, c.at) in nodes:
                self.draw_signal(c)
        for c in self.network.outputs:
            ends = {self.layout.home.get(n, n) for n in c.between or ()}
            inner = ends - {self.layout.top, *self.layout.bottoms}
            if ends and (inner or ends) & nodes and (inner or ends) <= self.drawn:
                self.draw_distance(c)

    def draw_node(self, node: str) -> None:
        layout = self.layout
        out = self.out
        part = f"node:{node}"
        xs, (top, bottom) = layout.at(node), self.edges(node)
        left, right = min(xs) - 12, max(xs) + 12
        if node == layout.top and node in layout.masses:
            right = max(right, self.x)
        if node in layout.masses:
            text = self.labels.mass(node, layout.masses[node])
            wide = max(right - left + 20, 30 + 1.2 * LETTER * len(text))
            left, right = 0.5 * (left + right - wide), 0.5 * (left + right + wide)
            out.box(part, left, right, top)
            out.word(
                part,
                0.5 * (left + right),
                0.5 * (top + bottom) + 4,
                text,
                INK,
                "middle",
                "bold",
                12.5,
            )
        else:
            is_moved = any(
                c.at == node and c.quantity in MOVES for c in self.network.inputs
            )
            is_fixed = is_moved or node == GROUND
            out.line(part, (left, top), (right, top), width=2.6 if is_fixed else 1.8)
            out.word(part, left - 5, top + 4, channel_text(node), MUTED, "end")
        if node == GROUND:
            for k in range(int((right - left) // 9)):
                out.line(
                    part, (left + 9 * k + 9, top), (left + 9 * k, top + 9), MUTED, 1.0
                )
        self.end[node] = right
        self.x = max(self.x, right)
        points = [n for n, home in layout.home.items() if home == node]
        for k, point in enumerate(points, start=1):
            own = [
                layout.x[n] for n, e in layout.elements.items() if point in e.between
            ]
            x = (
                sum(own) / len(own)
                if own
                else left + (right - left) * k / (len(points) + 1)
            )
            text = channel_text(point.removeprefix(f"{node}."))
            out.word(
                f"node:{point}", x, top - 5 - LINE * (k % 2), text, MUTED, "middle"
            )
            self.end[point] = right

    def draw_signal(self, c: Channel) -> None:
        """Draw an input or an output of one node; of moved nodes, the arrow has two heads."""
        node = self.layout.home.get(str(c.at), str(c.at))
        part = f"ch:{c.name}"
        text = f"{_channel(c)} in"
        colour = BLUE
        if c in self.network.outputs:
            text, colour = self.labels.output(c)
        is_moved = c in self.network.inputs and c.quantity in MOVES
        count = sum(
            part in self.out.parts
            for part in (f"ch:{d.name}" for d in self.beside(node))
        )
        first = self.edges(node)[0] + (17.0 if node in self.layout.masses else 4.0)
        x, y = self.end[node] + 14, first + 17.0 * count
        self.out.arrow(part, x, y + 3, y - 12, "both" if is_moved else "up")
        self.x = max(self.x, self.out.word(part, x + 9, y, text, colour))

    def beside(self, node: str) -> list[Channel]:
        """Return the channels that are written beside a node."""
        channels = (*self.network.inputs, *self.network.outputs)
        return [
            c
            for c in channels
            if c.at is not None and self.layout.home.get(c.at, c.at) == node
        ]

    def draw_distance(self, c: Channel) -> None:
        """Draw an output between two nodes: an arrow at the right of all that is drawn."""
        assert c.between is not None
        part, x = f"ch:{c.name}", self.x + 12
        # from the lower edge of the top node, to the upper edge of others
        heights = [
            self.edges(n)[self.layout.home.get(n, n) == self.layout.top]
            for n in c.between
        ]
        for node, y in zip(c.between, heights, strict=True):
            start = self.end.get(node, x)
            self.out.line(part, (start + 4, y), (x + 6, y), MUTED, 0.6, "4 3")
        self.out.arrow(part, x, max(heights), min(heights), "both")
        text, colour = self.labels.output(c)
        self.x = self.out.word(part, x + 7, 0.5 * sum(heights), text, colour)


def draw(network: Network, *, found: Iterable[str] = ()) -> Drawing:
    """Return the drawing of a network."""
    if not any(e.place == "between" for e in network.elements):
        raise InputError("a network without elements between nodes cannot be drawn")
    return _Sheet(network, found).draw()


__all__ = ["Drawing", "check_suffix", "draw"]
