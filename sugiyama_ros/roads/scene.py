"""What drivers see of each other on a network: who is ahead on their way, and before which line they let others pass.

A driver sees the next vehicle on their way, and of all lines before which they may have to wait the one that matters:
the nearest line that asks for their attention, or else the one that comes nearest to it. Who goes first is expected to
arrive at a usual acceleration, and to leave at their present speed. Who stands is not on the way; who is on the place
behind the line is in the way of everybody, whoever goes first by the rule.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.line import SOFT_S, TIME_GAP_S, USUAL, attention, time_over, time_to_line
from sugiyama_ros.driver.parameters import REFERENCE_HORIZON, REFERENCE_PERIOD_S
from sugiyama_ros.jit import kernel
from sugiyama_ros.roads.network import Network, Path
from sugiyama_ros.roads.view import FREE_M, InSight, OnNetwork, Sides, behind_lost, hidden, is_beside, leaving
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.assemble import assemble
from sugiyama_ros.trajectories.labels import Labels, labels
from sugiyama_ros.trajectories.tracks import FREE, LINE, NOBODY, UNKNOWN, Tracks

#: Way [m] within which a driver looks for lines.
VIEW_M = 100.0
# Speed [m/s] below which a vehicle stands.
_STANDING = 0.3
# Time [s] after green for which a signal is still seen as one that has turned green.
_AFTER_GREEN_S = 10.0
# Way [m] that drivers stop before the place behind a line, or before a signal; who rolls on stops there.
_BEFORE_M = 1.0
# Way [m] from a place where ways meet or part, within which a vehicle may matter to who drives there.
_NEAR_M = 30.0
# Time [s] on each side over which speeds are measured.
_SPEED_OVER_S = 0.5
# Way [m] between two places at which curvatures are kept, and time [s] for which drivers look ahead (paper, section 3).
_STEP_M, _AHEAD_S = 1.0, REFERENCE_HORIZON * REFERENCE_PERIOD_S


class RouteLines(NamedTuple):
    """R routes through a network of L lanes, with all that drivers on them may come to.

    start: (R, L), place [m] where each lane begins on each route, NaN for a lane that is not on it; order: (R, most),
    numbers of the lanes of each route, -1 after the last; first: (R + 1,), first line of each route. Then of all lines,
    in the order in which drivers come to them: stop, enter: (C,), where drivers wait, and where the place behind the
    line begins [m]; other: (C,), the other lane, or -1 - k for signal number k; other_enter, other_leave: (C,), the
    place on the other lane [m]; yields: (C,), whether drivers yield by rule. curvature: (R, most), [1/m], every metre.
    """

    start: Array
    order: Ints
    first: Ints
    stop: Array
    enter: Array
    other: Ints
    other_enter: Array
    other_leave: Array
    yields: Mask
    curvature: Array


class Moment(NamedTuple):
    """N vehicles at one time: route (N,), place of the centre (N,) [m] on it, speed (N,) [m/s], length (N,) [m].

    red: (S,), whether each signal of the network is red; since: (S,), time [s] since it has turned green; sides: (N,),
    where vehicles are across their lanes; is_recorded: whether who is ahead was seen, and not simulated.
    """

    route: Ints
    place: Array
    speed: Array
    length: Array
    red: Mask
    since: Array
    sides: Sides
    is_recorded: bool


def lines_of_routes(network: Network, paths: Sequence[Path]) -> RouteLines:
    """Put the routes of a network into arrays for compiled code."""
    lanes = len(network.lanes)
    start = np.array([[path.place_of(k) for k in range(lanes)] for path in paths]).reshape(-1, lanes)
    most = max(len(path.lanes) for path in paths)
    order = np.array([[*path.lanes, *[-1] * (most - len(path.lanes))] for path in paths], dtype=np.int64)
    number = {id(one): k for k, one in enumerate(network.signals)}
    first, lines = [0], []
    for path in paths:
        met = path.conflicts
        own = [
            (
                min(met.stop_m[c], met.enter_m[c] - _BEFORE_M),
                met.enter_m[c],
                met.other[c],
                met.other_enter_m[c],
                met.other_leave_m[c],
                met.yields[c],
            )
            for c in range(len(met.stop_m))
        ]
        own += [(place - _BEFORE_M, place, -1 - number[id(signal)], 0.0, 0.0, True) for place, signal in path.signals]
        lines += sorted(own, key=lambda line: line[0])
        first.append(len(lines))
    stop, enter, other, other_enter, other_leave, yields = zip(*lines, strict=True) if lines else ((),) * 6
    places = [np.arange(0.0, path.length_m + _STEP_M, _STEP_M) for path in paths]
    curvature = np.zeros((len(paths), max(map(len, places))))
    for row, path, place in zip(curvature, paths, places, strict=True):
        row[: len(place)] = np.abs(path.curvature(np.minimum(place, path.length_m)))
    return RouteLines(
        start=start,
        order=order,
        first=np.array(first, dtype=np.int64),
        stop=np.array(stop, dtype=np.float64),
        enter=np.array(enter, dtype=np.float64),
        other=np.array(other, dtype=np.int64),
        other_enter=np.array(other_enter, dtype=np.float64),
        other_leave=np.array(other_leave, dtype=np.float64),
        yields=np.array(yields, dtype=np.bool_),
        curvature=curvature,
    )


def signals_at(network: Network, time_s: float) -> tuple[Mask, Array]:
    """Whether each signal is red at a time [s], and the time [s] since it turned green; infinite while it is red."""
    at = np.array([time_s])
    red = np.array([bool(one.red_at(at)[0]) for one in network.signals], dtype=np.bool_)
    since = np.array([float(one.changes(at)[0][0]) for one in network.signals], dtype=np.float64)
    return red, np.where(red, np.inf, since)


@kernel
def _lane_at(place: float, route: int, ways: RouteLines) -> int:
    """Return which lane of its route, counted along the route, is at a place [m]."""
    k = 0
    while k + 1 < ways.order.shape[1] and ways.order[route, k + 1] >= 0:
        if ways.start[route, ways.order[route, k + 1]] > place:
            break
        k += 1
    return k


@kernel
def _lane_on(j: int, own: Array, now: Moment, ways: RouteLines) -> int:
    """Return the lane on which vehicle j is in the way of a route that has its lanes at ``own`` [m]; -1 for none.

    That is the lane of the centre; or the one behind, where the rear still is, or the next one, where the front is.
    """
    route = now.route[j]
    k = _lane_at(now.place[j], route, ways)
    lane = int(ways.order[route, k])
    if not math.isnan(own[lane]):
        return lane
    if k > 0 and now.place[j] - 0.5 * now.length[j] <= ways.start[route, lane]:
        behind = int(ways.order[route, k - 1])
        if not math.isnan(own[behind]):
            return behind
    if now.is_recorded and k + 1 < ways.order.shape[1] and ways.order[route, k + 1] >= 0:
        ahead = int(ways.order[route, k + 1])
        if not math.isnan(own[ahead]) and now.place[j] + 0.5 * now.length[j] > ways.start[route, ahead]:
            return ahead
    return -1


@kernel
def _ahead(i: int, now: Moment, ways: RouteLines) -> tuple[int, float]:
    """Return the next vehicle on the way of vehicle i, and the shift [m] of its places to the own way.

    Who drives beside vehicle i is not on its way. Returns `FREE` for nobody; `UNKNOWN` if only such vehicles are ahead,
    or some that cross the way.
    """
    leader, nearest, shift, alone = FREE, np.inf, 0.0, FREE
    own = ways.start[now.route[i]]
    for j in range(len(now.route)):
        if j == i:
            continue
        lane = _lane_on(j, own, now, ways)
        if lane < 0:
            continue
        off = own[lane] - ways.start[now.route[j], lane]
        away = now.place[j] + off - now.place[i]
        if (away > 0.0 or (away == 0.0 and j < i)) and away < nearest:
            if is_beside(i, j, away < 0.5 * (now.length[i] + now.length[j]), now.sides):
                alone = UNKNOWN if away < FREE_M else alone
            else:
                leader, nearest, shift = j, away, off
    if leader == FREE and now.is_recorded and _is_crossed(i, now, ways):
        alone = UNKNOWN
    return leader if leader >= 0 else alone, shift


@kernel
def _is_crossed(i: int, now: Moment, ways: RouteLines) -> bool:
    """Whether somebody is near a place ahead where ways meet the way of vehicle i, or has just turned off it."""
    route = now.route[i]
    own = ways.start[route]
    for j in range(len(now.route)):
        begin, lanes = ways.start[now.route[j]], ways.order[now.route[j]]
        k = _lane_at(now.place[j], now.route[j], ways)
        while k > 0 and begin[lanes[k]] > now.place[j] - _NEAR_M:
            fork = own[lanes[k - 1]] + begin[lanes[k]] - begin[lanes[k - 1]]
            if math.isnan(own[lanes[k]]) and fork > now.place[i]:
                return True
            k -= 1
        for c in range(ways.first[route], ways.first[route + 1]):
            if ways.other[c] >= 0 and 0.0 < ways.enter[c] - now.place[i] < FREE_M:
                way = now.place[j] - begin[ways.other[c]]
                if ways.other_enter[c] - _NEAR_M < way < ways.other_leave[c] + _NEAR_M and j != i:
                    return True
    return False


@kernel
def _met(i: int, c: int, needed: float, now: Moment, ways: RouteLines) -> tuple[float, float]:
    """Return when who is in the way at line c reaches the place behind it, and has left it [s]; NaN for nobody."""
    other = ways.other[c]
    first, clear = np.nan, np.nan
    for j in range(len(now.route)):
        begin = ways.start[now.route[j], other]
        if j == i or math.isnan(begin):
            continue
        to_enter = begin + ways.other_enter[c] - now.place[j] - 0.5 * now.length[j]
        to_leave = begin + ways.other_leave[c] - now.place[j] + 0.5 * now.length[j]
        if to_leave <= 0.0 or (to_enter > 0.0 and not (ways.yields[c] and now.speed[j] > _STANDING)):
            continue
        if to_enter > 0.0 and _is_held(j, begin + ways.other_enter[c], now, ways):
            continue
        arrive = time_over(to_enter, now.speed[j], USUAL)
        leave = to_leave / max(now.speed[j], _STANDING)
        if leave > needed - 3.0 * SOFT_S and not arrive >= first:
            first, clear = arrive, leave
    return first, clear


@kernel
def _is_held(j: int, place: float, now: Moment, ways: RouteLines) -> bool:
    """Whether a red signal holds vehicle j before a place [m] on its way."""
    front = now.place[j] + 0.5 * now.length[j]
    for c in range(ways.first[now.route[j]], ways.first[now.route[j] + 1]):
        if ways.other[c] < 0 and now.red[-1 - ways.other[c]] and front < ways.stop[c] <= place:
            return True
    return False


@kernel
def _line(i: int, now: Moment, ways: RouteLines) -> tuple[float, float, float]:
    """Return the place [m] of the line that matters to vehicle i, and its two times [s]; NaN for none."""
    route, speed = now.route[i], now.speed[i]
    front = now.place[i] + 0.5 * now.length[i]
    place, first, clear, most = np.nan, np.nan, np.nan, -1.0
    for c in range(ways.first[route], ways.first[route + 1]):
        stop = ways.stop[c] if front < ways.stop[c] else ways.enter[c]
        gap = stop - front
        if not 0.0 < gap < VIEW_M:
            continue
        signal = -1 - ways.other[c]
        if signal < 0:
            arrive, leave = _met(i, c, time_to_line(gap, speed), now, ways)
            if math.isnan(arrive):
                continue
        elif now.red[signal]:
            arrive, leave = 0.0, np.inf
        elif now.since[signal] < _AFTER_GREEN_S:
            arrive, leave = np.inf, -now.since[signal]
        else:
            continue
        paid = attention(gap, speed, arrive, leave, TIME_GAP_S)
        if paid > most:
            place, first, clear, most = stop, arrive, leave, paid
        if paid > 0.5:
            break
    return place, first, clear


@kernel
def see_scene(now: Moment, ways: RouteLines, leader: Ints, shift: Array, line: Array) -> None:
    """Fill in what each of N vehicles sees.

    leader: (N,), the next vehicle on the way, `FREE` for none, `UNKNOWN` if only others are ahead who drive beside;
    shift: (N,), what to add to the leader's place [m]; line: (N, 4), as of ``Order``.
    """
    for i in range(len(now.route)):
        leader[i], shift[i] = _ahead(i, now, ways)
        line[i, 0], line[i, 1], line[i, 2] = _line(i, now, ways)
        here = max(int(now.place[i] / _STEP_M), 0)
        there = int((now.place[i] + max(now.speed[i], 0.0) * _AHEAD_S) / _STEP_M) + 1
        line[i, 3] = 0.0
        for k in range(here, min(there, ways.curvature.shape[1])):
            line[i, 3] = max(line[i, 3], ways.curvature[now.route[i], k])


def scene(network: Network, paths: Sequence[Path], rows: OnNetwork) -> tuple[Ints, dict[str, Array]]:
    """Work out what the drivers of recorded vehicles see.

    Returns the row of each leader (R,), `FREE` where the road is seen to be empty, `UNKNOWN` where it is not known who
    is ahead, and columns (R,) for tracks: ``leader_shift_m``, ``line_m``, ``arrive_s``, ``clear_s`` and
    ``curvature_per_m``.
    """
    count = len(rows.route)
    there = np.flatnonzero(rows.route >= 0)
    leader, shift, line = np.full(count, UNKNOWN), np.zeros(count), np.full((count, 4), np.nan)
    if len(there):
        ways, unseen = lines_of_routes(network, paths), hidden(rows)
        row, time, place = there, rows.time_s[there], rows.place[there]
        for more in (leaving(rows, paths), *([] if unseen is None else [unseen])):
            row = np.concatenate((row, more.row))
            time, place = np.concatenate((time, more.time_s)), np.concatenate((place, more.place))
        speed, lost = _speeds(rows, there)[row], np.arange(len(row)) >= len(there)
        across, usual, half = (side[row] for side in rows.sides)
        half = np.where(lost, np.inf, half)
        order = np.lexsort((time, rows.recording[row]))
        new = (np.diff(time[order]) > 0.5e-3) | (np.diff(rows.recording[row[order]]) != 0)
        for some in np.split(order, np.flatnonzero(new) + 1):
            red, since = signals_at(network, float(time[some[0]]))
            own, beside = row[some], Sides(across[some], usual[some], half[some])
            now = Moment(rows.route[own], place[some], speed[some], rows.length[own], red, since, beside, True)
            ahead, shifts, lines = np.full(len(some), -1), np.zeros(len(some)), np.full((len(some), 4), np.nan)
            see_scene(now, ways, ahead, shifts, lines)
            led = np.where(ahead >= 0, np.where(lost[some[ahead]], UNKNOWN, own[ahead]), ahead)
            kept = ~lost[some]
            leader[own[kept]], shift[own[kept]], line[own[kept]] = led[kept], shifts[kept], lines[kept]
        leader[behind_lost(leader, rows)] = UNKNOWN
        nobody = np.flatnonzero(leader == FREE)
        is_free = InSight(paths, rows).far(nobody, FREE_M) if unseen is not None else np.zeros(len(nobody), dtype=bool)
        leader[nobody[~is_free]] = UNKNOWN
    return leader, {"leader_shift_m": shift, **{name: line[:, k] for k, name in enumerate(LINE)}}


class InView(NamedTuple):
    """What the drivers of vehicles on a network see, row by row, as `see_scene` fills it in.

    leader: (R,), number of the vehicle ahead, -1 for none; shift: (R,) [m]; line: (R, 4).
    """

    leader: Ints
    shift: Array
    line: Array


def tracks_on(rows: OnNetwork, seen: InView, about: About) -> Tracks:
    """Make tracks of vehicles on a network, which have numbers, with what their drivers see. Raises InputError."""
    count = int(rows.vehicle.max(initial=-1)) + 1
    called = [str(k) for k in range(count)]
    columns: dict[str, Labels | Array] = {
        "vehicle": labels(rows.vehicle.astype(np.int32), called),
        "leader": labels(np.where(seen.leader < 0, count, seen.leader).astype(np.int32), [*called, NOBODY]),
        "time_s": rows.time_s,
        "s_m": rows.place,
        "length_m": rows.length,
        "leader_shift_m": seen.shift,
    }
    lines = {name: seen.line[:, k] for k, name in enumerate(LINE)}
    return assemble({**columns, **lines}, replace(about, leaders="given"), checked=False)


def _speeds(rows: OnNetwork, there: Ints) -> Array:
    """Speed [m/s] in the rows ``there``: slope of the straight line through the places within half a second."""
    speed = np.zeros(len(rows.place))
    order = there[np.lexsort((rows.time_s[there], rows.route[there], rows.vehicle[there]))]
    new = (np.diff(rows.vehicle[order]) != 0) | (np.diff(rows.route[order]) != 0)
    for own in np.split(order, np.flatnonzero(new) + 1):
        time, place = rows.time_s[own], rows.place[own]
        first = np.searchsorted(time, time - _SPEED_OVER_S - 1e-6)
        last = np.searchsorted(time, time + _SPEED_OVER_S + 1e-6)
        # at least one row on each side
        first = np.minimum(first, np.maximum(np.arange(len(own)) - 1, 0))
        last = np.maximum(last, np.minimum(np.arange(len(own)) + 2, len(own)))
        t, x = time - time[0], place - place[0]
        sums = [np.concatenate(([0.0], np.cumsum(one))) for one in (t, x, t * t, t * x)]
        n = (last - first).astype(np.float64)
        st, sx, stt, stx = (one[last] - one[first] for one in sums)
        spread = n * stt - st * st
        speed[own] = np.where(spread > 1e-12, (n * stx - st * sx) / np.where(spread > 1e-12, spread, 1.0), 0.0)
    return speed
