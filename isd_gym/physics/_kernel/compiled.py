"""Compiled kernel, with every registered law or without laws; cached on disk under a hash of the sources."""

from __future__ import annotations

import functools
import hashlib
import math
import types
from collections.abc import Callable, Sequence
from importlib import resources
from typing import Any, NamedTuple

import numba as nb
from numba.core.options import DefaultOptions

from ..._common import jit
from .. import cost
from .. import elements as el
from . import cars, contact, lanes, law_forces, layout, linear, newton, solve, steps


def _dispatch(
    functions: Sequence[Callable[..., Any]], fallback: Callable[..., Any]
) -> Callable[..., Any]:
    """Return a compiled function that calls functions[which]."""
    names = fallback.__code__.co_varnames[: fallback.__code__.co_argcount]
    of_law = ", ".join(names[1:])
    lines = [f"def dispatch({', '.join(names)}):"]
    for code in range(len(functions)):
        lines.append(f"    if which == {code}:\n        return law_{code}({of_law})")
    lines.append(f"    return fallback({', '.join(names)})")
    scope: dict[str, Any] = {
        f"law_{code}": nb.njit(f, **_INNER) for code, f in enumerate(functions)
    }
    scope["fallback"] = nb.njit(fallback, **_INNER)
    exec("\n".join(lines), scope)
    return nb.njit(scope["dispatch"], **_INNER)


def _laws() -> tuple[list[type[el.Element]], list[type[el.Element]]]:
    smooth = [cls for cls in el.TYPES.values() if cls.law is not None]
    dry = [cls for cls in el.TYPES.values() if cls.bound is not None]
    return smooth, dry


def law_code(cls: type[el.Element]) -> int:
    """Return the code of an element's law in the kernel."""
    smooth, dry = _laws()
    return smooth.index(cls) if cls.law is not None else -1 - dry.index(cls)


def stamp() -> int:
    """Return a number that changes with the code of the kernel and the laws."""
    smooth, dry = _laws()
    return _stamp_of(
        (*((c.type, c.law) for c in smooth), *((c.type, c.bound) for c in dry))
    )


@functools.cache
def _stamp_of(registered: tuple[tuple[str, Any], ...]) -> int:
    digest = hashlib.sha256()
    for package in (str(__package__), el.__name__):
        files = resources.files(
            package
        ).iterdir()  # the package may be in a zip archive
        for file in sorted(
            (f for f in files if f.name.endswith(".py")), key=lambda f: f.name
        ):
            digest.update(file.read_bytes())
    digest.update(
        resources.files(__name__.rsplit(".", 2)[0]).joinpath("cost.py").read_bytes()
    )
    for name, law in registered:
        digest.update(
            name.encode() + law.__code__.co_code + repr(law.__code__.co_consts).encode()
        )
    return int.from_bytes(digest.digest()[:6], "big")


class Kernel(NamedTuple):
    """Compiled functions."""

    advance: Callable[..., Any]  # see `steps.advance`
    measure: Callable[..., Any]  # see `steps.measure`
    record: Callable[..., Any]  # see `steps.record`
    drive: Callable[..., Any]  # see `cars.drive`


