"""A simulator of drivers on a ring or an open road: the forward problem of the paper (Eq. ssm_form).

The acceleration is the mean action plus an AR(1) noise: a_t = mean_action(s_t) + n_t with n_t = rho n_{t-1} + shock.
The paper writes this as a_t = rho a_{t-1} + (mean_action_t - rho mean_action_{t-1}) + shock. Effects act on the mean
action through ``effects.control``. Random effects draw from their own generator, so the other noises stay the same.
A controller drives a vehicle without noise; all drivers draw the same random numbers, whoever is controlled.
"""

from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.controllers.controller import Controlled
from sugiyama_ros.driver.parameters import (
    REFERENCE_PERIOD_S,
    SIGMA_A,
    SIGMA_V,
    SIGMA_X,
    at_period,
    check,
    horizon_at,
)
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.drive import (
    Order,
    Setting,
    Traffic,
    Wandering,
    begin,
    drive,
    gaps,
    measure,
    move,
    remember,
    see,
)
from sugiyama_ros.simulation.result import Collision, Simulation
from sugiyama_ros.trajectories.about import SIMULATED
from sugiyama_ros.trajectories.dense import DenseTracks


@dataclass(frozen=True)
class Clock:
    """Time [s] between two samples, time [s] of the first sample, and number of periods that a driver looks ahead.

    If ``horizon`` is None, drivers look ahead for the paper's look-ahead time.
    """

    period_s: float = REFERENCE_PERIOD_S
    start_s: float = 0.0
    horizon: int | None = None


#: Samples as in the Sugiyama experiment, from time 0.
REFERENCE_CLOCK = Clock()


class Simulator:
    """N drivers, one behind another: vehicle i follows vehicle i + 1.

    On a ring the last vehicle follows the first vehicle. On an open road the last vehicle has no leader.

    parameters: (N, P) or (N, width), parameters of the drivers at the reference period, or their rows with effects;
    length_m, position_m: (N,), lengths [m], and positions [m] of the centres at the start, which increase and lie
    within one circumference; road: the road; rng: generator of all noises; speed: (N,), speeds [m/s] at the start; 0 if
    left out; clock: times of the simulation; controlled: vehicles that a controller drives in place of their drivers.
    Raises InputError.
    """

    def __init__(
        self,
        parameters: Array,
        length_m: Array,
        position_m: Array,
        road: Road,
        rng: np.random.Generator,
        *,
        speed: Array | None = None,
        clock: Clock = REFERENCE_CLOCK,
        controlled: Controlled | None = None,
    ) -> None:
        check(parameters)
        vehicles = len(length_m)
        if parameters.shape[0] != vehicles or position_m.shape != (vehicles,):
            raise InputError(
                f"simulation: {len(parameters)} drivers, {vehicles} lengths, {len(position_m)} positions; give one each"
            )
        self.road = road
        self.period_s = clock.period_s
        self.horizon = horizon_at(clock.period_s) if clock.horizon is None else clock.horizon
        self._controlled = controlled
        #: Numbers of the vehicles that a controller drives.
        self.controlled: tuple[int, ...] = () if controlled is None else controlled.vehicles
        if wrong := [i for i in self.controlled if not 0 <= i < vehicles]:
            raise InputError(
                f"controlled: vehicle {wrong[0]} is not on the road; give numbers from 0 to {vehicles - 1}"
            )
        self._memories = () if controlled is None else controlled.memories(clock.period_s)
        self._let_drive(ROW.with_effects(parameters))
        self.length_m = length_m.astype(np.float64)
        self.leader: Ints = np.arange(1, vehicles + 1)
        self.leader[-1] = 0 if road.is_ring and vehicles > 1 else -1
        self._turn = np.zeros(vehicles)
        self.line: Array = np.full((vehicles, 4), np.nan)
        self._turn[-1] = -road.circumference_m
        self.position_m = position_m.astype(np.float64).copy()
        self.speed = np.zeros(vehicles) if speed is None else speed.astype(np.float64).copy()
        self.noise: Array = np.zeros(vehicles)
        self.held: Array = np.zeros(vehicles)
        self.acceleration: Array = np.zeros(vehicles)
        self.step_number = 0
        self.start_s = clock.start_s
        self._rng = rng
        self._rng_of_effects = rng.spawn(1)[0]
        self._wandering = Wandering(clock.period_s, self._rng_of_effects)
        self._past: Array = np.empty((0, 2, vehicles))
        self._look_back()
        self._touching = self.gap_m <= 0.0
        if self._touching.any():
            i = int(np.argmax(self._touching))
            raise InputError(f"simulation: vehicle {i} starts inside its leader (gap {self.gap_m[i]:.2f} m)")
        self._accelerate()

    @property
    def gap_m(self) -> Array:
        """Gaps [m] to the leaders, shape (N,); infinite without a leader."""
        return np.asarray(gaps(self._traffic, self._order))

    @property
    def _traffic(self) -> Traffic:
        return Traffic(self.position_m, self.speed, self.held, self.acceleration, self._past)

    @property
    def _order(self) -> Order:
        return Order(self.leader, self._turn, self.length_m, self.line)

    def change(self, drivers: Array) -> None:
        """Let the drivers drive otherwise from the next period on; rows (N, width) at the reference period.

        Raises InputError for a parameter out of bounds; the drivers drive on as before then.
        """
        check(drivers)
        self._let_drive(drivers)
        self._look_back()

    def _let_drive(self, drivers: Array) -> None:
        """Let drivers drive by rows (N, width) at the reference period; a controlled vehicle moves without noise."""
        self.drivers = drivers.copy()
        self.drivers[np.ix_(self.controlled, [SIGMA_A, SIGMA_X, SIGMA_V])] = 0.0
        self.parameters = at_period(self.drivers, self.period_s)

    def _look_back(self) -> None:
        """Keep as much of the past as the drivers look back; before what is known, every vehicle kept its speed."""
        start = self.position_m, self.speed, self.held, self.acceleration
        past = begin(*start, self.parameters, self.period_s).past
        known = min(len(past), len(self._past))
        past[:known] = self._past[:known]
        self._past = past

    def measure(self) -> Array:
        """Measure the positions [m] at the present sample, shape (N,), wrapped on a ring; draws measurement noise."""
        return measure(self.position_m, self.road, self.parameters, self._rng, self._rng_of_effects)

    def step(self, recorded: tuple[Ints, Array, Array] | None = None) -> tuple[Collision, ...]:
        """Advance all drivers by one period, and return the collisions that began in this period.

        recorded: numbers of vehicles that move as recorded, and their positions [m] and speeds [m/s] after the period.
        """
        remember(self._traffic)
        own = self.position_m, self.speed, self.noise
        self.position_m, self.speed, self.noise = move(
            own, self.acceleration, self.parameters, self.period_s, self._rng
        )
        if recorded is not None:
            places, position, speed = recorded
            self.position_m[places], self.speed[places] = position, speed
        self.step_number += 1
        self._accelerate()
        touching = self.gap_m <= 0.0
        began = np.flatnonzero(touching & ~self._touching)
        self._touching = touching
        time = self.step_number * self.period_s
        return tuple(Collision(time, int(i), int(self.leader[i])) for i in began)

    def _accelerate(self) -> None:
        """Compute the accelerations of the coming period."""
        rows = self._wandering.next_rows(self.parameters)
        held: Array = np.empty(len(rows))
        pushed: Array = np.empty(len(rows))
        time = self.start_s + self.step_number * self.period_s
        setting = Setting(self.period_s, self.horizon, self.road.circumference_m)
        drive(self._traffic, self._order, rows, ACTIONS, time, setting, held, pushed)
        self.held = held
        self.acceleration = held + pushed + self.noise
        if self._controlled is not None:
            self._control(self._controlled)

    def _control(self, controlled: Controlled) -> None:
        """Let controllers choose the accelerations of their vehicles, whatever pushes these."""
        traffic, order = self._traffic, self._order
        for i, memory in zip(controlled.vehicles, self._memories, strict=True):
            gap, leader_speed = see(i, self.leader[i], traffic, order)
            seen = gap, float(self.speed[i]), leader_speed
            self.acceleration[i] = controlled.controller.function(*seen, memory, self.period_s, controlled.values)
            self.held[i] = self.acceleration[i]


