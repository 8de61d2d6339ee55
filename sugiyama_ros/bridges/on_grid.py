"""Sightings of vehicles, each at times of its own, become rows at regular times, with lanes and leaders."""

import math
from collections.abc import Iterator
from statistics import median_low
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.bridges.perception import RATES_DIFFER
from sugiyama_ros.bridges.sightings import Sightings
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.assemble import LONGEST_ABSENCE_S
from sugiyama_ros.trajectories.leaders import TICK_S
from sugiyama_ros.trajectories.placing import Placer, SeenVehicle
from sugiyama_ros.trajectories.time_base import LONGEST_HOLE_S, nearly
from sugiyama_ros.trajectories.tracks import FREE, UNKNOWN

_NS = 1_000_000_000
# Periods of a vehicle that make a hole in its track, and sightings from which its period follows.
_PERIODS, _FEW = 1.5, 3
# Steps whose leaders are found at once.
_AT_ONCE = 2000


class Grid(NamedTuple):
    """Regular times: stamp [ns] of the first, and time [s] between two."""

    first_ns: int
    period_s: float


class Rows(NamedTuple):
    """R rows of vehicles on the road: step, vehicle, lane, positions [m] along and across, length [m], and leader.

    ``leader`` is the number of a vehicle, `FREE` or `UNKNOWN`.
    """

    step: Ints
    vehicle: Ints
    lane: Ints
    s_m: Array
    d_m: Array
    length_m: Array
    leader: Ints


class Lost(NamedTuple):
    """What became of sightings: rows beside the road, sightings without a neighbour, interpolated rows, and holes."""

    beside: int
    alone: int
    interpolated: int
    holes: int


def own_periods(found: Sightings) -> list[float]:
    """Usual time [s] between two sightings of each vehicle, from the shortest to the longest."""
    periods = []
    for rows in found.steps():
        step = np.diff(found.stamp_ns[rows]) / _NS
        if len(step) >= _FEW - 1:
            periods.append(float(np.median(step)))
    return sorted(periods)


def usual_period(periods: list[float]) -> float:
    """The period [s] that most vehicles have, as a round number if it nearly is one."""
    return nearly(median_low(periods))


def rates_noted(periods: list[float], period_s: float) -> str:
    """A warning where vehicles are seen at rates that differ, or less often than there are rows; empty otherwise."""
    if not periods or max(periods[-1] / periods[0], periods[-1] / period_s) <= RATES_DIFFER:
        return ""
    return (
        f"warning: vehicles were seen every {periods[0]:.3g} to {periods[-1]:.3g} s; in rows every {period_s:.3g} s,"
        " positions in between are interpolated; --period sets another time"
    )


class _AtSteps(NamedTuple):
    """Where vehicles are at the times of a grid: step, vehicle, position (x, y) [m], heading [rad] and length [m]."""

    step: Ints
    vehicle: Ints
    x_m: Array
    y_m: Array
    heading: Array
    length_m: Array


def rows_of(found: Sightings, grid: Grid, placer: Placer) -> tuple[Rows, Lost]:
    """Rows at the times of a grid, interpolated between the sightings of each vehicle.

    A hole in which a vehicle was not seen for more than 0.5 s, or one and a half of its own periods if that is more,
    stays a hole. A vehicle may drive on in its hole, and for a minute before and after it was seen: whoever would have
    it as leader has an unknown leader.
    """
    parts, alone, interpolated, holes = [], 0, 0, 0
    for rows in found.steps():
        time_s = (found.stamp_ns[rows] - grid.first_ns) / _NS
        step_s = np.diff(time_s)
        longest_s = max(LONGEST_HOLE_S, _PERIODS * float(np.median(step_s)) if len(step_s) else 0.0)
        ends = np.flatnonzero(step_s > longest_s) + 1
        holes += len(ends)
        for piece in np.split(np.arange(len(rows)), ends):
            part, off_s = _at_steps(found, rows[piece], time_s[piece], grid.period_s)
            alone += len(piece) == 1 and not len(part.step)
            interpolated += int(np.sum(off_s > TICK_S))
            parts.append(part)
    joined: list[Any] = [np.concatenate(columns) for columns in zip(*parts, strict=True)]
    in_time = np.argsort(joined[0], kind="stable")
    table = _AtSteps(*[column[in_time] for column in joined])
    on_road, lane, s_m, d_m = _placed(table, found.vehicles, placer)
    leader = np.full(len(on_road), UNKNOWN, dtype=np.int64)
    leader[on_road] = _leaders(table, on_road, lane, s_m, grid.period_s, placer.road)
    columns: list[Any] = [table.step, table.vehicle, lane, s_m, d_m, table.length_m, leader]
    return Rows(*[column[on_road] for column in columns]), Lost(int((~on_road).sum()), alone, interpolated, holes)


