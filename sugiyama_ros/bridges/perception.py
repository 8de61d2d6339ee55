"""Messages of a perception, as they come, become samples of the road at regular times. Nothing waits for the future."""

import math
import re
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.bridges.fields import NS, UNITS_NS, Bridge
from sugiyama_ros.bridges.frames import EARLY, LONGEST_HOLE_S, Frames
from sugiyama_ros.errors import InputError
from sugiyama_ros.trajectories.assemble import LONGEST_ABSENCE_S
from sugiyama_ros.trajectories.centre_line import RoadLanes
from sugiyama_ros.trajectories.placing import NOBODY, OnLane, Placer, SeenVehicle, Unseen
from sugiyama_ros.trajectories.tracks import FREE, UNKNOWN
from sugiyama_ros.trajectories.trajectories import DEFAULT_LENGTH_M

# Time has begun anew when so many vehicles in a row were seen so long [ns] before the last sample.
_BACK_NS, _BACK_IN_A_ROW = NS, 5
# A vehicle is still where it drove to for so many of its own periods after its last sample.
_CARRIED_PERIODS = 1.5
#: Speed [m/s] above which the way of a vehicle says in which direction it points.
MOVING = 1.0
# Stamps of a vehicle from which its own period follows.
_STAMPS = 6
# Time [s] from the beginning in which a vehicle may be ahead of which nothing was heard yet.
_SETTLED_S = 1.0
# A number at the end of a name, perhaps written as 5.0, and perhaps with something behind it.
_NUMBER = re.compile(r"(\d+)(?:\.0*)?\D*$")


class RoadMoment(NamedTuple):
    """The road at one time: number of the sample, its stamp [ns], and the vehicles on the road.

    ``carried`` are vehicles without a sample now, whose last one is not older than one and a half of their own periods.
    """

    step: int
    stamp_ns: int
    placed: list[OnLane]
    carried: list[OnLane]


class Numbers:
    """Numbers of vehicles: the last number in the name, if no other vehicle has it, or else the next free number."""

    def __init__(self) -> None:
        self.of: dict[str, int] = {}

    def __call__(self, name: str | None) -> int:
        """Number of a vehicle; `FREE` for nobody, and `UNKNOWN` for one that is not known."""
        if name is None:
            return UNKNOWN
        if name == NOBODY:
            return FREE
        if name not in self.of:
            digits = _NUMBER.search(name)
            wanted = int(digits[1]) if digits and len(digits[1]) <= 9 else -1
            taken = set(self.of.values())
            self.of[name] = wanted if wanted >= 0 and wanted not in taken else max(taken, default=-1) + 1
        return self.of[name]


@dataclass
class Counts:
    """What became of what was seen.

    taken: vehicles that are in a sample; beside, late, unknown_frame: vehicles that are not on the road; that were seen
    before the last sample; whose position is in a frame from which nothing leads to the road's; unnamed, doubled:
    vehicles without an id, or with the id of another one in the same message; unstamped, repeated: vehicles whose stamp
    is 0, and which count as seen when the message came; with the stamp that they had before; carried: rows of vehicles
    without a sample.
    """

    taken: int = 0
    beside: int = 0
    late: int = 0
    unknown_frame: int = 0
    unnamed: int = 0
    doubled: int = 0
    unstamped: int = 0
    repeated: int = 0
    carried: int = 0


@dataclass
class _Last:
    """Where a vehicle was last, and its speed [m/s]."""

    placed: OnLane
    speed: float = 0.0

    def ahead(self, stamp_ns: int) -> float:
        """Position [m] along the lane at a stamp [ns], if it drives on as before."""
        return self.placed.s_m + self.speed * (stamp_ns - self.placed.seen.stamp_ns) / NS


