"""The most frequent messages, made of what nodes know."""

from array import array
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import ArrayLike
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header
from sugiyama_msgs.msg import DriverArray, DriverParameters, Innovation, MeasuredPositions, VehicleState

from sugiyama_ros.arrays import Array, Mask, selection
from sugiyama_ros.filters.online import Estimate
from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.trajectories.placing import Positions

NS = 1_000_000_000

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


def time_message(stamp_ns: int) -> Time:
    """A stamp as a message."""
    sec, nanosec = divmod(stamp_ns, NS)
    return Time(sec=sec, nanosec=nanosec)


def stamp_key(raw: bytes) -> bytes:
    """Bytes of the stamp in a message that starts with a header or with a stamp."""
    return raw[4:12]


def clock(stamp_ns: int) -> Clock:
    """A stamp on the topic of the time."""
    return Clock(clock=time_message(stamp_ns))


@lru_cache(maxsize=4)
def _header(stamp_ns: int) -> Header:
    """The header of all messages with a stamp: nobody changes it."""
    return Header(stamp=time_message(stamp_ns), frame_id=FRAME)


def measured_positions(stamp_ns: int, step: int, positions: Positions) -> MeasuredPositions:
    """Sample number ``step``."""
    whole = ("vehicle", "leader", "lane")
    given = {name: values for name, values in positions._asdict().items() if values}
    lists = {name: array("i" if name in whole else "d", values) for name, values in given.items()}
    return MeasuredPositions(header=_header(stamp_ns), step=step, **lists)


def state(stamp_ns: int, vehicle: int, estimate: Estimate) -> VehicleState:
    """The state of a vehicle."""
    e = estimate
    return VehicleState(
        header=_header(stamp_ns),
        vehicle=vehicle,
        position_m=e.position_m,
        speed=e.speed,
        acceleration=e.acceleration,
        covariance=e.covariance.ravel(),
        mean_action=e.mean_action,
        gap_m=e.gap_m,
        approach_rate=e.approach_rate,
    )


def innovation(stamp_ns: int, vehicle: int, estimate: Estimate) -> Innovation:
    """The innovation of a vehicle."""
    e = estimate
    return Innovation(
        header=_header(stamp_ns),
        vehicle=vehicle,
        innovation_m=e.innovation_m,
        innovation_var=e.innovation_var,
        nis=e.nis,
        log_likelihood=e.log_likelihood,
        scored=bool(e.scored),
    )


class ParameterNames(NamedTuple):
    """Names of a driver's parameters, and of the parameters among them that the filter adapts, in the same order."""

    shown: tuple[str, ...]
    adapted: tuple[str, ...]


def parameters(
    stamp_ns: int, vehicle: int, names: ParameterNames, value: Array, covariance: Array, identified: Mask
) -> DriverParameters:
    """The parameters of a driver, with ``value`` (P,), ``covariance`` (P, P) and ``identified`` (P,)."""
    return DriverParameters(
        header=_header(stamp_ns),
        vehicle=vehicle,
        name=list(names.shown),
        estimated=[name in names.adapted for name in names.shown],
        value=array("d", value.tobytes()),
        covariance=array("d", covariance.tobytes()),
        identified=identified.tolist(),
    )


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


def driver_array(stamp_ns: int, drivers: Sequence[KnownDriver]) -> DriverArray:
    """What is known of at least one driver; they may have different parameters."""
    shown, adapted, places = _columns(tuple(driver.names for driver in drivers))
    value = np.full((len(drivers), len(shown)), np.nan)
    covariance = np.zeros((len(drivers), len(adapted), len(adapted)))
    identified = np.zeros((len(drivers), len(adapted)), np.bool_)
    for k, (driver, (of_shown, of_adapted, block)) in enumerate(zip(drivers, places, strict=True)):
        value[k, of_shown] = driver.value
        covariance[k][block] = driver.covariance
        identified[k, of_adapted] = driver.identified
    estimates = zip(Estimate._fields, zip(*(driver.estimate for driver in drivers), strict=True), strict=True)
    numbers: dict[str, ArrayLike] = dict(estimates)
    scored, of_state = np.asarray(numbers.pop("scored")), numbers.pop("covariance")
    numbers |= {"state_covariance": of_state, "value": value, "parameter_covariance": covariance}
    return DriverArray(
        header=_header(stamp_ns),
        vehicle=[driver.vehicle for driver in drivers],
        name=list(shown),
        estimated=[name in adapted for name in shown],
        scored=scored.tolist(),
        identified=identified.ravel().tolist(),
        **{name: array("d", _digits(name, values)) for name, values in numbers.items()},
    )


@lru_cache(maxsize=16)
def _columns(names: tuple[ParameterNames, ...]) -> tuple[list[str], list[str], list[tuple[Any, Any, Any]]]:
    """Parameters that any driver shows, and that any adapts; each driver's places in both, and in a covariance."""
    shown = list(dict.fromkeys(name for one in names for name in one.shown))
    adapted = [name for name in shown if any(name in one.adapted for one in names)]
    places = []
    for one in names:
        of_shown = selection([shown.index(name) for name in one.shown])
        of_adapted = selection([adapted.index(name) for name in one.adapted])
        block = (of_adapted, of_adapted) if isinstance(of_adapted, slice) else np.ix_(of_adapted, of_adapted)
        places.append((of_shown, of_adapted, block))
    return shown, adapted, places


def _digits(name: str, numbers: ArrayLike) -> bytes:
    """Bytes of numbers as float64; of some fields, the digits beyond those of a float32 are 0, which compress well."""
    with np.errstate(over="ignore"):
        kept = np.asarray(numbers, dtype=np.float32 if name in SEVEN_DIGITS else np.float64)
    return kept.astype(np.float64).tobytes()
