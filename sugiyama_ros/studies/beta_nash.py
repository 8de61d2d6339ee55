"""Two lanes become one: does bargaining (betaNash) change who goes first?

Random states, a few seconds before a barrier: each of the drivers of the blocked lane is 5 to 30 m from the merge
point, and those of the open lane are abreast or up to 12 m ahead or behind, at 4 to 10 m/s. Their desired speeds and
risk premiums differ by 10 %. From each state the drivers drive on without noise, and decide anew in each period, until
all have passed the merge point.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import KAPPA_V, REFERENCE_PERIOD_S, V_STAR, defaults
from sugiyama_ros.driver.utility import advance
from sugiyama_ros.simulation.best_response import (
    TOLERANCE,
    Equilibrium,
    Merge,
    chosen,
    distinct,
    equilibria,
    keep_speed,
)
from sugiyama_ros.studies.rings import LENGTH_M
from sugiyama_ros.studies.study import Answer, Asked, Row, Study

# Random states of a case in one run, and periods after which drivers who have not passed are stuck.
_STATES, _LONGEST = 100, 90
# Distance [m] between vehicles on a lane in a random state.
_APART_M = 15.0


class _Passing(NamedTuple):
    """How drivers pass the merge point.

    order: drivers, the last one first; is_contact: whether two of them touch behind the merge point; has_passed:
    whether all have passed.
    """

    order: tuple[int, ...]
    is_contact: bool
    has_passed: bool


def random_merge(drivers: int, rng: np.random.Generator) -> Merge:
    """Draw a state: half of the drivers on the open lane, the other half on the blocked lane."""
    parameters = defaults(drivers)
    parameters[:, [V_STAR, KAPPA_V]] *= np.exp(0.1 * rng.standard_normal((drivers, 2)))
    each = drivers // 2
    behind = -_APART_M * np.arange(each)
    blocked = behind - rng.uniform(5.0, 30.0)
    place = np.concatenate((blocked + rng.uniform(-12.0, 12.0), blocked))
    lane = np.repeat([0, 1], each)
    return Merge(place, rng.uniform(4.0, 10.0, drivers), np.full(drivers, LENGTH_M), lane, parameters)


def pass_merge(merge: Merge, decide: Callable[[Merge], Array]) -> _Passing:
    """Let drivers drive on and decide anew in each period, until all have passed the merge point."""
    is_contact = False
    for _ in range(_LONGEST):
        place, speed = advance(merge.position_m, merge.speed, decide(merge), REFERENCE_PERIOD_S)
        # who has passed the merge point is on the open lane
        lane = np.where(place >= 0.0, 0, merge.is_blocked)
        merge = merge._replace(position_m=place, speed=np.maximum(speed, 0.0), is_blocked=lane)
        behind = np.sort(place[place >= 0.0])
        is_contact = is_contact or bool(np.any(np.diff(behind) < LENGTH_M))
        if np.all(place >= 0.0):
            break
    return _Passing(tuple(np.argsort(place).tolist()), is_contact, bool(np.all(place >= 0.0)))


def _bargain(merge: Merge) -> Array:
    """Return the actions (N,) [m/s^2] of betaNash."""
    return chosen(equilibria(merge)).actions


def _share(true: list[bool]) -> tuple[float, float]:
    """Return a share and its standard error."""
    share = float(np.mean(true))
    return share, float(np.sqrt(share * (1.0 - share) / len(true)))


def _case(drivers: int, merges: list[Merge]) -> tuple[Row, list[int]]:
    """Return the row of a case, and the number of equilibria of each state."""
    found: list[tuple[Equilibrium, ...]] = [equilibria(merge) for merge in merges]
    seek, nash = ([pass_merge(merge, how) for merge in merges] for how in (keep_speed, _bargain))
    numbers = [distinct(one) for one in found]
    agrees, error = _share([a.order == b.order for a, b in zip(seek, nash, strict=True)])
    off = [chosen(one).actions - keep_speed(merge) for merge, one in zip(merges, found, strict=True)]
    row: Row = {
        "drivers": drivers,
        "states": len(merges),
        "equilibrium from rest": _share([one[0].residual <= TOLERANCE for one in found])[0],
        "cycle from rest": _share([one[0].is_cycle for one in found])[0],
        "equilibrium from any start": _share([number > 0 for number in numbers])[0],
        "several equilibria": _share([number > 1 for number in numbers])[0],
        "same order": agrees,
        "same order error": error,
        "rms difference [m/s^2]": float(np.sqrt(np.mean(np.square(off)))),
        "rounds from rest": float(np.mean([one[0].rounds for one in found])),
        "contacts, adaptiveSeek": _share([one.is_contact for one in seek])[0],
        "contacts, betaNash": _share([one.is_contact for one in nash])[0],
        "stuck": sum(not one.has_passed for one in (*seek, *nash)),
    }
    return row, numbers


def _answer(asked: Asked) -> Answer:
    """Compare betaNash with adaptiveSeek for two and for four drivers, in 100 random states for each run."""
    rng = np.random.default_rng(asked.seed)
    merges = {drivers: [random_merge(drivers, rng) for _ in range(_STATES * asked.runs)] for drivers in (2, 4)}
    rows, numbers = {}, {}
    for drivers, states in merges.items():
        rows[drivers], numbers[drivers] = _case(drivers, states)

    def draw(figure: Any) -> None:
        axes, pairs = figure.subplots(), merges[2]
        lead = np.array([merge.position_m[0] - merge.position_m[1] for merge in pairs])
        faster = np.array([merge.speed[0] - merge.speed[1] for merge in pairs])
        for count, colour in ((1, "C0"), (2, "C1")):
            some = np.array(numbers[2]) == count
            axes.plot(lead[some], faster[some], ".", color=colour, label=f"equilibria: {count}")
        axes.set(
            xlabel="lead of the driver on the open lane [m]", ylabel="speed on the open minus the blocked lane [m/s]"
        )
        axes.legend()

    return Answer(tuple(rows.values()), draw)


STUDY = Study(
    name="beta-nash",
    question="Does it change who goes first at a barrier that drivers bargain?",
    paper=(
        "adaptiveSeek approximates the Nash equilibrium of betaNash well in simplified settings, and costs less"
        " (section 3.1)."
    ),
    answer=_answer,
    takes=("runs", "seed"),
)
