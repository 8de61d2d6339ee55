"""A driver and the vehicles ahead: what is measured of them, which parameters they have, and what is adapted."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.parameters import NAMES, OMEGA_2, UTILITY, population
from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.road import Road

#: Vehicles in a chain: own, leader and the leader's leader.
CHAIN = 3
#: Position [m], speed [m/s] and length [m] of the vehicle behind where there is none.
NO_REAR = (math.nan, math.nan, math.nan)
#: Position [m] of the line ahead, two times [s] and the curvature [1/m] where there is neither a line nor a curve.
NO_LINE = (math.nan, math.nan, math.nan, math.nan)
#: The same of a driver and of the leader.
NO_LINES = (*NO_LINE, *NO_LINE)
#: What a driver sees besides the chain, as of ``Chain.around``, where there is nothing, and the number of its entries.
NOTHING_AROUND = (*NO_REAR, *NO_LINES)
AROUND = len(NOTHING_AROUND)
# Time [s] over which a speed is measured, and part of the speeds that are not above the high one.
_SPEED_OVER_S, _HIGH = 1.0, 0.99
_WANDERING = tuple(e for e in EFFECTS.values() if e.wanders)


@dataclass(frozen=True, eq=False)
class Chain:
    """What is measured of one driver and of the vehicles ahead, M in all, own first.

    position_m: (T, M), NaN where missing; identity: (T, M) number of the vehicle, -1 for none; length_m: (T, M);
    around: (T, 11) what else there is, NaN for nothing: filtered position [m] and speed [m/s], and length [m], of the
    vehicle behind; position [m] of the line ahead, times [s] until who goes first reaches the place behind it and has
    left it, and curvature [1/m] of the road; the same four of the leader;
    start_s: time [s] of the first sample; circumference_m: length of the ring, 0 for an open road.
    """

    position_m: Array
    identity: Ints
    length_m: Array
    around: Array
    period_s: float
    start_s: float
    circumference_m: float

    @cached_property
    def end(self) -> int:
        """Number of samples up to the last one in which the driver is there."""
        there = np.flatnonzero(self.identity[:, 0] >= 0)
        return int(there[-1]) + 1 if len(there) else 0

    def high_speed(self, counts: Mask) -> float:
        """Return the speed [m/s] of the driver below which 99 % of the samples in ``counts`` (T,) are.

        NaN if no speed is known.
        """
        at = np.flatnonzero(counts & np.isfinite(self.position_m[:, 0]))
        if len(at) < 2:
            return math.nan
        steps = max(1, round(_SPEED_OVER_S / (self.period_s * float(np.median(np.diff(at))))))
        after, before = at[steps:], at[:-steps]
        same = self.identity[after, 0] == self.identity[before, 0]
        after, before = after[same], before[same]
        way = Road(self.circumference_m).difference(self.position_m[after, 0], self.position_m[before, 0])
        return float(np.quantile(way / (self.period_s * (after - before)), _HIGH)) if len(way) else math.nan


@dataclass(frozen=True)
class Adaptation:
    """Which parameters of the utility are adapted online.

    names: of the parameters; prior_std: of their logarithms; relaxation_s: time [s] in which they return to the prior,
    infinite for drivers who never change. Raises InputError for a parameter that cannot be adapted.
    """

    names: tuple[str, ...] = ()
    prior_std: tuple[float, ...] = ()
    relaxation_s: float = math.inf

    def __post_init__(self) -> None:
        # omega_2 is negative, so it has no logarithm
        adaptable = [NAMES[k] for k in UTILITY if k != OMEGA_2]
        if len(self.names) != len(self.prior_std):
            raise InputError(f"adapt: {len(self.names)} names and {len(self.prior_std)} prior stds; give one each")
        for name in self.names:
            if name not in adaptable:
                raise InputError(f"adapt: {name!r} cannot be adapted online; choose among {', '.join(adaptable)}")

    @property
    def arrays(self) -> tuple[Ints, Array]:
        """Places in UTILITY and prior variances of the logarithms, (A,) each."""
        places = np.array([UTILITY.index(NAMES.index(name)) for name in self.names], dtype=np.int64)
        return places, np.array(self.prior_std, dtype=np.float64) ** 2


#: Nothing is adapted.
NOT_ADAPTED = Adaptation()


def adaptation_of(parameters: Array, given: Adaptation = NOT_ADAPTED) -> Adaptation:
    """Return how a driver's preferences are adapted."""
    if len(parameters) == ROW.width:
        for effect in _WANDERING:
            std, relaxation_s = parameters[ROW.places[effect.name]][:2].tolist()
            if std != 0.0:
                return Adaptation(effect.wanders, (std,) * len(effect.wanders), relaxation_s)
    return given


def chain_parameters(own: Array, ahead: Array | None, vehicles: int) -> Array:
    """Return the rows of all drivers of a chain."""
    others = population() if ahead is None else ahead
    rows = np.zeros((vehicles, ROW.width))
    rows[0, : len(own)], rows[1:, : others.shape[-1]] = own, others
    return rows
