"""Where the values of a message stand in its bytes (plain CDR): it follows from the fields and types of its class."""

import struct
from collections.abc import Callable
from functools import cache
from importlib import import_module
from itertools import takewhile
from typing import Any

from rosidl_parser.definition import AbstractSequence, AbstractString, Array, BasicType, NamespacedType

#: Bytes before the first field of a message. Offsets count from the first field.
ENCAPSULATION = 4
# Bytes of the basic types of CDR.
_SIZES = {
    **dict.fromkeys(("boolean", "octet", "char", "uint8", "int8"), 1),
    **dict.fromkeys(("int16", "uint16", "wchar"), 2),
    **dict.fromkeys(("int32", "uint32", "float"), 4),
    **dict.fromkeys(("int64", "uint64", "double"), 8),
}
# Moves on from an offset, over one value.
_Skip = Callable[[memoryview, int], int]


@cache
def over(kind: Any, order: str) -> _Skip:
    """What moves over a message of a class. It raises ValueError where the lengths that a message claims do not fit.

    The middleware makes room for everything that a message claims before it reads it: 60 bytes that claim 2**28 texts
    take 11 GB. So this is checked first.
    """
    fields = [_skip(one, order) for one in kind.SLOT_TYPES]

    def skip(body: memoryview, at: int) -> int:
        for field in fields:
            at = field(body, at)
        return at

    return skip


def offset(kind: Any, name: str, body: memoryview, at: int) -> int:
    """Offset of a number in a message (little endian) of a class that begins at ``at``.

    name: of its field, such as ``pose.position.x``.
    """
    field, _, rest = name.partition(".")
    types = dict(zip(kind.get_fields_and_field_types(), kind.SLOT_TYPES, strict=True))
    for before in takewhile(lambda other: other != field, types):
        at = _skip(types[before], "<")(body, at)
    inner = types[field]
    return offset(_class(inner), rest, body, at) if rest else _aligned(at, _SIZES[inner.typename])


def _skip(kind: Any, order: str) -> _Skip:
    """What moves over one value of a type."""
    if isinstance(kind, BasicType):
        return _elements(_SIZES[kind.typename], 1)
    if isinstance(kind, AbstractString):
        return lambda body, at: _elements(1, _length(order, body, at))(body, _aligned(at, 4) + 4)
    if isinstance(kind, NamespacedType):
        return over(_class(kind), order)
    element = kind.value_type
    size = _SIZES[element.typename] if isinstance(element, BasicType) else 0
    one = _skip(element, order)

    def several(body: memoryview, at: int, count: int) -> int:
        if size:
            return _elements(size, count)(body, at)
        if count > len(body) - at:
            raise ValueError(f"claims {count} elements")
        for _ in range(count):
            at = one(body, at)
        return at

    if isinstance(kind, Array):
        return lambda body, at: several(body, at, kind.size)
    assert isinstance(kind, AbstractSequence)
    return lambda body, at: several(body, _aligned(at, 4) + 4, _length(order, body, at))


def _class(kind: NamespacedType) -> Any:
    return getattr(import_module(".".join(kind.namespaces)), kind.name)


def _elements(size: int, count: int) -> _Skip:
    def skip(body: memoryview, at: int) -> int:
        end = _aligned(at, size) + count * size if count else at
        if end > len(body):
            raise ValueError(f"claims {end} bytes, has {len(body)}")
        return end

    return skip


def _aligned(at: int, size: int) -> int:
    return -(-at // size) * size


def _length(order: str, body: memoryview, at: int) -> int:
    try:
        return int(struct.unpack_from(f"{order}I", body, _aligned(at, 4))[0])
    except struct.error:
        raise ValueError("is cut off") from None
