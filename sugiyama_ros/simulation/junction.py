"""Vehicles on a network of lanes: they come in, let others pass where the rule asks for it, and leave.

Every driver drives along their own route, as on a road of one lane. What is new is what they see: the next vehicle on
their route, wherever it comes from, and the lines before which they let others pass (`roads.scene`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.parameters import V_STAR, at_period, check, horizon_at
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.results import Result
from sugiyama_ros.road import Road
from sugiyama_ros.roads.network import Network, Path
from sugiyama_ros.roads.scene import InView, Moment, lines_of_routes, see_scene, signals_at, tracks_on
from sugiyama_ros.roads.view import OnNetwork, nobody_beside
from sugiyama_ros.simulation.drive import Order, Setting, Traffic, Wandering, begin, drive, measure, move, remember
from sugiyama_ros.simulation.result import Collision
from sugiyama_ros.simulation.simulator import Clock
from sugiyama_ros.trajectories.about import SIMULATED, About
from sugiyama_ros.trajectories.tracks import Tracks

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

#: Width [m] of a car, for collisions of vehicles that cross.
WIDTH_M = 1.8
# Time [s] of the gap before which a vehicle comes in, and least gap [m].
_GAP_S, _GAP_M = 1.5, 3.0
# Points along a body at which its distance to another one is measured.
_POINTS = 9


@dataclass(frozen=True, eq=False)
class Traveller:
    """A driver on a route.

    route: number of the route; row: (P,) or (width,), parameters at the reference period, or a row with effects;
    time_s: time [s] at which they come in, or later, as soon as there is room; length_m: length [m] of the vehicle.
    """

    route: int
    row: Array
    time_s: float
    length_m: float = 4.5


def demand(
    flow_per_hour: Sequence[float], rows: Array, rng: np.random.Generator, length_m: float = 4.5
) -> list[Traveller]:
    """Draw who comes when, at random times (Poisson).

    flow_per_hour: (R,), vehicles per hour on each route; rows: (N, P) or (N, width), the drivers, in the order in which
    they come.
    """
    flow = np.asarray(flow_per_hour, dtype=np.float64)
    times = np.cumsum(rng.exponential(3600.0 / flow.sum(), len(rows)))
    routes = rng.choice(len(flow), len(rows), p=flow / flow.sum())
    return [Traveller(int(r), row, float(t), length_m) for r, row, t in zip(routes, rows, times, strict=True)]


@dataclass(frozen=True, eq=False, repr=False)
class JunctionRun(Result):
    """What N drivers did on a network.

    Parameters
    ----------
    network : Network
        The network.
    paths : tuple of Path
        The routes.
    travellers : tuple of Traveller, N
        The drivers; vehicles have their numbers.
    rows : OnNetwork
        Measured places of the vehicles, row by row.
    seen : InView
        What the drivers saw, in the same rows.
    place_m, speed : ndarray, shape (R,)
        True places [m] and speeds [m/s] in the same rows.
    collisions : tuple of Collision
        Collisions, in the order of time. Vehicles that collide are taken off the road.
    arrived : ndarray of bool, shape (N,)
        Who has come to the end of their route.
    longest_stop_s : float
        Longest time [s] for which somebody was on the road and nobody moved, where no signal was red.
    """

    network: Network
    paths: tuple[Path, ...]
    travellers: tuple[Traveller, ...]
    rows: OnNetwork
    seen: InView
    place_m: Array
    speed: Array
    collisions: tuple[Collision, ...]
    arrived: Mask
    longest_stop_s: float

    @cached_property
    def measured(self) -> Tracks:
        """What a camera would have measured, with what the drivers saw."""
        return tracks_on(self.rows, self.seen, About(source=SIMULATED, view="end"))

    def headline(self) -> str:
        """Say how many came through."""
        return (
            f"{len(self.travellers)} drivers, {int(self.arrived.sum())} came through, {len(self.collisions)}"
            f" collisions, longest standstill of all {self.longest_stop_s:.0f} s"
        )

    def records(self) -> list[dict[str, object]]:
        """List the drivers."""
        return [
            {"vehicle": i, "route": one.route, "time_s": one.time_s, "arrived": bool(self.arrived[i])}
            for i, one in enumerate(self.travellers)
        ]

    def draw(self, figure: "Figure | SubFigure") -> None:
        """Draw where the vehicles were, coloured by speed."""
        axes = figure.subplots()
        x, y = np.zeros(len(self.place_m)), np.zeros(len(self.place_m))
        for r, path in enumerate(self.paths):
            mine = self.rows.route == r
            x[mine], y[mine], _ = path.at(self.place_m[mine])
        drawn = axes.scatter(x, y, c=self.speed, s=2.0)
        figure.colorbar(drawn, ax=axes, label="speed [m/s]")
        axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")


class JunctionSimulator:
    """Drivers on a network.

    network: the network; paths: the routes; travellers: who comes when, on which route; rng: generator of all noises;
    clock: times of the simulation. Raises InputError.
    """

    def __init__(
        self,
        network: Network,
        paths: Sequence[Path],
        travellers: Sequence[Traveller],
        rng: np.random.Generator,
        clock: Clock | None = None,
    ) -> None:
        clock = clock or Clock(0.2)
        self.network, self.paths, self.travellers = network, tuple(paths), tuple(travellers)
        if not travellers or not paths:
            raise InputError("junction: give at least one route and one driver")
        if any(not 0 <= one.route < len(paths) for one in travellers):
            raise InputError(f"junction: a driver has a route that is not there; give 0 to {len(paths) - 1}")
        drivers = ROW.with_effects(np.array([one.row for one in travellers]))
        check(drivers)
        self.period_s = clock.period_s
        self._setting = Setting(clock.period_s, horizon_at(clock.period_s), 0.0)
        self.drivers, self._rows = drivers, at_period(drivers, clock.period_s)
        self._rng = rng
        self._rng_of_effects = rng.spawn(1)[0]
        self._wandering = Wandering(clock.period_s, self._rng_of_effects)
        self._ways = lines_of_routes(network, self.paths)
        self._route = np.array([one.route for one in travellers], dtype=np.int64)
        self.length_m = np.array([one.length_m for one in travellers])
        self._due = np.array([one.time_s for one in travellers])
        self._end = np.array([path.length_m for path in self.paths])[self._route]
        count = len(travellers)
        self.time_s = clock.start_s
        #: Whether each driver has come in, has arrived, or has collided.
        self.entered, self.arrived, self.collided = (np.zeros(count, dtype=bool) for _ in range(3))
        #: State of each vehicle: place [m], speed [m/s], noise and held acceleration, acceleration [m/s^2].
        self.place, self.speed, self.noise, self.held, self.acceleration = (np.zeros(count) for _ in range(5))
        self._past = self._no_past()
        self._let_in()

    @property
    def on_road(self) -> Ints:
        """Numbers of the vehicles that are on the network."""
        return np.flatnonzero(self.entered & ~self.arrived & ~self.collided)

    def measure(self) -> Array:
        """Measure the places [m] of the vehicles on the network; draws measurement noise."""
        here = self.on_road
        if not len(here):
            return np.empty(0)
        return measure(self.place[here], Road(), self._rows[here], self._rng, self._rng_of_effects)

    def see(self) -> InView:
        """What those on the network see."""
        here = self.on_road
        leader, shift, line = self._see(here)
        return InView(np.where(leader >= 0, here[leader], -1) if len(here) else leader, shift, line)

    def change(self, drivers: Array) -> None:
        """Let the drivers drive otherwise from the next period on; rows (N, width) at the reference period.

        Raises InputError for a parameter out of bounds; the drivers drive on as before then.
        """
        check(drivers)
        self.drivers, self._rows = drivers.copy(), at_period(drivers, self.period_s)
        if len(past := self._no_past()) != len(self._past):
            self._past = past
            self._drove_evenly(self.on_road)

    def step(self) -> list[Collision]:
        """Advance all vehicles by one period; returns the collisions."""
        here = self.on_road
        rows = self._wandering.next_rows(self._rows)[here]
        self._decide(here, rows)
        own = self.place[here], self.speed[here], self.noise[here]
        place, speed, noise = move(own, self.acceleration[here], rows, self.period_s, self._rng)
        # who stands and does not mean to drive stands still, and nobody rolls back, however long they wait
        rests = own[1] + self.period_s * (self.acceleration[here] - own[2]) <= 1e-9
        self.place[here] = np.where(rests, own[0], np.maximum(place, own[0]))
        self.speed[here], self.noise[here] = np.where(rests, 0.0, [np.maximum(speed, 0.0), noise])
        self.time_s += self.period_s
        self.arrived[here] |= self.place[here] + 0.5 * self.length_m[here] >= self._end[here]
        collisions = self._collisions()
        for one in collisions:
            self.collided[[one.vehicle, one.leader]] = True
        self._let_in()
        return collisions

    def _moment(self, here: Ints) -> Moment:
        red, since = signals_at(self.network, self.time_s)
        return Moment(
            self._route[here],
            self.place[here],
            self.speed[here],
            self.length_m[here],
            red,
            since,
            nobody_beside(len(here)),
            False,
        )

    def _see(self, here: Ints) -> tuple[Ints, Array, Array]:
        """Leader, shift of their place and line of each vehicle on the network."""
        leader, shift, line = np.full(len(here), -1), np.zeros(len(here)), np.full((len(here), 4), np.nan)
        see_scene(self._moment(here), self._ways, leader, shift, line)
        return leader, shift, line

    def _decide(self, here: Ints, rows: Array) -> None:
        """Let the drivers decide what their cars do in the coming period; rows (K, width): of those who are here."""
        leader, shift, line = self._see(here)
        order = Order(leader, -shift, self.length_m[here], line)
        past = np.ascontiguousarray(self._past[:, :, here])
        traffic = Traffic(self.place[here], self.speed[here], self.held[here], self.acceleration[here], past)
        held, pushed = np.empty(len(here)), np.empty(len(here))
        drive(traffic, order, rows, ACTIONS, self.time_s, self._setting, held, pushed)
        remember(traffic)
        self._past[:, :, here] = past
        self.held[here] = held
        self.acceleration[here] = held + pushed + self.noise[here]

    def _let_in(self) -> None:
        """Let those in who are due and have room, at the speed of the vehicle ahead, or at their own."""
        for i in np.flatnonzero((self._due <= self.time_s) & ~self.entered).tolist():
            first = self.paths[self._route[i]].lanes[0]
            if any(self.paths[self._route[j]].lanes[0] == first for j in self._waiting_before(i)):
                continue
            here = np.append(self.on_road, i)
            self.place[i], self.speed[i] = 0.5 * self.length_m[i], self._rows[i, V_STAR]
            leader, shift, _ = self._see(here)
            ahead = here[leader[-1]] if leader[-1] >= 0 else -1
            if ahead >= 0:
                gap = self.place[ahead] + shift[-1] - self.place[i] - 0.5 * (self.length_m[ahead] + self.length_m[i])
                self.speed[i] = min(self.speed[i], max(self.speed[ahead], 0.0))
                if gap < _GAP_M + _GAP_S * self.speed[i]:
                    continue
            limit = self.network.lanes[first].speed_limit
            self.speed[i] = min(self.speed[i], limit)
            self.entered[i] = True
            self._drove_evenly(np.array([i]))

    def _no_past(self) -> Array:
        """Room for what the drivers remember."""
        zero = np.zeros(len(self.travellers))
        return begin(zero, zero, zero, zero, self._rows, self.period_s).past

    def _drove_evenly(self, vehicles: Ints) -> None:
        """Let some vehicles have driven at their present speed before."""
        periods = 1 + np.arange(len(self._past))[:, None]
        self._past[:, 0, vehicles] = self.place[vehicles] - periods * self.period_s * self.speed[vehicles]
        self._past[:, 1, vehicles] = self.speed[vehicles]

    def _waiting_before(self, i: int) -> list[int]:
        """Numbers of those who wait to come in and were due before driver i."""
        due = ~self.entered & (self._due < self._due[i])
        return [int(j) for j in np.flatnonzero(due)]

    def _collisions(self) -> list[Collision]:
        """Vehicles that touch another one: the leader, or one whose way crosses theirs."""
        here = self.on_road
        leader, shift, _ = self._see(here)
        found = []
        for k, i in enumerate(here.tolist()):
            if leader[k] >= 0:
                j = int(here[leader[k]])
                gap = self.place[j] + shift[k] - self.place[i] - 0.5 * (self.length_m[i] + self.length_m[j])
                if gap <= 0.0:
                    found.append(Collision(self.time_s, i, j))
        taken = {one.vehicle for one in found}
        bodies = {}
        for i, j in self._meeting(here):
            if i in taken or j in taken:
                continue
            for one in (i, j):
                if one not in bodies:
                    bodies[one] = self._body(one)
            if np.min(np.hypot(*(bodies[i][:, :, None] - bodies[j][:, None, :]))) < WIDTH_M:
                found.append(Collision(self.time_s, i, j))
                taken |= {i, j}
        return found

    def _meeting(self, here: Ints) -> list[tuple[int, int]]:
        """Pairs of vehicles that are on the same place where two lanes meet."""
        pairs = []
        ways = self._ways
        for i in here.tolist():
            front, back = self.place[i] + 0.5 * self.length_m[i], self.place[i] - 0.5 * self.length_m[i]
            met = self.paths[self._route[i]].conflicts
            for c in np.flatnonzero((met.enter_m < front) & (met.leave_m > back)).tolist():
                for j in here.tolist():
                    start = ways.start[self._route[j], met.other[c]]
                    if j <= i or math.isnan(start):
                        continue
                    along = self.place[j] - start
                    half = 0.5 * self.length_m[j]
                    if along + half > met.other_enter_m[c] and along - half < met.other_leave_m[c]:
                        pairs.append((i, j))
        return sorted(set(pairs))

    def _body(self, i: int) -> Array:
        """Points (2, P) [m] along the middle of a vehicle."""
        s = self.place[i] + 0.5 * self.length_m[i] * np.linspace(-1.0, 1.0, _POINTS)
        x, y, _ = self.paths[self._route[i]].at(s)
        return np.array([x, y])


def simulate_junction(simulator: JunctionSimulator, duration_s: float) -> JunctionRun:
    """Run a simulator, and keep every sample; ends early when nobody is left.

    duration_s: duration [s]. Raises InputError if nobody comes.
    """
    parts: list[tuple[Ints, Array, Array, Array, Array]] = []
    views: list[InView] = []
    collisions: list[Collision] = []
    standing_s, longest_s = 0.0, 0.0
    for t in range(round(duration_s / simulator.period_s) + 1):
        if t > 0:
            collisions += simulator.step()
        here = simulator.on_road
        if not len(here) and simulator.entered.all():
            break
        time = np.full(len(here), simulator.time_s)
        parts.append((here, time, simulator.measure(), simulator.place[here], simulator.speed[here]))
        views.append(simulator.see())
        red, _ = signals_at(simulator.network, simulator.time_s)
        moves = not len(here) or red.any() or bool((np.abs(simulator.speed[here]) > 0.5).any())
        standing_s = 0.0 if moves else standing_s + simulator.period_s
        longest_s = max(longest_s, standing_s)
    if not simulator.entered.any():
        enough_s = math.ceil(min(one.time_s for one in simulator.travellers)) + 10
        raise InputError(f"duration: {duration_s:g} s: nobody comes so early; give at least {enough_s} s")
    vehicle, time_s, measured, place, speed = (np.concatenate(part) for part in zip(*parts, strict=True))
    length_m = simulator.length_m[vehicle]
    return JunctionRun(
        network=simulator.network,
        paths=simulator.paths,
        travellers=simulator.travellers,
        rows=OnNetwork(
            vehicle,
            simulator._route[vehicle],
            time_s,
            measured,
            length_m,
            np.zeros_like(vehicle),
            nobody_beside(len(vehicle)),
        ),
        seen=InView(*(np.concatenate(part) for part in zip(*views, strict=True))),
        place_m=place,
        speed=speed,
        collisions=tuple(collisions),
        arrived=simulator.arrived.copy(),
        longest_stop_s=longest_s,
    )
