"""All that a bag says of vehicles, as arrays: when each was seen, by which clock, and where."""

from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median_low
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.bridges.fields import NS, Bridge
from sugiyama_ros.bridges.frames import CACHE_S, EARLY, Frames
from sugiyama_ros.bridges.perception import LONGEST_M, MOST_LOST, MOVING, Counts, check_unit, told_apart
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.mcap_reader import BagMessage
from sugiyama_ros.formats.samples import MAX_SAMPLES
from sugiyama_ros.trajectories.placing import SeenVehicle

# Time has begun anew where so many stamps of a vehicle in a row lie so long [ns] before an earlier one.
_BACK_NS, _BACK_IN_A_ROW = NS, 5
# Two resets of vehicles that are logged within this time [ns] are one.
_ONE_RESET_NS = 5 * NS
# A vehicle that is seen less often is not followed.
_FEW = 3
# A time [ns] after all others.
_END_NS = 1 << 62
# Way [m] that a vehicle goes between two messages, so that they are not of the same time.
_MOVED_M = 0.01
#: Clocks that are further apart [s] are set; those that are so far apart are warned of.
CLOCKS_APART_S, CLOCKS_DOUBTFUL_S = 1.0, 0.1


@dataclass(frozen=True, eq=False)
class Sightings:
    """N sightings of vehicles, in the order of the log.

    stamp_ns, log_ns: (N,), when [ns] the vehicle was seen, and when that was recorded; x_m, y_m, heading, length_m:
    (N,), as in `SeenVehicle`; vehicle, topic, frame: (N,), number of the vehicle, of the topic, and of the frame in
    these lists; vehicles, topics, frames: their names.
    """

    stamp_ns: Ints
    log_ns: Ints
    x_m: Array
    y_m: Array
    heading: Array
    length_m: Array
    vehicle: Ints
    topic: Ints
    frame: Ints
    vehicles: tuple[str, ...] = ()
    topics: tuple[str, ...] = ()
    frames: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def taken(self, rows: Mask | Ints) -> "Sightings":
        """Some of the sightings."""
        return replace(self, **{name: getattr(self, name)[rows] for name in _COLUMNS})

    def steps(self) -> Iterator[Ints]:
        """Rows of each vehicle, in the order in which they stand."""
        order = np.argsort(self.vehicle, kind="stable")
        yield from np.split(order, np.flatnonzero(np.diff(self.vehicle[order])) + 1)


# Columns, and the types of their values.
_COLUMNS = {
    **dict.fromkeys(("stamp_ns", "log_ns"), "q"),
    **dict.fromkeys(("x_m", "y_m", "heading", "length_m"), "d"),
    **dict.fromkeys(("vehicle", "topic", "frame"), "q"),
}


