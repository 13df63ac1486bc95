"""Schematic of a network: nodes as bars, masses as boxes, elements between nodes with their values.

Reduction of the graph finds series and parallel groups: series groups are drawn one below another, parallel
groups side by side. Other structures (a bridge) are drawn at the side, with wires that may cross. A drawing
is a list of strokes and words, written as SVG (in the colours of the reader's page), PNG or PDF.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..._common.errors import InputError
from ..._common.units import practical
from ...physics import elements as el
from .plots import channel_text, number, unit_text

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from ...physics.network import Body, Channel, Lever, Network

GROUND = "ground"
SYMBOL = 46.0  # height of an element's symbol [px]
TALL = 84.0  # height of an element with its wires [px]
BOX = 34.0  # height of a mass [px]
LETTER = 6.1  # mean width of a letter of the small print [px]
SMALL = 11.0
SUFFIXES = (".svg", ".png", ".pdf")
#: colours outside of a page: ink, muted, found, signal
PLAIN = {"ink": "#262b30", "muted": "#606870", "found": "#D55E00", "signal": "#0072B2"}


# ------------------------------------------------------------------------------------------------- the drawing


@dataclass
class _Stroke:
    """A polyline through points (x, y) [px], of a part of the network; colours have names."""

    points: list[tuple[float, float]]
    part: str = ""
    colour: str = "ink"
    width: float = 1.4
    closed: bool = False
    filled: bool = False
    dashed: bool = False


@dataclass
class _Word:
    """A text at a position [px], of a part of the network; anchored at its 'start', 'middle' or 'end'."""

    x: float
    y: float
    text: str
    part: str = ""
    colour: str = "ink"
    anchor: str = "start"
    bold: bool = False
    size: float = SMALL


@dataclass
class Drawing:
    """Strokes and words on a sheet."""

    width: float = 0.0  # width of the sheet [px]
    height: float = 0.0  # height of the sheet [px]
    strokes: list[_Stroke] = field(default_factory=list)  # polylines
    words: list[_Word] = field(default_factory=list)  # texts
    title: str = ""  # title

    def svg(self, *, inline: bool = False) -> str:
        """Return the drawing as SVG."""

        def colour(name: str) -> str:
            return (
                {"ink": "currentColor"}.get(name, f"var(--{name}, {PLAIN[name]})") if inline else PLAIN[name]
            )

        paper = "var(--paper, #fff)" if inline else "#fff"
        parts: dict[str, list[str]] = {}
        for s in self.strokes:
            path = " ".join(f"{x:.1f},{y:.1f}" for x, y in s.points)
            paint = colour(s.colour)
            fill = paint if s.filled else (paper if s.closed else "none")
            dash = ' stroke-dasharray="4 3"' if s.dashed else ""
            tag = "polygon" if s.closed else "polyline"
            parts.setdefault(s.part, []).append(
                f'<{tag} points="{path}" fill="{fill}" stroke="{paint}" stroke-width="{s.width}"{dash}/>'
            )
        for w in self.words:
            weight = ' font-weight="600"' if w.bold else ""
            parts.setdefault(w.part, []).append(
                f'<text x="{w.x:.1f}" y="{w.y:.1f}" font-size="{w.size}" text-anchor="{w.anchor}" '
                f'fill="{colour(w.colour)}"{weight} paint-order="stroke" stroke="{paper}" stroke-width="3">{escape(w.text)}</text>'
            )
        body = "".join(f'<g data-part="{escape(name)}">{"".join(marks)}</g>' for name, marks in parts.items())
        size = f'width="{self.width:.0f}" height="{self.height:.0f}" viewBox="0 0 {self.width:.0f} {self.height:.0f}"'
        # in a page the drawing shrinks to the width of the text, as long as its words remain readable
        style = f' style="min-width:{0.8 * self.width:.0f}px"' if inline else ""
        head = f'<svg xmlns="http://www.w3.org/2000/svg" {size}{style} class="schematic" role="img" font-family="system-ui, sans-serif" stroke-linejoin="round">'
        back = "" if inline else f'<rect width="{self.width:.0f}" height="{self.height:.0f}" fill="#fff"/>'
        return f"{head}<title>{escape(self.title)}</title>{back}{body}</svg>"

    def save(self, path: str | Path) -> Path:
        """Write the drawing in the format of the suffix."""
        from ..._common.files import whole, write_text

        path = Path(path)
        check_suffix(path)
        if path.suffix.lower() == ".svg":
            write_text(path, self.svg() + "\n")
            return path
        from matplotlib.patches import Polygon

        from .plots import figure, halo, style

        with style(), whole(path) as temporary:
            fig = figure(self.width / 96, self.height / 96)
            fig.set_layout_engine("none")
            ax = fig.add_axes((0, 0, 1, 1))
            ax.set_axis_off()
            ax.set_xlim(0, self.width)
            ax.set_ylim(self.height, 0)
            for s in self.strokes:
                if s.closed:
                    face = PLAIN[s.colour] if s.filled else "white"
                    ax.add_patch(
                        Polygon(
                            s.points, facecolor=face, edgecolor=PLAIN[s.colour], lw=0.75 * s.width, zorder=2
                        )
                    )
                else:
                    xs, ys = zip(*s.points, strict=True)
                    ax.plot(xs, ys, color=PLAIN[s.colour], lw=0.75 * s.width, ls="--" if s.dashed else "-")
            for w in self.words:
                ha = {"start": "left", "middle": "center", "end": "right"}[w.anchor]
                ax.text(
                    w.x, w.y, w.text, fontsize=0.75 * w.size * 0.94, color=PLAIN[w.colour], ha=ha, va="baseline",
                    fontweight="bold" if w.bold else "normal", zorder=4, parse_math=False, path_effects=halo(),
                )  # fmt: skip
            bare = {"CreationDate": None} if path.suffix.lower() == ".pdf" else {"Software": None}
            fig.savefig(temporary, format=path.suffix[1:].lower(), dpi=192, metadata=bare)
        return path


def check_suffix(path: Path) -> None:
    """Check that a file name has the suffix of a drawing."""
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"cannot draw to '{path}': end the name in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}"
        )


# ------------------------------------------------------------------------------------- series, parallel, the rest


@dataclass(frozen=True)
class _Piece:
    """An element, a series group from the top down (with the nodes between its parts), or a parallel group."""

    top: str
    bottom: str
    element: el.Element | Lever | None = None
    parts: tuple[_Piece, ...] = ()
    inner: tuple[str, ...] = ()

    @property
    def series(self) -> bool:
        """Whether the piece is a series group."""
        return bool(self.inner)

    def flipped(self) -> _Piece:
        """Return the piece upside down."""
        parts = tuple(p.flipped() for p in self.parts)
        if self.series:
            parts = parts[::-1]
        return _Piece(self.bottom, self.top, self.element, parts, self.inner[::-1])

    def reads(self, top: str) -> _Piece:
        """Return the piece with a given upper node."""
        return self if self.top == top else self.flipped()


def _reduced(pieces: Sequence[_Piece], keep: Iterable[str]) -> list[_Piece]:
    """Merge pieces in parallel and in series as far as possible; the nodes to `keep` stay."""
    pieces, keep = list(pieces), set(keep)
    while True:
        by_pair: dict[frozenset[str], list[_Piece]] = {}
        for p in pieces:
            by_pair.setdefault(frozenset((p.top, p.bottom)), []).append(p)
        merged = []
        for group in by_pair.values():
            if len(group) == 1:
                merged.append(group[0])
                continue
            top, bottom = group[0].top, group[0].bottom
            flat: list[_Piece] = []
            for p in (g.reads(top) for g in group):
                flat += p.parts if p.parts and not p.series else (p,)
            merged.append(_Piece(top, bottom, parts=tuple(flat)))
        pieces = merged
        ends: dict[str, list[_Piece]] = {}
        for p in pieces:
            for n in (p.top, p.bottom):
                ends.setdefault(n, []).append(p)
        node = next((n for n, at in ends.items() if len(at) == 2 and n not in keep), None)
        if node is None:
            return pieces
        first, second = ends[node]
        upper = first if first.bottom == node else first.flipped()
        lower = second.reads(node)
        parts = (upper.parts if upper.series else (upper,)) + (lower.parts if lower.series else (lower,))
        joined = _Piece(upper.top, lower.bottom, parts=parts, inner=(*upper.inner, node, *lower.inner))
        at = min(pieces.index(first), pieces.index(second))
        pieces = [p for p in pieces if p is not first and p is not second]
        pieces.insert(at, joined)


# --------------------------------------------------------------------------------------------------- words


def _values_text(e: el.Element | Lever, network: Network) -> list[str]:
    """Return the parameters of an element or lever with their units, one a line."""
    if not isinstance(e, el.Element):
        return [
            f"ratio {number(e.ratio, _digits(e.ratio))} {e.unit}".removesuffix(" m/m").removesuffix(
                " rad/rad"
            )
        ]
    if isinstance(e, el.TabulatedForce) and e.scale == 1.0:
        return [f"table over {' and '.join(k for k in ('elongation', 'rate') if getattr(e, k))}"]
    out = []
    for f in el.parameter_fields(type(e)):
        value = getattr(e, f.name)
        if not isinstance(value, int | float):
            continue
        # rotational elements have other units than the class states
        unit = unit_text(network.unit_of(f"{e.name}.{f.name}"))
        factor, unit = practical(float(value), unit)
        scaled = number(factor * value, _digits(value))
        out.append(f"{scaled} {unit}" if unit else f"{channel_text(f.name)} {scaled}")
    return out[:3]


def _briefly(e: el.Element, network: Network) -> str:
    """Return an element without terminals and its parameters in words, such as ``sensor gain 1.13``."""
    name = el.spoken(e.type)
    values = (v.removeprefix(f"{name.split()[-1]} ") for v in _values_text(e, network))
    return " ".join([name, *values])


def _digits(value: float) -> int:
    """Return the number of significant digits of a value, from two to four."""
    for n in (1, 2, 3):
        if value == 0 or math.isclose(float(f"{value:.{n - 1}e}"), value, rel_tol=1e-9):
            return max(n, 1)
    return 4


def _channel(c: Channel) -> str:
    unit = unit_text(c.unit)
    more = "" if getattr(c, "measured", True) else ", not measured"
    return f"{channel_text(c.name)} [{unit}]{more}" if unit else channel_text(c.name) + more


# -------------------------------------------------------------------------------------------------- the layout


class _Sheet:
    def __init__(self, network: Network, found: Iterable[str]) -> None:
        self.net = network
        self.found = set(found)
        self.out = Drawing(
            title=f"{network.name}: {network.description}" if network.description else network.name
        )
        self.y: dict[str, tuple[float, float]] = {}  # node -> upper and lower edge
        self.x: dict[str, list[float]] = {}  # node -> positions of attached elements
        self.beside: dict[str, list[str]] = {}  # element -> further texts at the element
        self.carried = {**network.masses, **{b.name: b.mass for b in network.bodies}}
        #: points and angles are drawn at the box of their body
        self.home = {n: b.name for b in network.bodies for n in b.nodes[1:]}
        self.points = {p.name: (p.x, p.y) for b in network.bodies for p in b.points}
        self.attached: dict[str, list[float]] = {}  # point -> positions of attached elements
        self.columns: dict[str, float] = {}  # measured distance -> position of its arrow
        self.right = 0.0  # right end of the elements
        # element -> channels of the element, and their colours
        self.signal: dict[str, list[tuple[str, str]]] = {}
        for e in network.elements:
            if e.place == "element":
                self.beside.setdefault(e.where[0], []).append(_briefly(e, network))
        for c in network.inputs:
            for name in c.elements:
                self.signal.setdefault(name, []).append((f"← {_channel(c)}", "signal"))
        for c in network.outputs:
            text, ink = self.output(c)
            for name in c.elements:
                self.signal.setdefault(name, []).append((f"→ {text}", ink))

    def output(self, c: Channel) -> tuple[str, str]:
        """Return an output with the effects at its sensor, and its colour."""
        sensors = [e for e in self.net.elements if e.place == "channel" and e.where[0] == c.name]
        found = any(e.name in self.found for e in sensors)
        text = ", ".join([_channel(c), *(_briefly(e, self.net) for e in sensors)])
        return text, "found" if found else "signal"

    def stroke(self, *what: Any, **look: Any) -> None:
        """Draw a `_Stroke`."""
        self.out.strokes.append(_Stroke(*what, **look))

    def word(self, *what: Any, **look: Any) -> None:
        """Write a `_Word`."""
        self.out.words.append(_Word(*what, **look))

    # sizes

    def words(self, e: el.Element | Lever) -> list[tuple[str, str, bool]]:
        colour = "found" if e.name in self.found else "ink"
        lines = [(channel_text(e.name), colour, True)]
        lines += [(t, "found" if colour == "found" else "muted", False) for t in _values_text(e, self.net)]
        for t in self.beside.get(e.name, []):
            hit = any(
                o.name in self.found
                for o in self.net.elements
                if o.place == "element" and o.where[0] == e.name
            )
            lines.append((t, "found" if hit else "muted", False))
        return lines + [(t, ink, False) for t, ink in self.signal.get(e.name, [])]

    def width(self, p: _Piece) -> float:
        if p.element is not None:
            return 44.0 + LETTER * max(len(t) for t, _, _ in self.words(p.element))
        if p.series:
            return self.margin(p) + max(
                [self.width(q) for q in p.parts] + [self.node_width(n) for n in p.inner]
            )
        return sum(self.width(q) for q in p.parts)

    def margin(self, p: _Piece) -> float:
        """Return the width at the left for the names of nodes without mass."""
        return max([LETTER * len(n) + 8.0 for n in p.inner if n not in self.carried], default=0.0)

    def tall(self, n: str) -> float:
        return BOX if n in self.carried else 0.0

    def node_width(self, n: str) -> float:
        return 30.0 + LETTER * 1.1 * len(self.mass_text(n)) if n in self.carried else 30.0

    def mass_text(self, n: str) -> str:
        mass = self.carried[n]
        text = (
            f"{channel_text(n)}  {number(mass, _digits(mass))} {'kg m²' if n in self.net.turning else 'kg'}"
        )
        inertias = next((b.inertias for b in self.net.bodies if b.name == n), {})
        return ", ".join([text, *(f"{axis} {number(i, _digits(i))} kg m²" for axis, i in inertias.items())])

    def height(self, p: _Piece) -> float:
        if p.element is not None:
            return max(TALL, 30.0 + 13.0 * len(self.words(p.element)))
        if p.series:
            return sum(map(self.height, p.parts)) + sum(map(self.tall, p.inner))
        return max(map(self.height, p.parts))

    # placing

    def place(self, p: _Piece, x: float, top: float, bottom: float, wide: float) -> None:
        """Draw a piece in the strip of width `wide` from x, between two heights."""
        if p.element is not None:
            self.draw_element(p, x, top, bottom, wide)
        elif p.series:
            spare = (bottom - top - self.height(p)) / len(p.parts)
            at = top
            x, wide = x + self.margin(p), wide - self.margin(p)
            for k, q in enumerate(p.parts):
                tall = self.height(q) + spare
                if k:
                    n = p.inner[k - 1]
                    self.y[n] = (at, at + self.tall(n))
                    at += self.tall(n)
                self.place(q, x, at, at + tall, wide)
                at += tall
        else:
            spare = (wide - self.width(p)) / len(p.parts)
            for q in p.parts:
                own = self.width(q) + spare
                self.place(q, x, top, bottom, own)
                x += own

    def ends(self, p: _Piece) -> tuple[str, str]:
        """Return the upper and lower node of an element's piece in the network; points of bodies keep their names."""
        assert p.element is not None
        where = p.element.between
        first, second = where
        return (first, second) if self.home.get(first, first) == p.top else (second, first)

    def draw_element(self, p: _Piece, x: float, top: float, bottom: float, wide: float) -> None:
        e = p.element
        assert e is not None
        words = self.words(e)
        own = 44.0 + LETTER * max(len(t) for t, _, _ in words)
        cx, cy = x + 0.5 * (wide - own) + 20.0, 0.5 * (top + bottom)
        part = f"el:{e.name}"
        colour = "found" if e.name in self.found else "ink"
        for n, own_end in zip((p.top, p.bottom), self.ends(p), strict=True):
            self.x.setdefault(n, []).append(cx)
            if own_end in self.home:
                self.attached.setdefault(own_end, []).append(cx)
        half = SYMBOL / 2

        def line(points: Sequence[tuple[float, float]], **how: Any) -> None:
            shifted = [(cx + a, cy + b) for a, b in points]
            self.stroke(shifted, part, colour, **how)

        line([(0, top - cy), (0, -half)])
        line([(0, half), (0, bottom - cy)])
        kind = e.type if isinstance(e, el.Element) else "lever"
        symbol = SYMBOLS.get(kind, _BOX)
        for points, how in symbol:
            line(points, **how)
        if kind not in SYMBOLS or kind in LETTERED:
            self.word(cx, cy + 4, LETTERED.get(kind, "f"), part, colour, "middle", True, 12.0)
        at = cy - 6.5 * (len(words) - 1) + 4
        for text, ink, bold in words:
            self.word(cx + 18.0, at, text, part, ink, bold=bold)
            at += 13.0

    def draw_nodes(self) -> None:
        net, moved = self.net, {c.at for c in self.net.inputs if c.at and c.quantity in MOVES}
        for n, (top, bottom) in self.y.items():
            xs = self.x.get(n) or [60.0]
            part = f"node:{n}"
            middle = 0.5 * (min(xs) + max(xs))
            if n in self.carried:
                half = max(0.5 * (max(xs) - min(xs)) + 22.0, 0.5 * self.node_width(n))
                left, right = middle - half, middle + half
                if any(b.name == n for b in net.bodies):
                    right = max(right, self.right)
                corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
                self.stroke(corners, part, width=1.6, closed=True)
                x, y = 0.5 * (left + right), 0.5 * (top + bottom) + 4
                self.word(x, y, self.mass_text(n), part, "ink", "middle", True, 12.5)
            else:
                at = 0.5 * (top + bottom)
                left, right = min(xs) - 12.0, max(xs) + 12.0
                fixed = n == GROUND or n in moved
                if fixed:
                    left, right = left - 16.0, right + 16.0
                self.stroke([(left, at), (right, at)], part, width=2.6 if fixed else 1.8)
                if n == GROUND:
                    for k in range(int((right - left) // 9)):
                        self.stroke([(left + 9 * k + 9, at), (left + 9 * k, at + 9)], part, "muted", 1.0)
                else:
                    # a name inside the drawing, left of its bar, if the space is free
                    self.word(left - 5, at + 4, channel_text(n), part, "muted", "end")
            self.edge[n] = (left, right, 0.5 * (top + bottom))
        for body in net.bodies:
            if body.name in self.y:
                self.draw_points(body)

    def draw_points(self, body: Body) -> None:
        """Draw the points of a body along its lower edge if elements are attached, otherwise along its upper
        edge; and its angles."""
        left, right, _ = self.edge[body.name]
        top, bottom = self.y[body.name]
        free = [p.name for p in body.points if p.name not in self.attached]
        for node in (p.name for p in body.points):
            part = f"node:{node}"
            if node in self.attached:
                xs = self.attached[node]
                self.stroke([(min(xs) - 8, bottom), (max(xs) + 8, bottom)], part, width=4.0)
                self.y[node] = (bottom, bottom)
            else:
                at = left + (right - left) * (free.index(node) + 1) / (len(free) + 1)
                self.stroke([(at - 5, top - 7), (at + 5, top - 7), (at, top)], part, closed=True, filled=True)
                self.word(at + 9, top - 4, channel_text(node), part, "muted")
            self.edge[node] = self.edge[body.name]
        for k, (axis, node) in enumerate(body.angles.items()):
            part, cx, cy = f"node:{node}", right - 14.0 - 24.0 * k, 0.5 * (top + bottom)
            turn = [
                (cx + 8 * math.cos(a), cy + 8 * math.sin(a))
                for a in (0.25 * math.pi * i for i in range(-2, 5))
            ]
            self.stroke(turn, part, width=1.2)
            x, y = turn[-1]
            self.stroke([(x + 1, y - 5), (x, y), (x + 5, y + 1)], part, width=1.2)
            self.word(cx, cy + 3.5, axis[0], part, "muted", "middle", size=9.0)
            self.edge[node] = self.edge[body.name]

    def height_of(self, n: str) -> float:
        """Return the height of the arrow for a node's motion; for a point with elements, the lower edge of its body."""
        return self.y[n][1] if n in self.attached else self.edge[n][2]

    def keep_column(self, p: _Piece, x: float) -> float:
        """Reserve space at the right of a corner for measured distances, and return the end of the space."""
        nodes: set[str] = set()
        todo = [p]
        while todo:
            q = todo.pop()
            nodes |= set(q.element.between) if q.element is not None else set()
            todo += q.parts
        for c in self.net.outputs:
            if c.between is not None and set(c.between) <= nodes:
                self.columns[c.name] = x + 8.0
                x += 26.0 + LETTER * len(self.output(c)[0])
        return x

    edge: dict[str, tuple[float, float, float]]


MOVES = ("displacement", "velocity", "acceleration")
Symbol = list[tuple[list[tuple[float, float]], dict[str, Any]]]


def _zigzag(reach: float = 8.0, turns: int = 6) -> list[tuple[float, float]]:
    half = SYMBOL / 2
    inner = [(reach * (-1) ** k, -half + 6 + (SYMBOL - 12) * (k + 0.5) / turns) for k in range(turns)]
    return [(0.0, -half), (0.0, -half + 5), *inner, (0.0, half - 5), (0.0, half)]


def _circle(radius: float) -> list[tuple[float, float]]:
    return [(radius * math.cos(a), radius * math.sin(a)) for a in (2 * math.pi * k / 40 for k in range(40))]


_HALF = SYMBOL / 2
_BOX: Symbol = [
    ([(0.0, -_HALF), (0.0, -12.0)], {}),
    ([(0.0, 12.0), (0.0, _HALF)], {}),
    ([(-11.0, -12.0), (11.0, -12.0), (11.0, 12.0), (-11.0, 12.0)], {"closed": True}),
]
_POT: Symbol = [
    ([(-9.0, -6.0), (-9.0, 12.0), (9.0, 12.0), (9.0, -6.0)], {}),
    ([(0.0, 12.0), (0.0, _HALF)], {}),
    ([(0.0, -_HALF), (0.0, 2.0)], {}),
    ([(-7.0, 2.0), (7.0, 2.0)], {"width": 2.2}),
]
_ARROW: Symbol = [([(-13.0, 13.0), (13.0, -13.0)], {}), ([(7.0, -12.0), (13.0, -13.0), (12.0, -7.0)], {})]
_PLATES: Symbol = [
    ([(0.0, -_HALF), (0.0, -14.0), (-3.0, -14.0), (-3.0, 10.0)], {"width": 2.2}),
    ([(0.0, _HALF), (0.0, 14.0), (3.0, 14.0), (3.0, -10.0)], {"width": 2.2}),
    *(([(-3.0, -8.0 + 4 * k), (-8.0, -4.0 + 4 * k)], {"width": 1.0}) for k in range(4)),
]
_STOP: Symbol = [
    ([(0.0, -_HALF), (0.0, -9.0)], {}),
    ([(-9.0, -9.0), (9.0, -9.0)], {"width": 2.2}),
    ([(-7.0, 9.0), (7.0, 9.0), (3.0, -3.0), (-3.0, -3.0)], {"closed": True, "filled": True}),
    ([(0.0, 9.0), (0.0, _HALF)], {}),
]
_INERTER: Symbol = [
    ([(0.0, -_HALF), (0.0, 3.0)], {}),
    ([(-9.0, -12.0), (-9.0, 12.0), (9.0, 12.0), (9.0, -12.0)], {}),
    ([(0.0, 12.0), (0.0, _HALF)], {}),
    *(([(0.0, -12.0 + 3.5 * k), (3.0, -10.2 + 3.5 * k)], {"width": 1.0}) for k in range(5)),
    ([(x + 6.0, y - 3.0) for x, y in _circle(4.0)], {"closed": True}),
]
_SPRING: Symbol = [(_zigzag(), {})]
_PLAY: Symbol = [
    ([(0.0, -_HALF), (0.0, -4.0)], {}),
    ([(-6.0, -4.0), (6.0, -4.0)], {"width": 2.2}),
    ([(-9.0, -10.0), (-9.0, 10.0), (9.0, 10.0), (9.0, -10.0)], {}),
    ([(-9.0, -10.0), (-4.0, -10.0)], {}),
    ([(4.0, -10.0), (9.0, -10.0)], {}),
    ([(0.0, 10.0), (0.0, _HALF)], {}),
]
SYMBOLS: Mapping[str, Symbol] = {
    "linear_stiffness": _SPRING,
    "series_compliance": _SPRING,
    "cubic_stiffness": [*_SPRING, *_ARROW],
    "linear_damping": _POT,
    "quadratic_damping": [*_POT, *_ARROW],
    "asymmetric_damping": [*_POT, *_ARROW],
    "inertance": _INERTER,
    "coulomb_friction": _PLATES,
    "stribeck_friction": _PLATES,
    "bump_stop": _STOP,
    "backlash": _PLAY,
    "lever": [
        ([(0.0, -_HALF), (0.0, -12.0), (-11.0, -12.0), (-11.0, 0.0)], {}),
        ([(-11.0, 0.0), (11.0, 0.0)], {"width": 2.4}),
        ([(11.0, 0.0), (11.0, 12.0), (0.0, 12.0), (0.0, _HALF)], {}),
        ([(0.0, 0.0), (-5.0, 8.0), (5.0, 8.0)], {"closed": True, "filled": True}),
    ],
    "motor": [
        ([(0.0, -_HALF), (0.0, -12.0)], {}),
        ([(0.0, 12.0), (0.0, _HALF)], {}),
        (_circle(12.0), {"closed": True}),
    ],
}
LETTERED = {
    "motor": "M",
    "gas_spring": "p",
    "hysteresis": "z",
    "cogging_force": "~",
    "terminal_inertia": "m",
    "tabulated_force": "F",
}


def _pieces(sheet: _Sheet) -> list[_Piece]:
    """Return elements and levers as pieces between drawn nodes; a point of a body is drawn at the body."""
    out = []
    between: list[el.Element | Lever] = [e for e in sheet.net.elements if e.place == "between"]
    for e in (*between, *sheet.net.levers):
        first, second = e.between
        top, bottom = (sheet.home.get(n, n) for n in (first, second))
        out.append(_Piece(top, bottom if bottom != top else second, element=e))
    return out


def _poles(sheet: _Sheet, pieces: Sequence[_Piece]) -> tuple[str, list[str]]:
    """Return the top node, and the bottom nodes: the ground or the moved node; for a car with bodies, all moved nodes.

    Found elements are ignored, so that the arrangement of the model stays the same.
    """
    network = sheet.net
    known = [p for p in pieces if p.element is not None and p.element.name not in sheet.found] or pieces
    nodes = {n for p in known for n in (p.top, p.bottom)}
    moved = [c.at for c in network.inputs if c.at in nodes and c.quantity in MOVES]
    bottom = GROUND if GROUND in nodes else moved[0] if moved else min(nodes)
    bottoms = list(dict.fromkeys([bottom, *map(str, moved)])) if network.bodies else [bottom]
    near: dict[str, set[str]] = {}
    for p in known:
        near.setdefault(p.top, set()).add(p.bottom)
        near.setdefault(p.bottom, set()).add(p.top)
    far, ring = dict.fromkeys(bottoms, 0), bottoms
    while ring:
        ring = sorted({m for n in ring for m in near[n]} - set(far))
        for n in ring:
            far[n] = 1 + min(far[m] for m in near[n] if m in far)
    # among the most distant nodes: a mass, such as a car's body, with the most elements
    mass = sheet.carried
    top = max(far, key=lambda n: (far[n] > 0, n in mass, n in moved, far[n], mass.get(n, 0.0)))
    if bottom == GROUND and moved and not mass:
        top = str(moved[0])
    if top in bottoms:
        top = next(n for p in pieces for n in (p.top, p.bottom) if n != bottom)
    return top, [n for n in bottoms if n != top]


def draw(network: Network, *, found: Iterable[str] = ()) -> Drawing:
    """Return the drawing of a network."""
    if not any(e.place == "between" for e in network.elements):
        raise InputError("a network without elements between nodes cannot be drawn")
    sheet = _Sheet(network, found)
    sheet.edge = {}
    pieces = _pieces(sheet)
    top, bottoms = _poles(sheet, pieces)
    rest = _reduced(pieces, {top, *bottoms})
    main = [p for p in rest if top in (p.top, p.bottom) and {p.top, p.bottom} & set(bottoms)]
    others = [p for p in rest if p not in main]
    margin, head = 90.0, 46.0
    x = margin
    tallest = max([sheet.height(p) for p in main] + [_levels_height(sheet, others, top, bottoms)])
    sheet.y[top] = (head, head + sheet.tall(top))
    begin = sheet.y[top][1]
    for bottom in bottoms:
        sheet.y[bottom] = (begin + tallest, begin + tallest + sheet.tall(bottom))
    for p in main:
        wide = sheet.width(p)
        sheet.place(p.reads(top), x, begin, begin + tallest, wide)
        x += wide
        if network.bodies:
            x = sheet.keep_column(p, x)
    if others:
        x = _place_others(sheet, others, top, bottoms, x, begin, tallest)
    sheet.right = x
    sheet.draw_nodes()
    _signals(sheet, x)
    return sheet.out


def _depths(pieces: Sequence[_Piece], top: str, bottoms: Collection[str]) -> dict[str, int]:
    """Return the rows of the nodes outside of series and parallel groups, from the top down."""
    near: dict[str, set[str]] = {}
    for p in pieces:
        near.setdefault(p.top, set()).add(p.bottom)
        near.setdefault(p.bottom, set()).add(p.top)
    # voltages of a chain of resistors: every inner node lies between its neighbours
    level = {n: 0.0 if n == top else 1.0 if n in bottoms else 0.5 for n in near}
    for _ in range(200):
        for n in near:
            if n != top and n not in bottoms:
                level[n] = sum(level[m] for m in near[n]) / len(near[n])
    order = sorted((n for n in near if n != top and n not in bottoms), key=lambda n: (round(level[n], 6), n))
    return {n: k + 1 for k, n in enumerate(order)}


def _levels_height(sheet: _Sheet, pieces: Sequence[_Piece], top: str, bottoms: Collection[str]) -> float:
    if not pieces:
        return 0.0
    rows = len(_depths(pieces, top, bottoms)) + 1
    return rows * (max(map(sheet.height, pieces)) + BOX)


def _place_others(
    sheet: _Sheet,
    pieces: Sequence[_Piece],
    top: str,
    bottoms: Collection[str],
    x: float,
    begin: float,
    tallest: float,
) -> float:
    """Place pieces outside of series and parallel groups: each node in a row, each piece in a column."""
    depth = _depths(pieces, top, bottoms)
    pitch = tallest / (len(depth) + 1)
    for n, k in depth.items():
        at = begin + k * pitch - 0.5 * sheet.tall(n)
        sheet.y[n] = (at, at + sheet.tall(n))
    for p in sorted(pieces, key=lambda p: sum(sheet.y[n][0] for n in (p.top, p.bottom))):
        p = p if sheet.y[p.top][0] < sheet.y[p.bottom][0] else p.flipped()
        wide = sheet.width(p) + 14.0
        sheet.place(p, x, sheet.y[p.top][1], sheet.y[p.bottom][0], wide)
        x += wide
    return x


def _arrow(sheet: _Sheet, x: float, y0: float, y1: float, part: str, both: bool = False) -> None:
    """Draw a vertical arrow from y0 to y1."""
    s = math.copysign(5.0, y1 - y0)
    sheet.stroke([(x, y0), (x, y1)], part, "signal", 1.2)
    sheet.stroke([(x - 3.5, y1 - s), (x, y1), (x + 3.5, y1 - s)], part, "signal", 1.2)
    if both:
        sheet.stroke([(x - 3.5, y0 + s), (x, y0), (x + 3.5, y0 + s)], part, "signal", 1.2)


def _signals(sheet: _Sheet, x: float) -> None:
    """Draw inputs and outputs at and between nodes, then set the size of the sheet."""
    net, out = sheet.net, sheet.out
    right = max([x, *(e[1] for e in sheet.edge.values())]) + 10.0
    used: dict[str, int] = {}
    taken: dict[str, float] = {}  # node -> end of its texts
    widest = right
    sides = [(c, f"{_channel(c)} in", "signal", c.quantity != "force") for c in net.inputs]
    sides += [(c, *sheet.output(c), False) for c in net.outputs]
    for c, words, ink, both in sides:
        node = c.at
        if node not in sheet.edge:
            continue
        _, end, at = sheet.edge[node]
        stack = sheet.home.get(node, node)
        k = used[stack] = used.get(stack, -1) + 1
        part = f"ch:{c.name}"
        ax, ay = end + 14.0, at + 17.0 * k
        # positive values point up; moved nodes have arrows in both directions
        _arrow(sheet, ax, ay + 7, ay - 8, part, both=both)
        sheet.word(ax + 9, ay + 4, words, part, ink)
        taken[node] = max(taken.get(node, 0.0), ax + 12 + LETTER * 1.03 * len(words))
        widest = max(widest, taken[node])
    beside = widest + 16.0
    for c in net.outputs:
        if c.between is None or not set(c.between) <= set(sheet.edge):
            continue
        part = f"ch:{c.name}"
        own = sheet.columns.get(c.name)
        column = beside if own is None else own
        ys = [sheet.height_of(n) for n in c.between]
        for n, y in zip(c.between, ys, strict=True):
            if n in sheet.attached:  # the arrow reaches the body
                continue
            start = max(sheet.edge[n][1], taken.get(n, 0.0)) + 4
            sheet.stroke([(start, y), (column + 6, y)], part, "muted", 0.6, dashed=True)
        _arrow(sheet, column, max(ys), min(ys), part, both=True)
        text, ink = sheet.output(c)
        # beside the arrow, away from the height of a node
        place = min(ys) + 0.5 * (max(ys) - min(ys))
        sheet.word(column + 7, place, text, part, ink)
        if own is None:
            beside += 26.0 + LETTER * len(text)
            widest = max(widest, beside)
    low = min(
        [a for s in out.strokes for a, _ in s.points]
        + [w.x - (LETTER * len(w.text) if w.anchor == "end" else 0) for w in out.words]
    )
    shift = low - 10.0
    for s in out.strokes:
        s.points = [(a - shift, b) for a, b in s.points]
    for w in out.words:
        w.x -= shift
    out.width = widest - shift + 14.0
    out.height = max([b for s in out.strokes for _, b in s.points] + [w.y for w in out.words]) + 18.0
    out.words.insert(0, _Word(10.0, 20.0, net.name, "", "ink", bold=True, size=14.0))
    out.width = max(out.width, 40.0 + 8.0 * len(net.name))


def place_parts(network: Network, where: Sequence[str]) -> list[str]:
    """Return the highlighted parts of a drawing for a place."""
    if len(where) == 2:
        between = [e.name for e in network.elements if e.place == "between" and set(e.where) == set(where)]
        return [*(f"node:{n}" for n in where), *(f"el:{n}" for n in between)]
    return [f"el:{where[0]}", f"ch:{where[0]}"]


__all__ = ["Drawing", "check_suffix", "draw", "place_parts"]
