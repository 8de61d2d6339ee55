"""The most frequent messages, to and from CDR bytes.

A message object costs 10 to 60 us. With 22 drivers in one process, that would be a quarter of the time of a step. The
functions here read and write the same bytes as rclpy does; a test compares them.
"""

import struct
from array import array
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import ArrayLike, NDArray
from rclpy.serialization import serialize_message
from sugiyama_msgs.msg import DriverArray, DriverParameters

from sugiyama_ros.arrays import Array, Mask, selection
from sugiyama_ros.filters.online import Estimate
from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.nodes.base.samples import Sample
from sugiyama_ros.trajectories.placing import Positions

NS = 1_000_000_000

# Encapsulation (CDR, little endian); stamp, frame, vehicle; then the fields, which need no further alignment.
_HEAD = "<4s i I I 5s 3x i"
_ENCAPSULATION = b"\0\1\0\0"
_FRAME_BYTES = FRAME.encode() + b"\0"
_CLOCK = struct.Struct("<4s i I")
# types of the sequences of MeasuredPositions that may be empty or absent
_OPTIONAL = ("<i4", "<f8", "<f8", "<f8")
# the covariance as the bytes of its nine numbers
_STATE = struct.Struct(_HEAD + "3d 72s 3d")
_INNOVATION = struct.Struct(_HEAD + "4d ?")
# Fields with one number for each driver, named as in an estimate.
_NUMBERS = tuple(name for name in Estimate._fields if name not in ("covariance", "scored"))
#: Fields whose numbers have seven digits, so that a recording is smaller by a quarter.
SEVEN_DIGITS = frozenset(
    {
        "state_covariance",
        "acceleration",
        "mean_action",
        "approach_rate",
        "innovation_var",
        "log_likelihood",
        "parameter_covariance",
    }
)
# what is read of many innovations, in the layout of _INNOVATION
_READ = np.dtype(
    {
        "names": ["encapsulation", "frame", "vehicle", "innovation_m", "nis", "scored"],
        "formats": ["S4", "S5", "<i4", "<f8", "<f8", "?"],
        "offsets": [0, 16, 24, 28, 44, 60],
        "itemsize": _INNOVATION.size,
    }
)


def measured(raw: bytes) -> Sample:
    """Decode a MeasuredPositions message, also one of the older definition, which ends with the lengths.

    Raises ValueError or struct.error where the bytes are cut off, or in a format other than plain little-endian CDR.
    """
    if raw[:2] != b"\0\1":
        raise ValueError(f"measured positions in CDR format {raw[:2].hex()}, not in little-endian plain CDR")
    sec, nanosec, frame = struct.unpack_from("<iII", raw, 4)
    at = 4 + _aligned(12 + frame, 8)
    (step,) = struct.unpack_from("<Q", raw, at)
    vehicle, at = _sequence(raw, at + 8, "<i4")
    leader, at = _sequence(raw, at, "<i4")
    position, at = _sequence(raw, at, "<f8")
    length, at = _sequence(raw, at, "<f8")
    place = {v: k for k, v in enumerate(vehicle)}
    optional: list[list[Any]] = []
    if len(raw) >= 4 + _aligned(at - 4, 4) + 4:
        for dtype in _OPTIONAL:
            found, at = _sequence(raw, at, dtype)
            optional.append(found)
    return Sample(sec * NS + nanosec, step, leader, position, length, place, *optional)


def measured_positions(stamp_ns: int, step: int, positions: Positions) -> bytes:
    """A MeasuredPositions message of sample number ``step``."""
    *head, _ = _head(stamp_ns, 0)
    arrays: tuple[Sequence[float], ...] = positions
    numbers = [number for values in arrays for number in (len(values), *values)]
    return _layout(*map(len, arrays)).pack(*head, step, *numbers)


@lru_cache(maxsize=16)
def _layout(*counts: int) -> struct.Struct:
    """Layout of a MeasuredPositions message whose sequences have so many entries."""
    layout = "<4s i I I 5s 7x Q"
    for count, dtype in zip(counts, ("<i4", "<i4", "<f8", "<f8", *_OPTIONAL), strict=True):
        # CDR counts from behind the encapsulation. Nothing is aligned for an empty sequence.
        at = struct.calcsize(layout) - 4
        first = _aligned(at, 4) + 4
        size = int(dtype[-1])
        gap = _aligned(first, size) - first if count else 0
        layout += f" {_aligned(at, 4) - at}x I {gap}x {count}{'i' if size == 4 else 'd'}"
    return struct.Struct(layout)