class Collector:
    """Collects what the messages of a bag say. Raises InputError for more than a table may have.

    path: the bag, for messages; counts: what is left out is counted here.
    """

    def __init__(self, path: Path, counts: Counts) -> None:
        self._path, self._counts = path, counts
        self._columns = {name: array(kind) for name, kind in _COLUMNS.items()}
        self._numbers: dict[str, dict[str, int]] = {"vehicle": {}, "topic": {}, "frame": {}}
        # stamp and log time [ns] of the first message of each topic
        self._clocks: dict[str, tuple[int, int]] = {}
        self._total = 0

    def add(self, message: BagMessage, bridge: Bridge) -> None:
        """Take in a message.

        Raises InputError for one that has not what the bridge names, or where stamps are in another unit.
        """
        seen = list(bridge.seen(message.message, message.topic, message.log_time_ns))
        self._total += len(seen)
        if seen and seen[0].stamp_ns:
            first = self._clocks.setdefault(message.topic, (seen[0].stamp_ns, message.log_time_ns))
            since = seen[0].stamp_ns - first[0], message.log_time_ns - first[1]
            check_unit(f"{self._path}: {message.topic}", bridge, *since)
        for one in told_apart(seen, self._counts):
            if not (np.isfinite(one.x_m) and np.isfinite(one.y_m)):
                self._counts.beside += 1
                continue
            values: dict[str, Any] = {
                "stamp_ns": min(max(one.stamp_ns, -_END_NS), _END_NS),
                "log_ns": message.log_time_ns,
                "x_m": one.x_m,
                "y_m": one.y_m,
                "heading": one.heading,
                "length_m": one.length_m if one.length_m < LONGEST_M else np.nan,
                "vehicle": self._number("vehicle", one.name),
                "topic": self._number("topic", message.topic),
                "frame": self._number("frame", one.frame.lstrip("/")),
            }
            for name, value in values.items():
                self._columns[name].append(value)
        if len(self._columns["x_m"]) > MAX_SAMPLES:
            raise InputError(f"{self._path}: more than {MAX_SAMPLES} sightings of vehicles; split the bag")

    def all(self) -> Sightings:
        """All sightings. Raises InputError where vehicles cannot be told apart."""
        for lost, why in ((self._counts.unnamed, "have no id"), (self._counts.doubled, "share an id in a message")):
            if lost > MOST_LOST * self._total:
                raise InputError(
                    f"{self._path}: {lost} of {self._total} detections {why}, so nobody can be followed; give the"
                    " messages of a tracker, whose ids stay with the vehicles"
                )
        columns = {name: np.frombuffer(values, dtype=_COLUMNS[name]).copy() for name, values in self._columns.items()}
        names = {f"{name}s": tuple(known) for name, known in self._numbers.items()}
        return Sightings(**columns, **names)  # type: ignore[arg-type]

    def _number(self, column: str, name: str) -> int:
        return self._numbers[column].setdefault(name, len(self._numbers[column]))


def recordings(sightings: Sightings) -> list[Sightings]:
    """The parts between which time has begun anew, as when a simulation is reset."""
    resets: list[int] = []
    for rows in sightings.steps():
        resets += _resets(sightings.stamp_ns[rows], sightings.log_ns[rows])
    resets.sort()
    first = [at for k, at in enumerate(resets) if not k or at - resets[k - 1] > _ONE_RESET_NS]
    part = np.searchsorted(np.array(first, dtype=np.int64), sightings.log_ns, side="right")
    return [sightings.taken(part == k) for k in range(len(first) + 1)]


def _resets(stamp_ns: Ints, log_ns: Ints) -> list[int]:
    """Log times [ns] at which the stamps of a vehicle begin anew."""
    found, begin = [], 0
    while begin < len(stamp_ns):
        stamps = stamp_ns[begin:]
        back = (stamps < np.maximum.accumulate(stamps) - _BACK_NS) & (stamps > 0)
        in_a_row = np.convolve(back.astype(np.int64), np.ones(_BACK_IN_A_ROW, dtype=np.int64))
        full = np.flatnonzero(in_a_row[: len(back)] == _BACK_IN_A_ROW)
        if not len(full):
            break
        begin += int(full[0]) - _BACK_IN_A_ROW + 1
        found.append(int(log_ns[begin]))
    return found


