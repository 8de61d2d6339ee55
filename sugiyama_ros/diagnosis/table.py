"""The table of models: forecasts on the same held-out samples, as gains over the base model with standard errors.

References
----------
A. Vehtari, A. Gelman and J. Gabry, Stat. Comput. 27 (2017) 1413. C. Varin, N. Reid and D. Firth, Stat. Sinica 21 (2011)
5 (composite likelihood).
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

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
    """How much more one model forecasts than another: a sum over blocks of time and drivers.

    nats: Difference of the log scores [nats]; se: Standard error: a jackknife over the blocks of time of each driver;
    of whole roads, whose drivers depend on one another, over blocks of time.
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
        return gains(data, self.forecasts, other.forecasts, once=bool(new) and all(one.is_single_event for one in new))

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


def gains(data: Recorded, better: Forecasts, than: Forecasts, *, once: bool = False) -> dict[str, Difference]:
    """Return the gain of one model over another at each horizon, and over all of them together.

    Columns: ``one_step``; ``1s``, ``2s``, ``5s``, ``10s`` of single cars; ``road_1s`` and so on of all cars of a whole
    road; ``all``, the sum of all but those of the road.

    once: whether the models differ by something that happens once. Blocks of time then tell nothing of its error, and
    the standard error is that of the logarithm of a likelihood ratio, which is normal with a variance of twice its mean
    if the better model is right. All columns see the same event, so that their errors add.
    """
    parts = list(_differences(data, better, than))
    single = [part for part in parts if not part[0].startswith("road")]
    driver, block, nats = (np.concatenate(column) for column in list(zip(*single, strict=True))[1:])
    if once:
        won = {name: float(own.sum()) for name, _, _, own in parts}
        error = {name: math.sqrt(2.0 * abs(own)) for name, own in won.items()}
        won["all"], error["all"] = float(nats.sum()), sum(error[name] for name, *_ in single)
        return {name: Difference(own, error[name]) for name, own in won.items()}
    columns = (*parts, ("all", driver, block, nats))
    blocks = int(data.block.max()) + 1
    return {
        name: _gain(when if name.startswith("road") else who * blocks + when, won) for name, who, when, won in columns
    }


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


def is_better(gain: Mapping[str, Difference]) -> bool:
    """Whether a model is better by more than two standard errors on the whole, and in no column worse but by chance."""
    return gain["all"].is_clear and not any(one.is_loss(len(gain)) for one in gain.values())


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


def _differences(data: Recorded, better: Forecasts, than: Forecasts) -> Iterator[tuple[str, Ints, Ints, Array]]:
    """Each column: its name, and driver, block and difference of the log scores [nats] of each forecast."""
    difference = better.one_step - than.one_step
    driver, t = np.nonzero(np.isfinite(difference))
    yield "one_step", driver, data.block[driver, t], difference[driver, t]
    start, period_s = better.start, data.vicinity.period_s
    apart_s = float(np.median(np.diff(start))) * period_s if len(start) > 1 else HORIZONS_S[-1]
    for prefix, ours, theirs in (("", better.single, than.single), ("road_", better.road, than.road)):
        if ours is None or theirs is None:
            continue
        for h, horizon_s in enumerate(HORIZONS_S):
            difference = ours.log_score[:, h] - theirs.log_score[:, h]
            s, driver = np.nonzero(np.isfinite(difference))
            share = min(apart_s / horizon_s, 1.0)
            yield f"{prefix}{horizon_s:g}s", driver, data.block[driver, start[s]], share * difference[s, driver]


def _gain(unit: Ints, nats: Array) -> Difference:
    """The sum, with its error over units."""
    return Difference(float(nats.sum()), sum_error(np.bincount(np.unique(unit, return_inverse=True)[1], nats)))
