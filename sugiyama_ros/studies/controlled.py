"""What controlled cars do against the jam: how many, by which controller, at which speed; in pairs with nobody."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import t as student

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.controllers.controller import Controlled
from sugiyama_ros.controllers.registry import controlled_by
from sugiyama_ros.driver.parameters import SIGMA_V, SIGMA_X, defaults
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.simulation.experiment import spread_out
from sugiyama_ros.studies.rings import CARS, Outcome, Ring, estimated, mean, outcome, ring_of
from sugiyama_ros.studies.study import Answer, Asked, Study

# Controlled cars, evenly spread over the ring.
_CARS = (1, 2, 4)
# Controllers with their values, each from the lowest value to the highest one.
_TARGETS = (5.0, 6.0, 7.0, 8.0, 9.0, 10.0)
_CONTROLLERS = {
    **{name: [f"target={v:g}" for v in _TARGETS] for name in ("constant_speed", "follower_stopper")},
    **{name: [f"catch_up={v:g}" for v in (0.5, 1.0, 2.0)] for name in ("mean_speed", "pi_saturation")},
}
# Drivers without a recording: relative standard deviation of v_star and kappa_v. With twice as much, a slow driver
# among 22 often takes the jam away. Speed [m/s] from which on the noise of the acceleration is whole (a footnote of the
# paper's section 6), and factor of this noise of estimated drivers (section 6); there is no other noise in the paper.
_SPREAD, _FULL_NOISE_AT, _FACTOR = 0.05, 5.0, 0.5
# Runs are drawn anew so often.
_DRAWS = 2000
# What is counted for each run, and how a difference is called that is surely above 0, or below.
_FLOW, _STD, _KINETIC = range(3)
_CALLED = {_FLOW: ("more flow", "less flow"), _STD: ("rougher", "smoother")}


@dataclass(frozen=True)
class _Setting:
    """Controlled cars: their number, and the controller as ``NAME:KEY=VALUE``; nobody without cars."""

    cars: int = 0
    controller: str = ""

    @property
    def name(self) -> str:
        """Name in the table."""
        return f"{self.cars} {self.controller}" if self.cars else "nobody"

    def of(self, vehicles: int) -> Controlled | None:
        """The controlled vehicles among some, evenly spread."""
        if self.cars == 0:
            return None
        return controlled_by([k * vehicles // self.cars for k in range(self.cars)], self.controller)


def _settings() -> list[_Setting]:
    """Nobody, and all settings."""
    texts = [f"{name}:{value}" for name, values in _CONTROLLERS.items() for value in values]
    return [_Setting(), *(_Setting(cars, text) for cars in _CARS for text in texts)]


def _different(drivers: Array, seed: int) -> Array:
    """Return drivers (N, width) who differ from each other, the same for all settings with a seed."""
    rows = drivers.copy()
    spread_out(rows, _SPREAD, np.random.default_rng([seed, 1]))
    return rows


def difference(against: Array) -> tuple[float, float]:
    """Mean of paired differences (R,), and half of its 95 % interval by Student's t; NaN for one run."""
    known = against[np.isfinite(against)]
    if len(known) < 2:
        return mean(known), float("nan")
    return float(known.mean()), float(student.ppf(0.975, len(known) - 1) * known.std(ddof=1) / np.sqrt(len(known)))


def pareto(flow: Array, std: Array, cars: Ints) -> Mask:
    """Settings (..., S) with flow and spread that no other one with as many cars (S,), and not nobody, improves on.

    To improve on a setting is to have as much flow and as small a spread, and more of one or less of the other.
    """
    flow, std = np.nan_to_num(flow, nan=-np.inf), np.nan_to_num(std, nan=np.inf)
    as_good = (flow[..., None, :] >= flow[..., :, None]) & (std[..., None, :] <= std[..., :, None])
    better = (flow[..., None, :] > flow[..., :, None]) | (std[..., None, :] < std[..., :, None])
    comparable = (cars[:, None] == cars) | (cars[:, None] == 0) | (cars == 0)
    return np.asarray(~(as_good & better & comparable).any(axis=-1))


def _measures(found: list[Outcome]) -> Array:
    """Flow [1/h], spread of speeds [m/s] and positive kinetic energy [m/s^2] of runs, (R, 3); NaN after a collision."""
    values = np.array([(o.flow_per_h, o.speed_std, o.kinetic) for o in found])
    values[[o.collided for o in found]] = np.nan
    return values


def _shares(measures: Array, cars: Ints, seed: int) -> Array:
    """Share of draws of the runs in which each setting is in the Pareto set, (S,); measures: (S, R, 3)."""
    runs = measures.shape[1]
    drawn = np.random.default_rng(seed).integers(runs, size=(_DRAWS, runs))
    known = np.isfinite(measures[..., 0])
    count = known[:, drawn].sum(axis=2)
    flow, std = (
        np.where(count > 0, np.where(known, measures[..., k], 0.0)[:, drawn].sum(axis=2) / np.maximum(count, 1), np.nan)
        for k in (_FLOW, _STD)
    )
    return np.asarray(pareto(flow.T, std.T, cars).mean(axis=0))


