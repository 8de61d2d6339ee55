"""DriverArray messages, to CDR bytes."""

import struct
from array import array
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from rclpy.serialization import serialize_message
from sugiyama_msgs.msg import DriverArray

from sugiyama_ros.arrays import Array, Mask, selection
from sugiyama_ros.filters.online import Estimate
from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.nodes.base.cdr_messages import NS

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
    """DriverArray messages of the same drivers; the bytes are made once and filled with new numbers each time.

    drivers: the drivers, in the order in which every message has them; at least one; they may have different
    parameters.
    """

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
        self._lay_out(shown, adapted)

    def _lay_out(self, shown: list[str], adapted: list[str]) -> None:
        """Make the bytes, and find where the numbers stand in them."""
        count = len(self._of)
        message = DriverArray(vehicle=[vehicle for vehicle, _ in self._of], name=shown)
        message.header.frame_id = FRAME
        message.estimated = [name in adapted for name in shown]
        message.scored, message.identified = [False] * count, [False] * self._identified.size
        sizes = dict.fromkeys(_NUMBERS, count)
        sizes |= {"state_covariance": 9 * count, "value": self._value.size}
        sizes["parameter_covariance"] = self._covariance.size
        # special values, which nothing else in the message has, show where the numbers stand
        marks = {name: float(k) * 1.2345678901234567e-300 for k, name in enumerate(sizes, 1)}
        for name, size in sizes.items():
            setattr(message, name, array("d", [marks[name]] * size))
        self._bytes = bytearray(serialize_message(message))
        self._at = {name: self._bytes.find(struct.pack("<d", mark)) for name, mark in marks.items()}
        # a sequence of flags has its number of entries and then a byte for each of them
        self._scored_at = self._at["log_likelihood"] + 8 * count + 4
        self._identified_at = self._at["parameter_covariance"] + 8 * self._covariance.size + 4

    def fits(self, drivers: Sequence[KnownDriver]) -> bool:
        """Whether the drivers are the ones of this layout, with the same parameters."""
        return self._of == [(driver.vehicle, driver.names) for driver in drivers]

    def message(self, stamp_ns: int, drivers: Sequence[KnownDriver]) -> bytes:
        """Bytes of the message about drivers that fit, at a stamp [ns]."""
        struct.pack_into("<iI", self._bytes, 4, *divmod(stamp_ns, NS))
        columns = dict(zip(Estimate._fields, zip(*(driver.estimate for driver in drivers), strict=True), strict=True))
        for name in _NUMBERS:
            if name in SEVEN_DIGITS:
                self._put(self._at[name], _with_seven_digits(columns[name]))
            else:
                self._numbers.pack_into(self._bytes, self._at[name], *columns[name])
        self._put(self._at["state_covariance"], _with_seven_digits(columns["covariance"]))
        self._put(self._scored_at, bytes(columns["scored"]))
        for k, driver in enumerate(drivers):
            places, block = self._adapted[k]
            self._value[k, self._shown[k]] = driver.value
            self._covariance[k][block] = driver.covariance
            self._identified[k, places] = driver.identified
        self._put(self._at["value"], self._value.tobytes())
        self._put(self._at["parameter_covariance"], _with_seven_digits(self._covariance))
        self._put(self._identified_at, self._identified.tobytes())
        return bytes(self._bytes)

    def _put(self, at: int, content: bytes) -> None:
        self._bytes[at : at + len(content)] = content


def _with_seven_digits(numbers: ArrayLike) -> bytes:
    """Bytes of numbers as float64 whose digits beyond those of a float32 are 0, which compress well."""
    with np.errstate(over="ignore"):
        return np.asarray(numbers, dtype=np.float32).astype(np.float64).tobytes()
