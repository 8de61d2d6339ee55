"""The table of models: forecasts on the same held-out samples, as gains over the base model with standard errors.

References
----------
A. Vehtari, A. Gelman and J. Gabry, Stat. Comput. 27 (2017) 1413. C. Varin, N. Reid and D. Firth, Stat. Sinica 21 (2011)
5 (composite likelihood).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.diagnosis.forecast import HORIZONS_S, Forecasts
from sugiyama_ros.effects.registry import EFFECTS
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.model import Model, PointwiseDensity
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.results import CLEARLY
from sugiyama_ros.statistics import sum_error


@dataclass(frozen=True)
class Difference:
    """How much better one model forecasts than another, as a sum, and its standard error.

    nats: Difference of the log scores [nats], or of another score; se: by a jackknife over the blocks of time of each
    driver; of whole roads, whose drivers depend on one another, over blocks of time.
    """

    nats: float
    se: float

    @property
    def is_clear(self) -> bool:
        """Whether the gain is above two standard errors."""
        return self.nats > CLEARLY * self.se

    def is_loss(self, among: int) -> bool:
        """Whether the gain is less than chance lets the smallest one ``among`` several columns be.

        As improbable as two standard errors of a single one (Bonferroni).
        """
        return self.nats < -float(norm.isf(norm.sf(CLEARLY) / among)) * self.se


@dataclass(frozen=True, eq=False)
class Entry:
    """A fitted model in the table.

    name: Name of the model; added: What it has beyond the base model; fit: The fit to all samples; models: The fits
    without each fold; forecasts: Held-out forecasts.
    """

    name: str
    added: tuple[Candidate, ...]
    fit: JointFit
    models: tuple[Model, ...]
    forecasts: Forecasts

    def over(self, data: Recorded, other: "Entry") -> dict[str, Difference]:
        """Gain over another model, as of ``gains``."""
        new = [one for one in self.added if one not in other.added]
        once = bool(new) and all(one.is_single_event for one in new)
        rare = bool(new) and all(one.judged_by == "one_step" for one in new)
        return gains(data, self.forecasts, other.forecasts, once=once, rare=rare)

    def is_better(self, data: Recorded, than: "Entry") -> bool:
        """Whether it is better than another model by more than two standard errors over all horizons together.

        And at no horizon worse than by chance, in nats, in CRPS, or in metres; after 10 s, which people watch, neither
        in CRPS nor in metres by more than one standard error.
        """
        gain = self.over(data, than)
        metres = dict(_in_metres(data, self.forecasts, than.forecasts))
        columns = [*gain.values(), *metres.values()]
        watched = (one for name, one in metres.items() if name.endswith(f"_{HORIZONS_S[-1]:g}s"))
        is_worse = any(one.is_loss(len(columns)) for one in columns) or any(one.nats < -one.se for one in watched)
        return gain["all"].is_clear and not is_worse

    @property
    def signs(self) -> dict[str, tuple[float, float]]:
        """Values of what was added that have a smallest value which makes physical sense, and this value, by name."""
        found: dict[str, tuple[float, float]] = {}
        for one in self.added:
            rows = self.fit.model.rows[list(one.drivers) or slice(None)]
            limits = EFFECTS[one.effect].least if one.effect in EFFECTS else {}
            for place, name in zip(one.places, one.parameters, strict=True):
                if name in limits:
                    found[f"{one.name}.{name}"] = float(np.median(rows[:, place])), limits[name]
        return found

    @property
    def makes_sense(self) -> bool:
        """Whether all values of what was added make physical sense."""
        return all(value >= least for value, least in self.signs.values())


def gains(
    data: Recorded, better: Forecasts, than: Forecasts, *, once: bool = False, rare: bool = False
) -> dict[str, Difference]:
    """Return the gain of one model over another at each horizon, and over all of them together.

    Columns: ``one_step``; ``1s``, ``2s``, ``5s``, ``10s`` of single cars; ``road_1s`` and so on of all cars of a whole
    road; ``all``, the sum of all but those of the road, in which each column counts as much as the last one: as if
    there were as many forecasts one step ahead as there are over 10 s.

    rare: whether the models differ by what few drivers do at few moments, a push or a decision at a line. Few forecasts
    over seconds show it, but the likelihood of all samples does: ``all`` is then as clear as ``one_step``; once:
    whether it happens once. Blocks of time then tell nothing of its error, and the standard error is that of the
    logarithm of a likelihood ratio, which is normal with a variance of twice its mean if the better model is right.
    """
    parts = list(_differences(data, better, than, "log_score"))
    single = [part for part in parts if not part.name.startswith("road")]
    last = next((part.forecasts for part in reversed(single) if part.forecasts > 0.0), 1.0)
    evenly = [part.won * (last / max(part.forecasts, 1.0)) for part in single]
    driver, block = (np.concatenate([part[k] for part in single]) for k in (1, 2))
    found = {c.name: _gain(data, c) for c in [*parts, Horizon("all", driver, block, np.concatenate(evenly), math.nan)]}
    if once:
        found = {name: replace(won, se=math.sqrt(2.0 * abs(won.nats))) for name, won in found.items()}
    if rare:
        ratio = found["one_step"].se / max(found["one_step"].nats, 1e-9)
        found["all"] = replace(found["all"], se=ratio * abs(found["all"].nats))
    return found


def _in_metres(data: Recorded, better: Forecasts, than: Forecasts) -> Iterator[tuple[str, Difference]]:
    """Differences of CRPS [m] and of squared errors [m^2] at each horizon, of one car and of all, by name."""
    for score in ("crps", "error"):
        for c in _differences(data, better, than, score):
            if c.name != "one_step":
                yield f"{score}_{c.name}", _gain(data, c)


def paired(data: Recorded, better: PointwiseDensity, than: PointwiseDensity) -> Difference:
    """Return the gain of one model over another one step ahead; the larger error over drivers and over blocks."""
    difference = better.log_likelihood - than.log_likelihood
    known = np.isfinite(difference)
    # who follows nobody is not predicted, and tells nothing of how drivers differ
    by_driver = np.nansum(difference[known.any(axis=1)], axis=1)
    # nor do blocks in which nothing is predicted
    where, block = np.unique(data.block[known], return_inverse=True)
    by_block = np.bincount(block, weights=difference[known], minlength=len(where))
    return Difference(float(by_driver.sum()), max(sum_error(by_driver), sum_error(by_block)))


def errors(of: Forecasts) -> dict[str, float]:
    """Return the held-out errors of a model.

    Names: ``one_step_rmse_m``; ``loglik_per_sample`` [nats]; ``free_run_10s_m`` and ``free_run_10s_crps_m`` of all cars
    of a whole road, and ``single_car_10s_m`` and ``single_car_10s_crps_m``, for each horizon; NaN where there is none.
    """
    known = np.isfinite(of.one_step)
    found = {
        "one_step_rmse_m": _rms(of.innovation_m[known]),
        "loglik_per_sample": float(of.one_step[known].mean()) if known.any() else math.nan,
    }
    for name, runs in (("free_run", of.road), ("single_car", of.single)):
        for h, horizon_s in enumerate(HORIZONS_S):
            found[f"{name}_{horizon_s:g}s_m"] = _rms(runs.error[:, h]) if runs else math.nan
            found[f"{name}_{horizon_s:g}s_crps_m"] = _mean(runs.crps[:, h]) if runs else math.nan
    return found


def _mean(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else math.nan


def _rms(values: Array) -> float:
    return math.sqrt(_mean(np.square(values)))


class Horizon(NamedTuple):
    """One column: its name; driver, block and gain of each forecast; and how many forecasts do not overlap."""

    name: str
    driver: Ints
    block: Ints
    won: Array
    forecasts: float


def _differences(data: Recorded, better: Forecasts, than: Forecasts, score: str) -> Iterator[Horizon]:
    """Each column of a score: of ``log_score``, or how much less ``crps`` and the square of ``error`` are."""
    difference = better.one_step - than.one_step
    driver, t = np.nonzero(np.isfinite(difference))
    yield Horizon("one_step", driver, data.block[driver, t], difference[driver, t], float(len(t)))
    start, period_s = better.start, data.vicinity.period_s
    apart_s = float(np.median(np.diff(start))) * period_s if len(start) > 1 else HORIZONS_S[-1]
    for prefix, ours, theirs in (("", better.single, than.single), ("road_", better.road, than.road)):
        if ours is None or theirs is None:
            continue
        for h, horizon_s in enumerate(HORIZONS_S):
            new, old = (getattr(runs, score)[:, h] for runs in (ours, theirs))
            if score == "error":
                new, old = np.square(new), np.square(old)
            won = new - old if score == "log_score" else old - new
            s, driver = np.nonzero(np.isfinite(won))
            share = min(apart_s / horizon_s, 1.0)
            block = data.block[driver, start[s]]
            yield Horizon(f"{prefix}{horizon_s:g}s", driver, block, share * won[s, driver], share * len(s))


def _gain(data: Recorded, column: Horizon) -> Difference:
    """The sum, with its error over blocks: of the time of each driver, or of a whole road."""
    is_road = column.name.startswith("road")
    unit = column.block if is_road else column.driver * (int(data.block.max()) + 1) + column.block
    error = sum_error(np.bincount(np.unique(unit, return_inverse=True)[1], column.won))
    return Difference(float(column.won.sum()), error)
