"""Several lanes of an open road: vehicles come into view, drive behind one another on their lane, and leave."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.experiment import Experiment, spread_out
from sugiyama_ros.simulation.simulator import REFERENCE_CLOCK, Clock, Simulator, platoon, simulate
from sugiyama_ros.trajectories.about import DEFAULT_LENGTH_M, SIMULATED, About
from sugiyama_ros.trajectories.exchange import of_columns
from sugiyama_ros.trajectories.labels import labels_of
from sugiyama_ros.trajectories.tracks import Tracks


@dataclass(frozen=True, eq=False)
class Lane:
    """The vehicles of a lane, in the order in which they follow: the last one drives ahead of all others.

    parameters: (N, P) or (N, width), parameters of the drivers at the reference period, or their rows with effects;
    length_m: (N,), lengths [m]; vehicle_class: class of each vehicle, N; gap_m: gaps [m] at the start, when all
    vehicles stand.
    """

    parameters: Array
    length_m: Array
    vehicle_class: Sequence[str]
    gap_m: float = 2.0


def simulate_lanes(
    lanes: Sequence[Lane],
    duration_s: float,
    rng: np.random.Generator,
    *,
    view_m: tuple[float, float] = (-np.inf, np.inf),
    clock: Clock = REFERENCE_CLOCK,
) -> Tracks:
    """Simulate lanes of an open road.

    duration_s: duration [s]; view_m: part of the road [m] that is seen. Raises InputError.
    """
    parts: list[dict[str, Array | list[str]]] = []
    for number, (lane, simulator) in enumerate(zip(lanes, _at_start(lanes, rng, clock), strict=True), 1):
        run = simulate(simulator, duration_s)
        if run.collisions:
            raise InputError(f"simulation: vehicles collide on lane {number}; take another seed, or other drivers")
        position = run.dense.position_m
        step, vehicle = np.nonzero((position >= view_m[0]) & (position < view_m[1]))
        parts.append(
            {
                "vehicle": [f"{number}-{v + 1}" for v in vehicle],
                "lane": [str(number)] * len(vehicle),
                "class": [lane.vehicle_class[v] for v in vehicle],
                "time_s": np.asarray(clock.start_s + clock.period_s * step, dtype=np.float64),
                "s_m": position[step, vehicle],
                "length_m": lane.length_m[vehicle],
            }
        )
    numbers = {name: np.concatenate([part[name] for part in parts]) for name in ("time_s", "s_m", "length_m")}
    if not len(numbers["s_m"]):
        raise InputError(f"simulation: nobody comes between {view_m[0]:g} and {view_m[1]:g} m; see more of the road")
    texts = {name: labels_of([t for part in parts for t in part[name]]) for name in ("vehicle", "lane", "class")}
    about = About(source=SIMULATED, view="whole" if view_m[1] == np.inf else "end")
    return of_columns({**texts, **numbers}, about)


def _at_start(lanes: Sequence[Lane], rng: np.random.Generator, clock: Clock) -> Iterator[Simulator]:
    """Put the vehicles of each lane at their start; the first vehicle of all stands at 0 m."""
    for lane in lanes:
        start = platoon(lane.length_m, lane.gap_m)
        yield Simulator(lane.parameters, lane.length_m, start - start[-1], Road(), rng, clock=clock)


def alike_lanes(experiment: Experiment, rows: Array, lanes: int, view_m: tuple[float, float]) -> Tracks:
    """Simulate lanes with equally many vehicles of the usual length.

    rows: (N, width), rows of the drivers at the reference period, N a multiple of ``lanes``; they stay as they are;
    view_m: part of the road [m] that is seen.
    """
    lane, rng, clock = _alike(experiment, rows, lanes)
    return simulate_lanes(lane, experiment.duration_s, rng, view_m=view_m, clock=clock)


def set_up_lanes(experiment: Experiment, rows: Array, lanes: int) -> list[Simulator]:
    """Put the vehicles of ``alike_lanes`` at their start, lane by lane."""
    return list(_at_start(*_alike(experiment, rows, lanes)))


def _alike(experiment: Experiment, rows: Array, lanes: int) -> tuple[list[Lane], np.random.Generator, Clock]:
    """Lanes with equally many vehicles, the generator of their noises, and their clock."""
    rng, rows = np.random.default_rng(experiment.seed), rows.copy()
    spread_out(rows, experiment.spread, rng)
    each = len(rows) // lanes
    lane = [
        Lane(own, np.full(each, DEFAULT_LENGTH_M), ["car"] * each, experiment.gap_m) for own in np.split(rows, lanes)
    ]
    return lane, rng, Clock(experiment.period_s, horizon=experiment.horizon)
