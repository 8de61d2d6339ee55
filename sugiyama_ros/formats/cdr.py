"""Messages to and from bytes (CDR, or ROS 1) without ROS, from the text of their definition."""

import dataclasses
import math
import re
import struct
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.base import TypesysError
from rosbags.typesys.store import Typestore

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.definitions import full_text

# A definition inside a file may be hostile. rosbags makes Python code from it. Its grammar accepts only plain names,
# but it unrolls arrays and follows types into types, so their size is bounded here.
_MAX_TEXT = 1 << 16
_MAX_DEPTH = 8
_MAX_UNROLLED = 1000
# Definitions that are kept compiled. A file has one channel for each topic, but few types.
_KEPT = 64
# What stands between two files of a definition in IDL.
_NEXT_IDL = "=" * 80 + "\nIDL: "
# Lines such as #include: what they name is in the definition itself.
_PREPROCESSOR = re.compile(r"^[ \t]*#.*$", re.MULTILINE)
#: Kinds of definitions that can be used, as MCAP calls them.
_KINDS = ("ros2msg", "ros2idl", "omgidl", "ros1msg")
# Bytes that ROS may leave behind the end of a message for each list in it, which may have been empty.
_PADDING = 8
#: Largest message [bytes] that is decoded if it holds lists of messages or texts, each a Python object.
_MAX_COMPOUND = 1 << 18

Decoder = Callable[[bytes], Any]


@lru_cache(maxsize=_KEPT)
def decoder(type_name: str, text: str, kind: str = "ros2msg") -> Decoder | None:
    """Make a function that decodes a message.

    The function is made once for each definition, because rosbags compiles Python code for it.

    type_name: name of the type, such as ``std_msgs/msg/Header``; kind: kind of the definition; the messages of a
    ``ros1msg`` are in the encoding of ROS 1, all others in CDR.
    """
    store = _store(type_name, text, kind)
    if store is None:
        return None
    fields = [desc for _, fields in store.fielddefs.values() for _, desc in fields]
    compound = any(desc[0] == Nodetype.SEQUENCE and _is_object(_inner(desc)) for desc in fields)
    largest = _MAX_COMPOUND if compound else None
    padding = _PADDING * (1 + sum(desc[0] == Nodetype.SEQUENCE for desc in fields))

    def decode(data: bytes) -> Any:
        if largest is not None and len(data) > largest:
            raise ValueError(f"{len(data)} bytes are more than the limit of {largest} for a {type_name}")
        if kind != "ros1msg" and data[:2] not in (b"\0\0", b"\0\1"):
            raise ValueError("does not begin like CDR")
        try:
            made = store.get_msgdef(type_name)
            if kind == "ros1msg":
                message, end = made.deserialize_ros1(memoryview(data), 0, made.cls, store)
                rest = len(data) - end
            else:
                read = made.deserialize_cdr_le if data[1] else made.deserialize_cdr_be
                message, end = read(memoryview(data)[4:], 0, made.cls, store)
                rest = max(0, len(data) - 4 - end - padding)
        except (SerdeError, struct.error, ValueError, IndexError, RecursionError) as error:
            raise ValueError(" ".join(str(error).split())) from None
        if rest:
            raise ValueError("is longer than its definition says")
        return message

    return decode


def decoder_of(type_name: str, text: str, kind: str, encoding: str) -> Decoder | str:
    """Make a decoder for the messages of a channel of a bag.

    Where the bag has no definition, or one that cannot be used, the installed definition of the type counts.
    """
    if why := why_unreadable(encoding):
        return why
    if not type_name:
        return "the bag does not say the type of its messages; record it again"
    name, known = ros2_name(type_name), "ros1msg" if encoding == "ros1" else "ros2msg"
    if kind in _KINDS and text.strip() and (kind == "ros1msg") == (encoding == "ros1"):
        made = decoder(name, text, kind)
        if made is not None:
            return made
        what = f"its definition ({kind}) cannot be used"
        if kind not in ("ros2idl", "omgidl"):  # it says something else than what is installed
            return f"{what}; record the topic again"
    else:
        what = f"its definition is in {kind}" if text.strip() else "the bag does not have its definition"
    text, package = _known_text(name, known), name.partition("/")[0]
    made = decoder(name, text, known) if text else None
    return made or f"{what}, and {package} is not installed; install {package}, or record the topic again with it"


def why_unreadable(encoding: str) -> str:
    """Why messages in an encoding cannot be read, and what to do; empty if they can."""
    if encoding in ("cdr", "ros1"):
        return ""
    return f"its messages are in {encoding or 'no known encoding'}; record them as messages of ROS (cdr or ros1)"


def ros2_name(type_name: str) -> str:
    """Name of a type as in ROS 2: ``nav_msgs/msg/Odometry`` for ``nav_msgs/Odometry`` of ROS 1."""
    package, _, name = type_name.partition("/")
    return f"{package}/msg/{name}" if name and "/" not in name else type_name


