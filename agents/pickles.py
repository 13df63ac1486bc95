"""The content of a pickle, without executing the pickle.

`pickle.Unpickler` calls functions that the file names; even a permitted array constructor can be made to
interpret bytes as pointers. Here the opcodes are read one by one, and nothing is called. A class or function
in the file becomes a `Name`, and a call becomes a `Thing` with its arguments and its state. `array` makes the
few permitted kinds of arrays from a fixed list of numeric types, after a check of every size.
"""

from __future__ import annotations

import math
import pickletools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from isd_gym.common.errors import InputError, shown

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

OPCODES = 1_000_000
DIMENSIONS = 8


class Name(NamedTuple):
    """A class or function in a pickle.

    Attributes:
        module: Name of the module.
        name: Name in the module.
    """

    module: str
    name: str


@dataclass(eq=False)
class Thing:
    """A call in a pickle.

    Attributes:
        made: The called `Name`.
        arguments: Arguments.
        state: State that is set after the call.
    """

    made: Any
    arguments: tuple[Any, ...]
    state: Any = None


@dataclass(frozen=True)
class Stored:
    """A reference to data outside the pickle (the numbers of torch's tensors).

    Attributes:
        key: Persistent id.
    """

    key: Any


_MARK = object()


def read_pickle(data: bytes) -> Any:
    """Return the outline of a pickle: plain values, lists, tuples, dicts, `Name`, `Thing` and `Stored`.

    Keys of dicts that are no plain values are skipped.

    Args:
        data: The pickle.

    Returns:
        The outline.

    Raises:
        InputError: The data are no pickle of at most `OPCODES` steps.
    """
    stack = _Stack()
    try:
        for step, (opcode, argument, _) in enumerate(pickletools.genops(data)):
            if step > OPCODES:
                raise InputError(f"a pickle of more than {OPCODES} steps")
            if opcode.name == "STOP":
                return stack.pop()
            if opcode.name not in _ACTIONS:  # extension codes and out-of-band buffers
                raise ValueError(opcode.name)
            _ACTIONS[opcode.name](stack, argument)
    except InputError:
        raise
    except Exception as error:  # an opcode on an empty stack, or an invalid text
        raise InputError(f"not a pickle that can be read ({type(error).__name__})") from None
    raise InputError("a pickle without an end")


class _Stack:
    """Stack and memo of a pickle. Too few items on the stack raise `IndexError`, except for `pop_tuple`."""

    def __init__(self) -> None:
        self.items: list[Any] = []
        self.memo: dict[int, Any] = {}

    def push(self, value: Any) -> None:
        self.items.append(value)

    def pop(self) -> Any:
        return self.items.pop()

    def pop_to_mark(self) -> list[Any]:
        at = len(self.items) - 1
        while self.items[at] is not _MARK:  # IndexError without a mark
            at -= 1
        items = self.items[at + 1 :]
        del self.items[at:]
        return items

    def pop_tuple(self, count: int) -> tuple[Any, ...]:
        start = len(self.items) - count
        items = self.items[start:]
        del self.items[start:]
        return tuple(items)

    def store(self, key: int) -> None:
        """Keep the top of the stack in the memo."""
        self.memo[key] = self.items[-1]

    def extend(self, items: list[Any]) -> None:
        """Append items to the list at the top. The items of objects and sets are skipped."""
        target = self.items[-1]
        if isinstance(target, list):
            target += items
        elif not isinstance(target, Thing | set):
            raise ValueError("no list")

    def set_items(self, pairs: list[Any]) -> None:
        """Set keys and values, in turns, of the dict at the top."""
        target = self.items[-1]
        if isinstance(target, Thing):
            target = _items_of(target)
        for key, value in zip(pairs[::2], pairs[1::2], strict=True):
            if isinstance(key, str | int | float | bytes | None):
                target[key] = value

    def push_dict(self) -> None:
        pairs = self.pop_to_mark()
        self.push({})
        self.set_items(pairs)

    def push_name(self) -> None:
        inner, outer = self.pop(), self.pop()
        self.push(Name(str(outer)[:200], str(inner)[:200]))

    def push_call(self, keywords: Any = None) -> None:
        """Push the call of the object below its arguments. Keywords are skipped."""
        given, made = self.pop(), self.pop()
        self.push(Thing(made, given if isinstance(given, tuple) else ()))

    def push_instance(self, name: str | None) -> None:
        given = self.pop_to_mark()
        made = given.pop(0) if name is None else Name(*name.split(" ", 1))
        self.push(Thing(made, tuple(given)))

    def set_state(self) -> None:
        state = self.pop()
        if isinstance(self.items[-1], Thing):
            self.items[-1].state = state


