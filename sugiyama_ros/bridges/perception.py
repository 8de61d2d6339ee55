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

from sugiyama_ros.bridges.bridge import NS, UNITS_NS, Bridge
from sugiyama_ros.bridges.frames import Frames
from sugiyama_ros.errors import InputError
from sugiyama_ros.road import PERIODS_S
from sugiyama_ros.trajectories.about import DEFAULT_LENGTH_M
from sugiyama_ros.trajectories.assemble import LONGEST_ABSENCE_S
from sugiyama_ros.trajectories.centre_line import RoadLanes
from sugiyama_ros.trajectories.kinds import is_driver
from sugiyama_ros.trajectories.placing import NOBODY, OnLane, Placer, Positions, SeenVehicle, Unseen
from sugiyama_ros.trajectories.tracks import FREE, UNKNOWN

#: Time has begun anew when so many stamps in a row lie so long [ns] before an earlier one.
BACK_NS, BACK_IN_A_ROW = NS, 5
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
# Time [s] between two samples where nobody says it.
_DEFAULT_PERIOD_S = 0.1
#: Share of what is seen that may be lost before something is wrong.
MOST_LOST = 0.01
#: Ratio of the longest to the shortest period that is noted.
RATES_DIFFER = 1.5
# Factor between stamps and clock beyond which the unit of the stamps is wrong, as no replay is that fast; and the time
# [ns] after which they are compared.
_OTHER_UNIT, _LONG_ENOUGH_NS = 700.0, NS
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
        if self.period_s is not None and not PERIODS_S[0] <= self.period_s <= PERIODS_S[1]:
            raise InputError(f"period: {self.period_s:g} s is not within {PERIODS_S[0]:g} to {PERIODS_S[1]:g} s")
        if not 0.0 < self.length_m < math.inf:
            raise InputError(f"length: {self.length_m:g} m is not the length of a vehicle; give a positive number")


@dataclass
class Counts:
    """What became of what was seen.

    seen: vehicles in messages; taken: vehicles that are in a sample; beside, late, unknown_frame: vehicles that are not
    on the road; that were seen before the last sample; whose position is in a frame from which nothing leads to the
    road's; unnamed, doubled: vehicles without an id, or with the id of another one in the same message; unstamped,
    repeated: vehicles whose stamp is 0, and which count as seen when the message came; with the stamp that they had
    before; carried: rows of vehicles without a sample; no_driver: rows of who drives nothing, as pedestrians.
    """

    seen: int = 0
    taken: int = 0
    beside: int = 0
    late: int = 0
    unknown_frame: int = 0
    unnamed: int = 0
    doubled: int = 0
    unstamped: int = 0
    repeated: int = 0
    carried: int = 0
    no_driver: int = 0


class Numbers:
    """Numbers of vehicles: the last number in the name, if no other vehicle has it, or else the next free number."""

    def __init__(self) -> None:
        self._of: dict[str, int] = {}

    def __call__(self, name: str | None) -> int:
        """Number of a vehicle; `FREE` for nobody, and `UNKNOWN` for one that is not known."""
        if name is None:
            return UNKNOWN
        if name == NOBODY:
            return FREE
        if name not in self._of:
            digits = _NUMBER.search(name)
            wanted = int(digits[1]) if digits and len(digits[1]) <= 9 else -1
            taken = set(self._of.values())
            self._of[name] = wanted if wanted >= 0 and wanted not in taken else max(taken, default=-1) + 1
        return self._of[name]


class Intake:
    """Takes messages, and says which vehicles they show: those that can be told apart, at places that are numbers."""

    def __init__(self, counts: Counts) -> None:
        self.counts = counts
        # stamp [ns] of the first message of each topic, and when it came
        self._first: dict[str, tuple[int, int]] = {}

    def take(self, message: Any, bridge: Bridge, topic: str, came_ns: int) -> list[SeenVehicle]:
        """The vehicles in a message that came, or was logged, at a time [ns].

        Raises InputError for a message that has not what the bridge names, or whose stamps are in another unit.
        """
        seen = list(bridge.seen(message, topic, came_ns))
        if seen and seen[0].stamp_ns:
            first_ns, first_came_ns = self._first.setdefault(topic, (seen[0].stamp_ns, came_ns))
            _check_unit(topic, bridge, seen[0].stamp_ns - first_ns, came_ns - first_came_ns)
        often = Counter(one.name for one in seen)
        self.counts.seen += len(seen)
        self.counts.unnamed += often.pop("", 0)
        self.counts.doubled += sum(number for number in often.values() if number > 1)
        named = [one for one in seen if often.get(one.name) == 1]
        found = [one for one in named if math.isfinite(one.x_m) and math.isfinite(one.y_m)]
        self.counts.beside += len(named) - len(found)
        return found


