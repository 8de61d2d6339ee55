"""Checks of a model: does it give what was measured, in every respect that matters to users?

Each check is a number, what recordings that the model simulates give for it, and how probable the difference is by
chance. All checks are judged together, at one false-discovery rate.

References
----------
A. Gelman, X.-L. Meng and H. Stern, Stat. Sinica 6 (1996) 733 (posterior predictive checks). Y. Benjamini and
Y. Hochberg, J. R. Stat. Soc. B 57 (1995) 289.
"""

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.forecast import HORIZONS_S, Forecasts
from sugiyama_ros.diagnosis.table import Entry
from sugiyama_ros.diagnosis.where import Located, locate
from sugiyama_ros.filters.extract import motion_of
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.model import filtered_states
from sugiyama_ros.fit.recording import BLOCK_S, Recorded
from sugiyama_ros.fit.simulated import resample, seeds
from sugiyama_ros.simulation.collective import Collective, collective
from sugiyama_ros.statistics import failing
from sugiyama_ros.trajectories.dense import DenseTracks

# Number of simulations of the whole road: their spread is known to a fifth.
_SIMULATIONS = 12
_COLLECTIVE = {
    "mean_speed": "m/s",
    "least_speed": "m/s",
    "largest_speed": "m/s",
    "wave_speed": "m/s",
    "queue_vehicles": "vehicles",
    "period_s": "s",
}


@dataclass(frozen=True)
class Check:
    """One respect in which a model is compared with what was measured.

    Parameters
    ----------
    name : str
        What is compared.
    value : float
        What was measured, or what the model leaves.
    expected : float
        What the model's own simulations give.
    unit : str
        Unit of both.
    p_value : float
        Probability of such a difference by chance.
    failed : bool
        Whether the check fails, at one false-discovery rate over all checks.
    """

    name: str
    value: float
    expected: float
    unit: str
    p_value: float
    failed: bool = False


def judged(checks: Sequence[Check]) -> tuple[Check, ...]:
    """Return checks with those marked that fail (Benjamini and Hochberg)."""
    known = [one for one in checks if math.isfinite(one.p_value)]
    level = failing([one.p_value for one in known])
    return tuple(replace(one, failed=one.p_value <= level) for one in known)


def checks(
    data: Recorded,
    final: Entry,
    simulated: Sequence[tuple[Recorded, JointFit]],
    own: Sequence[Forecasts],
    seed: int,
    work: ThreadPoolExecutor,
) -> Iterator[Check]:
    """Yield the checks of a model against recordings that it simulates, and forecasts of these by the fits to them."""
    yield from _innovations(data, final, simulated, work)
    yield from _calibration(data, final.forecasts, own)
    if data.trajectories is not None:
        yield from _collective(data, final, seeds(seed, _SIMULATIONS), work)
    yield from _signs(final)


def _innovations(
    data: Recorded, final: Entry, simulated: Sequence[tuple[Recorded, JointFit]], work: ThreadPoolExecutor
) -> Iterator[Check]:
    """Bias, spread and correlation of the innovations."""
    here = locate(data, final.fit.model, final.fit.samples, work)
    there = [locate(one, fitted.model, fitted.samples, work) for one, fitted in simulated]
    for covariate in dict.fromkeys(b.covariate for b in here.bins):
        squares, bins = _squares(here, covariate)
        usual = [_squares(one, covariate) for one in there]
        # the filter's approximations bias innovations even where the model is right
        wider = max(1.0, float(np.mean([s / max(n, 1) for s, n in usual])))
        yield Check(f"bias_over_{covariate}", squares / max(bins, 1), wider, "1", float(chi2.sf(squares / wider, bins)))
    for name, of in (("spread_of_innovations", _spread), ("correlation_of_innovations", _correlation)):
        measured = of(final.fit.samples.innovation_m, final.fit.samples.innovation_var, data)
        if math.isfinite(measured[0]):
            own = [of(fitted.samples.innovation_m, fitted.samples.innovation_var, one) for one, fitted in simulated]
            yield as_simulated(name, measured, own, data.drivers)


