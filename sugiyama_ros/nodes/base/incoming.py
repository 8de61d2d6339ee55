"""The one place that decodes and checks what other nodes send. A message that is not valid is dropped, with a reason.

The middleware hands over bytes, because a message that it cannot decode would end the node. A function of this module
decodes them and raises `RefusedError` if they are no valid message.
"""

import traceback
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from math import isfinite, isnan, nan
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message
from sugiyama_msgs.msg import DriverArray, DriverParameters, MeasuredPositions, Verdict
from sugiyama_msgs.msg import Road as RoadMessage

from sugiyama_ros.nodes.base.cdr_layout import ENCAPSULATION, over
from sugiyama_ros.nodes.base.cdr_messages import NS
from sugiyama_ros.nodes.base.samples import Sample
from sugiyama_ros.road import PERIODS_S, RINGS_M
from sugiyama_ros.trajectories.placing import OPTIONAL

#: Steps of a recording, at most; counts of steps stay exact in a double.
MOST_STEPS = 1 << 53
#: Time [s] between the stamps of a vehicle and of its sample, at most.
MOST_OFFSET_S = 60.0
# Characters of a reason; names from messages may be in it.
_LONGEST_REASON = 500


class RefusedError(ValueError):
    """A message that is not used. The text, of a bounded length, says why."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason[:_LONGEST_REASON])


def receiver(
    kind: type, take: Callable[[Any], None], refuse: Callable[[RefusedError], None] = lambda reason: None
) -> Callable[[bytes], None]:
    """Make the callback of a subscription to the bytes of a class of messages. Whatever they say, the node goes on.

    refuse: gets the reason for each message that is not valid, and for each message that ``take`` fails on.
    """
    decode = decoder(kind)

    def receive(raw: bytes) -> None:
        try:
            message = decode(raw)
        except RefusedError as reason:
            refuse(reason)
            return
        try:
            take(message)
        except Exception as error:  # one message must not end the node
            refuse(unusable(error))

    return receive


def decoder(kind: type) -> Callable[[bytes], Any]:
    """What decodes and checks messages of a class."""
    return _DECODERS.get(kind) or partial(decoded, kind=kind)


def unusable(error: Exception) -> RefusedError:
    """Return the reason why a message or a request was dropped on which the code failed."""
    *_, at = traceback.extract_tb(error.__traceback__)
    return RefusedError(f"cannot be used: {error!r} ({Path(at.filename).name}, line {at.lineno})")


def road(raw: bytes) -> RoadMessage:
    """Decode a Road. Raises RefusedError for a road on which nobody can drive, or samples without a period."""
    message = decoded(raw, RoadMessage)
    period_s, ring_m = message.period_s, message.circumference_m
    if not PERIODS_S[0] <= period_s <= PERIODS_S[1]:
        raise RefusedError(f"a period of {period_s:g} s is not within {PERIODS_S[0]:g} to {PERIODS_S[1]:g} s")
    if ring_m != 0.0 and not RINGS_M[0] <= ring_m <= RINGS_M[1]:
        raise RefusedError(
            f"a ring of {ring_m:g} m is not within {RINGS_M[0]:g} to {RINGS_M[1]:g} m, or 0 for an open road"
        )
    if message.steps > MOST_STEPS:
        raise RefusedError(f"{message.steps} steps are more than a recording has")
    return message


@lru_cache(maxsize=4)
def sample(raw: bytes) -> Sample:
    """Decode MeasuredPositions, once for all nodes of a process that get the same bytes.

    An infinite position is a missing one, a variance that is not a positive number is unknown, and a shift that is no
    number is none. A line without a place or times is none. Raises RefusedError for arrays of unequal length, numbers
    below 0, a step that is too large, a vehicle measured at another time than the sample, or lines without times.
    """
    message = decoded(raw, MeasuredPositions)
    lists = ("leader", "position_m", "length_m", *OPTIONAL)
    found = Sample(
        stamp_ns=message.header.stamp.sec * NS + message.header.stamp.nanosec,
        step=message.step,
        place={vehicle: k for k, vehicle in enumerate(message.vehicle)},
        **{name: getattr(message, name).tolist() for name in lists},
    )
    count = len(found.position_m)
    vehicles = max(found.place.values(), default=-1) + 1
    if not count == len(found.leader) == len(found.length_m) == len(found.place) == vehicles:
        raise RefusedError("its arrays differ in length, or a vehicle occurs twice")
    if min(found.place, default=0) < 0:
        raise RefusedError(f"{min(found.place)} is not the number of a vehicle")
    if found.step >= MOST_STEPS:
        raise RefusedError(f"step {found.step} is more than a recording has")
    if any(len(getattr(found, name)) not in (0, count) for name in OPTIONAL):
        raise RefusedError("its arrays differ in length")
    if found.line_m and not (found.arrive_s and found.clear_s):
        raise RefusedError("its lines have no times")
    if not all(abs(offset) <= MOST_OFFSET_S for offset in found.stamp_offset_s):
        raise RefusedError(f"a vehicle's stamp is not within {MOST_OFFSET_S:g} s of the header's")
    return found._replace(
        position_m=[p if isfinite(p) else nan for p in found.position_m],
        position_var=[v if isfinite(v) and v > 0.0 else nan for v in found.position_var],
        line_m=[
            place if isfinite(place) and not isnan(arrive + clear) else nan
            for place, arrive, clear in zip(found.line_m, found.arrive_s, found.clear_s, strict=False)
        ],
        leader_shift_m=[shift if isfinite(shift) else 0.0 for shift in found.leader_shift_m],
    )


def parameters(raw: bytes) -> DriverParameters:
    """Decode DriverParameters. Raises RefusedError for uneven arrays, or estimates that are not positive numbers."""
    message = decoded(raw, DriverParameters)
    count = len(message.name)
    if not count == len(message.value) == len(message.estimated) or len(message.covariance) != count * count:
        raise RefusedError("its arrays differ in length")
    value, estimated = np.array(message.value), np.array(message.estimated, dtype=bool)
    # parameters of effects, such as drag.c0, may be negative
    of_driver = np.array(["." not in name for name in message.name], dtype=bool)
    if not (value[estimated & of_driver] > 0.0).all() or not np.isfinite(value[estimated]).all():
        raise RefusedError("an estimate is no positive number")
    if not np.isfinite(message.covariance).all():
        raise RefusedError("its covariance is no number")
    return message


def verdict(raw: bytes) -> Verdict:
    """Decode a Verdict. Raises RefusedError for uneven arrays, or a weight that is no number."""
    message = decoded(raw, Verdict)
    if not len(message.model) == len(message.weight) == len(message.strength):
        raise RefusedError("its arrays differ in length")
    if len(message.parameter) != len(message.value):
        raise RefusedError("its arrays differ in length")
    if not all(map(isfinite, (*message.weight, *message.strength, *message.value))):
        raise RefusedError("a weight or a value is no number")
    return message


def drivers(raw: bytes) -> DriverArray:
    """Decode a DriverArray. Raises RefusedError for uneven arrays, or without the parameters that every driver has."""
    message = decoded(raw, DriverArray)
    count, names = len(message.vehicle), len(message.name)
    each = (message.scored, message.innovation_m, message.nis)
    if any(len(values) != count for values in each) or len(message.value) != count * names:
        raise RefusedError("its arrays differ in length")
    return message


def named_values(what: str, names: Sequence[str], values: Sequence[float]) -> dict[str, float]:
    """Values of something by name, from a request. Raises RefusedError for uneven or repeated names."""
    if len(names) != len(values) or len(set(names)) != len(names):
        raise RefusedError(f"{what}: {len(names)} names, {len(values)} values; give each name one value")
    return dict(zip(names, values, strict=True))


def decoded(raw: bytes, kind: type) -> Any:
    """Decode a message of a class from bytes in plain CDR. Raises RefusedError."""
    # ROS 2 Kilted would end the process on a message that is nothing but its encapsulation
    if raw[:2] not in (b"\0\0", b"\0\1") or len(raw) <= ENCAPSULATION:
        raise RefusedError("is not in plain CDR")
    try:
        over(kind, "<" if raw[1] else ">")(memoryview(raw)[ENCAPSULATION:], 0)
        return deserialize_message(raw, kind)
    except Exception:  # the middleware's own class, which it does not export
        raise RefusedError(f"cannot be decoded as {kind.__name__}") from None


_DECODERS: Mapping[type, Callable[[bytes], Any]] = {
    RoadMessage: road,
    MeasuredPositions: sample,
    DriverParameters: parameters,
    DriverArray: drivers,
    Verdict: verdict,
}
