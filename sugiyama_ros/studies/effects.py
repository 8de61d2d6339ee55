"""Are the parameters of hidden effects found again, and are their stated errors right?

22 drivers, whose desired speeds and risk premiums differ by 10 %, start from rest with gaps of 2 m on a ring of 230 m
and drive for 250 s, with a sample every 1/3 s. Runs in which cars collide are drawn again. With effects that always
end in a collision, the cars start from uniform flow. The demonstration hides its effect here, too.
"""

from collections import defaultdict
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.refine import with_named
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR, defaults
from sugiyama_ros.effects.effect import Values
from sugiyama_ros.effects.registry import EFFECTS, ROW, effect, index_of, switch_on
from sugiyama_ros.fit.joint import fit_base
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.fit.standard_errors import shared_stds
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.result import Simulation
from sugiyama_ros.simulation.simulator import Simulator, evenly, platoon, simulate
from sugiyama_ros.studies.rings import CARS, JAM_GAP_M, LENGTH_M, RING_M
from sugiyama_ros.studies.study import Answer, Asked, Row, Study

#: Duration [s] of a simulated run.
DURATION_S = 250.0
#: Strong and weak values of each effect that can be hidden. Places and times that are left out are drawn at random.
STRENGTHS: Mapping[str, tuple[Values, ...]] = {name: e.benchmark for name, e in EFFECTS.items() if e.benchmark}
#: Values with which the demonstration hides an effect, where the strong ones hardly change a free run.
DEMONSTRATED: Mapping[str, Values] = {"slow_patch": {"reduction": 0.3, "width": 80.0}}
# Attempts at a run without a collision; those from uniform flow come last.
_ATTEMPTS, _FROM_REST = 60, 30
# A normal error is within this many standard errors in 95 of 100 cases.
_SURE = 1.96


def hide(name: str, values: Values, seed: int) -> tuple[Simulation, Values]:
    """Simulate a recording with one hidden effect, without a collision.

    values: values of its parameters, such as those in ``STRENGTHS``. Returns the simulation and all values, with the
    place and the time that were drawn. Raises ValueError.
    """
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, attempt])
        rows = ROW.with_effects(defaults(CARS))
        for k in (V_STAR, KAPPA_V):
            rows[:, k] *= np.exp(0.1 * rng.standard_normal(CARS))
        drawn = _with_place_and_time(name, values, rng)
        run = _run(switch_on(rows, name, drawn), rng, from_rest=attempt < _FROM_REST)
        if not run.collisions:
            return run, drawn
    raise ValueError(f"{name}: cars always collide")


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
    length, road = np.full(CARS, LENGTH_M), Road(RING_M)
    start = platoon(length, JAM_GAP_M) if from_rest else evenly(length, road)
    speed = np.full(CARS, 0.0 if from_rest else 5.0)
    return simulate(Simulator(rows, length, start, road, rng, speed=speed), DURATION_S)


class _FoundAgain(NamedTuple):
    """A parameter of a hidden effect: its true value, its fitted value and the standard error, in its own unit."""

    name: str
    truth: float
    value: float
    std: float


def _found_again(job: tuple[str, int]) -> list[_FoundAgain]:
    """Hide an effect in its strong form, add it to the fitted model as a diagnosis does, and return what was found."""
    name, seed = job
    try:
        run, truth = hide(name, STRENGTHS[name][0], seed)
    except ValueError:
        return []
    with ThreadPoolExecutor(1) as work:
        data = prepare(run.measured)
        base = fit_base(data, data.even.individual(V_STAR, KAPPA_V), work)
        fitted = with_named(data, base, [name], work)
        stds = shared_stds(data, fitted, work)
    return [
        _FoundAgain(f"{name}.{p}", value, float(fitted.model.rows[0, index_of(name, p)]), stds[f"{name}.{p}"])
        for p, value in truth.items()
        if f"{name}.{p}" in stds
    ]


def _standardised(found: _FoundAgain) -> float:
    """The error of a fit over its standard error; a place counts around the ring."""
    error = found.value - found.truth
    if ROW.declared[ROW.entries.index(found.name)].axis == "place":
        error -= RING_M * round(error / RING_M)
    return error / found.std


def _answer(asked: Asked) -> Answer:
    """Hide every effect in some recordings, and fit it.

    The table has, for each parameter, the medians of truth, fit and standard error, the mean and the spread of the
    errors over their standard errors, and the share of 95 % intervals that contain the truth.
    """
    jobs = [(name, asked.seed + k) for name in STRENGTHS for k in range(asked.runs)]
    found: dict[str, list[_FoundAgain]] = defaultdict(list)
    for one in (one for several in asked.work.map(_found_again, jobs) for one in several):
        found[one.name].append(one)
    z = {name: np.array([_standardised(one) for one in several]) for name, several in found.items()}
    rows: list[Row] = [
        {
            "parameter": name,
            "truth": float(np.median([one.truth for one in several])),
            "median": float(np.median([one.value for one in several])),
            "median error": float(np.median([one.std for one in several])),
            "mean z": float(z[name].mean()),
            "std of z": float(z[name].std(ddof=1)) if len(several) > 1 else np.nan,
            "coverage of 95 %": float(np.mean(np.abs(z[name]) < _SURE)),
            "fits": len(several),
        }
        for name, several in found.items()
    ]

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        for k, name in enumerate(found):
            axes.plot(z[name], np.full(len(z[name]), k), "o", color="C0")
        for side in (-_SURE, _SURE):
            axes.axvline(side, color="black", linestyle=":")
        axes.set(xlabel="error / standard error", yticks=range(len(found)), yticklabels=list(found))

    return Answer(tuple(rows), draw)


STUDY = Study(
    name="effects",
    question="Are the parameters of hidden effects found again, and do their intervals hold?",
    paper="The paper has no effects besides its model; further effects are left to later work (outlook).",
    answer=_answer,
    takes=("runs", "seed"),
)
