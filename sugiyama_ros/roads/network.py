"""Roads as graphs: lanes that follow one another, places where they meet, and signals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.errors import InputError
from sugiyama_ros.results import BLUE, Result
from sugiyama_ros.trajectories.centre_line import CentreLine

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

# Half of the way [m] over which a curvature is measured: the points of maps are not exact.
_HALF_M = 2.5
# Ends of lanes that are nearer than this [m] meet in their middle; a wider hole is a straight piece of the path.
_JOINT_M = 1.0
# Way [m] behind a lane within which a crossing ends.
_REACH_M = 50.0
#: Places [m] on earth, by UTM, at most.
FARTHEST_M = 2e7
# Lengths [m] of lanes, at most.
_LONGEST_M = 1e5
# Two points that are nearer than this [m] are the same point.
_SAME_M = 2e-3


@dataclass(frozen=True, eq=False)
class Lanelet:
    """A lanelet: a piece of a lane without forks.

    Parameters
    ----------
    name : str
        Name of the lane.
    x_m, y_m : numpy.ndarray, shape (P,)
        Points [m] of the middle of the lane, in the direction of driving.
    successors : tuple of str
        Names of the lanes that begin where this one ends.
    left, right : str
        Name of the lane beside this one in the same direction; empty for none.
    speed_limit : float
        Speed limit [m/s]; infinite for none.
    width_m : float
        Width [m].

    Raises
    ------
    InputError
        With the name of the lane, for a field that cannot be used.
    """

    name: str
    x_m: Array
    y_m: Array
    successors: tuple[str, ...] = ()
    left: str = ""
    right: str = ""
    speed_limit: float = np.inf
    width_m: float = 3.5

    def __post_init__(self) -> None:
        if not self.name:
            raise InputError("a lane has no name; give each lane a name of its own")
        if not self.speed_limit > 0.0:
            raise InputError(f"lane {self.name}: speed_limit {self.speed_limit:g} m/s is not positive; correct it")
        if not 0.5 <= self.width_m <= 50.0:
            raise InputError(f"lane {self.name}: width {self.width_m:g} m is not that of a lane; give 0.5 to 50")
        if not (np.abs(self.x_m) < FARTHEST_M).all() or not (np.abs(self.y_m) < FARTHEST_M).all():
            raise InputError(f"lane {self.name}: a point is no place on earth; correct its points")
        try:
            is_ring = self.line.road.is_ring
        except InputError as error:
            raise InputError(f"lane {self.name}: {error}") from None
        if self.length_m > _LONGEST_M:
            raise InputError(f"lane {self.name}: it is {self.length_m:.3g} m long; cut it into shorter ones")
        if is_ring:
            raise InputError(f"lane {self.name}: it ends where it begins; cut it into two lanes or more")

    @cached_property
    def line(self) -> CentreLine:
        """The middle of the lane."""
        return _line(np.stack((self.x_m, self.y_m), axis=1))

    @property
    def length_m(self) -> float:
        """Length [m] of the middle of the lane."""
        return self.line.length_m

    def curvature(self, s_m: Array) -> Array:
        """Curvature [1/m] at places (N,) [m] on the lane, positive to the left: the mean over 5 m around each."""
        return curvature_of(self.line, s_m)


def _line(point: Array) -> CentreLine:
    """A line through points (P, 2) [m] that turns only near its bends.

    A centre line turns steadily between two points. So a piece that is much longer than the next one gets a point more,
    which is as far from the bend as the next piece is long.
    """
    step = np.hypot(*np.diff(point, axis=0).T)
    if len(point) < 2 or not (step > 0.0).all():
        return CentreLine(*point.T)
    points = [point[0]]
    for k, (begin, end) in enumerate(pairwise(point)):
        before, after = (step[one] if 0 <= one < len(step) else np.inf for one in (k - 1, k + 1))
        way = (end - begin) / step[k]
        points += [begin + before * way] if 2.0 * before < step[k] else []
        points += [end - after * way] if 2.0 * after < step[k] else []
        points.append(end)
    return CentreLine(*np.array(points).T)


def curvature_of(line: CentreLine, s_m: Array) -> Array:
    """Curvature [1/m] of an open line at places (N,) [m], positive to the left: the mean over 5 m around each."""
    # a place beyond an end has the curvature of the end
    s = np.clip(s_m, 0.0, line.length_m)
    before, behind = np.maximum(s - _HALF_M, 0.0), np.minimum(s + _HALF_M, line.length_m)
    return np.asarray((line.heading(behind) - line.heading(before)) / (behind - before))


@dataclass(frozen=True)
class Conflict:
    """A part of a lane on which a vehicle may meet one on another lane.

    Two lanes that cross or merge have two conflicts, one for each of them, so that each sees a blocked area.

    Parameters
    ----------
    lane, other : str
        Names of the lane and of the other lane.
    stop_m : float
        Place [m] on the lane where front bumpers wait; negative: before the lane, on the one before it.
    enter_m, leave_m : float
        Part [m] of the lane that both would occupy.
    other_enter_m, other_leave_m : float
        The same part on the other lane [m].
    yields : bool
        Whether the rule asks drivers on the lane to let those on the other lane pass.

    Raises
    ------
    InputError
        If the places are not in order.
    """

    lane: str
    other: str
    stop_m: float
    enter_m: float
    leave_m: float
    other_enter_m: float
    other_leave_m: float
    yields: bool = False

    def __post_init__(self) -> None:
        where = f"conflict of lane {self.lane} with {self.other}"
        if self.lane == self.other:
            raise InputError(f"{where}: a lane does not meet itself; name two lanes")
        if not self.stop_m <= self.enter_m < self.leave_m or not self.other_enter_m < self.other_leave_m:
            raise InputError(f"{where}: its places are not in the order stop, enter, leave; correct them")


@dataclass(frozen=True, eq=False)
class Signal:
    """A signal at a place of a lane.

    Parameters
    ----------
    lane : str
        Name of the lane.
    stop_m : float
        Place [m] on the lane where front bumpers wait.
    change_s : numpy.ndarray, shape (S,)
        Times [s] at which the signal changes, rising; within a cycle if there is one. What it shows first, it also
        shows before; what it shows last lasts, or lasts until the next cycle begins with what it shows first. Without
        times, nothing is known of its colours: it is never red.
    red : numpy.ndarray, shape (S,)
        Whether vehicles have to stop from each of these times on.
    cycle_s : float
        Length [s] of a cycle; 0 without cycles.

    Raises
    ------
    InputError
        If the times do not rise, or do not lie within the cycle.
    """

    lane: str
    stop_m: float
    change_s: Array
    red: Mask
    cycle_s: float = 0.0

    def __post_init__(self) -> None:
        where, times = f"signal of lane {self.lane}", self.change_s
        if len(times) != len(self.red) or not (np.diff(times) > 0.0).all():
            raise InputError(f"{where}: its {len(times)} times do not rise, or do not have a colour each; correct them")
        within = not (self.cycle_s and len(times)) or (times[0] >= 0.0 and times[-1] < self.cycle_s)
        if not (np.isfinite(times).all() and 0.0 <= self.cycle_s < np.inf and within):
            raise InputError(f"{where}: its times do not lie within a cycle of {self.cycle_s:g} s; correct them")

    def red_at(self, time_s: Array) -> Mask:
        """Whether vehicles have to stop at times (N,) [s]."""
        time = self._within(time_s)
        if not len(self.red):
            return np.zeros(len(time), dtype=bool)
        shown = np.searchsorted(self.change_s, time, side="right") - 1
        # before its first change, a cycle goes on with the end of the one before
        return np.asarray(self.red[np.where(shown < 0, len(self.red) - 1 if self.cycle_s else 0, shown)])

    def changes(self, time_s: Array) -> tuple[Array, Array]:
        """Time [s] since the last change of colour and until the next one, at times (N,) [s]; infinite for none."""
        change, around = self._turns
        time = self._within(time_s)
        k = np.searchsorted(change, time, side="right")
        return np.asarray(time - around[k]), np.asarray(around[k + 1] - time)

    @cached_property
    def _turns(self) -> tuple[Array, Array]:
        """Times [s] at which the colour changes, and the same with the last one before and the next one after them."""
        before = np.roll(self.red, 1) if self.cycle_s else np.concatenate((self.red[:1], self.red[:-1]))
        change = self.change_s[self.red != before]
        first, last = (-np.inf, np.inf)
        if self.cycle_s and len(change):
            first, last = change[-1] - self.cycle_s, change[0] + self.cycle_s
        return change, np.concatenate(([first], change, [last]))

    def _within(self, time_s: Array) -> Array:
        """Times within a cycle, if there is one."""
        time = np.asarray(time_s, dtype=np.float64)
        return np.mod(time, self.cycle_s) if self.cycle_s else time


def periodic(lane: str, stop_m: float, offset_s: float, duration_s: Array, red: Mask) -> Signal:
    """A signal of phases (S,) that follow one another for ever, the first from a time [s] on. Raises InputError."""
    if not (duration_s > 0.0).all():
        raise InputError(f"signal of lane {lane}: a phase lasts {duration_s.min():g} s; give times above 0")
    if red.all() or not red.any():
        # the same for ever; without phases, nothing is known
        return Signal(lane, stop_m, np.zeros(min(1, len(red))), red[:1])
    cycle = float(duration_s.sum())
    begin = np.mod(offset_s + np.cumsum(duration_s) - duration_s, cycle)
    order = np.argsort(begin)
    return Signal(lane, stop_m, begin[order], red[order], cycle)


@dataclass(frozen=True)
class PathConflicts:
    """The conflicts of a path, in the order of the places where drivers wait.

    stop_m, enter_m, leave_m: (C,), places [m] on the path; other: (C,), number of the other lane; other_enter_m,
    other_leave_m: (C,), places [m] on the other lane; yields: (C,), whether the rule asks drivers on the path to yield.
    """

    stop_m: Array
    enter_m: Array
    leave_m: Array
    other: Ints
    other_enter_m: Array
    other_leave_m: Array
    yields: Mask


class Path:
    """A route through a network as one line.

    Parameters
    ----------
    network : Network
        The network.
    lanes : sequence of int
        Numbers of the lanes of the route; each follows the one before it, and none comes twice.

    Attributes
    ----------
    lanes : tuple of int
        Numbers of the lanes.
    start_m : numpy.ndarray, shape (L,)
        Place [m] on the path where each lane begins.
    line : CentreLine
        The middle of the path.

    Raises
    ------
    InputError
        If a lane does not follow the one before it, or comes twice.
    """

    def __init__(self, network: "Network", lanes: Sequence[int]) -> None:
        self.network, self.lanes = network, tuple(int(k) for k in lanes)
        _check_route(network, self.lanes)
        self.line, self.start_m = _joined([network.lanes[k] for k in self.lanes])
        self._place = dict(zip(self.lanes, self.start_m.tolist(), strict=True))

    @property
    def length_m(self) -> float:
        """Length [m] of the path."""
        return self.line.length_m

    def at(self, s_m: Array) -> tuple[Array, Array, Array]:
        """Points x, y (N,) [m] of the plane, and the direction [rad] there, at places (N,) [m] on the path."""
        s = np.asarray(s_m, dtype=np.float64)
        return *self.line.at(s, np.zeros_like(s)), self.line.heading(s)

    def curvature(self, s_m: Array) -> Array:
        """Curvature [1/m] at places (N,) [m] on the path, positive to the left: the mean over 5 m around each."""
        return curvature_of(self.line, np.asarray(s_m, dtype=np.float64))

    def project(self, x_m: Array, y_m: Array) -> tuple[Array, Array]:
        """Places [m] along the path and across it, positive to its left, of points (N,) [m]."""
        return self.line.project(x_m, y_m)

    def place_of(self, lane: int) -> float:
        """Place [m] on the path where a lane begins; NaN for a lane that is not part of the path."""
        return float(self._place.get(lane, np.nan))

    def lane_at(self, s_m: Array) -> Ints:
        """Number of the lane at places (N,) [m] on the path; the first and the last one beyond the ends."""
        k = np.clip(np.searchsorted(self.start_m, s_m, side="right") - 1, 0, None)
        return np.asarray(np.array(self.lanes)[k])

    @cached_property
    def conflicts(self) -> PathConflicts:
        """Conflicts of the lanes of the path."""
        found = [(self._place[k], one) for k in self.lanes for one in self.network.conflicts_of[k]]
        found.sort(key=lambda of: of[0] + of[1].stop_m)

        def values(name: str) -> Array:
            return np.array([getattr(one, name) for _, one in found], dtype=np.float64)

        start = np.array([place for place, _ in found], dtype=np.float64)
        return PathConflicts(
            stop_m=start + values("stop_m"),
            enter_m=start + values("enter_m"),
            leave_m=start + values("leave_m"),
            other=np.array([self.network.number(one.other) for _, one in found], dtype=np.int64),
            other_enter_m=values("other_enter_m"),
            other_leave_m=values("other_leave_m"),
            yields=np.array([one.yields for _, one in found], dtype=bool),
        )

    @cached_property
    def signals(self) -> tuple[tuple[float, Signal], ...]:
        """Places [m] on the path where drivers wait for signals, and the signals."""
        found = [(self._place[k] + one.stop_m, one) for k in self.lanes for one in self.network.signals_of[k]]
        return tuple(sorted(found, key=lambda of: of[0]))


@dataclass(frozen=True, eq=False)
class Network(Result):
    """A road: lanes that follow one another, places where they meet, and signals.

    Parameters
    ----------
    lanes : tuple of Lanelet
        The lanes; others name them, and numbers count them from 0 on.
    conflicts : tuple of Conflict
        The places where vehicles may meet.
    signals : tuple of Signal
        The signals.
    notes : tuple of str
        What a reader of the road left out.

    Raises
    ------
    InputError
        For a name that two lanes have, or that no lane has, and for places that are not on their lane.

    Examples
    --------
    >>> import numpy as np
    >>> from sugiyama_ros.roads.network import Lanelet, Network
    >>> straight, bend = np.array([0.0, 50.0]), 50.0 + 20.0 * np.sin(np.linspace(0.0, 1.5, 16))
    >>> first = Lanelet("first", straight, np.zeros(2), successors=("second",))
    >>> second = Lanelet("second", bend, 20.0 - 20.0 * np.cos(np.linspace(0.0, 1.5, 16)))
    >>> network = Network((first, second))
    >>> path = network.path([0, 1])
    >>> round(path.length_m, 1), path.curvature(np.array([20.0, 65.0])).round(3)
    (80.0, array([0.  , 0.05]))
    """

    lanes: tuple[Lanelet, ...]
    conflicts: tuple[Conflict, ...] = ()
    signals: tuple[Signal, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.lanes:
            raise InputError("road: no lanes; give at least one")
        if twice := sorted({one.name for one in self.lanes if self.lanes[self.number(one.name)] is not one}):
            raise InputError(f"lane {twice[0]}: there are two of this name; give each lane a name of its own")
        for lane in self.lanes:
            for field in ("successors", "left", "right"):
                names = getattr(lane, field)
                for name in (names,) if isinstance(names, str) and names else names:
                    if name not in self._numbers:
                        raise InputError(f"lane {lane.name}: {field}: no lane {name}; correct the name")
        for one in self.conflicts:
            where = f"conflict of lane {one.lane} with {one.other}"
            lane, other = (self.lanes[self.number(name, where)] for name in (one.lane, one.other))
            within = one.enter_m >= -_JOINT_M and one.leave_m <= lane.length_m + _JOINT_M
            if not (within and one.other_enter_m >= -_JOINT_M and one.other_leave_m <= other.length_m + _JOINT_M):
                raise InputError(f"{where}: its area is not on the lanes; correct its places")
        for signal in self.signals:
            lane = self.lanes[self.number(signal.lane, "signal")]
            if not signal.stop_m <= lane.length_m + _JOINT_M:
                raise InputError(f"signal of lane {lane.name}: stop {signal.stop_m:g} m is not on the lane; correct it")

    @cached_property
    def _numbers(self) -> dict[str, int]:
        return {lane.name: k for k, lane in reversed([*enumerate(self.lanes)])}

    def number(self, name: str, where: str = "road") -> int:
        """Number of the lane of a name. Raises InputError, which begins with ``where``, if there is none."""
        if name not in self._numbers:
            raise InputError(f"{where}: no lane {name}; there are {', '.join(one.name for one in self.lanes)[:200]}")
        return self._numbers[name]

    @cached_property
    def after(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the lanes that follow each lane."""
        return tuple(tuple(self._numbers[name] for name in one.successors) for one in self.lanes)

    @cached_property
    def before(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the lanes that each lane follows."""
        found: list[list[int]] = [[] for _ in self.lanes]
        for k, after in enumerate(self.after):
            for other in after:
                found[other].append(k)
        return tuple(map(tuple, found))

    def arm(self, lane: int) -> dict[int, float]:
        """The part of a crossing that vehicles reach only by way of a lane: lanes, and the way [m] from its start."""
        found, waiting = {lane: 0.0}, [lane]
        while waiting:
            one = waiting.pop(0)
            way_m = found[one] + self.lanes[one].length_m
            for after in self.after[one]:
                if after not in found and self.before[after] == (one,) and way_m < self.lanes[lane].length_m + _REACH_M:
                    found[after] = way_m
                    waiting.append(after)
        return found

    @cached_property
    def conflicts_of(self) -> tuple[tuple[Conflict, ...], ...]:
        """Conflicts of each lane."""
        return tuple(tuple(one for one in self.conflicts if one.lane == lane.name) for lane in self.lanes)

    @cached_property
    def signals_of(self) -> tuple[tuple[Signal, ...], ...]:
        """Signals of each lane."""
        return tuple(tuple(one for one in self.signals if one.lane == lane.name) for lane in self.lanes)

    def path(self, route: Sequence[int | str]) -> Path:
        """Make one line of a route.

        Parameters
        ----------
        route : sequence of int or str
            Numbers or names of lanes; each follows the one before it, and none comes twice.

        Returns
        -------
        Path
            The route as one line.

        Raises
        ------
        InputError
            If a lane does not follow the one before it, or comes twice.
        """
        return Path(self, [self.number(one, "route") if isinstance(one, str) else one for one in route])

    def ways(self) -> list[Path]:
        """Return all paths from a lane that none leads to, to a lane that leads nowhere, through no lane twice."""
        begun: list[list[int]] = [[k] for k in range(len(self.lanes)) if not self.before[k]]
        found = []
        while begun:
            route = begun.pop()
            if not self.after[route[-1]]:
                found.append(self.path(route))
            begun += [[*route, k] for k in self.after[route[-1]] if k not in route]
        return sorted(found, key=lambda path: path.lanes)

    def headline(self) -> str:
        """Say in one line what the road is."""
        length = sum(one.length_m for one in self.lanes)
        yields = sum(one.yields for one in self.conflicts)
        return (
            f"road of {len(self.lanes)} lanes, {length:.0f} m in all; {len(self.conflicts)} conflicts, in {yields} of"
            f" which drivers yield by rule; {len(self.signals)} signals"
        )

    def records(self) -> Sequence[Mapping[str, Any]]:
        """List the lanes: one mapping of column names to values for each."""
        return [
            {
                "lane": one.name,
                "length_m": one.length_m,
                "speed_limit": one.speed_limit,
                "successors": " ".join(one.successors),
                "conflicts": len(self.conflicts_of[k]),
                "yields": sum(conflict.yields for conflict in self.conflicts_of[k]),
                "signals": len(self.signals_of[k]),
            }
            for k, one in enumerate(self.lanes)
        ]

    def draw(self, figure: "Figure | SubFigure") -> None:
        """Draw the lanes, the places where drivers yield (orange), and the signals (red)."""
        axes = figure.subplots()
        for lane in self.lanes:
            axes.plot(lane.x_m, lane.y_m, color=BLUE, linewidth=1.0)
        stops = [(one.lane, one.stop_m) for one in self.conflicts if one.yields]
        for places, colour in ((stops, "tab:orange"), ([(one.lane, one.stop_m) for one in self.signals], "tab:red")):
            for name, stop_m in dict.fromkeys(places):
                x, y = self.lanes[self.number(name)].line.at(np.array([stop_m]), np.zeros(1))
                axes.plot(x, y, "o", color=colour, markersize=4.0)
        axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=self.headline())


def _check_route(network: Network, lanes: tuple[int, ...]) -> None:
    if not lanes or not all(0 <= k < len(network.lanes) for k in lanes):
        raise InputError(f"route: {len(lanes)} lanes, not all of them of this road; name at least one lane")
    names = [network.lanes[k].name for k in lanes]
    for k, name in enumerate(names):
        if name in names[:k]:
            raise InputError(f"route: lane {name} comes twice; end the route before")
        if k and lanes[k] not in network.after[lanes[k - 1]]:
            raise InputError(f"route: lane {name} does not follow {names[k - 1]}; name the lanes between")


def _joined(lanes: Sequence[Lanelet]) -> tuple[CentreLine, Array]:
    """One line of lanes that follow one another, and the place [m] where each begins."""
    parts = [np.array([lane.x_m, lane.y_m]).T for lane in lanes]
    for before, behind in pairwise(parts):
        if np.hypot(*(behind[0] - before[-1])) < _JOINT_M:
            before[-1] = behind[0] = 0.5 * (before[-1] + behind[0])
    points, first = parts[0], [0]
    for part in parts[1:]:
        first.append(len(points) - 1 if (part[0] == points[-1]).all() else len(points))
        points = np.concatenate((points[: first[-1]], part))
    if np.hypot(*(points[-1] - points[0])) < _SAME_M:
        # a route once around a circle is open: its end is not its start
        way = points[-1] - points[-2]
        points[-1] -= way * min(0.5, 2.0 * _SAME_M / np.hypot(*way))
    way_m = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    return _line(points), way_m[first]