def clock(stamp_ns: int) -> bytes:
    """A Clock message."""
    return _CLOCK.pack(_ENCAPSULATION, *divmod(stamp_ns, NS))


def time_message(stamp_ns: int) -> Time:
    """A stamp as a message."""
    sec, nanosec = divmod(stamp_ns, NS)
    return Time(sec=sec, nanosec=nanosec)


def stamp_key(raw: bytes) -> bytes:
    """Bytes of the stamp in a message that starts with a header or with a stamp."""
    return raw[4:12]


def state(stamp_ns: int, vehicle: int, estimate: Estimate) -> bytes:
    """A VehicleState message."""
    e = estimate
    return _STATE.pack(
        *_head(stamp_ns, vehicle),
        e.position_m,
        e.speed,
        e.acceleration,
        e.covariance.tobytes(),
        e.mean_action,
        e.gap_m,
        e.approach_rate,
    )


def innovation(stamp_ns: int, vehicle: int, estimate: Estimate) -> bytes:
    """An Innovation message."""
    e = estimate
    return _INNOVATION.pack(
        *_head(stamp_ns, vehicle), e.innovation_m, e.innovation_var, e.nis, e.log_likelihood, e.scored
    )


def read_innovations(messages: Iterable[bytes]) -> NDArray[np.void]:
    """Read many Innovations at once: ``vehicle``, ``innovation_m``, ``nis`` and ``scored`` of those from estimators."""
    size = _INNOVATION.size
    found = np.frombuffer(b"".join(raw[:size] for raw in messages if len(raw) >= size), _READ)
    # numpy leaves out zeros at the end of texts
    is_known = (found["encapsulation"] == _ENCAPSULATION.rstrip(b"\0")) & (found["frame"] == _FRAME_BYTES.rstrip(b"\0"))
    return found[is_known]


class _Template:
    """The bytes of a message, made once; lists of numbers are filled in each time."""

    def __init__(self, message: Any, sizes: Mapping[str, int]) -> None:
        """sizes: number of entries of each list of numbers."""
        message.header.frame_id = FRAME
        # special values, which nothing else in the message has, show where the numbers stand
        marks = {name: float(k) * 1.2345678901234567e-300 for k, name in enumerate(sizes, 1)}
        for name, size in sizes.items():
            setattr(message, name, array("d", [marks[name]] * size))
        self.bytes = bytearray(serialize_message(message))
        self._at = {name: self.bytes.find(struct.pack("<d", mark)) for name, mark in marks.items()}
        # flags that follow a list have their number of entries and then a byte for each of them
        self._behind = {name: self._at[name] + 8 * size + 4 for name, size in sizes.items()}

    def stamp(self, stamp_ns: int) -> None:
        """Fill in the stamp [ns]."""
        struct.pack_into("<iI", self.bytes, 4, *divmod(stamp_ns, NS))

    def put(self, name: str, content: bytes) -> None:
        """Fill in a list of numbers."""
        self.bytes[self._at[name] : self._at[name] + len(content)] = content

    def put_behind(self, name: str, flags: bytes) -> None:
        """Fill in the flags that follow a list."""
        self.bytes[self._behind[name] : self._behind[name] + len(flags)] = flags


class ParametersWriter:
    """DriverParameters messages of one driver."""

    def __init__(self, vehicle: int, names: Sequence[str], adapted: Sequence[str]) -> None:
        count, estimated = len(names), [name in adapted for name in names]
        message = DriverParameters(vehicle=vehicle, name=names, estimated=estimated, identified=[False] * count)
        self._template = _Template(message, {"value": count, "covariance": count * count})

    def message(self, stamp_ns: int, value: Array, covariance: Array, identified: Mask) -> bytes:
        """Bytes of a message with ``value`` (P,), ``covariance`` (P, P) and ``identified`` (P,)."""
        template = self._template
        template.stamp(stamp_ns)
        template.put("value", value.tobytes())
        template.put("covariance", covariance.tobytes())
        template.put_behind("covariance", identified.tobytes())
        return bytes(template.bytes)


class ParameterNames(NamedTuple):
    """Names of a driver's parameters, and of the parameters among them that the filter adapts, in the same order."""

    shown: tuple[str, ...]
    adapted: tuple[str, ...]