class Stamps:
    """Checks stamps against log times, and corrects those that cannot be right.

    path: the bag, for messages; bridges: bridge of each topic; notes: what was corrected; repeated: sightings that were
    left out because the vehicle has another one at the same time.
    """

    def __init__(self, path: Path, bridges: dict[str, Bridge]) -> None:
        self._path, self._bridges = path, bridges
        self.notes: list[str] = []
        self.repeated = 0

    def corrected(self, sightings: Sightings) -> Sightings:
        """Give the sightings stamps that can be used, one for each vehicle and time, sorted by stamp.

        Raises InputError where neither stamps nor log times can be used.
        """
        return self._once(self._set(self._unstamped(sightings)))

    def _unstamped(self, found: Sightings) -> Sightings:
        """Log times instead of stamps of topics that have none, or the same one for several places."""
        stamp_ns = found.stamp_ns.copy()
        same = _same_stamp(found)
        for number, topic in enumerate(found.topics):
            here = (found.topic == number) & bool(self._bridges[topic].stamp)
            zero = here & (stamp_ns == 0)
            many = int(here.sum())
            unset = zero.sum() > 0.5 * many
            if unset or same[here].sum() > MOST_LOST * many:
                stamp_ns[here] = found.log_ns[here]
                why = "is 0" if unset else "stays the same while vehicles move"
                self._note(f"{topic}: header.stamp {why}; the log times count instead", topic)
            elif zero.any():
                stamp_ns[zero] = found.log_ns[zero] + round(np.median((stamp_ns - found.log_ns)[here & ~zero]))
                self._note(f"{topic}: {int(zero.sum())} stamps are 0; the log times count instead", topic)
        return replace(found, stamp_ns=stamp_ns)

    def _note(self, text: str, topic: str) -> None:
        stamp = self._bridges[topic].stamp or "header.stamp"
        self.notes.append("warning: " + text.replace("header.stamp", stamp))

    def _set(self, found: Sightings) -> Sightings:
        """The same, with clocks that are far apart set by the log times."""
        offset = _offsets_s(found)
        if not len(offset):
            return found
        usual = median_low(offset.values())
        stamp_ns = found.stamp_ns.copy()
        for number, off_s in offset.items():
            topic, late_s = found.topics[number], off_s - usual
            if abs(late_s) > CLOCKS_APART_S:
                stamp_ns[found.topic == number] += round(late_s * NS)
                which = "behind" if late_s > 0.0 else "ahead of"
                self._note(
                    f"{topic}: its clock is {abs(late_s):.3g} s {which} the others; it was set by the log times", topic
                )
            elif abs(late_s) > CLOCKS_DOUBTFUL_S:
                self._note(
                    f"{topic}: recorded {late_s:.3g} s later after its stamps than the others; if its clock is wrong,"
                    " give a bridge with `stamp: ''`, which takes the log times",
                    topic,
                )
        return replace(found, stamp_ns=stamp_ns)

    def _once(self, found: Sightings) -> Sightings:
        """One sighting for each vehicle and time, sorted by time."""
        order = np.lexsort((found.log_ns, found.stamp_ns, found.vehicle))
        found = found.taken(order)
        again = np.zeros(len(found), dtype=bool)
        again[1:] = (np.diff(found.stamp_ns) == 0) & (np.diff(found.vehicle) == 0)
        apart = again.copy()
        apart[1:] &= np.hypot(np.diff(found.x_m), np.diff(found.y_m)) > _MOVED_M
        if apart.sum() > MOST_LOST * len(found):
            row = int(np.flatnonzero(apart)[0])
            raise InputError(
                f"{self._path}: {found.vehicles[found.vehicle[row]]} is at two places at"
                f" {found.stamp_ns[row] / NS:g} s, and so in {int(apart.sum())} of {len(found)} messages; one name"
                " stands for several vehicles, or the log times are wrong as well; record each vehicle with a name or"
                " a topic of its own"
            )
        self.repeated += int(again.sum())
        found = found.taken(~again)
        return found.taken(np.argsort(found.stamp_ns, kind="stable"))


def _same_stamp(found: Sightings) -> Mask:
    """Whether a vehicle has moved since a message with the same stamp (N,)."""
    same = np.zeros(len(found), dtype=bool)
    for rows in found.steps():
        moved = np.hypot(np.diff(found.x_m[rows]), np.diff(found.y_m[rows])) > _MOVED_M
        same[rows[1:]] = (np.diff(found.stamp_ns[rows]) == 0) & moved
    return same