def platoon(length_m: Array, gap_m: float) -> Array:
    """Place vehicles of lengths (N,) [m] in a line with equal gaps [m], and return their positions (N,) [m].

    The last vehicle in the line comes first, at position 0.
    """
    centre = np.cumsum(length_m + gap_m) - 0.5 * length_m
    return np.asarray(centre - centre[0])


def evenly(length_m: Array, road: Road) -> Array:
    """Place vehicles of lengths (N,) [m] with equal gaps all around a ring, and return their positions (N,) [m].

    Raises InputError.
    """
    free = road.circumference_m - float(length_m.sum())
    if free <= 0.0:
        raise InputError(f"simulation: {len(length_m)} vehicles do not fit on a ring of {road.circumference_m:g} m")
    return platoon(length_m, free / len(length_m))


def simulate(simulator: Simulator, duration_s: float, *, stop_at_collision: bool = True) -> Simulation:
    """Run a simulator and keep every sample.

    After a collision the model has no meaning, because the penalty is flat inside another vehicle.

    duration_s: duration [s].
    """
    samples = round(duration_s / simulator.period_s) + 1
    vehicles = len(simulator.length_m)
    position, speed, acceleration, measured = (np.empty((samples, vehicles)) for _ in range(4))
    collisions: list[Collision] = []
    taken = 0
    for t in range(samples):
        if t > 0:
            collisions.extend(simulator.step())
        position[t], speed[t], acceleration[t] = simulator.position_m, simulator.speed, simulator.acceleration
        measured[t] = simulator.measure()
        taken = t + 1
        if collisions and stop_at_collision:
            break
    return Simulation(
        dense=DenseTracks(
            position_m=measured[:taken],
            length_m=simulator.length_m,
            vehicle=np.arange(vehicles),
            road=simulator.road,
            period_s=simulator.period_s,
            start_s=simulator.start_s,
            source=SIMULATED,
            controlled=simulator.controlled,
        ),
        parameters=simulator.drivers,
        position_m=simulator.road.wrap(position[:taken]),
        speed=speed[:taken],
        acceleration=acceleration[:taken],
        collisions=tuple(collisions),
    )
