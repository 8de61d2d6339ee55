"""Shared parameters whose likelihood is a staircase: the profile over a wide range, smoothed by a parabola.

At a line a driver stops or goes on. Each such decision is a step of the likelihood, so derivatives say nothing of a
maximum that is some steps away, and each driver's own parameters have several maxima. The profile is therefore
computed at values that are far apart, at each of them with the best parameters of each driver that two starts find, and
a parabola is fitted to it by least squares. Its vertex is the estimate. The standard error is the larger one of two:
that of the parabola, with the roughness of the profile, and that of the jackknife, which leaves out one driver after
the other.

References
----------
E. L. Ionides et al., Monte Carlo profile confidence intervals for dynamic systems, J. R. Soc. Interface 14 (2017)
20170126. B. Efron and C. Stein, The jackknife estimate of variance, Annals of Statistics 9 (1981) 586.
"""

import math
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.joint import JointFit, at_model, best_of_each, fit, renewed
from sugiyama_ros.fit.law import start_of_drivers
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.laws.registry import name_of

# Logarithms of the values of a profile, over the value that a search has found.
_STEPS: Array = np.linspace(-0.6, 0.6, 13, dtype=np.float64)
# Differences from the best value, as part of it, up to which the parabola is fitted: farther away the steps end, and
# the profile is flat. The next one counts where there is no maximum.
_NEAR = (0.25, 0.5, math.inf)
# Number of values at an end of a profile that it does not tell enough of, and how much farther it goes then.
_END, _SPAN = 4, 0.4
# Fewest values that say something of the roughness: a parabola has three coefficients.
_FEWEST = 5


def profiled(data: Recorded, fitted: JointFit, place: int, work: Executor) -> JointFit:
    """Return a fit with a shared parameter at the vertex of its profile, and with its standard error.

    place: its place in the rows. A fit that holds the parameter, or in which it is 0, is returned as it is; so is a fit
    whose profile has no maximum, with a standard error as wide as the profile.
    """
    model = fitted.model
    found = float(np.abs(model.rows[:, place]).max())
    if found == 0.0 or model.held:
        return fitted
    name = ROW.entries[place]
    there = _profile(data, model, place, found, work)
    sizes = np.array(sorted(there), dtype=np.float64)
    profile = np.array([there[size].objectives() for size in sizes.tolist()])
    at, std = estimate(sizes, profile) if len(sizes) >= _FEWEST else (0.0, math.inf)
    if not std < math.inf:
        return replace(fitted, stds={**fitted.stds, name: float(np.ptp(sizes))})
    nearest = there[float(sizes[int(np.argmin(np.abs(sizes - at)))])].model.rows
    last = _alone(data, _with(model, nearest, place, at), work)
    moved = replace(model, rows=last.model.rows, ahead=last.model.rows)
    here = renewed(data, at_model(data, fitted, moved, work), work)
    return replace(here, stds={**fitted.stds, name: std})


def estimate(sizes: Array, profile: Array) -> tuple[float, float]:
    """Return the estimate of a parameter and its standard error from a profile.

    sizes: (K,), ascending values; profile: (K, N), log posterior of each driver at each of them [nats]. The error is
    infinite where the profile has no maximum.
    """
    total = profile.sum(axis=1)
    best = sizes[_best(total)]
    x = sizes / best - 1.0
    for near in _NEAR:
        some = np.abs(x) < near
        vertex, std = parabola(x[some], total[some]) if some.sum() >= _FEWEST else (0.0, math.inf)
        if std < math.inf:
            break
    else:
        return float(best), math.inf
    without = [parabola(x[some], (total - own)[some])[0] for own in profile.T]
    vertex = float(np.clip(vertex, x[some][0], x[some][-1]))
    return float(best * (1.0 + vertex)), float(min(best * max(std, _jackknife(np.array(without))), np.ptp(sizes)))


def parabola(x: Array, y: Array) -> tuple[float, float]:
    """Return the vertex of the least-squares parabola through a log-likelihood, and its standard error.

    The error has two parts: of the log-likelihood, and of its roughness. Without a maximum the error is infinite.
    """
    columns = np.stack([-np.square(x), x, np.ones_like(x)], axis=1)
    a, b, _ = coefficients = np.linalg.lstsq(columns, y, rcond=None)[0]
    if a <= 0.0:
        return 0.0, math.inf
    roughness = float(np.square(y - columns @ coefficients).sum()) / (len(x) - 3)
    c = roughness * np.linalg.inv(columns.T @ columns)
    slope = np.array([-b / a, 1.0]) / (2.0 * a)
    return b / (2.0 * a), math.sqrt(1.0 / (2.0 * a) + float(slope @ c[:2, :2] @ slope))


def _jackknife(without: Array) -> float:
    """Standard error of an estimate from the estimates without each driver."""
    count = len(without)
    return math.sqrt((count - 1) / count * float(np.square(without - without.mean()).sum()))


def _best(total: Array) -> int:
    """Number of the best value of a profile (K,): a single step of the staircase is no maximum."""
    return 1 + int(np.convolve(total, np.full(3, 1.0 / 3.0), "valid").argmax())


def _profile(data: Recorded, model: Model, place: int, found: float, work: Executor) -> dict[float, JointFit]:
    """Fit the drivers' own parameters at sizes of a shared parameter; once more beyond an end where the best one is."""
    there: dict[float, JointFit] = {}
    steps = _STEPS
    for _ in range(2):
        sizes = np.clip(found * np.exp(steps), data.lower[place], data.upper[place])
        there |= {size: _at(data, model, place, size, work) for size in set(sizes.tolist()) - set(there)}
        if len(there) < _FEWEST:
            break
        best = _best(np.array([there[size].objective for size in sorted(there)]))
        if _END <= best < len(there) - _END:
            break
        steps = steps[:_END] - _SPAN if best < _END else steps[-_END:] + _SPAN
    return there


def _at(data: Recorded, model: Model, place: int, size: float, work: Executor) -> JointFit:
    """Fit the drivers' own parameters at a size of a shared parameter: from the model's drivers, and from typical ones.

    Each driver keeps the better fit. The drivers of the base model have made up for what it lacks, and a search that
    begins with them may stay there.
    """
    typical = start_of_drivers(data, name_of(float(model.rows[0, ROW.law]))).rows
    rows, own = model.rows.copy(), list(model.individual)
    rows[:, own] = typical[:, own]
    first, second = (_alone(data, _with(model, start, place, size), work) for start in (model.rows, rows))
    return best_of_each(first, second)


def _with(model: Model, rows: Array, place: int, size: float) -> Model:
    """Return a model with rows, and with a size of a parameter where it is not 0."""
    rows, ahead = rows.copy(), model.ahead.copy()
    sign = np.sign(model.rows[:, place])
    rows[:, place] = ahead[:, place] = sign * size
    return replace(model, rows=rows, ahead=ahead)


def _alone(data: Recorded, model: Model, work: Executor) -> JointFit:
    """Fit the drivers' own parameters alone; the shared ones stay."""
    return fit(data.roughly, replace(model, shared=(), few=()), work)
