"""Maximum likelihood for many drivers at once: some parameters each driver's own, others the same for all.

Damped Fisher scoring (``fit.scoring``): what belongs to one driver is independent of what belongs to another but for
the shared parameters, so the system to solve is an arrow.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array
from sugiyama_ros.fit.model import Model, Step, moved
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.score import PointwiseDensity, predict_drivers
from sugiyama_ros.fit.scoring import Damping, damped, damped_step
from sugiyama_ros.fit.slopes import Slopes, informed_steps, slopes, slopes_of, sums

# A search ends when a step is predicted to gain less log-likelihood [nats] than this. The likelihood of a recording is
# rough by about 1 from step to step of the difference quotients.
_ENOUGH = 0.5
_DAMPING = Damping(least=1e-6, least_after_failure=0.1, most=1e4)
# Steps of a search at most, and times at most that it takes the derivatives anew.
_STEPS, _RENEWALS = 12, 5


@dataclass(frozen=True, eq=False)
class JointFit:
    """A model of all drivers with its samples and slopes, at a maximum or on the way to one."""

    model: Model
    samples: PointwiseDensity
    slopes: tuple[Slopes, ...]

    @property
    def log_likelihood(self) -> float:
        """Log-likelihood of all samples."""
        return self.samples.total


def start_fit(data: Recorded, model: Model, work: Executor) -> JointFit:
    """The beginning of a search from ``model``: its samples and slopes."""
    start, samples = slopes(data, model, work)
    return JointFit(model, samples, tuple(start))


def fit(data: Recorded, model: Model, work: Executor, *, iterations: int = _STEPS) -> JointFit:
    """Maximise the likelihood from ``model``, with at most ``iterations`` steps."""
    return maximise(data, start_fit(data, model, work), work, iterations=iterations)


def warm_start(data: Recorded, near: JointFit, model: Model, work: Executor, *, renewals: int = _RENEWALS) -> JointFit:
    """Maximise the likelihood from ``model``, with the derivatives of the fit ``near`` until they are poor."""
    start = at_model(data, near, model, work, np.ones(data.drivers, np.bool_))
    return maximise(data, start, work, renewals=renewals, fresh=False)


def maximise(
    data: Recorded,
    start: JointFit,
    work: Executor,
    *,
    folds: Sequence[int] = tuple(range(FOLDS)),
    iterations: int = _STEPS,
    enough: float = _ENOUGH,
    renewals: int = _RENEWALS,
    fresh: bool = True,
) -> JointFit:
    """Maximise the log posterior from a model whose slopes are known.

    The derivatives of the samples take most of the time. They are kept from step to step, and computed anew at the end
    and where a step gains less than half of what was predicted. Without shared parameters each driver rests on arrival.

    Parameters
    ----------
    data, start
        The recording and where the search starts.
    work
        Executor that runs the filters.
    folds
        Folds whose samples count.
    iterations
        Steps at most.
    enough
        The search ends when a step is predicted to gain less than this [nats].
    renewals
        How often derivatives are computed anew, at most.
    fresh
        Whether the derivatives of ``start`` belong to its model, and not to a model near by.
    """
    here = start
    damping: Array = np.full(data.drivers, _DAMPING.start)
    is_fresh = np.full(data.drivers, fresh)
    for _ in range(iterations):
        step, moves = _next_step(here, folds, damping, enough)
        if step.predicted_gain < enough or damping[moves].min(initial=np.inf) > _DAMPING.most:
            if is_fresh.all() or not renewals:
                break
            here, renewals = renewed(data, here, work, ~is_fresh), renewals - 1
            is_fresh[:] = True
            step, moves = _next_step(here, folds, damping, enough)
            if step.predicted_gain < enough:
                break
        there = at_model(data, here, moved(data, here.model, step), work, moves)
        rise, predicted_gains = _risen(here, there, step, folds)
        better = moves & (rise > 0.0)
        here = mixed(here, there, better)
        gained = np.where(better, rise, 0.0)
        poor = moves & (gained <= 0.5 * predicted_gains)
        if gained.sum() < enough and is_fresh[moves].all() and better.any():
            break
        damping = _DAMPING.updated(damping, better, moves & ~better & is_fresh)
        again = poor & (better | ~is_fresh) & (renewals > 0)
        if again.any():
            here, renewals = renewed(data, here, work, again), renewals - 1
        is_fresh = (is_fresh & ~better) | again
    return here


def _next_step(here: JointFit, folds: Sequence[int], damping: Array, enough: float) -> tuple[Step, NDArray[np.bool_]]:
    """The next step, and the drivers (N,) that it moves: those with enough to gain, or all together."""
    step = solve(here.slopes, here.model, folds, damping)
    return step, bool(here.model.shared) | (step.predicted_gains > enough / len(here.slopes))


def _risen(here: JointFit, there: JointFit, step: Step, folds: Sequence[int]) -> tuple[Array, Array]:
    """Rise of each driver's objective from one model to another, and the rise that was predicted; (N,) each.

    With shared parameters the drivers rise and fall together, so each has the mean.
    """
    rise = objectives(there.slopes, there.model, folds) - objectives(here.slopes, here.model, folds)
    if not here.model.shared:
        return rise, step.predicted_gains
    return np.full_like(rise, rise.mean()), np.full_like(rise, step.predicted_gain / len(rise))


def solve(
    all_slopes: Sequence[Slopes],
    model: Model,
    folds: Sequence[int],
    damping: float | Array,
    curvature: Sequence[int] | None = None,
) -> Step:
    """Damped Newton step of a model; the prior counts in proportion to the folds.

    Parameters
    ----------
    all_slopes
        Slopes of each driver at the model.
    model
        The model.
    folds
        Folds whose samples count.
    damping
        One number, or one for each driver (N,).
    curvature
        Folds that the information is taken from, if not ``folds``.
    """
    curved, own = list(folds if curvature is None else curvature), len(model.individual)
    of_driver: Array = np.broadcast_to(damping, len(all_slopes))
    std, share = np.array(model.prior_std), len(folds) / FOLDS
    g: Array = np.array([s.score for s in all_slopes])[:, list(folds)].sum(axis=1)
    h: Array = np.array([s.information for s in all_slopes])[:, curved].sum(axis=1)
    g_own, h_own, cross = g[:, :own] - share * model.away / std, h[:, :own, :own], h[:, :own, own:]
    h_own = h_own + len(curved) / FOLDS * np.diag(1.0 / std**2)
    inverse = np.linalg.inv(damped(h_own, of_driver))
    # what the individual parameters give way by, for each shared one
    gives_way = inverse @ cross
    reduced = (h[:, own:, own:] - cross.transpose(0, 2, 1) @ gives_way).sum(axis=0)
    rest = g[:, own:].sum(axis=0) - np.einsum("nis,ni->s", gives_way, g_own)
    of_shared = damped_step(reduced, rest, of_driver.max() + 1e-9, 1e-6)
    of_own: Array = np.einsum("nij,nj->ni", inverse, g_own - cross @ of_shared)
    predicted_gains: Array = 0.5 * np.einsum("ni,nij,nj->n", g_own, inverse, g_own)
    return Step(of_own, of_shared, predicted_gains, 0.5 * float(rest @ of_shared) + float(predicted_gains.sum()))


def at_model(data: Recorded, here: JointFit, model: Model, work: Executor, who: NDArray[np.bool_]) -> JointFit:
    """Move the drivers in ``who`` (N,) to another model near by, with the derivatives as they were."""
    numbers = np.flatnonzero(who)
    rows, slopes_, samples = here.model.rows.copy(), list(here.slopes), here.samples.copy()
    rows[who] = model.rows[who]
    for i, at in zip(numbers, predict_drivers(data, model, numbers, work), strict=True):
        slopes_[i] = sums(at, slopes_[i].derivatives, rows[i], data.fold)
        samples.put(i, at)
    return JointFit(replace(model, rows=rows), samples, tuple(slopes_))


def renewed(data: Recorded, here: JointFit, work: Executor, who: NDArray[np.bool_]) -> JointFit:
    """The fit with the derivatives of the drivers in ``who`` (N,) computed anew."""
    numbers, slopes_ = np.flatnonzero(who), list(here.slopes)
    steps = informed_steps(data, here.model, here.slopes)
    for i, s in zip(numbers, slopes_of(data, here.model, here.samples, steps, work, numbers), strict=True):
        slopes_[i] = s
    return replace(here, slopes=tuple(slopes_))


def mixed(here: JointFit, there: JointFit, better: NDArray[np.bool_]) -> JointFit:
    """The fit ``there`` for the drivers in ``better`` (N,), and ``here`` for the others."""
    rows, slopes_, samples = here.model.rows.copy(), list(here.slopes), here.samples.copy()
    rows[better] = there.model.rows[better]
    for i in np.flatnonzero(better):
        slopes_[i] = there.slopes[i]
        samples.put(i, there.samples.of(i))
    return JointFit(replace(here.model, rows=rows), samples, tuple(slopes_))


def objectives(all_slopes: Sequence[Slopes], model: Model, folds: Sequence[int]) -> Array:
    """Log-likelihood of each driver's samples in ``folds`` plus the log prior in proportion, (N,)."""
    likelihood = np.array([s.log_likelihood for s in all_slopes])[:, list(folds)].sum(axis=1)
    return np.asarray(likelihood - 0.5 * len(folds) / FOLDS * np.square(model.away).sum(axis=1))


def objective(all_slopes: Sequence[Slopes], model: Model, folds: Sequence[int]) -> float:
    """Log-likelihood of all samples in ``folds`` plus the log prior in proportion."""
    return float(objectives(all_slopes, model, folds).sum())
