"""Vehicles seen in the plane become vehicles on lanes, with leaders: sample by sample, without a look ahead."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.centre_line import RoadLanes

#: Name of the vehicle ahead where there is none.
NOBODY = ""


@dataclass(frozen=True)
class SeenVehicle:
    """A vehicle as it was seen.

    stamp_ns: when it was seen [ns]; name: name of the vehicle; empty if nobody knows it; x_m, y_m: position [m] of its
    centre, in the frame of the centre line; heading: direction [rad] in which it points; naN where unknown; length_m,
    var: length [m], and variance [m^2] of the position; naN where unknown; vehicle_class: its class; empty where
    unknown; frame: frame of the position.
    """

    stamp_ns: int
    name: str
    x_m: float
    y_m: float
    heading: float = math.nan
    length_m: float = math.nan
    var: float = math.nan
    vehicle_class: str = ""
    frame: str = ""


class Positions(NamedTuple):
    """One sample of all vehicles on the road, one entry for each vehicle.

    vehicle, leader: number of the vehicle, and number of its leader: -1 without a leader, -2 where it is not in view;
    position_m, length_m: position [m] (NaN if missing) and length [m]; lane, d_m, stamp_offset_s, position_var: lane,
    position [m] across the road, time [s] at which the vehicle was measured after the sample's own, and variance [m^2]
    of the position; line_m, arrive_s, clear_s, curvature_per_m, leader_shift_m: what the driver comes to, and what to
    add to the leader's position, as in tracks; each is empty where the source does not know it.
    """

    vehicle: list[int]
    leader: list[int]
    position_m: list[float]
    length_m: list[float]
    lane: Sequence[int] = ()
    d_m: Sequence[float] = ()
    stamp_offset_s: Sequence[float] = ()
    position_var: Sequence[float] = ()
    line_m: Sequence[float] = ()
    arrive_s: Sequence[float] = ()
    clear_s: Sequence[float] = ()
    curvature_per_m: Sequence[float] = ()
    leader_shift_m: Sequence[float] = ()


#: What not every source knows of vehicles.
OPTIONAL = Positions._fields[4:]


class OnLane(NamedTuple):
    """A vehicle on the road.

    seen: what was seen; s_m, d_m: position [m] along and across its lane; lane: number of the lane; leader: name of the
    vehicle ahead; `NOBODY` where there is none, None where it is not known.
    """

    seen: SeenVehicle
    s_m: float
    d_m: float
    lane: int
    leader: str | None = None


class Unseen(NamedTuple):
    """A vehicle that is on the road, but was not seen now: its name, None if it may be gone, position [m] and lane."""

    name: str | None
    s_m: float
    lane: int


@dataclass(frozen=True)
class LaneRule:
    """When a vehicle changes lane, and when it is not on the road.

    margin_m: a vehicle changes to another lane when it is nearer to its centre line by this distance [m] than to the
    centre line of the lane that it is on; so one on the marking does not go to and fro; beside_m: a vehicle whose
    centre is farther [m] beside the road's lanes is not on the road.
    """

    margin_m: float = 0.4
    beside_m: float = 1.0


class Placer:
    """Puts vehicles on lanes, and says who follows whom. It remembers each vehicle's lane.

    lanes: the road; rule: when vehicles change lanes.
    """

    def __init__(self, lanes: RoadLanes, rule: LaneRule = LaneRule()) -> None:
        self._lanes, self._rule = lanes, rule
        self._lane: dict[str, int] = {}

    @property
    def road(self) -> Road:
        """The road, along the centre line of its first lane."""
        return self._lanes.road

    def place(self, seen: Sequence[SeenVehicle]) -> list[OnLane]:
        """Place the vehicles of one moment, each of them once, in the order in which they were given.

        A vehicle that is not on the road, or points against its direction, is left out.
        """
        if not seen:
            return []
        s_m, d_m = self._lanes.place(np.array([one.x_m for one in seen]), np.array([one.y_m for one in seen]))
        along = self._lanes.lines[0].heading(s_m)
        on_road: list[tuple[SeenVehicle, float, float, int]] = []
        for k, one in enumerate(seen):
            lane = self._lane_of(one.name, np.abs(d_m[:, k]))
            against = math.cos(one.heading - along[k]) < 0.0  # never for a heading that is not known
            if lane is None or against:
                self._lane.pop(one.name, None)
                continue
            self._lane[one.name] = lane
            on_road.append((one, float(s_m[k]), float(d_m[lane, k]), lane))
        leaders = self.leaders([Unseen(one.name, s, lane) for one, s, _, lane in on_road])
        return [OnLane(*one, leader) for one, leader in zip(on_road, leaders, strict=True)]

    def forget(self, names: Sequence[str]) -> None:
        """Forget the lanes of vehicles that have gone."""
        for name in names:
            self._lane.pop(name, None)

    def _lane_of(self, name: str, distance_m: Array) -> int | None:
        """Lane of a vehicle at distances (L,) [m] from the centre lines; None beside the road."""
        nearest = int(np.argmin(distance_m - 0.5 * self._lanes.width_m))
        if distance_m[nearest] > 0.5 * self._lanes.width_m[nearest] + self._rule.beside_m:
            return None
        before = self._lane.get(name)
        if before is None or distance_m[nearest] < distance_m[before] - self._rule.margin_m:
            return nearest
        return before

    def leaders(self, there: Sequence[Unseen]) -> list[str | None]:
        """Name of the vehicle directly ahead on the same lane, for each vehicle; None for one that may be gone."""
        leaders: list[str | None] = [NOBODY] * len(there)
        for lane in {one.lane for one in there}:
            behind = [k for _, k in sorted((one.s_m, k) for k, one in enumerate(there) if one.lane == lane)]
            for k, ahead in pairwise(behind):
                leaders[k] = there[ahead].name
            if self._lanes.road.is_ring and len(behind) > 1:
                leaders[behind[-1]] = there[behind[0]].name
        return leaders