def _at_steps(found: Sightings, rows: Ints, time_s: Array, period_s: float) -> tuple[_AtSteps, Array]:
    """A piece of a vehicle's track at the steps of a grid, and the time [s] from each to the nearest sighting."""
    near = TICK_S / period_s
    step = np.arange(math.ceil(time_s[0] / period_s - near), math.floor(time_s[-1] / period_s + near) + 1)
    at_s = np.clip(step * period_s, time_s[0], time_s[-1])
    right = np.clip(np.searchsorted(time_s, at_s), 0, len(time_s) - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(at_s - time_s[left] < time_s[right] - at_s, left, right)
    x, y = found.x_m[rows], found.y_m[rows]
    if len(rows) > 1:
        x, y = (CubicHermiteSpline(time_s, v, np.gradient(v, time_s))(at_s) for v in (x, y))
    else:
        x, y = x[nearest], y[nearest]
    own = rows[nearest]
    table = _AtSteps(step, found.vehicle[own], x, y, found.heading[own], found.length_m[own])
    return table, np.abs(at_s - time_s[nearest])


def _placed(table: _AtSteps, names: tuple[str, ...], placer: Placer) -> tuple[Mask, Ints, Array, Array]:
    """Whether each row is on the road (R,), its lane, and its positions along and across [m]."""
    count = len(table.step)
    on_road, lane = np.zeros(count, dtype=bool), np.full(count, -1, dtype=np.int64)
    s_m, d_m = np.full(count, np.nan), np.full(count, np.nan)
    starts = np.flatnonzero(np.diff(table.step, prepend=-(1 << 62)))
    for first, last in zip(starts.tolist(), [*starts[1:].tolist(), count], strict=True):
        rows = {names[table.vehicle[row]]: row for row in range(first, last)}
        seen = [SeenVehicle(0, n, table.x_m[r], table.y_m[r], table.heading[r]) for n, r in rows.items()]
        for one in placer.place(seen):
            row = rows[one.seen.name]
            on_road[row], lane[row], s_m[row], d_m[row] = True, one.lane, one.s_m, one.d_m
    return on_road, lane, s_m, d_m


class _Ghost(NamedTuple):
    """A vehicle that may be on the road without a row: steps from ``first`` to before ``last``, lane, and position.

    The position [m] is ``s_m`` at the step ``first``, and grows by ``way_m`` [m] with each step.
    """

    first: int
    last: int
    lane: int
    s_m: float
    way_m: float

    def within(self, begin: int, end: int) -> tuple[Ints, Array]:
        """Steps of a block, and positions [m] at them."""
        steps: Ints = np.arange(max(self.first, begin), min(self.last, end), dtype=np.int64)
        return steps, self.s_m + self.way_m * (steps - self.first).astype(np.float64)


def _leaders(table: _AtSteps, on_road: Mask, lane: Ints, s_m: Array, period_s: float, road: Road) -> Ints:
    """Leader of each row on the road: the next vehicle ahead on its lane, `UNKNOWN` where another may be between."""
    ghosts = sorted(_ghosts(table, on_road, lane, s_m, round(LONGEST_ABSENCE_S / period_s), road))
    step, vehicle = table.step[on_road], table.vehicle[on_road]
    lane, s_m = lane[on_road], s_m[on_road]
    leader = np.full(len(step), FREE, dtype=np.int64)
    for begin in range(int(step[0]), int(step[-1]) + 1, _AT_ONCE) if len(step) else ():
        here = np.arange(*np.searchsorted(step, (begin, begin + _AT_ONCE)))
        more = [ghost.within(begin, begin + _AT_ONCE) for ghost in ghosts]
        all_step = np.concatenate([step[here], *(steps for steps, _ in more)])
        all_lane = np.concatenate(
            [lane[here], *(np.full(len(k), g.lane) for g, (k, _) in zip(ghosts, more, strict=True))]
        )
        all_s = np.concatenate([s_m[here], *(road.wrap(positions) for _, positions in more)])
        name = np.concatenate([vehicle[here], np.full(len(all_step) - len(here), UNKNOWN)])
        ahead = _next_ahead(all_step, all_lane, all_s, road.is_ring)
        leader[here] = np.where(ahead >= 0, name[ahead], FREE)[: len(here)]
    return leader


def _next_ahead(step: Ints, lane: Ints, s_m: Array, is_ring: bool) -> Ints:
    """Number of the next entry ahead at the same step on the same lane (N,); -1 for none."""
    order = np.lexsort((s_m, lane, step))
    last = np.ones(len(order), dtype=bool)
    last[:-1] = (np.diff(step[order]) != 0) | (np.diff(lane[order]) != 0)
    ahead = np.roll(order, -1)
    first = np.flatnonzero(np.roll(last, 1))
    ahead[last] = order[first] if is_ring else -1
    ahead[ahead == order] = -1
    found = np.empty(len(order), dtype=np.int64)
    found[order] = ahead
    return found


def _ghosts(table: _AtSteps, on_road: Mask, lane: Ints, s_m: Array, most: int, road: Road) -> Iterator[_Ghost]:
    """Where vehicles may be that have no row: in their holes, and before and after they were seen."""
    order = np.lexsort((table.step, table.vehicle))
    for rows in np.split(order, np.flatnonzero(np.diff(table.vehicle[order])) + 1):
        step, there = table.step[rows], on_road[rows]
        way = road.difference(s_m[rows[1:]], s_m[rows[:-1]]) / np.diff(step)
        way = np.where(np.isfinite(way), way, 0.0)
        # the way with each step, before and after each row
        before, after = np.append(way[:1], way), np.append(way, way[-1:])
        if not len(way):
            before = after = np.zeros(1)
        for k in range(-1, len(rows)):
            left, right = k >= 0 and bool(there[k]), k + 1 < len(rows) and bool(there[k + 1])
            start = int(step[k]) + 1 if k >= 0 else int(step[0]) - most
            end = int(step[k + 1]) if k + 1 < len(rows) else int(step[-1]) + most + 1
            if start >= end:
                continue
            if left:
                ahead = float(after[k] if right else before[k])
                last = min(end, start + most)
                yield _Ghost(start, last, int(lane[rows[k]]), float(s_m[rows[k]]) + ahead, ahead)
            elif right:
                back, begin = float(after[k + 1]), max(start, end - most)
                yield _Ghost(begin, end, int(lane[rows[k + 1]]), float(s_m[rows[k + 1]]) - back * (end - begin), back)
