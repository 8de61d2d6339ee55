"""From messages of a perception, as they come, to samples of the road."""

import math
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from sugiyama_ros.bridges.fields import UNITS_NS, Bridge
from sugiyama_ros.bridges.frames import EARLY, LONGEST_HOLE_S, Frames
from sugiyama_ros.bridges.moments import Counts, Moments, Numbers, RoadMoment
from sugiyama_ros.errors import InputError
from sugiyama_ros.trajectories.centre_line import RoadLanes
from sugiyama_ros.trajectories.placing import Placer, SeenVehicle
from sugiyama_ros.trajectories.trajectories import DEFAULT_LENGTH_M

#: Names of the topics with transforms, and whether these stay for ever.
TF_TOPICS = {"/tf": False, "/tf_static": True}
TF_TYPE = "tf2_msgs/msg/TFMessage"
#: Types of their messages; the second is of old bags of ROS 1.
TF_TYPES = (TF_TYPE, "tf/msg/tfMessage")
# Shortest and longest time [s] between two samples.
_PERIODS_S = (1e-3, 1e3)
#: Time [s] between two samples where nobody says it.
DEFAULT_PERIOD_S = 0.1
#: Length [m] beyond which a vehicle is none.
LONGEST_M = 100.0
#: Share of what is seen that may be lost before something is wrong.
MOST_LOST = 0.01
#: Ratio of the longest to the shortest period that is noted.
RATES_DIFFER = 1.5
#: Factor between stamps and clock beyond which the unit of the stamps is wrong: no replay is that fast.
OTHER_UNIT = 700.0
# Time [ns] after which stamps are compared with the clock.
_NS, _LONG_ENOUGH_NS = 1_000_000_000, 1_000_000_000
# What is lost, and what to do.
_PROBLEMS = {
    "unnamed": "have no id, so nobody can be followed; give the messages of a tracker",
    "doubled": "share an id with another one in the same message; give the messages of a tracker",
    "unstamped": "have stamp 0 and count as seen when the message came; set header.stamp where they are published",
    "repeated": "have a stamp that the vehicle had before; set header.stamp, or give a bridge with `stamp: ''`",
    "unknown_frame": "are in a frame from which no transform leads to that of the centre line in time",
    "late": "come too late for their sample; are the clocks of the publishers apart? A bridge with `stamp: ''` takes"
    " the time of receipt",
}


@dataclass(frozen=True)
class PerceptionSettings:
    """How vehicles are seen.

    period_s: time [s] between two samples of the road; by default that of the data of a bag, and 0.1 s of what comes
    live; frame: frame of the centre line; if empty, all positions are taken to be in it; length_m: length [m] of a
    vehicle of which nobody says it. Raises InputError.
    """

    period_s: float | None = None
    frame: str = ""
    length_m: float = DEFAULT_LENGTH_M

    def __post_init__(self) -> None:
        if self.period_s is not None and not _PERIODS_S[0] <= self.period_s <= _PERIODS_S[1]:
            raise InputError(f"period: {self.period_s:g} s is not within {_PERIODS_S[0]:g} to {_PERIODS_S[1]:g} s")
        if not 0.0 < self.length_m < math.inf:
            raise InputError(f"length: {self.length_m:g} m is not the length of a vehicle; give a positive number")


class RoadSample(NamedTuple):
    """All vehicles on the road at one time, in lists with one entry each; see the message MeasuredPositions.

    A vehicle without a sample at this time has no position, but a lane and a leader.
    """

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


class _Clock(NamedTuple):
    """When [ns] the first message of a topic came, and its stamp."""

    log_ns: int
    stamp_ns: int


