"""The model: masses, named nodes, two-terminal elements between nodes, inputs and outputs."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

from ..._common.errors import InputError, harmless, hint, shown
from ..._common.inputs import is_number, number
from ..._common.units import HELD, QUANTITIES, TURNING, UNITS, about_axis, si_of
from .. import elements as el
from ._bodies import LEVER_UNITS, MASSES, Body, Lever

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping
    from pathlib import Path

    from ._assembly import Assembly

GROUND = "ground"
#: quantities of inputs that move a node
MOTIONS = ("displacement", "velocity", "acceleration")
#: limits of a model; larger models are refused
NAME_LENGTH, NODES, ELEMENTS, CHANNELS = 200, 250, 1000, 1000
#: unknown constant of an output's sensor: "free" is shared by all records, "record" differs between records
Offset = Literal["free", "record"]


def check_name(name: Any, what: str) -> str:
    """Return a name that is valid for a node, an element or a channel."""
    if (
        not isinstance(name, str)
        or not 0 < len(name) <= NAME_LENGTH
        or not harmless(name)
    ):
        raise InputError(
            f"{what}: {shown(name)} cannot be a name (1 to {NAME_LENGTH} characters, without control characters)"
        )
    if name[0] in "=+-@":
        raise InputError(
            f"{what}: {shown(name)} cannot begin with {name[0]}: a spreadsheet takes it as a formula"
        )
    return name


@dataclass(frozen=True)
class Channel:
    """An input or output of a model."""

    name: str  # name of the channel, and of its column in a table
    #: quantity in the equations (a key of `UNITS`). An angle in deg is a displacement, a torque in N m a
    #: force, a commanded voltage a current
    quantity: str
    unit: str  # unit of the channel in a table
    at: str | None = None  # node
    between: tuple[str, str] | None = None  # two nodes of a relative motion
    #: element of a force or current; several for the sum of their forces
    element: str | tuple[str, ...] | None = None
    #: unknown constant of an output's sensor: 'free' for a common constant of all records, 'record' for a
    #: constant per record, None without
    offset: Offset | None = None
    #: RMS of an output's noise from the sensor's data sheet [unit]; None if unknown
    noise: float | None = None
    measured: bool = True  # false for a road that was not measured
    #: 'pitch' or 'roll' if `at` is the angle of a body ('body.pitch'); a model file has "body" and "axis"
    #: instead
    axis: str | None = None

    @property
    def si(self) -> str:
        """SI unit in the equations."""
        return si_of(self.unit)

    @property
    def spoken(self) -> str:
        """Quantity as in a model file, such as 'angle' for a displacement in deg."""
        si = self.si
        return next(
            (q for q, is_ in QUANTITIES.items() if is_ == (self.quantity, si)),
            self.quantity,
        )

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of the elements of the channel."""
        return (self.element,) if isinstance(self.element, str) else self.element or ()

    def to_dict(self) -> dict[str, Any]:
        """Return the channel as an object of a model file (`isd-model/1`)."""
        out: dict[str, Any] = {"name": self.name, "quantity": self.spoken}
        if self.at is not None and self.axis is not None:
            out |= {"body": self.at.removesuffix(f".{self.axis}"), "axis": self.axis}
        elif self.at is not None:
            out["at"] = self.at
        if self.between is not None:
            out["between"] = list(self.between)
        if self.element is not None:
            out["element"] = (
                self.element if isinstance(self.element, str) else list(self.element)
            )
        out["unit"] = self.unit
        if self.offset:
            out["offset"] = self.offset
        if self.noise is not None:
            out["noise"] = self.noise
        if not self.measured:
            out["measured"] = False
        return out