def _known_text(type_name: str, kind: str) -> str:
    """Definition of a type that is installed, or that rosbags brings; empty if there is none."""
    if kind == "ros2msg":
        with suppress(InputError):
            return full_text(type_name)
    store = get_typestore(Stores.LATEST if kind == "ros2msg" else Stores.ROS1_NOETIC)
    if type_name not in store.fielddefs:
        return ""
    return store.generate_msgdef(type_name, ros_version=2 if kind == "ros2msg" else 1)[0]


def plain(value: Any) -> Any:
    """A decoded message as dictionaries, lists, numbers and texts, for printing."""
    if dataclasses.is_dataclass(value):
        # Fields have no default; the constants of a message have one.
        fields = (field.name for field in dataclasses.fields(value) if field.default is dataclasses.MISSING)
        return {name: plain(getattr(value, name)) for name in fields}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, bytes):  # of a message that cannot be decoded
        return value.hex()
    return [plain(element) for element in value] if isinstance(value, list) else value


class Encoder:
    """Builds and encodes messages of installed types. The bytes are the same as from a ROS 2 publisher."""

    def __init__(self, *type_names: str) -> None:
        """Raises InputError where a definition is not installed or cannot be used."""
        self._stores: dict[str, Typestore] = {}
        for type_name in type_names:
            store = _store(type_name, full_text(type_name))
            if store is None:
                raise InputError(f"{type_name}: its installed definition cannot be read; install its package again")
            self._stores[type_name] = store

    def __call__(self, type_name: str, **fields: Any) -> bytes:
        """CDR bytes of a message. Give a nested message as a dictionary of its fields; a list left out is empty."""
        store = self._stores[type_name]
        return bytes(store.serialize_cdr(_build(store, type_name, fields), type_name, little_endian=True))


def _build(store: Typestore, type_name: str, fields: dict[str, Any]) -> Any:
    """A message object with its nested messages."""
    message_type: Any = store.types[type_name]
    nested = {name: desc[1] for name, desc in store.fielddefs[type_name][1] if desc[0] == Nodetype.NAME}
    lists = [name for name, desc in store.fielddefs[type_name][1] if desc[0] == Nodetype.SEQUENCE]
    values = {name: _build(store, str(nested[name]), v) if name in nested else v for name, v in fields.items()}
    return message_type(**{name: np.zeros(0) for name in lists} | values)


def _store(type_name: str, text: str, kind: str = "ros2msg") -> Typestore | None:
    """Types of a definition and of the types in it; None if it is malformed or too large."""
    if len(text) > _MAX_TEXT:
        return None
    try:
        store = get_typestore(Stores.EMPTY)
        text = text.replace("\r\n", "\n")
        if kind in ("ros2idl", "omgidl"):
            first, *others = text.split(_NEXT_IDL)
            for part in (first, *(other.partition("\n")[2] for other in others)):
                if part.strip():
                    store.register(get_types_from_idl(_PREPROCESSOR.sub("", part)))
        else:
            store.register(get_types_from_msg(text, type_name))
        return store if _depth(type_name, store, {}) <= _MAX_DEPTH else None
    except (TypesysError, SyntaxError, ValueError, TypeError, AssertionError, RecursionError):
        return None


def _depth(type_name: str, store: Typestore, known: dict[str, float]) -> float:
    """Levels of messages within messages below a type; infinite if the type contains itself.

    Raises ValueError where a type is not defined or an array is too large to unroll.
    """
    if type_name not in known:
        if type_name not in store.fielddefs:
            raise ValueError(f"{type_name} is not defined")
        known[type_name] = math.inf
        inner = [(desc, _inner(desc)) for _, desc in store.fielddefs[type_name][1]]
        # An empty array takes no bytes, so that the length of the data would not bound the work.
        sizes = [desc[1][1] for desc, _ in inner if desc[0] == Nodetype.ARRAY]
        unrolled = sum(desc[1][1] for desc, of in inner if desc[0] == Nodetype.ARRAY and _is_object(of))
        if min(sizes, default=1) < 1 or unrolled > _MAX_UNROLLED:
            raise ValueError(f"{type_name} has an array of a size that is not decoded")
        below = (_depth(str(of[1]), store, known) for _, of in inner if of[0] == Nodetype.NAME)
        known[type_name] = 1 + max(below, default=0)
    return known[type_name]


def _inner(desc: Any) -> Any:
    """Description of the elements of a list, or of the field itself if it is not a list."""
    return desc[1][0] if desc[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else desc


def _is_object(desc: Any) -> bool:
    """Whether each element becomes a Python object; numbers share one array."""
    return bool(desc[0] == Nodetype.NAME or desc[1][0] == "string")