_CLOSED = (
    layout.layout,
    linear.sums,
    linear.pooled,
    linear.number,
    linear.clip,
    linear.take,
)
_ALONE = (contact.beside, contact.touch, contact.apply, contact.contact)
_SEVERAL = (
    contact.among_others,
    contact.beside_others,
    contact.touch,
    contact.apply,
    contact.contacts,
)
_LAWS = (
    law_forces.parameters, law_forces.held, law_forces.seen, law_forces.force_beside, law_forces.update_friction, law_forces.push,
    newton.eliminate, newton.resting, newton.answers, newton.excess, newton.bracketed, newton.slopes, newton.newton,
    solve.settle, solve.busy, solve.finish, solve.solved, solve.yields, solve.lacks, solve.between, solve.at_once,
)  # fmt: skip
_INSTEAD = {
    solve.unsolved: "solved",
    solve.as_it_is: "at_once",
    contact.beside_others: "beside",
    contact.contacts: "contact",
}
_STEPS = (
    cost.square,
    steps.march,
    steps.outputs,
    steps.pool_of,
    cars.driven,
    cars.ground,
    cars.meet_again,
    cars.wheels,
    cars.show_state,
    cars.look,
    cars.record_outcome,
    cars.shape_rows,
    cars.foresee,
    cars.shape,
    cars.car_state,
    cars.square_form,
)
_ENTRIES = (steps.advance, steps.measure, steps.record, cars.drive)
_MODULES = (
    math,
    layout,
    lanes,
    linear,
    contact,
    law_forces,
    newton,
    solve,
    steps,
    cars,
)  # modules with constants of the functions
#: inlined at the call: functions that return a view cannot be separate without reference counts, and
#: functions with one call need not be compiled and linked twice
_INLINE = (
    steps.pool_of,
    law_forces.parameters,
    solve.settle,
    solve.busy,
    solve.finish,
    solve.solved,
    solve.unsolved,
    steps.march,
)
#: inlined by the optimiser: a call would pass seven numbers per array
_CLOSE = (
    linear.take,
    linear.sums,
    contact.beside,
    contact.among_others,
    contact.touch,
    contact.apply,
    contact.contact,
    contact.contacts,
    cars.ground,
    cars.wheels,
    cars.record_outcome,
)
_INNER: dict[str, Any] = {
    "nogil": True, "error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True
}  # fmt: skip
_ENTRY: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
if hasattr(
    DefaultOptions, "_nrt"
):  # no function allocates an array, and calls without reference counts are inlined
    _INNER["_nrt"] = False


@functools.cache
def _bind(of: int, with_laws: bool, several: bool, car: layout.CarSize) -> Kernel:
    jit.check_compiler()
    smooth, dry = _laws() if with_laws else ([], [])
    names: dict[str, Any] = {
        k: v for module in _MODULES for k, v in vars(module).items()
    }
    names["CAR"] = layout.cars_layout(car)
    flavour = "_".join(
        map(str, ("laws" if with_laws else "several" if several else "closed", *car))
    )
    if with_laws:
        names["law_force"] = _dispatch([c.law for c in smooth], law_forces.law_force)  # type: ignore[misc]
        names["law_bound"] = _dispatch([c.bound for c in dry], law_forces.law_bound)  # type: ignore[misc]
    laws_ = _LAWS if with_laws else (solve.unsolved, solve.as_it_is)
    for plain in (
        *_CLOSED,
        *(_SEVERAL if several else _ALONE),
        *laws_,
        *_STEPS,
        *_ENTRIES,
    ):
        # compiled functions read constants and functions from `names`; the name of a function is part of its
        # key in numba's disk cache, and the stamp excludes old laws
        twin = types.FunctionType(plain.__code__, names, plain.__name__)
        twin.__qualname__ = f"{plain.__name__}_{flavour}_{of:x}"
        name = _INSTEAD.get(plain, plain.__name__)
        options: dict[str, Any] = {
            "forceinline": plain in _CLOSE,
            "inline": "always" if plain in _INLINE else "never",
        }
        if plain in _ENTRIES:
            names[name] = jit.compiled(**_ENTRY, **options)(twin)
        else:
            names[name] = nb.njit(twin, **_INNER, **options)
    return Kernel(names["advance"], names["measure"], names["record"], names["drive"])


def kernel(
    with_laws: bool = True,
    several: bool = False,
    car: layout.CarSize = layout.QUARTER_CAR,
) -> Kernel:
    """Return the compiled kernel."""
    return _bind(stamp(), with_laws, several, car)


def kernel_of(at: layout.Layout, car: layout.CarSize = layout.QUARTER_CAR) -> Kernel:
    """Return the compiled kernel for networks of a layout.

    A car of several corners without laws has the kernel of several devices, which need not be compiled for the car twice.
    """
    if at.way != layout.CONTACT:
        return kernel(with_laws=True, car=car)
    is_without_laws = at.laws == 0 and car.corners > 1
    return kernel(with_laws=False, several=at.devices > 1 or is_without_laws, car=car)
