"""From messages of a perception to samples of the road: the same on a vehicle and for a bag."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from sugiyama_ros.bridges.fields import Bridge
from sugiyama_ros.bridges.frames import Frames
from sugiyama_ros.bridges.moments import Moments, Numbers, RoadMoment
from sugiyama_ros.errors import InputError
from sugiyama_ros.trajectories.centre_line import RoadLanes
from sugiyama_ros.trajectories.placing import Placer, SeenVehicle
from sugiyama_ros.trajectories.trajectories import DEFAULT_LENGTH_M

#: Names of the topics with transforms, and whether these stay for ever.
TF_TOPICS = {"/tf": False, "/tf_static": True}
TF_TYPE = "tf2_msgs/msg/TFMessage"
# Shortest and longest time [s] between two samples.
_PERIODS_S = (1e-3, 1e3)
# Length [m] beyond which a vehicle is none.
_LONGEST_M = 100.0


@dataclass(frozen=True)
class PerceptionSettings:
    """How vehicles are seen.

    Parameters
    ----------
    period_s : float
        Time [s] between two samples of the road.
    frame : str
        Frame of the centre line; if empty, all positions are taken to be in it.
    length_m : float
        Length [m] of a vehicle of which nobody says it.

    Raises
    ------
    InputError
        For a period with which nobody is followed, or a length that is no positive number.
    """

    period_s: float = 0.1
    frame: str = ""
    length_m: float = DEFAULT_LENGTH_M

    def __post_init__(self) -> None:
        if not _PERIODS_S[0] <= self.period_s <= _PERIODS_S[1]:
            raise InputError(f"period: {self.period_s:g} s is not within {_PERIODS_S[0]:g} to {_PERIODS_S[1]:g} s")
        if not 0.0 < self.length_m < math.inf:
            raise InputError(f"length: {self.length_m:g} m is not the length of a vehicle; give a positive number")


class RoadSample(NamedTuple):
    """All vehicles on the road at one time, in lists with one entry each; see the message MeasuredPositions."""

    step: int
    stamp_ns: int
    vehicle: list[int]
    leader: list[int]
    position_m: list[float]
    length_m: list[float]
    lane: list[int]
    d_m: list[float]
    stamp_offset_s: list[float]
    position_var: list[float]


@dataclass
class Perception:
    """Takes messages, and gives out samples of the road.

    Parameters
    ----------
    lanes : RoadLanes
        The road.
    settings : PerceptionSettings
        How vehicles are seen.
    """

    lanes: RoadLanes
    settings: PerceptionSettings = PerceptionSettings()
    frames: Frames = field(default_factory=Frames)
    numbers: Numbers = field(default_factory=Numbers)
    _length: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.moments = Moments(Placer(self.lanes), self.settings.period_s)
        names = self.lanes.names
        are_numbers = all(name.lstrip("-").isdecimal() and abs(int(name)) < 1000 for name in names)
        self._lane_number = [int(name) if are_numbers else k for k, name in enumerate(names)]

    def take(self, message: Any, bridge: Bridge, topic: str) -> Iterator[RoadSample]:
        """Take in a message; yields the samples that are complete with it. Raises InputError for one that has not what
        the bridge names.
        """
        for moment in self.moments.take(list(self._brought(message, bridge, topic))):
            yield self._sample(moment)

    def rest(self) -> Iterator[RoadSample]:
        """What is left at the end."""
        return map(self._sample, self.moments.rest())

    def _brought(self, message: Any, bridge: Bridge, topic: str) -> Iterator[SeenVehicle]:
        """The vehicles in a message, in the frame of the road."""
        for one in bridge.seen(message, topic):
            found = self.frames.brought(one, self.settings.frame)
            if found is None:
                self.moments.counts.unknown_frame += 1
            else:
                yield found

    def _sample(self, moment: RoadMoment) -> RoadSample:
        placed = moment.placed
        var = [one.seen.var for one in placed]
        return RoadSample(
            step=moment.step,
            stamp_ns=moment.stamp_ns,
            vehicle=[self.numbers(one.seen.name) for one in placed],
            leader=[self.numbers(one.leader) for one in placed],
            position_m=[one.s_m for one in placed],
            length_m=[self._length_of(one.seen) for one in placed],
            lane=[self._lane_number[one.lane] for one in placed],
            d_m=[one.d_m for one in placed],
            stamp_offset_s=[1e-9 * (one.seen.stamp_ns - moment.stamp_ns) for one in placed],
            position_var=var if any(map(math.isfinite, var)) else [],
        )

    def _length_of(self, seen: SeenVehicle) -> float:
        """Length [m] of a vehicle; it stays as it was said first."""
        given = seen.length_m if 0.0 < seen.length_m < _LONGEST_M else self.settings.length_m
        return self._length.setdefault(seen.name, given)
