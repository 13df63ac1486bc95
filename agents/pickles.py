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
    from collections.abc import Mapping

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


class _Mark:
    pass


_MARK = _Mark()


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
    stack: list[Any] = []
    memo: dict[int, Any] = {}

    def since_mark() -> list[Any]:
        at = len(stack) - 1
        while stack[at] is not _MARK:  # IndexError without a mark
            at -= 1
        items = stack[at + 1 :]
        del stack[at:]
        return items

    def put(target: Any, pairs: list[Any]) -> None:
        if isinstance(target, Thing):
            target = _items_of(target)
        for key, value in zip(pairs[::2], pairs[1::2], strict=True):
            if isinstance(key, str | int | float | bytes | None):
                target[key] = value

    def extend(target: Any, items: list[Any]) -> None:
        if isinstance(target, list):
            target += items
        elif not isinstance(target, Thing | set):
            raise ValueError("no list")

    try:
        argument: Any
        for step, (opcode, argument, _) in enumerate(pickletools.genops(data)):
            if step > OPCODES:
                raise InputError(f"a pickle of more than {OPCODES} steps")
            name = opcode.name
            if name in _CONSTANTS:
                stack.append(_CONSTANTS[name])
            elif name in _VALUES:
                stack.append(argument)
            elif name in ("PROTO", "FRAME"):
                continue
            elif name == "STOP":
                return stack.pop()
            elif name in ("PUT", "BINPUT", "LONG_BINPUT"):
                memo[argument] = stack[-1]
            elif name == "MEMOIZE":
                memo[len(memo)] = stack[-1]
            elif name in ("GET", "BINGET", "LONG_BINGET"):
                stack.append(memo[argument])
            elif name == "MARK":
                stack.append(_MARK)
            elif name == "POP":
                stack.pop()
            elif name == "POP_MARK":
                since_mark()
            elif name == "DUP":
                stack.append(stack[-1])
            elif name in ("EMPTY_TUPLE", "TUPLE1", "TUPLE2", "TUPLE3"):
                count = ("EMPTY_TUPLE", "TUPLE1", "TUPLE2", "TUPLE3").index(name)
                items = stack[len(stack) - count :]
                del stack[len(stack) - count :]
                stack.append(tuple(items))
            elif name == "TUPLE":
                stack.append(tuple(since_mark()))
            elif name in ("EMPTY_LIST", "EMPTY_DICT", "EMPTY_SET"):
                stack.append([] if name != "EMPTY_DICT" else {})
            elif name == "LIST" or name == "FROZENSET":
                stack.append(since_mark())
            elif name == "DICT":
                pairs = since_mark()
                stack.append({})
                put(stack[-1], pairs)
            elif name == "APPEND":
                item = stack.pop()
                extend(stack[-1], [item])
            elif name in ("APPENDS", "ADDITEMS"):
                items = since_mark()
                extend(stack[-1], items)
            elif name == "SETITEM":
                value, key = stack.pop(), stack.pop()
                put(stack[-1], [key, value])
            elif name == "SETITEMS":
                pairs = since_mark()
                put(stack[-1], pairs)
            elif name == "GLOBAL":
                stack.append(Name(*argument.split(" ", 1)))
            elif name == "STACK_GLOBAL":
                inner, outer = stack.pop(), stack.pop()
                stack.append(Name(str(outer)[:200], str(inner)[:200]))
            elif name in ("REDUCE", "NEWOBJ"):
                given, made = stack.pop(), stack.pop()
                stack.append(Thing(made, given if isinstance(given, tuple) else ()))
            elif name == "NEWOBJ_EX":
                _, given, made = stack.pop(), stack.pop(), stack.pop()
                stack.append(Thing(made, given if isinstance(given, tuple) else ()))
            elif name in ("OBJ", "INST"):
                given = since_mark()
                made = Name(*argument.split(" ", 1)) if name == "INST" else given.pop(0)
                stack.append(Thing(made, tuple(given)))
            elif name == "BUILD":
                state = stack.pop()
                if isinstance(stack[-1], Thing):
                    stack[-1].state = state
            elif name == "BINPERSID":
                stack.append(Stored(stack.pop()))
            else:  # extension codes and out-of-band buffers do not occur in supported files
                raise ValueError(name)
    except InputError:
        raise
    except Exception as error:  # an opcode on an empty stack, or an invalid text
        raise InputError(f"not a pickle that can be read ({type(error).__name__})") from None
    raise InputError("a pickle without an end")


_CONSTANTS: dict[str, Any] = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_VALUES = {
    *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
    *("STRING", "BINSTRING", "SHORT_BINSTRING", "UNICODE", "SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8"),
    *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
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
