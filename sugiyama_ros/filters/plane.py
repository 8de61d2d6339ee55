"""A car in the plane: what is measured of it, the filter (``bicycle``), and what the filter says of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.bicycle import CAR, Steering, car_at_period, car_of, wanted_line
from sugiyama_ros.driver.parameters import NAMES, RATIONALITY, at_period, check, population
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.effects.effect import MEASUREMENT
from sugiyama_ros.effects.registry import active, effect
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.bicycle import Plane, PlaneSamples, PlaneTrace, plane_for, run_plane
from sugiyama_ros.filters.chain import chain_parameters
from sugiyama_ros.filters.state import STATE, Drivers, State, scene_at, step_for
from sugiyama_ros.results import BLUE, Result, figure
from sugiyama_ros.trajectories.about import DEFAULT_LENGTH_M, LONGEST_M
from sugiyama_ros.trajectories.assemble import check_possible
from sugiyama_ros.trajectories.centre_line import CentreLine

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure


@dataclass(frozen=True, eq=False)
class PlaneTrack:
    """What is measured of a car in the plane, and of the vehicles ahead on the same line, at T regular times.

    Parameters
    ----------
    x_m, y_m : ndarray, shape (T,)
        Place [m] of the car; NaN where not measured.
    heading : ndarray, shape (T,), optional
        Heading [rad] of the car, counter-clockwise from the x axis; NaN where not measured.
    ahead_m : ndarray, shape (T, M - 1), optional
        Positions [m] along the line of the vehicles ahead, the nearest first; NaN where not measured; nobody is ahead
        if left out.
    identity : ndarray of int, shape (T, M), optional
        Numbers of the vehicles, own first, -1 for none; by default the vehicles stay the same.
    length_m : float or ndarray, shape (M,)
        Length [m] of all vehicles, or of each.
    """

    x_m: Array
    y_m: Array
    heading: Array | None = None
    ahead_m: Array | None = None
    identity: Ints | None = None
    length_m: float | Array = DEFAULT_LENGTH_M

    @property
    def vehicles(self) -> int:
        """Number M of vehicles; without anybody ahead, there is room for one."""
        return 2 if self.ahead_m is None else 1 + self.ahead_m.shape[1]

    def samples(self) -> PlaneSamples:
        """Return the arrays that the filter takes. Raises InputError."""
        t, vehicles = len(self.x_m), self.vehicles
        heading = np.full(t, np.nan) if self.heading is None else self.heading
        ahead = np.full((t, 1), np.nan) if self.ahead_m is None else self.ahead_m
        for name, given in (("x_m", self.x_m), ("y_m", self.y_m), ("heading", heading), ("ahead_m", ahead)):
            if t == 0 or given.shape[0] != t or given.ndim != (2 if name == "ahead_m" else 1):
                raise InputError(f"{name}: has shape {given.shape}; give one value, or one row, for each sample")
            if np.isinf(given).any():
                raise InputError(
                    f"{name}: is infinite at sample {int(np.argwhere(np.isinf(given))[0, 0])}; give NaN there"
                )
            check_possible({name: given.ravel()}, "samples")
        identity = np.tile(np.arange(vehicles), (t, 1)) if self.identity is None else self.identity
        own: Array = np.column_stack([self.x_m, self.y_m, heading])
        length: Array = np.tile(np.broadcast_to(self.length_m, vehicles).astype(np.float64), (t, 1))
        return PlaneSamples(own, ahead.copy(), identity.astype(np.int64), length)


def plane_track(
    x_m: ArrayLike,
    y_m: ArrayLike,
    heading: ArrayLike | None = None,
    ahead_m: ArrayLike | None = None,
    length_m: float = DEFAULT_LENGTH_M,
) -> PlaneTrack:
    """Make a track of what numpy can make arrays of; ``ahead_m`` may be (T,) of one vehicle. Raises InputError."""
    if not 0.0 < length_m < LONGEST_M:
        raise InputError(
            f"length_m: {length_m:g} is no length of a vehicle; give a number above 0 and below {LONGEST_M:g}"
        )
    turned = None if heading is None else np.asarray(heading, np.float64)
    ahead = None if ahead_m is None else np.asarray(ahead_m, np.float64)
    if ahead is not None and ahead.ndim == 1:
        ahead = ahead[:, None]
    x, y = np.asarray(x_m, np.float64), np.asarray(y_m, np.float64)
    return PlaneTrack(x, y, turned, ahead, length_m=length_m)


@dataclass(frozen=True, eq=False, repr=False)
class PlaneEstimates(Result):
    """What the filter says of a car in the plane at T samples, after the update with each; NaN where not known.

    Parameters
    ----------
    time_s : ndarray, shape (T,)
        Times [s] of the samples.
    mean : ndarray, shape (T, 4 M + 3)
        State: x [m], speed [m/s], noise [m/s^2] and held acceleration [m/s^2] of the car; position along the line,
        speed, noise and held acceleration of each vehicle ahead; y [m], heading and steering angle [rad] of the car.
    covariance : ndarray, shape (T, 4 M + 3, 4 M + 3)
        Covariance of the state.
    innovation, innovation_var : ndarray, shape (T, 3)
        Innovations along and across the line [m] and of the heading [rad], each given those before it, and their
        variances.
    sample_log_likelihood : ndarray, shape (T, 3)
        Log-likelihood of each innovation, without the term of 2 pi; NaN where it does not count.
    s_m, d_m : ndarray, shape (T,)
        Position [m] along the line, not wrapped on a ring, and across it, positive to its left.
    acceleration, mean_action : ndarray, shape (T,)
        Acceleration of the car, and what the driver means to do [m/s^2].
    mean_steering : ndarray, shape (T,)
        Expected steering angle [rad] of the next period.
    """

    time_s: Array
    mean: Array
    covariance: Array
    innovation: Array
    innovation_var: Array
    sample_log_likelihood: Array
    s_m: Array
    d_m: Array
    acceleration: Array
    mean_action: Array
    mean_steering: Array

    @property
    def x_m(self) -> Array:
        """Place [m] in x, shape (T,)."""
        return self._entry(0)

    @property
    def y_m(self) -> Array:
        """Place [m] in y, shape (T,)."""
        return self._entry(-3)

    @property
    def heading(self) -> Array:
        """Heading [rad], shape (T,)."""
        return self._entry(-2)

    @property
    def speed(self) -> Array:
        """Speed [m/s], shape (T,)."""
        return self._entry(1)

    @property
    def steering(self) -> Array:
        """Steering angle [rad] of the period before, shape (T,)."""
        return self._entry(-1)

    def _entry(self, k: int) -> Array:
        return np.where(np.isnan(self.s_m), np.nan, self.mean[:, k])

    @property
    def nis(self) -> Array:
        """Normalised innovation squared of each sample, over all that is measured of it, shape (T,)."""
        each = np.where(np.isnan(self.sample_log_likelihood), np.nan, self.innovation**2 / self.innovation_var)
        return np.where(np.isnan(each).all(axis=1), np.nan, np.nansum(each, axis=1))

    @property
    def log_likelihood(self) -> float:
        """Log-likelihood of all samples, without the term of 2 pi."""
        return float(np.nansum(self.sample_log_likelihood))

    def headline(self) -> str:
        """Say how many samples there are, and how well they are predicted."""
        counted = int(np.isfinite(self.sample_log_likelihood).sum())
        if not counted:
            return f"{len(self.time_s)} samples in the plane, too few to tell how well they are predicted"
        nis = figure(float(np.nansum(self.nis)) / counted)
        return f"{len(self.time_s)} samples in the plane, NIS {nis} for each number measured"

    def records(self) -> Sequence[Mapping[str, Any]]:
        """List the estimates, one row for each sample."""
        names = ("time_s", "x_m", "y_m", "heading", "speed", "acceleration", "steering", "s_m", "d_m", "nis")
        columns = [getattr(self, name).tolist() for name in names]
        return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]

    def draw(self, figure: "Figure | SubFigure") -> None:
        """Draw the way in the plane, coloured by speed, and the distance from the line over time."""
        way, across = figure.subplots(1, 2)
        dots = way.scatter(self.x_m, self.y_m, c=self.speed, s=4.0, cmap="cividis", linewidths=0)
        figure.colorbar(dots, ax=way, label="speed [m/s]", location="bottom")
        way.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
        across.plot(self.time_s, self.d_m, color=BLUE, linewidth=1.0)
        across.set(xlabel="time [s]", ylabel="distance to the left of the line [m]")


class PlaneFilter:
    """Filter of one driver in the plane, which goes on from sample to sample.

    line: the line that the driver wants to follow; period_s: time between two samples [s]; vehicles: number M of
    vehicles, own first, at least 2; parameters: of the driver at the reference period: (P,), or a row with effects
    (WIDTH,); the mean of the population if left out; ahead: the same of the drivers ahead; car: of the car and of how
    the driver steers, (C,) at the reference period, as of ``driver.bicycle.car_of``; start_s: time [s] of the first
    sample. Raises InputError.
    """

    def __init__(
        self,
        line: CentreLine,
        period_s: float,
        vehicles: int = 2,
        parameters: Array | None = None,
        ahead: Array | None = None,
        car: Array | None = None,
        start_s: float = 0.0,
    ) -> None:
        own = population() if parameters is None else parameters
        car = car_of() if car is None else car
        check(own)
        _check_car(car)
        _check_effects(own)
        rows = at_period(chain_parameters(own, ahead, vehicles), period_s)
        nothing = np.zeros(0)
        scene = scene_at(period_s, line.road.circumference_m)
        drivers = Drivers(rows, np.zeros(0, np.int64), nothing, nothing)
        state = State(np.zeros(STATE * vehicles), np.zeros((STATE * vehicles,) * 2), np.zeros(vehicles, np.int64))
        self.period_s = period_s
        self._step = step_for(state, drivers, np.zeros(vehicles), scene, ACTIONS)
        horizon_s = scene.horizon * period_s
        self._steering = Steering(
            wanted_line(line), car_at_period(car, period_s), float(rows[0, RATIONALITY]), horizon_s
        )
        self._plane = plane_for(vehicles, start_s)
        self._length: Array = np.full(vehicles, DEFAULT_LENGTH_M)

    def run(self, track: PlaneTrack) -> PlaneEstimates:
        """Go on over the samples of a track. Raises InputError."""
        samples, vehicles = track.samples(), len(self._plane.known)
        if track.vehicles != vehicles:
            raise InputError(f"track: has {track.vehicles} vehicles; this filter has {vehicles}")
        self._length = samples.length[-1]
        return self._go_on(self._plane, samples)

    def predicted_path(self, duration_s: float) -> PlaneEstimates:
        """Return what the filter expects from the latest sample on, as if nothing more were measured."""
        periods, vehicles = max(1, round(duration_s / self.period_s)), len(self._plane.known)
        nothing = PlaneSamples(
            np.full((periods, 3), np.nan),
            np.full((periods, vehicles - 1), np.nan),
            np.tile(self._plane.identity, (periods, 1)),
            np.tile(self._length, (periods, 1)),
        )
        copied = {name: array.copy() for name, array in self._plane._asdict().items()}
        return self._go_on(Plane(**copied), nothing)

    def _go_on(self, plane: Plane, samples: PlaneSamples) -> PlaneEstimates:
        t, n, start_s = len(samples.own), len(plane.mean), float(plane.clock[0])
        shapes = ((t, n), (t, n, n), (t, 3), (t, 3), (t, 3), (t, 2), (t, 3))
        trace = PlaneTrace(*(np.full(shape, np.nan) for shape in shapes))
        run_plane(samples, plane, self._step, self._steering, trace)
        times = np.array([start_s + self.period_s * k for k in range(t)])
        return PlaneEstimates(times, *trace[:5], *trace.line.T.copy(), *trace.motion.T.copy())


def _check_car(car: Array) -> None:
    """Check that the parameters of a car lie within their bounds. Raises InputError."""
    for p, value in zip(CAR, car.tolist(), strict=True):
        if not p.lower <= value <= p.upper:
            raise InputError(f"{p.name}: {value:g}{p.of_unit} is out of bounds; give {p.bounds}")


def _check_effects(row: Array) -> None:
    """Check that the filter in the plane knows the effects of a row. Raises InputError."""
    for name in active(row) if len(row) > len(NAMES) else ():
        one = effect(name)
        if one.stage == MEASUREMENT or one.displacement or one.measurement_noise_factor or one.contamination:
            raise InputError(f"{name}: the filter in the plane has no errors of measurement but noise; leave it out")
        if one.looks_back or one.wanders or one.sees_rear:
            raise InputError(f"{name}: the filter in the plane knows neither the past nor who is behind; leave it out")