@dataclass(frozen=True)
class Network:
    """A suspension model.

    Immutable and validated on construction; `with_parameters` and `with_element` return changed copies.

    Raises:
        InputError: An entry is invalid; the message names the entry in one line.
    """

    name: str  # name, for people
    # mass [kg] by node, or moment of inertia [kg m^2] for nodes in `turning`
    masses: Mapping[str, float]
    # two-terminal elements, and effects at motors and channels
    elements: tuple[el.Element, ...]
    inputs: tuple[Channel, ...] = ()  # input channels
    outputs: tuple[Channel, ...] = ()  # output channels
    #: relative standard deviation by parameter path; parameters without an entry are known
    uncertainty: Mapping[str, float] = field(default_factory=dict)
    description: str = ""  # description, for people
    turning: frozenset[str] = frozenset()  # rotational nodes among the masses
    bodies: tuple[Body, ...] = ()  # rigid bodies; their points are ordinary nodes
    levers: tuple[Lever, ...] = ()  # ratios that couple two nodes

    # ------------------------------------------------------------------------------------ the file

    @classmethod
    def load(cls, source: str | Path | Mapping[str, Any] | Network) -> Network:
        """Read a model.

        Args:
            source: Name of a built-in model ('quarter-car-isd'), a JSON file, the content of a file, or a
                network, which is returned unchanged.

        Raises:
            InputError: The file cannot be read, or an entry is invalid.
        """
        from ._format import read

        return source if isinstance(source, Network) else read(source)

    @classmethod
    def from_dict(cls, data: Any) -> Network:
        """Return the model of a JSON object.

        Args:
            data: Content of a model file (`isd-model/1`).

        Raises:
            InputError: An entry is invalid; the message names the entry.
        """
        from ._format import from_dict

        return from_dict(data)

    def to_dict(self) -> dict[str, Any]:
        """Return the model as the content of a model file (`isd-model/1`)."""
        from ._format import to_dict

        return to_dict(self)

    def dumps(self) -> str:
        """Return the model as JSON text, one element or channel per line."""
        from ._format import dumps

        return dumps(self)

    def save(self, path: str | Path) -> None:
        """Write a model file atomically.

        Args:
            path: File to write.

        Raises:
            InputError: The file cannot be written.
        """
        from ..._common.files import write_text

        write_text(path, self.dumps())

    # --------------------------------------------------------------------------------- validation

    def __post_init__(self) -> None:
        if not self.elements:
            raise InputError("the model has no elements")
        for count, what, most in (
            (len(self.elements), "elements", ELEMENTS),
            (len(self.inputs) + len(self.outputs), "channels", CHANNELS),
            (len(self.masses), "masses", NODES),
            (len(self.levers), "levers", ELEMENTS),
            (len(self.nodes), "nodes", NODES),
        ):
            if count > most:
                raise InputError(
                    f"the model has {count} {what}, at most {most} are handled"
                )
        channels = [c.name for c in self.inputs + self.outputs]
        for kind, names in (
            ("node", self.nodes),
            ("element", [e.name for e in self.elements]),
            ("channel", channels),
        ):
            for name in names:
                check_name(name, kind)
        self._check_masses()
        self._check_bodies()
        for node in self.turning:
            if node not in self.masses:
                raise InputError(f"inertias: '{node}' has none")
        _unique(
            [*(e.name for e in self.elements), *(v.name for v in self.levers)],
            "element",
        )
        _unique(channels, "channel")
        if "time" in channels:
            raise InputError("a channel cannot be called 'time'")
        by_name = {e.name: e for e in self.elements}
        motors = {e.name for e in self.elements if e.driven}
        self._check_places(motors)
        self._check_nodes(by_name)
        for c in self.inputs:
            self._check_input(c, motors)
        self._check_conditions()
        for c in self.outputs:
            self._check_output(c, by_name)
        _unique(list(self.moved_nodes), "moved node")
        self._check_uncertainty()
        self._check_connected()
        if self.rotating:
            self._check_turning()
        self._check_loads(by_name)
        if self.bodies or self.levers:
            from ._coordinates import coordinates

            coordinates(self)

    def _check_places(self, motors: set[str]) -> None:
        """Check that each element is between two nodes, at a motor or at an output."""
        outputs = {c.name for c in self.outputs}
        for e in self.elements:
            if e.place == "between" and len(set(e.where)) != 2:
                raise InputError(
                    f"element '{e.name}' connects '{e.where[0]}' to itself"
                )
            if e.place == "element" and e.where[0] not in motors:
                raise InputError(f"element '{e.name}': no motor '{e.where[0]}'")
            if e.place == "channel" and e.where[0] not in outputs:
                raise InputError(f"element '{e.name}': no output '{e.where[0]}'")

    def _check_nodes(self, by_name: Mapping[str, el.Element]) -> None:
        """Check that the nodes and elements of the channels exist."""
        nodes = set(self.nodes)
        for kind, channels in (("input", self.inputs), ("output", self.outputs)):
            for c in channels:
                if c.axis is not None:
                    self._check_axis(c, f"{kind} '{c.name}'")
                for node in [c.at, *(c.between or ())]:
                    if node is not None and node not in nodes | {GROUND}:
                        raise InputError(f"{kind} '{c.name}': no node '{node}'")
                if c.at == GROUND:
                    raise InputError(f"{kind} '{c.name}': the ground does not move")
                for name in c.elements:
                    if name not in by_name:
                        raise InputError(f"{kind} '{c.name}': no element '{name}'")

    def _check_uncertainty(self) -> None:
        """Check that the uncertainty is a relative standard deviation of a parameter."""
        known = self.parameters
        for key, sigma in self.uncertainty.items():
            if key not in known:
                raise InputError(
                    f"uncertainty: no parameter {shown(key)}; {hint(key, known)}"
                )
            if not 0 <= number(sigma, f"uncertainty: '{key}'") <= 100:
                raise InputError(
                    f"uncertainty: '{key}' must be a relative sigma of 0 to 100, not {shown(sigma)}"
                )

    def _check_bodies(self) -> None:
        """Check that the nodes of a body belong to the body alone, and that no lever has the ground as a node."""
        for body in self.bodies:
            check_name(body.name, "body")
        for lever in self.levers:
            check_name(lever.name, "lever")
            if GROUND in lever.between:
                raise InputError(
                    f"lever '{lever.name}': the ground does not move, and cannot be at a lever"
                )
        taken = {GROUND: "the ground", **dict.fromkeys(self.masses, "a mass")}
        for body in self.bodies:
            points = {p.name for p in body.points}
            for node in body.nodes:
                what = (
                    f"point '{node}' of body '{body.name}'"
                    if node in points
                    else f"body '{body.name}'"
                )
                if node in taken:
                    raise InputError(
                        f"bodies: {what} has the name of {taken[node]}: give it another"
                        + (
                            ", and tie the two with a lever of ratio 1"
                            if taken[node] == "a mass"
                            else ""
                        )
                    )
                taken[node] = f"a node of body '{body.name}'"

    def _check_axis(self, c: Channel, where: str) -> None:
        """Check that the body of a channel rotates about the channel's axis."""
        name = str(c.at).removesuffix(f".{c.axis}")
        body = next((b for b in self.bodies if b.name == name), None)
        if body is None:
            known = ", ".join(b.name for b in self.bodies) or "none in the model"
            raise InputError(f"{where}: no body {shown(name)} (bodies: {known})")
        if c.axis not in body.angles:
            raise InputError(
                f"{where}: body '{name}' does not turn about its {c.axis} axis: give it an inertia "
                f'("inertia": {{"{c.axis}": ...}} [kg m^2])'
            )

    def _check_masses(self) -> None:
        for node, mass in self.masses.items():
            if node == GROUND:
                raise InputError("the ground has no mass: remove it from masses")
            low, high = MASSES
            if not (is_number(mass) and low <= mass <= high):
                raise InputError(
                    f"{'inertias' if node in self.turning else 'masses'}: '{node}' must be a positive number of "
                    f"{'kg m^2' if node in self.turning else 'kg'}, {low:g} to {high:g}, not {shown(mass)}"
                )

    def _check_conditions(self) -> None:
        """Check that every law with a logged channel names an input that acts on no node."""
        known = [c.name for c in self.inputs if c.quantity == "condition"]
        for e in self.elements:
            if e.scheduled and not e.driven and getattr(e, "channel", "") not in known:
                raise InputError(
                    f"element '{e.name}': \"channel\" must name an input that acts on no node "
                    f"({', '.join(known) or 'there is none'}); add one, such as "
                    '{"name": "oil", "quantity": "temperature", "unit": "degC"}'
                )

    def _check_loads(self, by_name: Mapping[str, el.Element]) -> None:
        """Check that every friction under load names an element that transmits a force of the same kind."""
        for e in self.elements:
            if not e.loaded:
                continue
            load = by_name.get(getattr(e, "load", ""))
            if load is None or load is e or not el.transmits(load):
                known = [
                    x.name for x in self.elements if x is not e and el.transmits(x)
                ]
                raise InputError(
                    f"element '{e.name}': \"load\" must name a spring, a damper, a motor or a smooth law ({', '.join(known) or 'there is none'})"
                )
            if bool(set(load.where) & self.rotating) != bool(
                set(e.where) & self.rotating
            ):
                raise InputError(
                    f"element '{e.name}': \"load\" must name a {'torque' if set(e.where) & self.rotating else 'force'}, as the friction is"
                )

    def _check_input(self, c: Channel, motors: set[str]) -> None:
        if c.quantity == "condition" and (c.at, c.between, c.element) != (
            None,
            None,
            None,
        ):
            raise InputError(
                f"input '{c.name}': a {c.spoken} acts on no node and no element; leave its place out"
            )
        if c.quantity == "current":
            if c.element not in motors:
                raise InputError(
                    f"input '{c.name}': a current needs \"element\": the name of a motor or a controlled damper"
                )
        elif c.at is None and c.quantity != "condition":
            hint = (
                " (of that one node: a distance between two cannot be moved)"
                if c.between
                else ""
            )
            raise InputError(
                f"input '{c.name}': a {c.quantity} needs \"at\": a node{hint}"
            )
        if c.offset:
            raise InputError(f"input '{c.name}': only outputs have an offset")
        if c.noise is not None:
            raise InputError(f"input '{c.name}': only outputs have a noise")
        if not c.measured and c.quantity != "displacement":
            raise InputError(
                f"input '{c.name}': only a moved node's displacement may be unmeasured, not a {c.quantity}"
            )

    def _check_output(self, c: Channel, by_name: Mapping[str, el.Element]) -> None:
        if not c.measured:
            raise InputError(
                f"output '{c.name}': only an input may be unmeasured: remove the output"
            )
        if c.offset not in (None, "free", "record"):
            raise InputError(
                f"output '{c.name}': offset must be 'free', 'record' or None, not {shown(c.offset)}"
            )
        if c.quantity == "force":
            if (c.element is None) == (c.at is None):
                raise InputError(
                    f'output \'{c.name}\': a force is that of an "element" or "at" a moved node'
                )
            if c.at is not None and c.at not in self.moved_nodes:
                raise InputError(
                    f"output '{c.name}': force at '{c.at}', which is not a moved node"
                )
            for name in c.elements:
                if by_name[name].place != "between":
                    raise InputError(
                        f"output '{c.name}': '{name}' has no force of its own"
                    )
        elif c.quantity in ("displacement", "velocity", "acceleration"):
            if (c.between is None) == (c.at is None):
                raise InputError(
                    f'output \'{c.name}\': a {c.quantity} is "at" a node or "between" two'
                )
        else:
            raise InputError(f"output '{c.name}': a {c.spoken} cannot be an output")

    def _check_connected(self) -> None:
        links: dict[str, list[str]] = {n: [] for n in self.nodes}
        pairs = [e.where for e in self.elements if e.place == "between"] + [
            v.between for v in self.levers
        ]
        pairs += [(b.name, n) for b in self.bodies for n in b.nodes[1:]]
        for pair in pairs:
            for this, other in (pair, pair[::-1]):
                if this != GROUND:
                    links[this].append(other)
        held = (
            set(self.inertial)
            | set(self.moved_nodes)
            | {n for v in self.levers for n in v.between}
        )
        held |= {
            c.at for c in self.inputs if c.quantity == "force" and c.at is not None
        }
        for node, others in links.items():
            if node not in held and len(others) < 2:
                raise InputError(
                    f"node '{node}' floats: it has no mass and no input, and only one element is connected to it "
                    f"(give it a mass, an input, or call it 'ground')"
                )
        # an inerter to the ground is an inertia: a force may drive its node
        inert = [
            n
            for e in self.elements
            if GROUND in e.where and e.linear()[2] > 0
            for n in e.where
        ]
        reached = set()
        frontier = [*self.inertial, *inert, *self.moved_nodes, GROUND]
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

    def _check_turning(self) -> None:
        """Check that no element connects a rotational node with a translational node."""
        for body in self.bodies:
            for node in (body.name, *(p.name for p in body.points)):
                if node in self.rotating:
                    raise InputError(
                        f"bodies: '{node}' of body '{body.name}' moves along a line, and is tied to what turns"
                    )
        for lever in self.levers:
            for node, turns in zip(lever.between, LEVER_UNITS[lever.unit], strict=True):
                if node in self.rotating and not turns:
                    raise InputError(
                        f"lever '{lever.name}': '{node}' turns, and the unit '{lever.unit}' of the ratio has it move along a line"
                    )
        for node in self.masses:
            if node in self.rotating and node not in self.turning:
                raise InputError(
                    f"masses: '{node}' is tied to what turns, and so turns too: it needs one of \"inertias\" [kg m^2] "
                    "in place of its mass"
                )
        for kind, channels in (("input", self.inputs), ("output", self.outputs)):
            for c in channels:
                nodes = [
                    n
                    for n in (c.at, *(c.between or ()))
                    if n is not None and n != GROUND
                ]
                if c.quantity == "force":
                    ties = [self.element(n) for n in c.elements]
                    nodes += [n for e in ties for n in e.where if n != GROUND]
                elif c.quantity in HELD:
                    continue
                turns = c.si in TURNING
                for n in nodes:
                    if (n in self.rotating) != turns:
                        so = "turns" if n in self.rotating else "moves along a line"
                        raise InputError(
                            f"{kind} '{c.name}': '{n}' {so}, and cannot be measured in {c.unit}"
                        )

    # ------------------------------------------------------------------------------------- access

    @cached_property
    def nodes(self) -> tuple[str, ...]:
        """Names of all nodes except the ground: nodes with masses, nodes of bodies, others in order of
        appearance, moved nodes last."""
        seen = dict.fromkeys(self.masses)
        for body in self.bodies:
            seen |= dict.fromkeys(body.nodes)
        for e in self.elements:
            if e.place == "between":
                seen |= dict.fromkeys(e.where)
        for lever in self.levers:
            seen |= dict.fromkeys(lever.between)
        moved = self.moved_nodes
        return tuple(n for n in seen if n != GROUND and n not in moved) + moved

    @cached_property
    def moved_nodes(self) -> tuple[str, ...]:
        """Names of the nodes that inputs move."""
        return tuple(str(c.at) for c in self.moving)

    @property
    def moving(self) -> tuple[Channel, ...]:
        """Inputs that move a node by its displacement, velocity or acceleration."""
        return tuple(c for c in self.inputs if c.quantity in MOTIONS)

    @cached_property
    def tied(self) -> dict[str, int]:
        """Index of the connected part of the network by node; elements and bodies connect nodes.

        The ground is excluded, and levers do not connect nodes: the motions at the two ends differ.
        """
        links: dict[str, set[str]] = {n: set() for n in self.nodes}
        pairs = [
            e.where
            for e in self.elements
            if e.place == "between" and GROUND not in e.where
        ]
        pairs += [(b.name, p.name) for b in self.bodies for p in b.points]
        for first, second in pairs:
            links[first].add(second)
            links[second].add(first)
        out: dict[str, int] = {}
        for number_, root in enumerate(links):
            frontier = [root]
            while frontier:
                node = frontier.pop()
                if node not in out:
                    out[node] = number_
                    frontier += links[node]
        return out

    def probe(
        self,
        name: str,
        quantity: str,
        *,
        at: str | None = None,
        between: tuple[str, str] | None = None,
        element: str | None = None,
    ) -> Channel:
        """Return a channel in SI units that measures a node, two nodes or an element, of translation or rotation.

        Args:
            name: Name of the channel.
            quantity: 'displacement', 'velocity', 'acceleration' or 'force'.
            at: Measured node.
            between: Two nodes of a relative motion.
            element: Element of a force.
        """
        if element is not None:
            between = self.element(element).between
        nodes = [n for n in (at, *(between or ())) if n is not None and n != GROUND]
        unit = UNITS[quantity]
        if any(n in self.rotating for n in nodes):
            unit = about_axis(unit)
        if element is not None:
            return Channel(name, quantity, unit, element=element)
        return Channel(name, quantity, unit, at=at, between=between)

    @cached_property
    def rotating(self) -> frozenset[str]:
        """Rotational nodes: nodes with a moment of inertia or a channel of rotation, and all nodes connected to such a node."""
        seeds = set(self.turning) | {n for b in self.bodies for n in b.angles.values()}
        seeds |= {n for v in self.levers for n in v.turning}
        for c in self.inputs + self.outputs:
            if c.quantity not in HELD and c.si in TURNING:
                seeds |= {
                    n
                    for n in (c.at, *(c.between or ()))
                    if n is not None and n != GROUND
                }
        parts = {self.tied[n] for n in seeds if n in self.tied} if seeds else set()
        return frozenset(n for n, part in self.tied.items() if part in parts)

    @cached_property
    def mechanical(self) -> Network:
        """The network without the effects of motors and sensors, which act outside the equations of motion."""
        kept = tuple(e for e in self.elements if e.place == "between")
        return self if len(kept) == len(self.elements) else replace(self, elements=kept)

    @cached_property
    def _assembly(self) -> Assembly:
        from ._assembly import _assemble

        return _assemble([self], ())[0]

    @property
    def carried(self) -> dict[str, float]:
        """Mass [kg] or moment of inertia [kg m^2] by node; for bodies at their centres and angles."""
        out = dict(self.masses)
        for body in self.bodies:
            out |= body.carried
        return out

    @cached_property
    def inertial(self) -> frozenset[str]:
        """Nodes that carry inertia: those with a mass of their own, and every node of a body."""
        return frozenset(self.masses) | {n for body in self.bodies for n in body.nodes}

    def largest_inertia(self, *nodes: str) -> float:
        """Return the largest mass of the network, or the largest moment of inertia where a node turns.

        Args:
            *nodes: Nodes that decide between masses and moments of inertia.

        Returns:
            Mass [kg] or moment of inertia [kg m^2]; 0 without any.
        """
        turns = any(n in self.rotating for n in nodes)
        return max(
            (m for n, m in self.carried.items() if (n in self.rotating) == turns),
            default=0.0,
        )

    def inertia_at(self, node: str) -> float:
        """Return the inertia that a node carries; at a point of a body that of the body.

        Args:
            node: The node.

        Returns:
            Mass [kg] or moment of inertia [kg m^2]; 0 without any.
        """
        bodies = {p.name: b.mass for b in self.bodies for p in b.points}
        return self.carried.get(node, bodies.get(node, 0.0))

    @property
    def total_mass(self) -> float:
        """Total mass [kg] of translational nodes and bodies."""
        return sum(m for n, m in self.carried.items() if n not in self.rotating)

    @cached_property
    def parameters(self) -> dict[str, float]:
        """All parameters of the model by path: 'body.mass', 'body.inertia.pitch', 'oil.stiffness', 'pinion.ratio', ..."""
        out = {self.mass_path(node): float(m) for node, m in self.masses.items()}
        for body in self.bodies:
            out |= body.parameters
        for e in self.elements:
            for f in el.parameter_fields(type(e)):
                out[f"{e.name}.{f.name}"] = getattr(e, f.name)
        return out | {f"{v.name}.ratio": float(v.ratio) for v in self.levers}

    def mass_path(self, node: str) -> str:
        """Return the parameter path of the mass of a node.

        Args:
            node: Name of the node.

        Returns:
            'body.mass', 'arm.inertia' for a rotational node, or 'body.inertia.pitch' for the angle of a body.
        """
        for body in self.bodies:
            if node in body.carried:
                return list(body.parameters)[list(body.carried).index(node)]
        return f"{node}.{'inertia' if node in self.turning else 'mass'}"

    def unit_of(self, path: str) -> str:
        """Return the unit of a parameter.

        Args:
            path: Path of the parameter, such as 'oil.stiffness'.

        Raises:
            InputError: No such parameter exists.
        """
        owner, _, name = path.rpartition(".")
        for e in self.elements:
            if e.name == owner:
                for f in el.parameter_fields(type(e)):
                    if f.name == name:
                        if (
                            e.place == "channel"
                            and f.metadata["unit"] == "unit of the channel"
                        ):
                            return next(
                                c.unit for c in self.outputs if c.name == e.where[0]
                            )
                        unit = f.metadata["unit"]
                        if e.scheduled and "unit of the channel" in unit:
                            own = next(
                                c.si
                                for c in self.inputs
                                if c.name == getattr(e, "channel", "")
                            )
                            base, _, rest = unit.partition("unit of the channel")
                            return f"{self._unit(e, base)}{own}{rest}"
                        return self._unit(e, unit)
        if owner in self.masses and path == self.mass_path(owner):
            return "kg m^2" if owner in self.turning else "kg"
        for body in self.bodies:
            if path in body.parameters:
                return "kg" if owner == body.name else "kg m^2"
        for lever in self.levers:
            if path == f"{lever.name}.ratio":
                return lever.unit
        raise InputError(
            f"no parameter {shown(path)}; there are {', '.join(self.parameters)}"
        )

    def _unit(self, e: el.Element, unit: str) -> str:
        """Return the unit of a parameter of an element at its place."""
        motor = e.name if e.driven else e.where[0] if e.place == "element" else ""
        if motor and any(motor in c.elements and c.si == "V" for c in self.inputs):
            unit = unit.replace("A", "V")
        turns = e.place == "between" and any(n in self.rotating for n in e.where)
        return about_axis(unit) if turns else unit

    def element(self, name: str) -> el.Element:
        """Return an element.

        Args:
            name: Name of the element.

        Raises:
            InputError: No such element exists.
        """
        for e in self.elements:
            if e.name == name:
                return e
        raise InputError(
            f"no element {shown(name)}; there are {', '.join(e.name for e in self.elements)}"
        )

    def with_uncertainty(self, uncertainty: Mapping[str, float]) -> Network:
        """Return the network with other uncertainties.

        Args:
            uncertainty: Relative standard deviation by parameter; parameters that the network lacks are left out.
        """
        known = self.parameters
        return replace(
            self, uncertainty={k: v for k, v in uncertainty.items() if k in known}
        )

    def with_parameters(self, values: Mapping[str, float]) -> Network:
        """Return a copy with changed parameters.

        Args:
            values: Value by path ('body.mass', 'main_spring.stiffness'), in the parameter's unit.

        Raises:
            InputError: No such parameter exists, or a value is outside its limits.
        """
        masses = dict(self.masses)
        bodies = {path: b.name for b in self.bodies for path in b.parameters}
        levers = {f"{v.name}.ratio": v.name for v in self.levers}
        kinds = {e.name: type(e) for e in self.elements}
        changes: dict[str, dict[str, Any]] = {}
        for path, value in values.items():
            owner, _, name = path.rpartition(".")
            if path not in self.parameters:
                raise InputError(
                    f"no parameter {shown(path)}; there are {', '.join(self.parameters)}"
                )
            if owner in kinds and name in {
                f.name for f in el.parameter_fields(kinds[owner])
            }:
                changes.setdefault(owner, {})[name] = float(value)
            elif path in bodies:
                changes.setdefault(bodies[path], {})[name] = float(value)
            elif path in levers:
                changes.setdefault(levers[path], {})[name] = float(value)
            else:
                masses[owner] = float(value)
        elements = tuple(
            replace(e, **changes[e.name]) if e.name in changes else e
            for e in self.elements
        )
        own = {
            k: tuple(replace(b, **changes.get(b.name, {})) for b in getattr(self, k))
            for k in ("bodies", "levers")
        }
        out = self._with_values(masses=masses, elements=elements, **own)
        out._check_masses()
        return out

    def _with_values(self, **parts: Any) -> Network:
        """Return a copy with other values, which do not change the checked structure."""
        out = copy(self)
        for name in ("parameters", "mechanical", "_assembly"):
            out.__dict__.pop(name, None)
        out.__dict__.update(parts)
        return out

    def with_element(self, element: el.Element | Mapping[str, Any]) -> Network:
        """Return a copy with an additional element.

        Args:
            element: The element, or its object in a model file.

        Raises:
            InputError: The element is invalid or not connected.
        """
        if not isinstance(element, el.Element):
            from ._format import read_element

            element = read_element(element, len(self.elements))
        return replace(self, elements=(*self.elements, element))

    def without_element(self, name: str) -> Network:
        """Return a copy without an element and the uncertainties of its parameters.

        Args:
            name: Name of the element.

        Raises:
            InputError: No such element exists.
        """
        self.element(name)
        return replace(
            self,
            elements=tuple(e for e in self.elements if e.name != name),
            uncertainty={
                k: v
                for k, v in self.uncertainty.items()
                if k.rpartition(".")[0] != name
            },
        )

    def with_outputs(self, names: Collection[str]) -> Network:
        """Return a copy with fewer outputs, without the effects at the removed sensors.

        Args:
            names: Names of the outputs to keep.
        """
        outputs = tuple(c for c in self.outputs if c.name in names)
        gone = {c.name for c in self.outputs} - {c.name for c in outputs}
        elements = tuple(
            e for e in self.elements if e.place != "channel" or e.where[0] not in gone
        )
        return replace(self, outputs=outputs, elements=elements) if gone else self

    def free_name(self, stem: str) -> str:
        """Return a name that no element, lever or node has yet.

        Args:
            stem: Wanted name.

        Returns:
            `stem`, or `stem` with the suffix _2, _3, ...
        """
        taken = (
            {e.name for e in self.elements}
            | {v.name for v in self.levers}
            | set(self.nodes)
        )
        names = (stem if i == 1 else f"{stem}_{i}" for i in range(1, 10_000))
        return next(n for n in names if n not in taken)


def _unique(names: Iterable[str | None], what: str) -> None:
    seen = set()
    for name in names:
        if name in seen:
            raise InputError(f"two {what}s are called '{name}'")
        seen.add(name)