def _called(against: Array) -> str:
    """What is surely different from nobody controlled; against: (R, 3)."""
    words = []
    for k, (above, below) in _CALLED.items():
        middle, half = difference(against[:, k])
        words += [above if middle > half else below] * (abs(middle) > half)
    return " and ".join(words) or "no difference"


def _drivers(asked: Asked) -> tuple[list[Array], partial[Ring]]:
    """Rows (N, width) of the drivers of each run, measured ones if there are any, and what makes a run with them."""
    seeds = range(asked.seed, asked.seed + asked.runs)
    if asked.trajectories is not None:
        rows, ring = [estimated(asked, _FACTOR, _FULL_NOISE_AT)] * asked.runs, ring_of(asked.measured)
    else:
        alike = switch_on(
            ROW.with_effects(defaults(CARS)), "speed_dependent_noise_fading", {"full_speed": _FULL_NOISE_AT}
        )
        rows, ring = [_different(alike, seed) for seed in seeds], partial(Ring)
    for one in rows:
        one[:, [SIGMA_X, SIGMA_V]] = 0.0
    return rows, partial(ring, jammed=True)


def _answer(asked: Asked) -> Answer:
    """Let cars be controlled on a ring, out of a jam, with drivers whose noise fades at low speed."""
    (rows, ring), every = _drivers(asked), _settings()
    vehicles = len(rows[0])
    every = [one for one in every if one.cars <= vehicles]
    jobs = [
        ring(drivers, asked.seed + k, controlled=one.of(vehicles)) for one in every for k, drivers in enumerate(rows)
    ]
    found = np.array(list(asked.work.map(outcome, jobs)), dtype=object).reshape(len(every), asked.runs)
    measures = np.array([_measures(list(runs)) for runs in found])
    cars = np.array([one.cars for one in every])
    shares = _shares(measures, cars, asked.seed)
    middle = np.array([[mean(runs[:, k]) for k in range(3)] for runs in measures])
    best = pareto(middle[:, _FLOW], middle[:, _STD], cars)
    table = []
    for k, (one, runs) in enumerate(zip(every, found, strict=True)):
        against = measures[k] - measures[0]
        (flow, flow_half), (std, std_half) = (difference(against[:, m]) for m in (_FLOW, _STD))
        table.append(
            {
                "case": one.name,
                "flow [1/h]": middle[k, _FLOW],
                "more": flow,
                "± more": flow_half,
                "std of speeds [m/s]": middle[k, _STD],
                "change": std,
                "± change": std_half,
                "range [m/s]": mean([o.road.largest_speed - o.road.least_speed for o in runs if not o.collided]),
                "PKE [m/s²]": middle[k, _KINETIC],
                "waves": sum(o.wave for o in runs),
                "collided": sum(o.collided for o in runs),
                "by controlled cars": sum(o.by_controlled for o in runs),
                "against nobody": _called(against) if one.cars else "",
                "Pareto": "yes" if best[k] else "",
                "in draws": float(shares[k]),
            }
        )
    return Answer(tuple(table), partial(_draw, every, measures, best))


def _draw(every: list[_Setting], measures: Array, best: Mask, figure: Any) -> None:
    """Draw flow over spread, a panel for each number of cars, with intervals of the differences to nobody."""
    panels, names = figure.subplots(1, len(_CARS), sharex=True, sharey=True), list(_CONTROLLERS)
    for axes, cars in zip(panels, _CARS, strict=True):
        labelled = set()
        for one, runs, is_best in zip(every, measures, best, strict=True):
            if one.cars not in (0, cars):
                continue
            name, _, value = one.controller.partition(":")
            x, y = mean(runs[:, _STD]), mean(runs[:, _FLOW])
            dx, dy = (np.nan_to_num(difference(runs[:, k] - measures[0, :, k])[1]) for k in (_STD, _FLOW))
            look = {"fmt": "osD^"[names.index(name)], "color": f"C{names.index(name)}"} if name else {"fmt": "k*"}
            label = None if name in labelled else name.replace("_", " ") or "nobody"
            edge = {"markeredgecolor": "black", "markeredgewidth": 1.5, "markersize": 9} if is_best else {}
            axes.errorbar(x, y, dy, dx, **look, **edge, elinewidth=0.8, label=label)
            axes.annotate(value.partition("=")[2], (x, y), (5, 5), textcoords="offset points", fontsize=7)
            labelled.add(name)
        axes.set(xlabel="std of speeds over cars and time [m/s]", title=f"{cars} controlled")
    panels[0].set_ylabel("flow [1/h]")
    panels[0].legend(fontsize="small", loc="lower right", title="large, black edge: Pareto set")


STUDY = Study(
    name="controlled",
    question="How much do a few controlled cars help against the jam, and where does the benefit end?",
    paper="Controlled desired speeds can make flow and smoothness better together; how is left to Shen 2020"
    " (section 6.2.2).",
    answer=_answer,
)
