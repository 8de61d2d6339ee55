"""Does an estimator notice that a driver wants to drive slower?"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Mask
from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.simulation.result import Simulation
from sugiyama_ros.studies.online import followed
from sugiyama_ros.studies.rings import CARS, Ring, run
from sugiyama_ros.studies.study import Answer, Asked, Row, Study

# The factor by which the desired speed falls, when it falls, on which roads, and in what time it should be noticed.
_FACTOR, _SWITCH_S, _RINGS_M, _SOON_S = 0.85, 100.0, (230.0, 400.0), 25.0
# The drivers whose desired speed falls: every third.
_SLOWED = np.arange(CARS) % 3 == 0
# A driver is slowed where they drive this much slower [m/s] than they would have driven without the change.
_LEAST_LOSS = 0.5


class _Count(NamedTuple):
    """Changes that were noticed on one ring: delays [s] of the slowed drivers, false alarms and hours of driving."""

    delays: list[float]
    false_alarms: int
    hours: float


def _answer(asked: Asked) -> Answer:
    """Let the desired speed of every third driver fall by 15 %, and count whether and how soon this is noticed."""
    counts = {ring_m: _count(asked, ring_m) for ring_m in _RINGS_M}
    rows: list[Row] = []
    for ring_m, count in counts.items():
        slowed, soon = len(count.delays), sum(delay <= _SOON_S for delay in count.delays)
        rows.append(
            {
                "ring [m]": ring_m,
                "slowed": slowed,
                "told within 25 s": soon,
                "share": soon / max(slowed, 1),
                "median delay [s]": float(np.median(count.delays)) if slowed else np.nan,
                "false alarms": count.false_alarms,
                "driver-hours": count.hours,
            }
        )

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        for ring_m, count in counts.items():
            of = np.minimum(count.delays, 100.0)
            axes.hist(of, bins=np.arange(0.0, 101.0, 2.5), alpha=0.6, label=f"{ring_m:g} m")
        axes.set(xlabel="time until the change is reported [s]; 100: not at all", ylabel="drivers")
        axes.legend()

    return Answer(tuple(rows), draw)


def _count(asked: Asked, ring_m: float) -> _Count:
    """Count the changes of style that the estimators report in all runs on one ring."""
    delays: list[float] = []
    false_alarms, hours = 0, 0.0
    for unchanged, switched in _pairs(asked, ring_m):
        t = switched.dense
        is_slowed = _slowed(unchanged, switched)
        for i, one in enumerate(asked.work.map(followed, [(t, i) for i in range(CARS)])):
            if is_slowed[i]:
                delays.append(
                    next((s for s, name in one.changes if s >= _SWITCH_S and name == "v_star"), np.inf) - _SWITCH_S
                )
            false_alarms += sum(not _SLOWED[i] or s < _SWITCH_S for s, _ in one.changes)
            hours += (t.duration_s if not _SLOWED[i] else _SWITCH_S) / 3600.0
    return _Count(delays, false_alarms, hours)


def _pairs(asked: Asked, ring_m: float) -> Iterator[tuple[Simulation, Simulation]]:
    """Simulate each run without and with the change, with the same random numbers.

    A run in which cars collide is left out.
    """
    for k in range(asked.runs):
        pairs = []
        for factor in (1.0, _FACTOR):
            change = {"v_star_change": float(np.log(factor)), "kappa_v_change": 1e-9, "time": _SWITCH_S}
            drivers = ROW.with_effects(defaults(CARS))
            drivers[_SLOWED] = switch_on(drivers, "preference_switch", change)[_SLOWED]
            pairs.append(
                run(Ring(drivers, asked.seed + k, jammed=ring_m == _RINGS_M[0], duration_s=200.0, ring_m=ring_m))
            )
        unchanged, switched = pairs
        if not unchanged.collisions and not switched.collisions:
            yield unchanged, switched


def _slowed(unchanged: Simulation, switched: Simulation) -> Mask:
    """Which drivers (N,) the change slows down: a driver in a queue could not have driven faster without the change."""
    period_s = switched.dense.period_s
    after = slice(round(_SWITCH_S / period_s), round((_SWITCH_S + _SOON_S) / period_s))
    loses_speed = np.mean(unchanged.speed[after] - switched.speed[after], axis=0) > _LEAST_LOSS
    return np.asarray(_SLOWED & loses_speed)


STUDY = Study(
    name="style-change",
    question="Does an estimator notice that a driver wants to drive slower?",
    paper="Learning a driver's style in real time is left to later work (outlook).",
    answer=_answer,
    takes=("runs", "seed"),
)