def _squares(located: Located, covariate: str) -> tuple[float, int]:
    """Sum of squares of the normalised biases of the bins of a covariate, and their number."""
    bins = [b for b in located.bins if b.covariate == covariate]
    return float(sum(b.samples * b.bias**2 for b in bins)), len(bins)


def _by_driver(values: Array) -> tuple[float, float]:
    """Mean over drivers of the mean of each, (N, T), and its standard error over drivers."""
    known = values[np.isfinite(values).any(axis=1)]
    if not len(known):
        return math.nan, math.inf
    means = np.nanmean(known, axis=1)
    return float(means.mean()), float(means.std(ddof=1) / math.sqrt(len(means))) if len(means) > 1 else math.inf


def _spread(y: Array, variance: Array, data: Recorded) -> tuple[float, float]:
    return _by_driver(np.where(data.scored, np.square(y) / variance, np.nan)[:, :: data.every])


def _correlation(y: Array, variance: Array, data: Recorded) -> tuple[float, float]:
    normal = np.where(data.scored, y / np.sqrt(variance), np.nan)[:, :: data.every]
    return _by_driver(normal[:, 1:] * normal[:, :-1])


def as_simulated(name: str, here: tuple[float, float], there: Sequence[tuple[float, float]], drivers: int) -> Check:
    """Compare a mean over drivers, and its standard error, with those of simulated recordings."""
    (value, error), expected = here, float(np.mean([mean for mean, _ in there]))
    error = math.hypot(error, math.sqrt(sum(e * e for _, e in there)) / len(there))
    return Check(name, value, expected, "1", _two_sided(value - expected, error, drivers))


def _two_sided(difference: float, error: float, count: int) -> float:
    """Probability of a difference with this standard error, which is known from so many drivers."""
    return float(2.0 * student.sf(abs(difference) / max(error, 1e-12), max(count - 1, 1)))


def _calibration(data: Recorded, ours: Forecasts, simulated: Sequence[Forecasts]) -> Iterator[Check]:
    """Whether errors of free runs are as large as the forecasts say, at each horizon."""
    for h, horizon_s in enumerate(HORIZONS_S):
        for name in ("single", "road"):
            runs = getattr(ours, name)
            if runs is not None:
                own = [_by_driver(np.square(getattr(one, name).normal[:, h]).T) for one in simulated]
                here = _by_driver(np.square(runs.normal[:, h]).T)
                yield as_simulated(f"spread_of_{name}_runs_{horizon_s:g}s", here, own, data.drivers)


def _collective(
    data: Recorded, final: Entry, rngs: Sequence[np.random.Generator], work: ThreadPoolExecutor
) -> Iterator[Check]:
    """The traffic on the whole road: speeds, waves and queues of simulations that begin as the recording does.

    The first block of time, in which they have hardly left its course, does not count.
    """
    assert data.trajectories is not None
    settled = partial(collective_of, from_s=BLOCK_S)
    measured = settled(data.trajectories)
    states = filtered_states(data, final.fit.model, work)
    runs = [resample(data, final.fit.model, states, rng).trajectories for rng in rngs]
    found: list[Collective] = list(work.map(settled, [run for run in runs if run is not None]))
    for name, unit in _COLLECTIVE.items():
        values = np.array([getattr(one, name) for one in found])
        known, value = values[np.isfinite(values)], getattr(measured, name)
        if math.isfinite(value) and len(known) > 2:
            error = float(known.std(ddof=1)) * math.sqrt(1.0 + 1.0 / len(known))
            p = _two_sided(value - float(known.mean()), error, len(known))
            yield Check(name, value, float(known.mean()), unit, p)


def _signs(final: Entry) -> Iterator[Check]:
    """Whether what was added has values that make physical sense; by name, only what was asked for has others."""
    for name, (value, least) in final.signs.items():
        yield Check(f"sign_of_{name}", value, least, "1", float(value >= least))


def collective_of(trajectories: DenseTracks, from_s: float = 0.0) -> Collective:
    """Return collective measures of trajectories; the speeds come from a filter without a driver model.

    from_s: Time [s] at the beginning that does not count, at most half of all.
    """
    speed, headway_m, leader, period_s = motion_of(trajectories)
    first = min(round(from_s / period_s), len(speed) // 2)
    return collective(speed[first:], headway_m[first:], leader[first:], period_s)
