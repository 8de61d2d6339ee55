"""Several lanes with changes of lane: a road whose lanes may open late (ramps) and end (ramps, barriers).

Drivers choose an acceleration and a manoeuvre in each period of 1/3 s. A driver who changes belongs to the new lane
from the next period on, while the car moves across the road for ``CHANGE_S``. A lane that ends is a standing leader at
its end. Effects do not act here.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sugiyama_ros.arguments import checked
from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.lane_change import (
    CHANGE_S,
    KEEP,
    LANE_PARAMETERS,
    TO_LANE,
    LaneSpan,
    OnLanes,
    ThreeLanes,
    lane_features,
    log_probabilities,
    neighbours,
    see_lanes,
    weights_of,
)
from sugiyama_ros.driver.parameters import (
    REFERENCE_HORIZON,
    REFERENCE_PERIOD_S,
    RHO,
    SIGMA_A,
    SIGMA_NU,
    SIGMA_V,
    SIGMA_X,
    V_STAR,
    check,
    defaults,
    index,
)
from sugiyama_ros.driver.utility import (
    ACTIONS,
    advance,
    boltzmann_mean,
    preferences,
    scratch_for,
    utilities,
)
from sugiyama_ros.errors import InputError
from sugiyama_ros.jit import kernel
from sugiyama_ros.results import Result
from sugiyama_ros.simulation.experiment import MAX_VEHICLES
from sugiyama_ros.simulation.result import Collision
from sugiyama_ros.trajectories.about import DEFAULT_LENGTH_M, SIMULATED, About
from sugiyama_ros.trajectories.dense import MAX_SAMPLES
from sugiyama_ros.trajectories.exchange import of_columns
from sugiyama_ros.trajectories.labels import labels_of
from sugiyama_ros.trajectories.tracks import Tracks

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

#: Width [m] of a lane.
LANE_WIDTH_M = 3.5
#: Number of the vehicle ahead in a `Collision` with the end of a lane.
END_OF_LANE = -1


class OnRoad(NamedTuple):
    """N vehicles and their drivers at the start.

    s_m: (N,), positions [m] of the centres; lane: (N,), numbers of the lanes, which grow to the left; speed: (N,),
    speeds [m/s]; length_m: (N,), lengths [m]; parameters: (N, P) at the reference period; lane_parameters: (N, 3), in
    the order of ``LANE_PARAMETERS``.
    """

    s_m: Array
    lane: Ints
    speed: Array
    length_m: Array
    parameters: Array
    lane_parameters: Array


class LaneChange(NamedTuple):
    """Vehicle number ``vehicle`` begins to move to another lane, ``time_s`` [s] after the start of the run."""

    time_s: float
    vehicle: int
    from_lane: int
    to_lane: int


@dataclass(frozen=True, eq=False, repr=False)
class MultilaneRun(Result):
    """A simulated run of N vehicles.

    Parameters
    ----------
    tracks : Tracks
        Measured positions along and across the road; the lane is the one on which the driver drives before they decide
        at this time. Vehicle ``v12`` is
        number 12.
    changes : tuple of LaneChange
        Changes of lane, in the order of time.
    collisions : tuple of Collision
        Contacts with a vehicle ahead, or with the end of a lane (``END_OF_LANE``), in the order of time.
    start : OnRoad
        The vehicles and their drivers at the start.
    spans : mapping of int to LaneSpan
        The lanes.
    """

    tracks: Tracks
    changes: tuple[LaneChange, ...]
    collisions: tuple[Collision, ...]
    start: OnRoad
    spans: Mapping[int, LaneSpan]

    def headline(self) -> str:
        """Say how many vehicles there are, how often they change lanes, and how often they collide."""
        return (
            f"{len(self.start.s_m)} vehicles on {len(self.spans)} lanes for {self.tracks.time_s.max():.0f} s,"
            f" {len(self.changes)} changes of lane, {len(self.collisions)} collisions"
        )

    def records(self) -> list[dict[str, Any]]:
        """List the changes of lane."""
        return [one._asdict() for one in self.changes]

    def draw(self, figure: "Figure | SubFigure") -> None:
        """Draw positions along the road over time, coloured by the position across it."""
        axes, t = figure.subplots(), self.tracks
        dots = axes.scatter(t.time_s, t.s_m, c=t.d_m, s=1.5, cmap="cividis", linewidths=0, rasterized=True)
        figure.colorbar(dots, ax=axes, label="position across the road [m]")
        axes.set(xlabel="time [s]", ylabel="position [m]")


@kernel
def _accelerations(
    gap: Array, leader_speed: Array, end: Array, speed: Array, parameters: Array, grid: Array, period: float
) -> Array:
    """Compute the mean actions (R,) [m/s^2]: behind the leader, or before the end of the lane if that is less."""
    scratch, action = scratch_for(grid), np.empty(len(gap))
    for r in range(len(gap)):
        driver = preferences(parameters[r])
        utilities(gap[r], speed[r], leader_speed[r], driver, scratch, period, REFERENCE_HORIZON)
        action[r] = boltzmann_mean(scratch, driver[-1])
        if end[r] < np.inf:
            utilities(end[r], speed[r], 0.0, driver, scratch, period, REFERENCE_HORIZON)
            action[r] = min(action[r], boltzmann_mean(scratch, driver[-1]))
    return action


class _State(NamedTuple):
    """N vehicles during a run.

    noise: (N,), acceleration noises [m/s^2]; old: (N,), lanes from which the vehicles came to their present lanes;
    begun: (N,), periods since then, at most those of a movement; the rest as of ``OnRoad``.
    """

    s_m: Array
    speed: Array
    noise: Array
    lane: Ints
    old: Ints
    begun: Ints


# Periods of a movement across the road.
_MOVING = round(CHANGE_S / REFERENCE_PERIOD_S)


def simulate_multilane(
    start: OnRoad, spans: Mapping[int, LaneSpan], duration_s: float, rng: np.random.Generator
) -> MultilaneRun:
    """Simulate drivers who may change lanes.

    Parameters
    ----------
    start : OnRoad
        N vehicles and their drivers.
    spans : mapping of int to LaneSpan
        The lanes by their numbers, which grow to the left.
    duration_s : float
        Duration [s].
    rng : numpy.random.Generator
        Generator of all noises and choices.

    Returns
    -------
    MultilaneRun
        The tracks, the changes of lane, and the collisions.

    Raises
    ------
    InputError
        For parameters out of bounds, or a vehicle on a lane that is not there, or inside another one.
    """
    _check(start, spans)
    vehicles = len(start.s_m)
    state = _State(
        start.s_m.astype(np.float64),
        start.speed.astype(np.float64),
        np.zeros(vehicles),
        start.lane.astype(np.int64),
        start.lane.astype(np.int64),
        np.full(vehicles, _MOVING),
    )
    changes: list[LaneChange] = []
    collisions: list[Collision] = []
    touching: set[frozenset[int]] = set()
    seen: list[_State] = []
    for k in range(round(duration_s / REFERENCE_PERIOD_S) + 1):
        time_s = k * REFERENCE_PERIOD_S
        seen.append(state)
        state = _decide(state, start, spans, rng)
        new = np.flatnonzero(state.begun == 0)
        changes += [LaneChange(time_s, i, int(state.old[i]), int(state.lane[i])) for i in new.tolist()]
        on = _on_lanes(state, start)
        view, leader = see_lanes(on, spans), neighbours(on)[0][:, KEEP]
        before, state = state, _move(state, start, view, rng)
        now = _touching(leader, view.end_m[:, KEEP], before, state, start.length_m)
        new_pairs = sorted(pair for pair in now if frozenset(pair) not in touching)
        collisions += [Collision(time_s + REFERENCE_PERIOD_S, *pair) for pair in new_pairs]
        touching = {frozenset(pair) for pair in now}
    return MultilaneRun(_tracks(seen, start, rng), tuple(changes), tuple(collisions), start, dict(spans))


def _check(start: OnRoad, spans: Mapping[int, LaneSpan]) -> None:
    """Check the vehicles at the start. Raises InputError."""
    check(start.parameters)
    for k, p in enumerate(LANE_PARAMETERS):
        if not np.all((start.lane_parameters[:, k] >= p.lower) & (start.lane_parameters[:, k] <= p.upper)):
            raise InputError(f"parameter {p.name}: out of bounds; give {p.lower:g} to {p.upper:g}")
    if missing := sorted(set(start.lane.tolist()) - set(spans)):
        raise InputError(f"lanes: a vehicle is on lane {missing[0]}; give one of {', '.join(map(str, sorted(spans)))}")
    for lane, (opens_m, end_m) in spans.items():
        if not opens_m < end_m:
            raise InputError(
                f"spans: lane {lane} opens at {opens_m:g} m and ends at {end_m:g} m; give the end last, and beyond"
            )
    on = OnLanes(np.zeros(len(start.s_m), dtype=np.int64), start.lane, start.s_m, start.speed, start.length_m)
    view = see_lanes(on, spans)
    inside = np.flatnonzero(np.minimum(view.gap_m, view.end_m)[:, KEEP] <= 0.0)
    if len(inside):
        raise InputError(f"lanes: vehicle {inside[0]} starts inside its leader, or behind the end of its lane")


def _on_lanes(state: _State, start: OnRoad) -> OnLanes:
    """Return all vehicles on their lanes."""
    return OnLanes(np.zeros(len(state.s_m), dtype=np.int64), state.lane, state.s_m, state.speed, start.length_m)


def _decide(state: _State, start: OnRoad, spans: Mapping[int, LaneSpan], rng: np.random.Generator) -> _State:
    """Let every driver who is not moving across the road choose a manoeuvre, in a random order."""
    vehicles = len(state.s_m)
    view = see_lanes(_on_lanes(state, start), spans)
    log_p = log_probabilities(lane_features(view, start.parameters), weights_of(start.lane_parameters), view.can_choose)
    manoeuvre = (rng.random((vehicles, 1)) > np.cumsum(np.exp(log_p), axis=1)[:, :2]).sum(axis=1)
    manoeuvre[state.begun < _MOVING] = KEEP
    lane, old, begun = state.lane.copy(), state.old.copy(), state.begun + 1
    for i in rng.permutation(vehicles).tolist():
        if manoeuvre[i] == KEEP:
            continue
        target = lane[i] + TO_LANE[manoeuvre[i]]
        # somebody else may just have decided for the same place
        rivals = (lane == target) & (begun == 0)
        room = 0.5 * (start.length_m + start.length_m[i])
        if not np.any(rivals & (np.abs(state.s_m - state.s_m[i]) <= room)):
            lane[i], old[i], begun[i] = target, lane[i], 0
    return state._replace(lane=lane, old=old, begun=np.minimum(begun, _MOVING))


def _touching(leader: Ints, end_m: Array, before: _State, after: _State, length_m: Array) -> set[tuple[int, int]]:
    """Find the pairs of a vehicle and its leader that touch after a period, or have passed through each other.

    leader: (N,), numbers of the leaders; end_m: (N,), distances [m] to the ends of the lanes before.
    """
    gap = after.s_m[leader] - after.s_m - 0.5 * (length_m[leader] + length_m)
    pairs = {(i, int(leader[i])) for i in np.flatnonzero((leader >= 0) & (gap <= 0.0)).tolist()}
    return pairs | {(i, END_OF_LANE) for i in np.flatnonzero(end_m <= after.s_m - before.s_m).tolist()}


def _move(state: _State, start: OnRoad, view: ThreeLanes, rng: np.random.Generator) -> _State:
    """Move all vehicles by one period; nobody drives backward."""
    p = start.parameters
    shock = rng.standard_normal((3, len(p)))
    noise = p[:, RHO] * state.noise + p[:, SIGMA_A] * shock[0]
    gap, leader_speed, end = (np.ascontiguousarray(x[:, KEEP]) for x in (view.gap_m, view.leader_speed, view.end_m))
    action = _accelerations(gap, leader_speed, end, state.speed, p, ACTIONS, REFERENCE_PERIOD_S)
    place, speed = advance(state.s_m, state.speed, action + noise, REFERENCE_PERIOD_S)
    speed = np.maximum(speed + p[:, SIGMA_V] * shock[1], 0.0)
    return state._replace(s_m=place + p[:, SIGMA_X] * shock[2], speed=speed, noise=noise)


def _across(state: _State) -> Array:
    """Return positions (N,) [m] across the road, with a smooth lateral acceleration."""
    done = np.clip(state.begun / _MOVING, 0.0, 1.0)
    share = done - np.sin(2.0 * np.pi * done) / (2.0 * np.pi)
    return np.asarray(LANE_WIDTH_M * (state.old + (state.lane - state.old) * share))


def _tracks(seen: list[_State], start: OnRoad, rng: np.random.Generator) -> Tracks:
    """Make tracks, measured with the drivers' noise along and across the road."""
    steps, vehicles = len(seen), len(start.s_m)
    noise = start.parameters[:, SIGMA_NU] * rng.standard_normal((2, steps, vehicles))
    names = labels_of([f"v{i}" for i in range(vehicles)] * steps)
    lane = labels_of(np.concatenate([state.lane for state in seen]).tolist())
    columns = {
        "vehicle": names,
        "lane": lane,
        "time_s": np.repeat(np.arange(steps) * REFERENCE_PERIOD_S, vehicles),
        "s_m": (np.array([state.s_m for state in seen]) + noise[0]).ravel(),
        "d_m": (np.array([_across(state) for state in seen]) + noise[1]).ravel(),
        "length_m": np.tile(start.length_m, steps),
    }
    return of_columns(columns, About(source=SIMULATED, view="whole"))


