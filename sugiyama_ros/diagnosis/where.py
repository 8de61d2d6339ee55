"""Where a model fails: bins of covariates in which innovations have a bias.

If nothing is missing from a model, its innovations do not depend on anything that was known before. In any bin of any
covariate, the mean of the normalised innovations is then a normal variable with a variance of one over their number.
Bins are flagged at a false-discovery rate of 5 % over all bins together (Benjamini and Hochberg 1995).
"""

from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.driver.parameters import RHO
from sugiyama_ros.fit.model import Model, PointwiseDensity, filtered_states
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.surroundings import covariates_of
from sugiyama_ros.statistics import failing

#: Number of bins of a covariate, and smallest number of samples in a bin.
BINS, FEWEST = 10, 30
#: A driver stands below this speed [m/s].
STANDING = 0.5
# A driver accelerates or brakes beyond this acceleration [m/s^2].
_CHANGING = 0.3
_COVARIATES = ("gap", "speed", "approach_rate", "rear_gap", "place", "time")
_REGIMES = ("standing", "braking", "accelerating", "following")


@dataclass(frozen=True)
class Bin:
    """Innovations while a covariate is in [low, high), SI units.

    covariate: Name of the covariate; label: Name of the driver or the regime; empty for other covariates; low,
    high: Ends of the bin; samples: Number of samples in the bin; bias: Mean of the normalised innovations; nis:
    Mean of their squares; 1 for a model that knows its own uncertainty; p_value: Probability of such a bias by
    chance; flagged: Whether the bias counts as a failure, at the false-discovery rate ALPHA.
    """

    covariate: str
    label: str
    low: float
    high: float
    samples: int
    bias: float
    nis: float
    p_value: float
    flagged: bool = False


@dataclass(frozen=True, eq=False)
class Map:
    """Bias over two covariates, in A by B bins; edges in SI units. NaN where there are too few samples."""

    first: str
    second: str
    first_edges: Array
    second_edges: Array
    bias: Array
    flagged: Mask


@dataclass(frozen=True, eq=False)
class Located:
    """All bins of covariates, drivers and regimes, and maps over speed and gap, and over place and time."""

    bins: tuple[Bin, ...]
    maps: tuple[Map, ...]

    @property
    def flagged(self) -> list[Bin]:
        """Bins in which the model fails, the smallest p-value first."""
        return sorted((b for b in self.bins if b.flagged), key=lambda b: b.p_value)


def locate(data: Recorded, model: Model, samples: PointwiseDensity, work: Executor) -> Located:
    """Find where samples differ from what a model predicts."""
    states = filtered_states(data, model, work)
    normal = samples.innovation_m / np.sqrt(samples.innovation_var)
    after = np.where(np.isfinite(samples.log_likelihood), normal, np.nan)[:, 1:]
    covariates = covariates_of(data, states)
    before = {name: covariates[name].T[:, :-1] for name in _COVARIATES}
    bins: list[Bin] = []
    for name, values in before.items():
        edges = _edges(name, values)
        bins += [b for k in range(len(edges) - 1) if (b := _bin(name, "", edges[k], edges[k + 1], values, after))]
    for k, driver in enumerate(data.vicinity.names):
        only = np.where(np.arange(data.drivers)[:, None] == k, 0.5, np.nan) * np.ones_like(after)
        bins += [b for b in (_bin("vehicle", driver.shown, 0.0, 1.0, only, after),) if b]
    regime = _regime(model, states[:, : data.drivers]).T[:, :-1]
    for k, label in enumerate(_REGIMES):
        bins += [b for b in (_bin("regime", label, float(k), k + 1.0, regime, after),) if b]
    maps = (_map("speed", "gap", before, after), _map("place", "time", before, after))
    return Located(tuple(_with_flags(bins)), maps)


def _regime(model: Model, states: Array) -> Array:
    """Number of the regime in _REGIMES plus a half, (T, N); NaN where unknown."""
    acceleration = states[:, :, 3] + model.rows[:, RHO] * states[:, :, 2]
    regime = np.select(
        [states[:, :, 1] < STANDING, acceleration < -_CHANGING, acceleration > _CHANGING], [0.5, 1.5, 2.5], 3.5
    )
    return np.where(np.isfinite(acceleration), regime, np.nan)


def _edges(name: str, values: Array) -> Array:
    known = values[np.isfinite(values)]
    if len(known) < BINS * FEWEST:
        return np.empty(0)
    if name in ("place", "time"):
        return np.linspace(float(known.min()), np.nextafter(float(known.max()), np.inf), BINS + 1)
    edges = np.unique(np.quantile(known, np.linspace(0.0, 1.0, BINS + 1)))
    edges[-1] = np.nextafter(edges[-1], np.inf)
    return np.asarray(edges)


def _bin(name: str, label: str, low: float, high: float, values: Array, after: Array) -> Bin | None:
    chosen = after[(values >= low) & (values < high) & np.isfinite(after)]
    if len(chosen) < FEWEST:
        return None
    bias = float(chosen.mean())
    p_value = 2.0 * float(norm.sf(abs(bias) * np.sqrt(len(chosen))))
    return Bin(
        covariate=name,
        label=label,
        low=float(low),
        high=float(high),
        samples=len(chosen),
        bias=bias,
        nis=float(np.mean(np.square(chosen))),
        p_value=p_value,
    )


def _with_flags(bins: list[Bin]) -> list[Bin]:
    threshold = failing([b.p_value for b in bins])
    return [replace(b, flagged=b.p_value <= threshold) for b in bins]


def _map(first: str, second: str, before: dict[str, Array], after: Array) -> Map:
    edges = [_edges(name, before[name]) for name in (first, second)]
    shape = tuple(max(len(e) - 1, 0) for e in edges)
    bias, flagged = np.full(shape, np.nan), np.zeros(shape, dtype=np.bool_)
    if all(shape):
        known = np.isfinite(before[first]) & np.isfinite(before[second]) & np.isfinite(after)
        pairs = (before[first][known], before[second][known])
        count = np.histogram2d(*pairs, bins=edges)[0]
        total = np.histogram2d(*pairs, bins=edges, weights=after[known])[0]
        full = count >= FEWEST
        bias[full] = total[full] / count[full]
        p_value = 2.0 * norm.sf(np.abs(bias[full]) * np.sqrt(count[full]))
        flagged[full] = p_value <= failing(p_value.tolist())
    return Map(first, second, edges[0], edges[1], bias, flagged)
