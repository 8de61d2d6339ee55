"""The most frequent messages, to and from CDR bytes.

A message object costs 10 to 60 us. With 22 drivers in one process, that would be a quarter of the time of a step. The
functions here read and write the same bytes as rclpy does; a test compares them.
"""

import struct
from array import array
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from rclpy.serialization import serialize_message
from sugiyama_msgs.msg import DriverParameters, DriverType, StyleChange

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.filters.online import Estimate
from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.nodes.base.samples import Positions

NS = 1_000_000_000
#: Length [m] that no vehicle has.
LONGEST_M = 1000.0

# Encapsulation (CDR, little endian); stamp, frame, vehicle; then the fields, which need no further alignment.
_HEAD = "<4s i I I 5s 3x i"
_ENCAPSULATION = b"\0\1\0\0"
_FRAME_BYTES = FRAME.encode() + b"\0"
_CLOCK = struct.Struct("<4s i I")
_MARK = 1.2345678901234567e-300
# types of the sequences of MeasuredPositions that may be empty or absent
_OPTIONAL = ("<i4", "<f8", "<f8", "<f8")
# the covariance as the bytes of its nine numbers
_STATE = struct.Struct(_HEAD + "3d 72s 3d")
_INNOVATION = struct.Struct(_HEAD + "4d ?")
# what is read of many innovations, in the layout of _INNOVATION
_READ = np.dtype(
    {
        "names": ["encapsulation", "frame", "vehicle", "innovation_m", "nis", "scored"],
        "formats": ["S4", "S5", "<i4", "<f8", "<f8", "?"],
        "offsets": [0, 16, 24, 28, 44, 60],
        "itemsize": _INNOVATION.size,
    }
)


class Sample(NamedTuple):
    """A MeasuredPositions message: lists with one entry for each vehicle; ``place`` is the entry of each number.

    From ``lane`` on, the sequences are empty where the source does not know them.
    """

    stamp_ns: int
    step: int
    leader: list[int]
    position_m: list[float]
    length_m: list[float]
    place: dict[int, int]
    lane: Sequence[int] = ()
    d_m: Sequence[float] = ()
    stamp_offset_s: Sequence[float] = ()
    position_var: Sequence[float] = ()

    def chain(self, vehicle: int, length: int) -> list[int]:
        """``length`` numbers: ``vehicle``, its leader, the leader's leader and so on; -1 where there is none."""
        numbers = [vehicle]
        while len(numbers) < length:
            place = self.place.get(numbers[-1])
            leader = -1 if place is None else self.leader[place]
            # on a ring with few vehicles, the chain ends before it comes back to the first vehicle
            numbers.append(-1 if leader in numbers else leader)
        return numbers

    def known_length_m(self, place: int) -> float:
        """Length [m] of the vehicle at a place; 0 if what was sent is no length."""
        length_m = self.length_m[place]
        return length_m if 0.0 <= length_m < LONGEST_M else 0.0

    def behind(self, vehicle: int) -> int:
        """Number of the vehicle whose leader is ``vehicle``; -1 if there is none."""
        return next((number for number, place in self.place.items() if self.leader[place] == vehicle), -1)


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


def read_state(raw: bytes) -> tuple[float, int, float, float, float]:
    """Time [s], vehicle, position [m], speed [m/s] and its variance of a VehicleState from an estimator."""
    _, sec, nanosec, _, _, vehicle, position, speed, _, covariance, *_ = _unpacked(_STATE, raw)
    (speed_var,) = struct.unpack_from("<d", covariance, 4 * 8)
    return sec + 1e-9 * nanosec, vehicle, position, speed, speed_var


class ReadInnovation(NamedTuple):
    """What is read of an Innovation: time [s], vehicle, the innovation [m], its variance [m^2], nis, and scored."""

    time_s: float
    vehicle: int
    innovation_m: float
    innovation_var: float
    nis: float
    scored: bool


def read_innovation(raw: bytes) -> ReadInnovation:
    """Read an Innovation from an estimator."""
    _, sec, nanosec, _, _, vehicle, value, variance, nis, _, scored = _unpacked(_INNOVATION, raw)
    return ReadInnovation(sec + 1e-9 * nanosec, vehicle, value, variance, nis, scored)


def read_innovations(messages: Iterable[bytes]) -> NDArray[np.void]:
    """Read many Innovations at once: ``vehicle``, ``innovation_m``, ``nis`` and ``scored`` of those from estimators."""
    size = _INNOVATION.size
    found = np.frombuffer(b"".join(raw[:size] for raw in messages if len(raw) >= size), _READ)
    # numpy leaves out zeros at the end of texts
    is_known = (found["encapsulation"] == _ENCAPSULATION.rstrip(b"\0")) & (found["frame"] == _FRAME_BYTES.rstrip(b"\0"))
    return found[is_known]


def style_change(stamp_ns: int, vehicle: int, name: str, factor: float) -> bytes:
    """A StyleChange message."""
    message = StyleChange(vehicle=vehicle, name=name, factor=factor)
    message.header.frame_id = FRAME
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NS)
    return bytes(serialize_message(message))


def driver_type(stamp_ns: int, vehicle: int, probability: Array) -> bytes:
    """A DriverType message."""
    message = DriverType(vehicle=vehicle, probability=probability.tolist())
    message.header.frame_id = FRAME
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NS)
    return bytes(serialize_message(message))


class Parameters:
    """DriverParameters messages of one driver; the bytes are made once and filled with new numbers each time."""

    def __init__(self, vehicle: int, names: Sequence[str], adapted: Sequence[str]) -> None:
        count = len(names)
        message = DriverParameters(vehicle=vehicle, name=names, estimated=[name in adapted for name in names])
        message.header.frame_id = FRAME
        # special values, which nothing else in the message has, show where the numbers stand
        message.value, message.covariance = array("d", [_MARK] * count), array("d", [2.0 * _MARK] * count * count)
        message.identified = [False] * count
        self._bytes = bytearray(serialize_message(message))
        self._value_at = self._bytes.index(struct.pack("<d", _MARK))
        self._covariance_at = self._bytes.index(struct.pack("<d", 2.0 * _MARK))
        # after the covariance comes the number of the last field's entries, a byte each
        self._identified_at = self._covariance_at + 8 * count * count + 4

    def message(self, stamp_ns: int, value: Array, covariance: Array, identified: Mask) -> bytes:
        """Bytes of a message with ``value`` (P,), ``covariance`` (P, P) and ``identified`` (P,)."""
        struct.pack_into("<iI", self._bytes, 4, *divmod(stamp_ns, NS))
        filled = (self._value_at, value), (self._covariance_at, covariance), (self._identified_at, identified)
        for at, numbers in filled:
            self._bytes[at : at + numbers.nbytes] = numbers.tobytes()
        return bytes(self._bytes)


def _unpacked(layout: struct.Struct, raw: bytes) -> tuple[Any, ...]:
    """Fields of a message from an estimator. Raises ValueError or struct.error for bytes of another kind."""
    found = layout.unpack_from(raw)
    if (found[0], found[4]) != (_ENCAPSULATION, _FRAME_BYTES):
        raise ValueError("is no message of an estimator")
    return found


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