def place_at_random(
    vehicles: int,
    lanes: int,
    spacing_m: float,
    rng: np.random.Generator,
    values: Mapping[str, float] = MappingProxyType({}),
) -> OnRoad:
    """Place drivers with different desired speeds on lanes 0 to ``lanes`` - 1, before position 0.

    Parameters
    ----------
    vehicles, lanes : int
        Numbers of vehicles and of lanes.
    spacing_m : float
        Mean distance [m] between the vehicles of a lane.
    rng : numpy.random.Generator
        Generator of places, speeds and drivers.
    values : mapping of str to float
        Parameters of all drivers, and of their choices, by name.

    Returns
    -------
    OnRoad
        Drivers at 0.8 of their desired speeds. Unless given, desired speeds differ by 20 %, and there is no measurement
        noise.

    Raises
    ------
    InputError
        For an unknown name.
    """
    parameters = defaults(vehicles)
    parameters[:, V_STAR] *= np.exp(0.2 * rng.standard_normal(vehicles))
    parameters[:, SIGMA_NU] = 0.0
    lane = np.arange(vehicles) % lanes
    s_m = spacing_m * (np.arange(vehicles) // lanes - vehicles // lanes + rng.uniform(-0.25, 0.25, vehicles))
    lane_parameters = np.tile([p.default for p in LANE_PARAMETERS], (vehicles, 1))
    of_choices = [p.name for p in LANE_PARAMETERS]
    for name, value in values.items():
        if name in of_choices:
            lane_parameters[:, of_choices.index(name)] = value
        else:
            parameters[:, index(name)] = value
    length = np.full(vehicles, DEFAULT_LENGTH_M)
    return OnRoad(s_m, lane, 0.8 * parameters[:, V_STAR], length, parameters, lane_parameters)


@checked()
def simulate_lane_changes(
    vehicles: int = 60,
    lanes: int = 3,
    duration_s: float = 120.0,
    *,
    spans: Mapping[int, tuple[float, float]] | None = None,
    parameters: Mapping[str, float] | None = None,
    spacing_m: float = 30.0,
    seed: int = 0,
) -> MultilaneRun:
    """Simulate drivers who change lanes on an open road.

    Parameters
    ----------
    vehicles, lanes : int
        Numbers of vehicles and of lanes. Lanes have the numbers 0, 1, ... from right to left.
    duration_s : float
        Duration [s].
    spans : mapping of int to (float, float), optional
        Where a lane opens to others, and where it ends [m]: a ramp is ``{0: (300.0, 500.0)}``, a barrier is
        ``{0: (-inf, 500.0)}``. Lanes that are left out have no ends.
    parameters : mapping of str to float, optional
        Parameters that all drivers share, and those of their choices (``lane_rationality``, ``politeness``,
        ``change_cost``). Desired speeds differ by 20 %, and positions are measured without noise, unless given here.
    spacing_m : float
        Mean distance [m] between the vehicles of a lane at the start.
    seed : int
        Seed of all random numbers.

    Returns
    -------
    MultilaneRun
        Tracks with lanes, the changes of lane, and the collisions.

    Raises
    ------
    InputError
        For an unknown name, a value out of bounds, or a lane that is not there.

    Examples
    --------
    >>> import sugiyama_ros as sg
    >>> run = sg.simulate_lane_changes(vehicles=20, lanes=2, duration_s=60.0, spans={0: (-np.inf, 300.0)})
    >>> run.tracks.column("lane").used()
    ('0', '1')
    """
    _check_asked(vehicles, lanes, duration_s, spacing_m, seed)
    if missing := sorted(set(spans or {}) - set(range(lanes))):
        raise InputError(f"spans: there is no lane {missing[0]}; lanes have the numbers 0 to {lanes - 1}")
    rng = np.random.default_rng(seed)
    start = place_at_random(vehicles, lanes, spacing_m, rng, parameters or {})
    known = {lane: LaneSpan(*(spans or {}).get(lane, LaneSpan())) for lane in range(lanes)}
    return simulate_multilane(start, known, duration_s, rng)


def _check_asked(vehicles: int, lanes: int, duration_s: float, spacing_m: float, seed: int) -> None:
    """Raise InputError for numbers that cannot be simulated."""
    for name, value, lower, upper in (
        ("vehicles", vehicles, 1, MAX_VEHICLES),
        ("lanes", lanes, 1, 100),
        ("duration_s", duration_s, 1.0, MAX_SAMPLES * REFERENCE_PERIOD_S / vehicles if vehicles > 0 else np.inf),
        # places differ by up to a quarter of it, and nobody starts inside a leader
        ("spacing_m", spacing_m, 2.0 * DEFAULT_LENGTH_M, 1e4),
        ("seed", seed, 0, np.inf),
    ):
        if not lower <= value <= upper:
            raise InputError(f"{name}: {value:g} is not possible; give {lower:g} to {upper:g}")