_VALUES = (
    *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
    *("STRING", "BINSTRING", "SHORT_BINSTRING", "UNICODE", "SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8"),
    *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
)
#: effect of each opcode, given its argument; all other opcodes are refused
_ACTIONS: dict[str, Callable[[_Stack, Any], object]] = {
    **dict.fromkeys(_VALUES, _Stack.push),
    **dict.fromkeys(("PROTO", "FRAME"), lambda stack, _: None),
    **dict.fromkeys(("PUT", "BINPUT", "LONG_BINPUT"), _Stack.store),
    **dict.fromkeys(("GET", "BINGET", "LONG_BINGET"), lambda stack, key: stack.push(stack.memo[key])),
    **dict.fromkeys(("EMPTY_LIST", "EMPTY_SET"), lambda stack, _: stack.push([])),
    **dict.fromkeys(("LIST", "FROZENSET"), lambda stack, _: stack.push(stack.pop_to_mark())),
    **dict.fromkeys(("APPENDS", "ADDITEMS"), lambda stack, _: stack.extend(stack.pop_to_mark())),
    **dict.fromkeys(("REDUCE", "NEWOBJ"), lambda stack, _: stack.push_call()),
    **dict.fromkeys(("OBJ", "INST"), _Stack.push_instance),
    "NONE": lambda stack, _: stack.push(None),
    "NEWTRUE": lambda stack, _: stack.push(True),
    "NEWFALSE": lambda stack, _: stack.push(False),
    "MEMOIZE": lambda stack, _: stack.store(len(stack.memo)),
    "MARK": lambda stack, _: stack.push(_MARK),
    "POP": lambda stack, _: stack.pop(),
    "POP_MARK": lambda stack, _: stack.pop_to_mark(),
    "DUP": lambda stack, _: stack.push(stack.items[-1]),
    "EMPTY_TUPLE": lambda stack, _: stack.push(()),
    "TUPLE1": lambda stack, _: stack.push(stack.pop_tuple(1)),
    "TUPLE2": lambda stack, _: stack.push(stack.pop_tuple(2)),
    "TUPLE3": lambda stack, _: stack.push(stack.pop_tuple(3)),
    "TUPLE": lambda stack, _: stack.push(tuple(stack.pop_to_mark())),
    "EMPTY_DICT": lambda stack, _: stack.push({}),
    "DICT": lambda stack, _: stack.push_dict(),
    "APPEND": lambda stack, _: stack.extend([stack.pop()]),
    "SETITEM": lambda stack, _: stack.set_items([stack.pop(), stack.pop()][::-1]),
    "SETITEMS": lambda stack, _: stack.set_items(stack.pop_to_mark()),
    "GLOBAL": lambda stack, name: stack.push(Name(*name.split(" ", 1))),
    "STACK_GLOBAL": lambda stack, _: stack.push_name(),
    "NEWOBJ_EX": lambda stack, _: stack.push_call(stack.pop()),
    "BUILD": lambda stack, _: stack.set_state(),
    "BINPERSID": lambda stack, _: stack.push(Stored(stack.pop())),
}
ORDERED = Name("collections", "OrderedDict")


def _items_of(thing: Thing) -> dict[Any, Any]:
    """Return the items of an outlined `OrderedDict`, which are kept in its first argument."""
    if not (thing.arguments and isinstance(thing.arguments[0], dict)):
        thing.arguments = ({}, *thing.arguments[1:])
    return thing.arguments[0]


def mapping(value: Any) -> Mapping[Any, Any]:
    """Return the items of a dict or an `OrderedDict`.

    Args:
        value: Part of an outline.

    Returns:
        The items.

    Raises:
        InputError: The value is no dictionary.
    """
    if isinstance(value, dict):
        return value
    if isinstance(value, Thing) and value.made == ORDERED:
        return _items_of(value)
    raise InputError("not a dictionary")


# ------------------------------------------------------------------------------------------- arrays

#: supported kinds of numbers, by numpy's letter and torch's storage
KINDS: dict[str, np.dtype[Any]] = {
    "f4": np.dtype("<f4"),
    "f8": np.dtype("<f8"),
    "i4": np.dtype("<i4"),
    "i8": np.dtype("<i8"),
    "b1": np.dtype("?"),
}
STORAGES: dict[str, np.dtype[Any]] = {
    "FloatStorage": KINDS["f4"],
    "DoubleStorage": KINDS["f8"],
    "IntStorage": KINDS["i4"],
    "LongStorage": KINDS["i8"],
    "BoolStorage": KINDS["b1"],
}