def _offsets_s(found: Sightings) -> dict[int, float]:
    """How much later [s] the messages of each topic are logged after their stamps than those of the first one.

    Topics are compared at the times at which both were logged: a replay that is not in real time moves all of them.
    """
    rows = {number: np.flatnonzero(found.topic == number) for number in range(len(found.topics))}
    rows = {number: here for number, here in rows.items() if len(here) > _BACK_IN_A_ROW}
    if len(rows) < 2:
        return {}
    late = (found.log_ns - found.stamp_ns) / NS
    log = (found.log_ns - found.log_ns.min()) / NS
    first = max(rows, key=lambda number: len(rows[number]))
    base = rows[first]
    offset = {first: 0.0}
    for number, here in rows.items():
        both = here[(log[here] >= log[base[0]]) & (log[here] <= log[base[-1]])]
        if number != first and len(both):
            offset[number] = float(np.median(late[both] - np.interp(log[both], log[base], late[base])))
    return offset


def check_followed(path: Path, parts: Sequence[Sightings]) -> None:
    """Raise InputError where most sightings are of vehicles that are seen once or twice: their ids do not stay."""
    often = [len(rows) for part in parts if len(part) for rows in part.steps()]
    seldom = [number for number in often if number < _FEW]
    if sum(seldom) > 0.5 * sum(often):
        raise InputError(
            f"{path}: {len(seldom)} ids are seen once or twice each, so nobody can be followed; give the messages of a"
            " tracker, whose ids stay with the vehicles"
        )


class Transforms(NamedTuple):
    """A message with transforms, whether they are static, and its log time [ns]."""

    message: Any
    static: bool
    log_ns: int


def brought(sightings: Sightings, transforms: Iterator[Transforms], frame: str) -> tuple[Sightings, int]:
    """Bring sightings into a frame; returns those that could be brought there, and how many could not."""
    known, kept = Frames(), np.zeros(len(sightings), dtype=bool)
    x_m, y_m, heading = sightings.x_m.copy(), sightings.y_m.copy(), sightings.heading.copy()
    row, around_ns = 0, round(0.5 * CACHE_S * NS)

    def go_on(log_ns: int) -> None:
        """Bring what can be brought with the transforms until a log time; what is not seen yet waits."""
        nonlocal row
        while row < len(sightings) and sightings.log_ns[row] <= log_ns + around_ns:
            stamp_ns = int(sightings.stamp_ns[row])
            own = sightings.frames[sightings.frame[row]]
            one = SeenVehicle(stamp_ns, "", x_m[row], y_m[row], heading[row], frame=own)
            found = known.brought(one, frame)
            if isinstance(found, SeenVehicle):
                x_m[row], y_m[row], heading[row], kept[row] = found.x_m, found.y_m, found.heading, True
            elif sightings.log_ns[row] > log_ns - (around_ns if found is EARLY else 0):
                return
            row += 1

    for message, static, log_ns in transforms:
        if static or log_ns >= sightings.log_ns.min(initial=log_ns) - around_ns:
            known.add(message, static)
        if not static:
            go_on(log_ns)
    go_on(_END_NS)
    here = replace(sightings, x_m=x_m, y_m=y_m, heading=heading).taken(kept)
    return here, int((~kept).sum())


def directed(sightings: Sightings) -> Sightings:
    """The same, with the direction in which a vehicle moves where it does not say in which direction it points."""
    heading = sightings.heading.copy()
    for rows in sightings.steps():
        unknown = np.isnan(heading[rows])
        if not unknown.any() or len(rows) < 2:
            continue
        time_s = (sightings.stamp_ns[rows] - sightings.stamp_ns[rows[0]]) / NS
        vx, vy = np.gradient(sightings.x_m[rows], time_s), np.gradient(sightings.y_m[rows], time_s)
        fast = unknown & (np.hypot(vx, vy) > MOVING)
        heading[rows[fast]] = np.arctan2(vy, vx)[fast]
    return replace(sightings, heading=heading)