def _check_unit(topic: str, bridge: Bridge, stamps_ns: int, came_ns: int) -> None:
    """Raise InputError where stamps that are numbers run much faster or slower than the clock: in another unit."""
    is_number = bridge.stamp and bridge.stamp != "header.stamp"
    if not is_number or came_ns < _LONG_ENOUGH_NS or stamps_ns <= 0:
        return
    ratio = stamps_ns / came_ns
    if 1.0 / _OTHER_UNIT < ratio < _OTHER_UNIT:
        return
    wanted_ns = UNITS_NS[bridge.stamp_unit] / ratio
    unit = min(UNITS_NS, key=lambda name: abs(math.log(UNITS_NS[name] / wanted_ns)))
    raise InputError(
        f"{topic}: {bridge.stamp} runs {ratio:.3g} times as fast as the clock; give `stamp_unit: {unit}` in the bridge"
    )


class RoadMoment(NamedTuple):
    """The road at one time: number of the sample, its stamp [ns], and the vehicles on the road.

    ``carried`` are vehicles without a sample now, whose last one is not older than one and a half of their own periods.
    """

    step: int
    stamp_ns: int
    placed: list[OnLane]
    carried: list[OnLane]


@dataclass
class _Known:
    """What is known of a vehicle: its last stamps [ns], what was seen last, its place on the road and speed [m/s]."""

    stamps: deque[int] = field(default_factory=lambda: deque(maxlen=_STAMPS))
    newest: SeenVehicle | None = None
    placed: OnLane | None = None
    speed: float = 0.0

    @property
    def period_s(self) -> float:
        """Usual time [s] between two samples; 0 for a vehicle that was seen once."""
        return median([(b - a) / NS for a, b in pairwise(sorted(self.stamps))] or [0.0])

    def directed(self, one: SeenVehicle) -> SeenVehicle:
        """The vehicle as it was seen now; where it does not say in which direction it points, with that of its way."""
        before, self.newest = self.newest, one
        if before is None or not math.isnan(one.heading) or one.stamp_ns <= before.stamp_ns:
            return one
        dx, dy = one.x_m - before.x_m, one.y_m - before.y_m
        speed = math.hypot(dx, dy) * NS / (one.stamp_ns - before.stamp_ns)
        return replace(one, heading=math.atan2(dy, dx)) if speed > MOVING else one


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

    placer: puts vehicles on lanes; period_s: time [s] between two samples; counts: what becomes of the vehicles.
    """

    placer: Placer
    period_s: float
    counts: Counts = field(default_factory=Counts)
    _seen: dict[int, dict[str, SeenVehicle]] = field(default_factory=dict)
    _known: dict[str, _Known] = field(default_factory=dict)
    _first_ns: int | None = None
    _first_step: int = 0
    _given: int = -1
    _back: int = 0

    def take(self, seen: Iterable[SeenVehicle]) -> Iterator[RoadMoment]:
        """Take in what was seen; yields the samples that are complete with it."""
        for one in seen:
            if self._first_ns is None or self._has_begun_anew(one.stamp_ns):
                self._first_ns, self._first_step = one.stamp_ns, self._given + 1
                self._seen.clear()
                self._known.clear()
            known = self._known.setdefault(one.name, _Known())
            if one.stamp_ns in known.stamps:
                self.counts.repeated += 1
                continue
            known.stamps.append(one.stamp_ns)
            one = known.directed(one)
            step = self._step(one.stamp_ns)
            if step <= self._given:
                self.counts.late += 1
                self._remember([one], self.placer.place([one]))
                continue
            self._seen.setdefault(step, {})[one.name] = one
            until = self._step(one.stamp_ns - round(0.25 * self.period_s * NS))
            for due in sorted(step for step in self._seen if step < until):
                yield self._moment(due)

    @property
    def periods_s(self) -> list[float]:
        """Time [s] between two samples of each vehicle, as it was lately, from the shortest to the longest."""
        return sorted(period_s for known in self._known.values() if (period_s := known.period_s) > 0.0)

    def _step(self, stamp_ns: int) -> int:
        assert self._first_ns is not None
        return self._first_step + math.floor((stamp_ns - self._first_ns) / (self.period_s * NS) + 0.5)

    def _has_begun_anew(self, stamp_ns: int) -> bool:
        self._back = self._back + 1 if stamp_ns < self._stamp_ns(self._given) - BACK_NS else 0
        return self._back >= BACK_IN_A_ROW

    def _stamp_ns(self, step: int) -> int:
        assert self._first_ns is not None
        return self._first_ns + round((step - self._first_step) * self.period_s * NS)

    def _moment(self, step: int) -> RoadMoment:
        self._given = step
        seen = list(self._seen.pop(step).values())
        placed = self.placer.place(seen)
        self.counts.taken += len(placed)
        self.counts.beside += len(seen) - len(placed)
        self._remember(seen, placed)
        stamp_ns = self._stamp_ns(step)
        carried, gone = self._absent(stamp_ns, {one.name for one in seen})
        # who drives nothing may be in the way, but nobody follows it
        others = [one for one in (*placed, *carried) if not _drives(one)]
        self.counts.no_driver += len(others)
        gone += [Unseen(None, one.s_m, one.lane) for one in others]
        placed, carried = list(filter(_drives, placed)), list(filter(_drives, carried))
        self.counts.carried += len(carried)
        there = [*placed, *carried]
        leaders = self.placer.leaders([*(Unseen(one.seen.name, one.s_m, one.lane) for one in there), *gone])
        if step - self._first_step < _SETTLED_S / self.period_s:
            leaders = [None if leader == NOBODY else leader for leader in leaders]
        led = [one._replace(leader=leader) for one, leader in zip(there, leaders, strict=False)]
        return RoadMoment(step, stamp_ns, led[: len(placed)], led[len(placed) :])

    def _remember(self, seen: list[SeenVehicle], placed: list[OnLane]) -> None:
        """Note where vehicles are, and that others are not on the road."""
        on_road = {one.seen.name: one for one in placed}
        for vehicle in seen:
            known, now = self._known[vehicle.name], on_road.get(vehicle.name)
            before = known.placed
            if now is None or before is None:
                known.placed, known.speed = now, 0.0
            elif vehicle.stamp_ns > before.seen.stamp_ns:
                way_m = float(self.placer.road.difference(np.array(now.s_m), np.array(before.s_m)))
                known.placed, known.speed = now, way_m * NS / (vehicle.stamp_ns - before.seen.stamp_ns)

    def _absent(self, stamp_ns: int, seen: set[str]) -> tuple[list[OnLane], list[Unseen]]:
        """Vehicles without a sample: those that still count as being there, and those that may be gone."""
        carried, gone = [], []
        for name, known in list(self._known.items()):
            if stamp_ns - max(known.stamps) > LONGEST_ABSENCE_S * NS:
                del self._known[name]
                continue
            if known.placed is None or name in seen:
                continue
            age_s = (stamp_ns - known.placed.seen.stamp_ns) / NS
            s_m = float(self.placer.road.wrap(np.array(known.placed.s_m + known.speed * age_s)))
            if age_s <= _CARRIED_PERIODS * max(known.period_s, self.period_s):
                carried.append(known.placed._replace(s_m=s_m))
            else:
                gone.append(Unseen(None, s_m, known.placed.lane))
        return carried, gone


def _drives(one: OnLane) -> bool:
    return is_driver(one.seen.vehicle_class)


class RoadSample(NamedTuple):
    """Number of a sample, its stamp [ns], all vehicles on the road then, and those of them that were seen, first.

    A vehicle without a sample at this time has no position, but a lane and a leader.
    """

    step: int
    stamp_ns: int
    positions: Positions
    placed: list[OnLane]


class Perception:
    """Takes messages as they come, and gives out samples of the road.

    lanes: the road; settings: how vehicles are seen.
    """

    def __init__(self, lanes: RoadLanes, settings: PerceptionSettings = PerceptionSettings()) -> None:
        self.lanes, self._settings = lanes, settings
        self._intake, self._frames, self._numbers = Intake(Counts()), Frames(settings.frame), Numbers()
        self._moments = Moments(Placer(lanes), settings.period_s or _DEFAULT_PERIOD_S, self._intake.counts)
        self._lane_number = lane_numbers(lanes)
        self._length: dict[str, float] = {}
        self._seen_in: set[str] = set()

    @property
    def counts(self) -> Counts:
        """What became of what was seen."""
        self._intake.counts.unknown_frame = self._frames.lost
        return self._intake.counts

    @property
    def periods_s(self) -> list[float]:
        """Time [s] between two samples of each vehicle, as it was lately, from the shortest to the longest."""
        return self._moments.periods_s

    def take(self, message: Any, bridge: Bridge, topic: str, received_ns: int) -> Iterator[RoadSample]:
        """Take in a message; yields the samples that are complete with it.

        Raises InputError for one that has not what the bridge names, or whose stamps are in another unit.
        """
        seen = self._intake.take(message, bridge, topic, received_ns)
        self._intake.counts.unstamped += sum(one.stamp_ns == 0 for one in seen)
        self._seen_in |= {one.frame for one in seen}
        stamped = (one if one.stamp_ns else replace(one, stamp_ns=received_ns) for one in seen)
        return map(self._sample, self._moments.take(self._frames.take(stamped)))

    def hear(self, message: Any, static: bool) -> Iterator[RoadSample]:
        """Take in transforms; yields the samples that are complete with what has waited for them."""
        return map(self._sample, self._moments.take(self._frames.hear(message, static)))

    def problem(self) -> str:
        """What is wrong with what is seen, and what to do; empty if nothing is."""
        counts = vars(self.counts)
        for name, why in _PROBLEMS.items():
            if counts[name] > MOST_LOST * counts["seen"]:
                return f"{counts[name]} of {counts['seen']} vehicles seen {why}"
        if not self._settings.frame and (moving := [f for f in self._seen_in if self._frames.is_moving(f)]):
            return f"positions are in {moving[0]}, which moves; set the parameter frame to that of the centre line"
        if not self._settings.frame and len(self._seen_in) > 1:
            return f"positions are in several frames ({', '.join(sorted(self._seen_in))}); set the parameter frame"
        periods, period_s = self.periods_s, self._moments.period_s
        if periods and periods[-1] > RATES_DIFFER * period_s:
            return (
                f"vehicles are seen every {periods[0]:.3g} to {periods[-1]:.3g} s, and a sample is sent every"
                f" {period_s:g} s; those without a new position are sent without one"
            )
        return ""

    def _sample(self, moment: RoadMoment) -> RoadSample:
        there, nan = [*moment.placed, *moment.carried], [math.nan] * len(moment.carried)
        offset = [1e-9 * (one.seen.stamp_ns - moment.stamp_ns) for one in moment.placed]
        var = [one.seen.var for one in moment.placed]
        positions = Positions(
            vehicle=[self._numbers(one.seen.name) for one in there],
            leader=[self._numbers(one.leader) for one in there],
            position_m=[one.s_m for one in moment.placed] + nan,
            length_m=[self._length_of(one.seen) for one in there],
            lane=[self._lane_number[one.lane] for one in there],
            d_m=[one.d_m for one in moment.placed] + nan,
            stamp_offset_s=offset + [0.0] * len(moment.carried),
            position_var=var + nan if any(map(math.isfinite, var)) else [],
        )
        return RoadSample(moment.step, moment.stamp_ns, positions, moment.placed)

    def _length_of(self, seen: SeenVehicle) -> float:
        """Length [m] of a vehicle; it stays as it was said first."""
        given = self._settings.length_m if math.isnan(seen.length_m) else seen.length_m
        return self._length.setdefault(seen.name, given)


def lane_numbers(lanes: RoadLanes) -> list[int]:
    """Number of each lane: its name if all names are numbers, else its place."""
    are_numbers = all(re.fullmatch(r"-?[0-9]{1,3}", name) for name in lanes.names)
    return [int(name) if are_numbers else k for k, name in enumerate(lanes.names)]