@dataclass
class Perception:
    """Takes messages as they come, and gives out samples of the road.

    lanes: the road; settings: how vehicles are seen.
    """

    lanes: RoadLanes
    settings: PerceptionSettings = PerceptionSettings()
    frames: Frames = field(default_factory=Frames)
    numbers: Numbers = field(default_factory=Numbers)
    #: Frames in which vehicles were seen.
    seen_in: set[str] = field(default_factory=set)
    _waiting: list[SeenVehicle] = field(default_factory=list)
    _length: dict[str, float] = field(default_factory=dict)
    _clock: dict[str, _Clock] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.moments = Moments(Placer(self.lanes), self.settings.period_s or DEFAULT_PERIOD_S)
        self.lane_number = lane_numbers(self.lanes)

    def take(self, message: Any, bridge: Bridge, topic: str, received_ns: int) -> Iterator[RoadSample]:
        """Take in a message; yields the samples that are complete with it.

        Raises InputError for one that has not what the bridge names, or whose stamps are in another unit.
        """
        counts = self.moments.counts
        for one in told_apart(list(bridge.seen(message, topic, received_ns)), counts):
            if one.stamp_ns == 0:
                counts.unstamped += 1
                one = replace(one, stamp_ns=received_ns)
            else:
                first = self._clock.setdefault(topic, _Clock(received_ns, one.stamp_ns))
                check_unit(topic, bridge, one.stamp_ns - first.stamp_ns, received_ns - first.log_ns)
            self.seen_in.add(one.frame.lstrip("/"))
            self._waiting.append(one)
        return self._resolved()

    def hear(self, message: Any, static: bool) -> Iterator[RoadSample]:
        """Take in transforms; yields the samples that are complete with what has waited for them."""
        self.frames.add(message, static)
        return self._resolved()

    def rest(self) -> Iterator[RoadSample]:
        """What is left at the end."""
        return map(self._sample, self.moments.rest())

    def problem(self) -> str:
        """What is wrong with what is seen, and what to do; empty if nothing is."""
        counts = vars(self.moments.counts)
        total = sum(counts[name] for name in ("taken", "beside", "late", "unknown_frame", *_PROBLEMS))
        for name, why in _PROBLEMS.items():
            if counts[name] > MOST_LOST * total:
                return f"{counts[name]} of {total} vehicles seen {why}"
        if not self.settings.frame and (moving := [f for f in self.seen_in if self.frames.is_moving(f)]):
            return f"positions are in {moving[0]}, which moves; set the parameter frame to that of the centre line"
        if not self.settings.frame and len(self.seen_in) > 1:
            return f"positions are in several frames ({', '.join(sorted(self.seen_in))}); set the parameter frame"
        if (periods := self.moments.periods_s) and periods[-1] > RATES_DIFFER * self.moments.period_s:
            return (
                f"vehicles are seen every {periods[0]:.3g} to {periods[-1]:.3g} s, and a sample is sent every"
                f" {self.moments.period_s:g} s; those without a new position are sent without one"
            )
        return ""

    def _resolved(self) -> Iterator[RoadSample]:
        """What has waited for transforms, and does so no longer."""
        waiting, self._waiting = self._waiting, []
        newest_ns = max((one.stamp_ns for one in waiting), default=0)
        ready = []
        for one in waiting:
            found = self.frames.brought(one, self.settings.frame)
            if isinstance(found, SeenVehicle):
                ready.append(found)
            elif found is EARLY and newest_ns - one.stamp_ns <= LONGEST_HOLE_S * _NS:
                self._waiting.append(one)
            else:
                self.moments.counts.unknown_frame += 1
        for moment in self.moments.take(ready):
            yield self._sample(moment)

    def _sample(self, moment: RoadMoment) -> RoadSample:
        there, nan = [*moment.placed, *moment.carried], [math.nan] * len(moment.carried)
        var = [one.seen.var for one in moment.placed]
        return RoadSample(
            step=moment.step,
            stamp_ns=moment.stamp_ns,
            vehicle=[self.numbers(one.seen.name) for one in there],
            leader=[self.numbers(one.leader) for one in there],
            position_m=[one.s_m for one in moment.placed] + nan,
            length_m=[self._length_of(one.seen) for one in there],
            lane=[self.lane_number[one.lane] for one in there],
            d_m=[one.d_m for one in moment.placed] + nan,
            stamp_offset_s=[1e-9 * (one.seen.stamp_ns - moment.stamp_ns) for one in moment.placed]
            + [0.0] * len(moment.carried),
            position_var=var + nan if any(map(math.isfinite, var)) else [],
        )

    def _length_of(self, seen: SeenVehicle) -> float:
        """Length [m] of a vehicle; it stays as it was said first."""
        given = seen.length_m if 0.0 < seen.length_m < LONGEST_M else self.settings.length_m
        return self._length.setdefault(seen.name, given)


def lane_numbers(lanes: RoadLanes) -> list[int]:
    """Number of each lane: its name if all names are numbers, else its place."""
    are_numbers = all(re.fullmatch(r"-?[0-9]{1,3}", name) for name in lanes.names)
    return [int(name) if are_numbers else k for k, name in enumerate(lanes.names)]


def told_apart(seen: list[SeenVehicle], counts: Counts) -> list[SeenVehicle]:
    """The vehicles of a message that can be told apart by their names; the others are counted."""
    often = Counter(one.name for one in seen)
    counts.unnamed += often.pop("", 0)
    counts.doubled += sum(number for number in often.values() if number > 1)
    return [one for one in seen if often.get(one.name) == 1]


def check_unit(topic: str, bridge: Bridge, stamps_ns: int, received_ns: int) -> None:
    """Raise InputError where stamps that are numbers run much faster or slower than the clock: in another unit."""
    is_number = bridge.stamp and bridge.stamp != "header.stamp"
    if not is_number or received_ns < _LONG_ENOUGH_NS or stamps_ns <= 0:
        return
    ratio = stamps_ns / received_ns
    if 1.0 / OTHER_UNIT < ratio < OTHER_UNIT:
        return
    wanted_ns = UNITS_NS[bridge.stamp_unit] / ratio
    unit = min(UNITS_NS, key=lambda name: abs(math.log(UNITS_NS[name] / wanted_ns)))
    raise InputError(
        f"{topic}: {bridge.stamp} runs {ratio:.3g} times as fast as the clock; give `stamp_unit: {unit}` in the bridge"
    )