@dataclass
class Moments:
    """Collects what was seen, in the order in which it comes, and gives out one sample of the road for each period.

    What was seen nearest to the time of a sample, by at most half a period, belongs to it. The sample is given out as
    soon as something comes whose stamp is later than that by a quarter of a period. What comes later still only says
    where the vehicle was. If the stamps of several vehicles in a row are a second older than the last sample, time has
    begun anew.

    A vehicle without a sample is not taken for gone. For one and a half of its own periods it drives on as before.
    After that it may be there or not, so whoever drove behind it has an unknown leader, for a minute at most. So has
    whoever sees nobody ahead in the first second.

    placer: puts vehicles on lanes; period_s: time [s] between two samples.
    """

    placer: Placer
    period_s: float
    counts: Counts = field(default_factory=Counts)
    _seen: dict[int, dict[str, SeenVehicle]] = field(default_factory=dict)
    _stamps: dict[str, deque[int]] = field(default_factory=dict)
    _newest: dict[str, SeenVehicle] = field(default_factory=dict)
    _last: dict[str, _Last] = field(default_factory=dict)
    _first_ns: int | None = None
    _first_step: int = 0
    _given: int = -1
    _back: int = 0

    def take(self, seen: Iterable[SeenVehicle]) -> Iterator[RoadMoment]:
        """Take in what was seen; yields the samples that are complete with it."""
        for one in seen:
            if not (math.isfinite(one.x_m) and math.isfinite(one.y_m)):
                self.counts.beside += 1
                continue
            if self._first_ns is None or self._has_begun_anew(one.stamp_ns):
                self._first_ns, self._first_step = one.stamp_ns, self._given + 1
                for known in (self._seen, self._stamps, self._newest, self._last):
                    known.clear()
            if self._is_repeated(one):
                continue
            one = self._directed(one)
            step = self._step(one.stamp_ns)
            if step <= self._given:
                self.counts.late += 1
                self._remember([one], self.placer.place([one]))
                continue
            self._seen.setdefault(step, {})[one.name] = one
            yield from self._complete(one.stamp_ns)

    def rest(self) -> Iterator[RoadMoment]:
        """What is left at the end."""
        for step in sorted(self._seen):
            yield self._moment(step)

    @property
    def periods_s(self) -> list[float]:
        """Time [s] between two samples of each vehicle, as it was lately, from the shortest to the longest."""
        return sorted(self._own_period_s(name) for name, stamps in self._stamps.items() if len(stamps) > 1)

    def _is_repeated(self, one: SeenVehicle) -> bool:
        """Whether a vehicle has had this stamp already; notes the stamp."""
        stamps = self._stamps.setdefault(one.name, deque(maxlen=_STAMPS))
        if one.stamp_ns in stamps:
            self.counts.repeated += 1
            return True
        stamps.append(one.stamp_ns)
        return False

    def _own_period_s(self, name: str) -> float:
        stamps = sorted(self._stamps.get(name, ()))
        return median((b - a) / NS for a, b in pairwise(stamps)) if stamps[1:] else self.period_s

    def _directed(self, one: SeenVehicle) -> SeenVehicle:
        """A vehicle that does not say in which direction it points, with the direction in which it moves."""
        before, self._newest[one.name] = self._newest.get(one.name), one
        if before is None or not math.isnan(one.heading) or one.stamp_ns <= before.stamp_ns:
            return one
        dx, dy = one.x_m - before.x_m, one.y_m - before.y_m
        speed = math.hypot(dx, dy) * NS / (one.stamp_ns - before.stamp_ns)
        return replace(one, heading=math.atan2(dy, dx)) if speed > MOVING else one

    def _step(self, stamp_ns: int) -> int:
        assert self._first_ns is not None
        return self._first_step + math.floor((stamp_ns - self._first_ns) / (self.period_s * NS) + 0.5)

    def _has_begun_anew(self, stamp_ns: int) -> bool:
        self._back = self._back + 1 if stamp_ns < self._stamp_ns(self._given) - _BACK_NS else 0
        return self._back >= _BACK_IN_A_ROW

    def _stamp_ns(self, step: int) -> int:
        assert self._first_ns is not None
        return self._first_ns + round((step - self._first_step) * self.period_s * NS)

    def _complete(self, newest_ns: int) -> Iterator[RoadMoment]:
        """The samples that lie far enough back."""
        until = self._step(newest_ns - round(0.25 * self.period_s * NS))
        for step in sorted(step for step in self._seen if step < until):
            yield self._moment(step)

    def _moment(self, step: int) -> RoadMoment:
        self._given = step
        seen = list(self._seen.pop(step).values())
        placed = self.placer.place(seen)
        self.counts.taken += len(placed)
        self.counts.beside += len(seen) - len(placed)
        self._remember(seen, placed)
        stamp_ns = self._stamp_ns(step)
        carried, gone = self._absent(stamp_ns, {one.name for one in seen})
        self.counts.carried += len(carried)
        there = [*placed, *carried]
        leaders = self.placer.leaders([*(Unseen(one.seen.name, one.s_m, one.lane) for one in there), *gone])
        if step - self._first_step < _SETTLED_S / self.period_s:
            leaders = [None if leader == NOBODY else leader for leader in leaders]
        led = [one._replace(leader=leader) for one, leader in zip(there, leaders, strict=False)]
        return RoadMoment(step, stamp_ns, led[: len(placed)], led[len(placed) :])

    def _remember(self, seen: list[SeenVehicle], placed: list[OnLane]) -> None:
        """Note where vehicles are, and forget those that are not on the road."""
        on_road = {one.seen.name for one in placed}
        for vehicle in seen:
            if vehicle.name not in on_road:
                self._last.pop(vehicle.name, None)
        for one in placed:
            before = self._last.get(one.seen.name)
            if before is None:
                self._last[one.seen.name] = _Last(one)
            elif one.seen.stamp_ns > before.placed.seen.stamp_ns:
                elapsed_s = (one.seen.stamp_ns - before.placed.seen.stamp_ns) / NS
                way_m = float(self.placer.road.difference(np.array(one.s_m), np.array(before.placed.s_m)))
                self._last[one.seen.name] = _Last(one, way_m / elapsed_s)

    def _absent(self, stamp_ns: int, seen: set[str]) -> tuple[list[OnLane], list[Unseen]]:
        """Vehicles without a sample: those that still count as being there, and those that may be gone."""
        carried, gone = [], []
        for name, last in list(self._last.items()):
            age_s = (stamp_ns - last.placed.seen.stamp_ns) / NS
            if age_s > LONGEST_ABSENCE_S:
                del self._last[name]
            elif name not in seen:
                s_m = float(self.placer.road.wrap(np.array(last.ahead(stamp_ns))))
                if age_s <= _CARRIED_PERIODS * max(self._own_period_s(name), self.period_s):
                    carried.append(last.placed._replace(s_m=s_m))
                else:
                    gone.append(Unseen(None, s_m, last.placed.lane))
        return carried, gone


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
_LONG_ENOUGH_NS = NS
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
    # when [ns] the first message of a topic came, and its stamp
    _clock: dict[str, tuple[int, int]] = field(default_factory=dict)

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
                first_ns, first_stamp_ns = self._clock.setdefault(topic, (received_ns, one.stamp_ns))
                check_unit(topic, bridge, one.stamp_ns - first_stamp_ns, received_ns - first_ns)
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
            elif found is EARLY and newest_ns - one.stamp_ns <= LONGEST_HOLE_S * NS:
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
