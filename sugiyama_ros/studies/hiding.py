"""Simulated recordings with hidden effects, for the benchmark of the diagnosis and for the demonstration.

22 drivers, whose desired speeds and risk premiums differ by 10 %, start from rest with gaps of 2 m on a ring of 230 m
and drive for 250 s, with a sample every 1/3 s. Runs in which cars collide are drawn again. With effects that always
end in a collision, the cars start from uniform flow.
"""

from collections.abc import Mapping

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR, defaults
from sugiyama_ros.effects.effect import Values
from sugiyama_ros.effects.registry import EFFECTS, ROW, effect, switch_on
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.result import Simulation
from sugiyama_ros.simulation.simulator import Simulator, evenly, platoon, simulate

DRIVERS, RING_M, DURATION_S, LENGTH_M = 22, 230.0, 250.0, 4.33
#: Strong and weak values of each effect that can be hidden. Places and times that are left out are drawn at random.
STRENGTHS: Mapping[str, tuple[Values, ...]] = {name: e.benchmark for name, e in EFFECTS.items() if e.benchmark}
#: Values with which the demonstration hides an effect, where the strong ones hardly change a free run.
DEMONSTRATED: Mapping[str, Values] = {"slow_patch": {"reduction": 0.3, "width": 80.0}}
# Attempts at a run without a collision; those from uniform flow come last.
_ATTEMPTS, _FROM_REST = 60, 30


def hide(name: str, values: Values, seed: int) -> tuple[Simulation, Values]:
    """Simulate a recording with one hidden effect.

    values: values of its parameters, such as those in ``STRENGTHS``. Returns simulation: a run without a collision;
    values: values of the parameters, with the place and the time that were drawn. Raises ValueError.
    """
    run, drawn = hide_all({name: values}, seed)
    return run, drawn[name]


def hide_all(effects: Mapping[str, Values], seed: int) -> tuple[Simulation, dict[str, Values]]:
    """Simulate a recording with several hidden effects, or with none.

    Returns simulation: a run without a collision; values: values of the parameters by the name of the effect, with the
    places and times that were drawn. Raises ValueError.
    """
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, attempt])
        rows = ROW.with_effects(defaults(DRIVERS))
        for k in (V_STAR, KAPPA_V):
            rows[:, k] *= np.exp(0.1 * rng.standard_normal(DRIVERS))
        drawn = {}
        for name, values in effects.items():
            drawn[name] = _with_place_and_time(name, values, rng)
            rows = switch_on(rows, name, drawn[name])
        run = _run(rows, rng, from_rest=attempt < _FROM_REST)
        if not run.collisions:
            return run, drawn
    raise ValueError(f"{', '.join(effects)}: cars always collide")


def _with_place_and_time(name: str, values: Values, rng: np.random.Generator) -> Values:
    """Draw the parameters of an effect that are a place on the road or a time, and that have no value."""
    drawn = dict(values)
    for parameter in effect(name).parameters:
        if parameter.name in values:
            continue
        if parameter.axis == "place":
            drawn[parameter.name] = float(rng.uniform(0.0, RING_M))
        elif parameter.axis == "time":
            drawn[parameter.name] = float(rng.uniform(0.3, 0.7) * DURATION_S)
    return drawn


def _run(rows: Array, rng: np.random.Generator, *, from_rest: bool) -> Simulation:
    """Simulate drivers (N, width) from rest with gaps of 2 m, or from uniform flow at 5 m/s."""
    length, road = np.full(DRIVERS, LENGTH_M), Road(RING_M)
    start = platoon(length, 2.0) if from_rest else evenly(length, road)
    speed = np.full(DRIVERS, 0.0 if from_rest else 5.0)
    return simulate(Simulator(rows, length, start, road, rng, speed=speed), DURATION_S)
