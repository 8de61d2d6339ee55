"""Checks of a model: does it give what was measured, in every respect that matters to users?

Each check is a number, what recordings that the model simulates give for it, how probable the difference is by chance,
and the largest difference that does not matter. A check fails if chance rarely gives the difference, judged together
with all other checks at one false-discovery rate, and if it is larger than that.

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

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.diagnosis.forecast import HORIZONS_S, Forecasts
from sugiyama_ros.diagnosis.table import Entry
from sugiyama_ros.diagnosis.where import Located, locate
from sugiyama_ros.filters.extract import motion_of
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.model import filtered_states
from sugiyama_ros.fit.recording import BLOCK_S, Recorded
from sugiyama_ros.fit.simulated import resample, seeds
from sugiyama_ros.simulation.collective import Collective, collective
from sugiyama_ros.statistics import failing, sum_error
from sugiyama_ros.trajectories.dense import DenseTracks

# Number of simulations of the whole road: their spread is known to a fifth.
_SIMULATIONS = 12
# Unit of each, and the difference from which on people see another traffic.
_COLLECTIVE = {
    "mean_speed": ("m/s", 0.5),
    "least_speed": ("m/s", 1.0),
    "largest_speed": ("m/s", 1.0),
    "wave_speed": ("m/s", 1.0),
    "queue_vehicles": ("vehicles", 2.0),
    "period_s": ("s", 5.0),
}
# The same for a bias in standard deviations of one step, for the correlation from one step to the next, and, as part of
# what the model gives, for how large errors are: one step ahead, which many samples say, and after some seconds.
_MARGINS = {"bias": 0.05, "correlation": 0.1, "one_step": 0.1, "runs": 0.25}


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
    margin : float
        Largest difference that does not matter.
    failed : bool
        Whether the check fails: the difference matters, and is more than chance at one false-discovery rate over all
        checks.
    """

    name: str
    value: float
    expected: float
    unit: str
    p_value: float
    margin: float = 0.0
    failed: bool = False

    @property
    def matters(self) -> bool:
        """Whether the difference is larger than the margin."""
        return abs(self.value - self.expected) > self.margin


def judged(checks: Sequence[Check]) -> tuple[Check, ...]:
    """Return checks with those marked that fail (Benjamini and Hochberg)."""
    known = [one for one in checks if math.isfinite(one.p_value)]
    level = failing([one.p_value for one in known])
    return tuple(replace(one, failed=one.p_value <= level and one.matters) for one in known)


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
    yield from _calibration(data, final.forecasts, [(one, of) for (one, _), of in zip(simulated, own, strict=True)])
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
        squares, bins, samples = _squares(here, covariate)
        usual = [_squares(one, covariate) for one in there]
        # the filter's approximations bias innovations even where the model is right
        wider = max(1.0, float(np.mean([s / max(n, 1) for s, n, _ in usual])))
        p = float(chi2.sf(squares / wider, bins))
        value, expected = (math.sqrt(mean / max(samples, 1)) for mean in (squares, wider * bins))
        yield Check(f"bias_over_{covariate}", value, expected, "1", p, _MARGINS["bias"])
    of_squares, of_products = [], []
    for one, fitted in ((data, final.fit), *simulated):
        y, variance = fitted.samples.innovation_m, fitted.samples.innovation_var
        z = np.where(one.scored, y / np.sqrt(variance), np.nan)[:, :: one.every]
        driver, block = np.broadcast_to(np.arange(one.drivers)[:, None], z.shape), one.block[:, :: one.every]
        of_squares.append(_mean(np.square(z), driver, block))
        of_products.append(_mean(z[:, 1:] * z[:, :-1], driver[:, 1:], block[:, 1:]))
    yield _spread("spread_of_innovations", of_squares, _MARGINS["one_step"])
    (value, *_), expected, p = of_products[0], *as_simulated(of_products)
    yield Check("correlation_of_innovations", value, expected, "1", p, _MARGINS["correlation"])


def _squares(located: Located, covariate: str) -> tuple[float, int, int]:
    """Sum of squares of the normalised biases of the bins of a covariate, their number, and that of the samples."""
    bins = [b for b in located.bins if b.covariate == covariate]
    return float(sum(b.samples * b.bias**2 for b in bins)), len(bins), sum(b.samples for b in bins)


def _mean(values: Array, *units: Ints) -> tuple[float, float, int]:
    """Mean of what is known, its standard error by the worst way to divide values into units, and the fewest units."""
    known = np.isfinite(values)
    mean = float(values[known].mean()) if known.any() else math.nan
    parts = [np.bincount(np.unique(unit[known], return_inverse=True)[1], values[known] - mean) for unit in units]
    fewest = min(map(len, parts))
    return mean, max(map(sum_error, parts)) / known.sum() if fewest > 1 else math.inf, fewest


def as_simulated(means: Sequence[tuple[float, float, int]]) -> tuple[float, float]:
    """What simulated recordings give for a mean, and how probable the difference is; means: the measured one first."""
    (value, error, units), *own = means
    expected = float(np.mean([mean for mean, *_ in own]))
    error = math.hypot(error, math.sqrt(sum(e * e for _, e, _ in own)) / len(own))
    return expected, _two_sided(value - expected, error, units)


def _spread(name: str, means: Sequence[tuple[float, float, int]], part: float) -> Check:
    """A check of how large errors are, over what is predicted, from means of their squares."""
    (value, *_), expected, p = means[0], *as_simulated(means)
    value, expected = math.sqrt(value), math.sqrt(expected)
    return Check(name, value, expected, "1", p, part * expected)


def _two_sided(difference: float, error: float, count: int) -> float:
    """Probability of a difference with this standard error, which is known from so many units."""
    return float(2.0 * student.sf(abs(difference) / max(error, 1e-12), max(count - 1, 1)))


def _calibration(data: Recorded, ours: Forecasts, simulated: Sequence[tuple[Recorded, Forecasts]]) -> Iterator[Check]:
    """Whether errors of free runs are as large as the forecasts say, at each horizon."""
    every = [(data, ours), *simulated]
    for h, horizon_s in enumerate(HORIZONS_S):
        for name in ("single", "road"):
            if getattr(ours, name) is None:
                continue
            means = []
            for one, of in every:
                squares, block = np.square(getattr(of, name).normal[:, h]), one.block.T[of.start]
                driver = np.broadcast_to(np.arange(one.drivers), block.shape)
                # the cars of one road are not independent of one another
                means.append(_mean(squares, *((block,) if name == "road" else (block, driver))))
            if math.isfinite(means[0][0]):
                yield _spread(f"spread_of_{name}_runs_{horizon_s:g}s", means, _MARGINS["runs"])


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
    for name, (unit, margin) in _COLLECTIVE.items():
        values = np.array([getattr(one, name) for one in found])
        known, value = values[np.isfinite(values)], getattr(measured, name)
        if math.isfinite(value) and len(known) > 2:
            error = float(known.std(ddof=1)) * math.sqrt(1.0 + 1.0 / len(known))
            p = _two_sided(value - float(known.mean()), error, len(known))
            yield Check(name, value, float(known.mean()), unit, p, margin)


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
