"""Scenes at which drivers meet: small roads, and drivers who come at random times."""

from collections.abc import Callable, Mapping

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.effects.effect import CURVES, SIGNALS, YIELDS
from sugiyama_ros.errors import InputError
from sugiyama_ros.roads.examples import crossing, merge, roundabout
from sugiyama_ros.roads.network import Network
from sugiyama_ros.roads.scene import lines_of_routes
from sugiyama_ros.simulation.experiment import spread_out
from sugiyama_ros.simulation.junction import JunctionRun, JunctionSimulator, demand, simulate_junction
from sugiyama_ros.simulation.simulator import Clock

#: Length [s] of a cycle of signals.
_CYCLE_S = 60.0
#: The scenes by name.
SCENES: Mapping[str, Callable[[], Network]] = {
    "roundabout": roundabout,
    "crossing": crossing,
    "signals": lambda: crossing(cycle_s=_CYCLE_S),
    "merge": merge,
}
#: Vehicles per hour that come to a scene.
PER_HOUR = 900.0
# Time [s] after the last one has come within which everybody leaves, or never will.
_LEAVE_S = 600.0


def road_of(scene: str) -> tuple[str, ...]:
    """What a scene has that effects may need. Raises InputError for a scene that is not known."""
    if scene not in SCENES:
        raise InputError(f"scene {scene!r}: is not known; give {', '.join(SCENES)}")
    network = SCENES[scene]()
    ways = lines_of_routes(network, network.ways())
    there = {
        YIELDS: bool((ways.yields & (ways.other >= 0)).any()),
        SIGNALS: bool(network.signals),
        CURVES: bool((ways.curvature > 0.0).any()),
    }
    return tuple(name for name, is_there in there.items() if is_there)


def scene_simulator(scene: str, rows: Array, seed: int, spread: float, period_s: float) -> JunctionSimulator:
    """Let drivers come to a scene at random times, on all ways through it alike; arguments as of `simulate_scene`."""
    if scene not in SCENES:
        raise InputError(f"scene {scene!r}: is not known; give {', '.join(SCENES)}")
    rng, network, drivers = np.random.default_rng(seed), SCENES[scene](), rows.copy()
    spread_out(drivers, spread, rng)
    paths = network.ways()
    come = demand([PER_HOUR / len(paths)] * len(paths), drivers, rng)
    return JunctionSimulator(network, paths, come, rng, Clock(period_s))


def simulate_scene(
    scene: str, rows: Array, seed: int, *, duration_s: float = np.inf, spread: float = 0.0, period_s: float = 0.2
) -> JunctionRun:
    """Simulate drivers at a scene.

    Parameters
    ----------
    scene : str
        One of ``SCENES``: roundabout, crossing (the road of arms 1 and 3 has priority), signals, or merge.
    rows : ndarray, shape (N, P) or (N, width)
        Parameters of the drivers at the reference period, or their rows with effects, in the order in which they come.
    seed : int
        Seed of all random numbers.
    duration_s : float
        Duration [s]; by default until everybody has left.
    spread : float
        Standard deviation, over the drivers, of the logarithms of the desired speed and of the risk premium.
    period_s : float
        Time [s] between two samples.

    Returns
    -------
    JunctionRun
        What the drivers did; ``measured`` are the tracks.

    Raises
    ------
    InputError
        For a scene that is not known.

    Examples
    --------
    >>> from sugiyama_ros.driver.parameters import defaults
    >>> from sugiyama_ros.simulation.scenes import simulate_scene
    >>> run = simulate_scene("roundabout", defaults(5), seed=1)
    >>> run.headline()
    '5 drivers, 5 came through, 0 collisions, longest standstill of all 0 s'
    """
    simulator = scene_simulator(scene, rows, seed, spread, period_s)
    return simulate_junction(simulator, min(duration_s, simulator.travellers[-1].time_s + _LEAVE_S))