def sizes(value: Any, what: str) -> tuple[int, ...]:
    """Return the sizes of an array.

    Args:
        value: Part of an outline.
        what: Description of the value, for messages.

    Returns:
        At most eight integers >= 0.

    Raises:
        InputError: The value is no such tuple.
    """
    if (
        not isinstance(value, tuple | list)
        or len(value) > DIMENSIONS
        or any(isinstance(n, bool) or not isinstance(n, int) or not 0 <= n < 2**40 for n in value)
    ):
        raise InputError(f"{what} are not whole numbers >= 0")
    return tuple(value)


def from_bytes(data: Any, kind: np.dtype[Any], shape: Any, fortran: bool = False) -> np.ndarray:
    """Return an array from its bytes.

    Args:
        data: Bytes of the array.
        kind: Numeric type.
        shape: Shape.
        fortran: Whether the order is column-major.

    Returns:
        The array.

    Raises:
        InputError: The number of bytes does not fit the shape.
    """
    dims = sizes(shape, "an array's sizes")
    if isinstance(data, Thing):  # protocols below 3 have no bytes
        text = data.arguments[0] if data.made == Name("_codecs", "encode") and data.arguments else ""
        data = text.encode("latin1", "replace") if isinstance(text, str) else None
    if not isinstance(data, bytes | bytearray) or len(data) != math.prod(dims) * kind.itemsize:
        raise InputError("an array is not as large as what is stored of it")
    return np.frombuffer(bytes(data), kind).reshape(dims, order="F" if fortran else "C")


def tensor(storage: np.ndarray, offset: Any, size: Any, stride: Any) -> np.ndarray:
    """Return a tensor as a copy of elements of a storage.

    Args:
        storage: Storage (n,).
        offset: First element.
        size: Shape.
        stride: Strides [elements].

    Returns:
        The tensor.

    Raises:
        InputError: An element is outside the storage, or the tensor has more elements than the storage.
    """
    (start,) = sizes((offset,), "a tensor's offset")
    dims, steps = sizes(size, "a tensor's sizes"), sizes(stride, "a tensor's strides")
    if len(dims) != len(steps):
        raise InputError("a tensor has other strides than sizes")
    if math.prod(dims) == 0:
        return np.zeros(dims, storage.dtype)
    last = start + sum((n - 1) * s for n, s in zip(dims, steps, strict=True))
    if last >= len(storage) or math.prod(dims) > len(storage):
        raise InputError("a tensor is larger than what is stored of it")
    index = np.array(start)
    for n, s in zip(dims, steps, strict=True):
        index = index[..., None] + s * np.arange(n)
    return storage[index]


def kind_of(value: Any) -> np.dtype[Any]:
    """Return the numeric type of a pickled `numpy.dtype`.

    Args:
        value: Part of an outline.

    Returns:
        Numeric type.

    Raises:
        InputError: Another type, or a foreign byte order.
    """
    if isinstance(value, Thing) and value.made == Name("numpy", "dtype") and value.arguments:
        code, state = value.arguments[0], value.state
        plain = state is None or (
            isinstance(state, tuple)
            and len(state) >= 5
            and state[1] in ("<", "|")
            and state[2] is state[3] is state[4] is None
        )
        if isinstance(code, str) and code in KINDS and plain:
            return KINDS[code]
    raise InputError("an array of another kind than plain numbers")


def array(value: Any) -> np.ndarray:
    """Return a pickled numpy array or scalar, or a plain number.

    Args:
        value: Part of an outline.

    Returns:
        The array.

    Raises:
        InputError: The value is no array of numbers.
    """
    if isinstance(value, int | float) and not isinstance(value, bool):
        try:
            return np.array(float(value))
        except OverflowError:
            raise InputError(f"{shown(value)} is too large") from None
    if isinstance(value, Thing) and isinstance(value.made, Name):
        module, _, last = value.made.module.rpartition(".")
        known = module in ("numpy.core", "numpy._core")
        given = value.arguments
        if known and (last, value.made.name) == ("multiarray", "_reconstruct"):
            state = value.state
            if isinstance(state, tuple) and len(state) == 5:
                return from_bytes(state[4], kind_of(state[2]), state[1], state[3] is True)
        if known and (last, value.made.name) == ("multiarray", "scalar") and len(given) == 2:
            return from_bytes(given[1], kind_of(given[0]), ())
        if known and (last, value.made.name) == ("numeric", "_frombuffer") and len(given) >= 4:
            return from_bytes(given[0], kind_of(given[1]), given[2], given[3] == "F")
    raise InputError("not an array of numbers")