class KnownDriver(NamedTuple):
    """What a filter knows of its driver after a sample.

    vehicle: number of the driver's vehicle; estimate: state and innovation; names: names of P parameters, A of them
    adapted; value: (P,), the parameters [SI]; covariance: (A, A), covariance of the adapted parameters; identified:
    whether the samples so far determine the parameter.
    """

    vehicle: int
    estimate: Estimate
    names: ParameterNames
    value: Array
    covariance: Array
    identified: Mask


class ArrayWriter:
    """DriverArray messages of the same drivers, at least one, in this order; they may have different parameters."""

    def __init__(self, drivers: Sequence[KnownDriver]) -> None:
        self._of = [(driver.vehicle, driver.names) for driver in drivers]
        shown = list(dict.fromkeys(name for driver in drivers for name in driver.names.shown))
        adapted = [name for name in shown if any(name in driver.names.adapted for driver in drivers)]
        count, self._value = len(drivers), np.full((len(drivers), len(shown)), np.nan)
        self._covariance = np.zeros((count, len(adapted), len(adapted)))
        self._identified = np.zeros((count, len(adapted)), np.bool_)
        self._shown = [selection([shown.index(name) for name in driver.names.shown]) for driver in drivers]
        at = [selection([adapted.index(name) for name in driver.names.adapted]) for driver in drivers]
        self._adapted = [(k, (k, k) if isinstance(k, slice) else np.ix_(k, k)) for k in at]
        self._numbers = struct.Struct(f"<{count}d")
        message = DriverArray(vehicle=[vehicle for vehicle, _ in self._of], name=shown)
        message.estimated = [name in adapted for name in shown]
        message.scored, message.identified = [False] * count, [False] * self._identified.size
        sizes = dict.fromkeys(_NUMBERS, count) | {"state_covariance": 9 * count, "value": self._value.size}
        self._template = _Template(message, sizes | {"parameter_covariance": self._covariance.size})

    def fits(self, drivers: Sequence[KnownDriver]) -> bool:
        """Whether the drivers are the ones of this layout, with the same parameters."""
        return self._of == [(driver.vehicle, driver.names) for driver in drivers]

    def message(self, stamp_ns: int, drivers: Sequence[KnownDriver]) -> bytes:
        """Bytes of the message about drivers that fit, at a stamp [ns]."""
        template = self._template
        template.stamp(stamp_ns)
        columns = dict(zip(Estimate._fields, zip(*(driver.estimate for driver in drivers), strict=True), strict=True))
        for name in _NUMBERS:
            numbers = columns[name]
            template.put(name, _seven_digits(numbers) if name in SEVEN_DIGITS else self._numbers.pack(*numbers))
        template.put("state_covariance", _seven_digits(columns["covariance"]))
        template.put_behind("log_likelihood", bytes(columns["scored"]))
        for k, driver in enumerate(drivers):
            places, block = self._adapted[k]
            self._value[k, self._shown[k]] = driver.value
            self._covariance[k][block] = driver.covariance
            self._identified[k, places] = driver.identified
        template.put("value", self._value.tobytes())
        template.put("parameter_covariance", _seven_digits(self._covariance))
        template.put_behind("parameter_covariance", self._identified.tobytes())
        return bytes(template.bytes)


def _seven_digits(numbers: ArrayLike) -> bytes:
    """Bytes of numbers as float64 whose digits beyond those of a float32 are 0, which compress well."""
    with np.errstate(over="ignore"):
        return np.asarray(numbers, dtype=np.float32).astype(np.float64).tobytes()


def _head(stamp_ns: int, vehicle: int) -> tuple[bytes, int, int, int, bytes, int]:
    sec, nanosec = divmod(stamp_ns, NS)
    return _ENCAPSULATION, sec, nanosec, len(_FRAME_BYTES), _FRAME_BYTES, vehicle


def _aligned(offset: int, size: int) -> int:
    return -(-offset // size) * size


def _sequence(raw: bytes, at: int, dtype: str) -> tuple[list[Any], int]:
    """A sequence of numbers whose count stands at or after byte ``at``, and the byte behind it."""
    size = int(dtype[-1])
    at = 4 + _aligned(at - 4, 4)
    (count,) = struct.unpack_from("<I", raw, at)
    # An empty sequence has only its count, so nothing is aligned for it.
    first = 4 + _aligned(at, size) if count else at + 4
    return np.frombuffer(raw, dtype, count, first).tolist(), first + size * count
