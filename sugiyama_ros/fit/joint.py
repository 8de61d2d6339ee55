"""Maximum likelihood for many drivers at once: each driver has individual parameters, and all drivers share others.

The search is damped Fisher scoring (``fit.coordinates``). Only the shared parameters connect the drivers, so the
matrix of the linear system has the shape of an arrow. The derivatives of the samples take most of the time. The search
keeps them from step to step. It computes them again at the end, and where a step gains less than half of its predicted
gain. Without shared parameters each driver moves independently and stops on reaching the maximum.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.driver.parameters import NAMES, V_STAR
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.first_look import PER_MEDIAN
from sugiyama_ros.fit.coordinates import ENOUGH_CAUSAL, Damping, coordinate, damped, damped_step, limits
from sugiyama_ros.fit.driver import calibrate
from sugiyama_ros.fit.driver_types import LEAST_STD
from sugiyama_ros.fit.model import Model, PointwiseDensity, evaluate, moved
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.slopes import Slopes, informed_steps, slopes, slopes_of, sums
from sugiyama_ros.fit.smooth_positions import measured_every

# A search ends when the predicted gain of a step is less than this [nats]. The log-likelihood of 22 drivers is rough:
# it varies irregularly by about 1 over one step of the difference quotients.
_ENOUGH = 0.5
#: Steps of a fit that begins near its maximum: without a fold, of a simulated recording, at another period.
NEAR_STEPS = 3
_DAMPING = Damping(least=1e-6, least_after_failure=0.1, most=1e4)
# Maximum number of steps of a search, and maximum number of times that it computes the derivatives again.
_STEPS, _RENEWALS = 12, 5


@dataclass(frozen=True, eq=False)
class JointFit:
    """A model of all drivers, its predictions of all samples, and score and information of each driver.

    beside: the fit from which the model has the parameters that it holds; stds: standard errors of shared parameters by
    name, where a profile has said them.
    """

    model: Model
    samples: PointwiseDensity
    slopes: tuple[Slopes, ...]
    beside: "JointFit | None" = None
    stds: Mapping[str, float] = field(default_factory=dict)

    @property
    def log_likelihood(self) -> float:
        """Log-likelihood of all samples [nats]."""
        return self.samples.total

    def objectives(self, folds: Sequence[int] = range(FOLDS)) -> Array:
        """Return the log posterior of each driver (N,) [nats]: samples in ``folds``, and the prior in proportion."""
        likelihood = np.array([s.log_likelihood for s in self.slopes])[:, list(folds)].sum(axis=1)
        return np.asarray(likelihood - 0.5 * len(folds) / FOLDS * np.square(self.model.away).sum(axis=1))

    @property
    def objective(self) -> float:
        """Log posterior of all drivers [nats]."""
        return float(self.objectives().sum())


def fit(data: Recorded, model: Model, work: Executor, *, iterations: int = _STEPS) -> JointFit:
    """Maximise the likelihood from ``model``, with at most ``iterations`` steps."""
    return maximise(data, _start(data, model, work), work, iterations=iterations)


def _start(data: Recorded, model: Model, work: Executor) -> JointFit:
    """The start of a search: the model with its samples and slopes."""
    start, samples = slopes(data, model, work)
    return JointFit(model, samples, tuple(start))


def maximise(
    data: Recorded,
    start: JointFit,
    work: Executor,
    *,
    folds: Sequence[int] = tuple(range(FOLDS)),
    iterations: int = _STEPS,
    enough: float | None = None,
    renewals: int = _RENEWALS,
    fresh: bool = True,
) -> JointFit:
    """Maximise the log posterior from a fit whose slopes are known, and return the best fit found.

    enough: the search ends when the predicted gain of a step is less than this [nats]; more than 0.5 for many drivers;
    fresh: whether the derivatives of ``start`` belong to its own model, and not to a nearby model.
    """
    here = start
    enough = max(_ENOUGH, ENOUGH_CAUSAL * data.drivers) if enough is None else enough
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
        there = at_model(data, here, moved(data, here.model, step.individual, step.shared), work, moves)
        rise, predicted_gains = _risen(here, there, step, folds)
        better = moves & (rise > 0.0)
        here = _mixed(here, there, better)
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


def _next_step(here: JointFit, folds: Sequence[int], damping: Array, enough: float) -> tuple["_Step", Mask]:
    """The next step, and the drivers (N,) that it moves: those with enough predicted gain, and those whom a shared
    parameter moves.
    """
    step, own = _solve(here, folds, damping), len(here.model.individual)
    shared = np.array([s.information[:, own:, own:].any() for s in here.slopes])
    return step, shared | (step.predicted_gains > enough / len(here.slopes))


def _risen(here: JointFit, there: JointFit, step: "_Step", folds: Sequence[int]) -> tuple[Array, Array]:
    """Rise of each driver's objective from one model to another, and the predicted rise; (N,) each.

    With shared parameters the drivers rise and fall together, so each driver gets the mean.
    """
    rise = there.objectives(folds) - here.objectives(folds)
    if not here.model.shared:
        return rise, step.predicted_gains
    return np.full_like(rise, rise.mean()), np.full_like(rise, step.predicted_gain / len(rise))


class _Step(NamedTuple):
    """A step of the search: changes of the individual (N, I) and of the shared coordinates (S,).

    predicted_gains: (N,), predicted rise of the log posterior [nats] from each driver's individual changes;
    predicted_gain: predicted rise from the whole step.
    """

    individual: Array
    shared: Array
    predicted_gains: Array
    predicted_gain: float


def _solve(here: JointFit, folds: Sequence[int], damping: Array) -> _Step:
    """The damped Newton step from a fit; the prior counts in proportion to the number of folds."""
    model, own, share = here.model, len(here.model.individual), len(folds) / FOLDS
    std = np.array(model.prior_std)
    g: Array = np.array([s.score for s in here.slopes])[:, list(folds)].sum(axis=1)
    h: Array = np.array([s.information for s in here.slopes])[:, list(folds)].sum(axis=1)
    g[:, :own] -= share * model.away / std
    h[:, range(own), range(own)] += share * (1.0 / std**2)
    # what a driver does not have, and what is held, does not move, and takes up nothing of what the others do
    is_held = np.isin((*model.individual, *model.shared), model.held)
    has = np.concatenate([np.ones((len(g), own), np.bool_), model.has], axis=1)
    g = np.where(has & ~is_held, g, 0.0)
    h = np.where(has[:, :, None] & has[:, None] & (is_held[:, None] == is_held), h, 0.0)
    cross, g_own = h[:, :own, own:], g[:, :own].copy()
    inverse = np.linalg.inv(damped(h[:, :own, :own], damping))
    # response of the individual parameters to a change of each shared parameter
    gives_way = inverse @ cross
    reduced = (h[:, own:, own:] - cross.transpose(0, 2, 1) @ gives_way).sum(axis=0)
    rest = g[:, own:].sum(axis=0) - np.einsum("nis,ni->s", gives_way, g_own)
    of_shared = damped_step(reduced, rest, damping.max() + 1e-9, 1e-6)
    of_own: Array = np.einsum("nij,nj->ni", inverse, g_own - cross @ of_shared)
    predicted_gains: Array = 0.5 * np.einsum("ni,nij,nj->n", g_own, inverse, g_own)
    return _Step(of_own, of_shared, predicted_gains, 0.5 * float(rest @ of_shared) + float(predicted_gains.sum()))


def at_model(data: Recorded, here: JointFit, model: Model, work: Executor, who: Mask | None = None) -> JointFit:
    """Return the fit with the drivers in ``who`` (N,) moved to a nearby model; the derivatives stay as they are."""
    numbers = range(data.drivers) if who is None else np.flatnonzero(who).tolist()
    rows, slopes_ = here.model.rows.copy(), list(here.slopes)
    samples, there = here.samples.copy(), evaluate(data, model, work, numbers)
    for i in numbers:
        rows[i] = model.rows[i]
        samples.put(i, there.of(i))
        slopes_[i] = sums(there.of(i), slopes_[i].columns, rows[i], data.fold[i])
    return JointFit(replace(model, rows=rows), samples, tuple(slopes_))


def renewed(data: Recorded, here: JointFit, work: Executor, who: Mask | None = None) -> JointFit:
    """Return the fit with the derivatives of the drivers in ``who`` (N,) computed again."""
    numbers = range(data.drivers) if who is None else np.flatnonzero(who).tolist()
    steps, slopes_ = informed_steps(data, here.model, here.slopes), list(here.slopes)
    for i, s in zip(numbers, slopes_of(data, here.model, here.samples, steps, work, numbers), strict=True):
        slopes_[i] = s
    return replace(here, slopes=tuple(slopes_))


def _mixed(here: JointFit, there: JointFit, better: Mask) -> JointFit:
    """The fit ``there`` for the drivers in ``better`` (N,), and the fit ``here`` for the other drivers."""
    rows, slopes_, samples = here.model.rows.copy(), list(here.slopes), here.samples.copy()
    for i in np.flatnonzero(better).tolist():
        rows[i], slopes_[i] = there.model.rows[i], there.slopes[i]
        samples.put(i, there.samples.of(i))
    return JointFit(replace(here.model, rows=rows), samples, tuple(slopes_))


def best_of_each(one: JointFit, other: JointFit) -> JointFit:
    """Return the better fit for each driver, of two fits without shared parameters."""
    return _mixed(one, other, other.objectives() > one.objectives())


#: Largest prior std of a parameter's coordinate (a logarithm for most), also before the spread is known.
LARGEST_STD = 1.0
# A driver further than this from the median driver, in prior stds, is fitted again.
_FAR_AWAY = 3.5
# The spread is known as if so many drivers with this spread of logarithms had been seen before.
_AS_IF, _USUAL_STD = 3.0, 0.3
# Number of steps towards the spread, at most, and change of the logarithm of a variance at which they end.
_SPREADS, _SETTLED = 500, 1e-3


def start_model(data: Recorded, individual: Sequence[int]) -> Model:
    """Return the model without effects in which every driver is the mean of the population."""
    typical = data.even.typical(data.speed)
    rows = np.tile(ROW.with_effects(typical), (data.drivers, 1))
    return Model(rows, tuple(individual), (), (LARGEST_STD,) * len(individual), rows.copy())


def fit_nearly(data: Recorded, individual: Sequence[int], work: Executor, start: Model | None = None) -> JointFit:
    """Fit every driver alone, but not to the end, because other searches follow, or because the fit is far behind."""
    return max(_nearly(data, individual, work, start), key=lambda near: near.log_likelihood)


def _nearly(data: Recorded, individual: Sequence[int], work: Executor, start: Model | None) -> list[JointFit]:
    """Fit every driver alone, but not to the end, from each start.

    The likelihood has several maxima along the desired speed. Far above a driver's own speed, the driver model says
    little, and noise explains the acceleration. At the own speed of drivers who are held up, the search may end below
    the desired speed. So drivers start at their own speed, and again at a desired speed that is typical.
    """
    first = start or start_model(data, individual)
    near = _by_paper(data, first, work) if start is None else None
    starts = [near or first]
    if start is None and near is None and V_STAR in individual:
        starts.insert(0, _at_own_speed(data, first))
    most = 10 if near is None else 3
    return [maximise(data, _start(data, model, work), work, iterations=most, enough=20.0) for model in starts]


def _at_own_speed(data: Recorded, model: Model) -> Model:
    """Return the model in which the desired speed of each driver is the driver's own highest speed."""
    own = np.array([chain.high_speed(counts) for chain, counts in zip(data.chains, data.scored, strict=True)])
    rows = model.rows.copy()
    rows[:, V_STAR] = np.clip(np.where(np.isnan(own), rows[:, V_STAR], own), *limits([V_STAR], data.lower, data.upper))
    return replace(model, rows=rows, ahead=rows)


def fit_base(data: Recorded, individual: Sequence[int], work: Executor, start: Model | None = None) -> JointFit:
    """Fit every driver alone, then all drivers as draws from one population.

    The second fit uses the first fit's parameters for the drivers ahead, and the spread of its drivers. A third fit
    uses those of the second, because drivers who are fitted alone to a few samples say little of their errors. It is
    repeated as long as the likelihood rises by it. Of the populations to which several starts lead, the likeliest
    counts.
    """
    populations = (
        _settled(data, _as_one_population(data, _as_one_population(data, near, work), work), work)
        for near in _nearly(data, individual, work, start)
    )
    return max(populations, key=_evidence)


def _evidence(found: JointFit) -> float:
    """Log-likelihood [nats] of all samples, of drivers who are draws from the population (Laplace's approximation)."""
    own, std = len(found.model.individual), np.array(found.model.prior_std)
    information = np.array([s.information.sum(axis=0)[:own, :own] for s in found.slopes])
    narrower = np.linalg.slogdet(np.eye(own) + information * np.outer(std, std))[1]
    return found.objective - 0.5 * float(narrower.sum())


def _as_one_population(data: Recorded, near: JointFit, work: Executor) -> JointFit:
    """Fit all drivers as draws from one population, with the parameters of a nearby fit for the drivers ahead."""
    start = at_model(data, near, _as_population(near), work)
    return _second_chance(data, maximise(data, start, work, fresh=False), work)


def _settled(data: Recorded, found: JointFit, work: Executor) -> JointFit:
    """Fit again with the parameters found for the drivers ahead, too, while the log-likelihood rises by it.

    Where it falls, the drivers ahead are better predicted by the parameters of the fit before, which is kept.
    """
    enough = max(0.1 * data.drivers, 2.0)  # nats, for each driver or for all of them
    there = at_model(data, found, _as_population(found), work)
    if abs(there.log_likelihood - found.log_likelihood) < enough:
        return found
    for _ in range(5):
        again = _as_one_population(data, found, work)
        rise = again.log_likelihood - found.log_likelihood
        if rise > 0.0:
            found = again
        if rise < enough:
            break
    return found


def _second_chance(data: Recorded, found: JointFit, work: Executor) -> JointFit:
    """Search again from the median driver for drivers who are unlike all others, and keep the better of both fits.

    The likelihood of a driver has several maxima, and the first search may have ended in a poor, distant maximum.
    """
    far = np.abs(found.model.away).max(axis=1) > _FAR_AWAY
    if not far.any():
        return found
    own = list(found.model.individual)
    rows = found.model.rows.copy()
    rows[np.ix_(far, own)] = np.median(rows[:, own], axis=0)
    elsewhere = at_model(data, found, replace(found.model, rows=rows), work, far)
    again = maximise(data, renewed(data, elsewhere, work, far), work)
    better = again.objectives() > found.objectives()
    return maximise(data, _mixed(found, again, better), work, iterations=4)


def _by_paper(data: Recorded, model: Model, work: Executor) -> Model | None:
    """The model fitted with the paper's formulation; None if the formulation cannot use the recording.

    In the paper, drivers decide once for each sample. So the formulation says little of samples that are far apart, and
    nothing of noises that it does not have.

    A parameter that the data of a driver do not determine becomes the median over the drivers whose data determine it,
    if there are any.
    """
    if data.trajectories is None or measured_every(data.trajectories) > 1 or data.even.has_other_noises:
        return None
    names = [NAMES[k] for k in model.individual]
    try:
        fits = list(calibrate(data.trajectories, "paper", names, work=work))
    except InputError:
        return None
    rows = model.rows.copy()
    for k, name in zip(model.individual, names, strict=True):
        known = [one.parameters[k] for one in fits if one.identified(name)]
        if known:
            rows[:, k] = [one.parameters[k] if one.identified(name) else np.median(known) for one in fits]
    return replace(model, rows=rows, ahead=rows)


def _as_population(here: JointFit) -> Model:
    """Return the model with the spread of its drivers as the prior, and with its own rows for the drivers ahead.

    The likelihood of each driver counts as quadratic. The EM algorithm finds the spread that makes all of them most
    probable (empirical Bayes): a driver's estimate differs from the median by the spread and by its own error, so the
    estimates alone would differ by too much, or once they are drawn to the median, by too little.
    """
    model, count = here.model, len(here.model.individual)
    own = coordinate(model.rows[:, list(model.individual)], model.individual)
    information = np.array([s.information.sum(axis=0)[:count, :count] for s in here.slopes])
    score = np.array([s.score.sum(axis=0)[:count] for s in here.slopes])
    pull = np.einsum("nij,nj->ni", information, own) + score
    centre, var = np.median(own, axis=0), np.full(count, LARGEST_STD**2)
    for _ in range(_SPREADS):
        posterior = np.linalg.inv(information + np.diag(1.0 / var))
        mean = np.einsum("nij,nj->ni", posterior, pull + centre / var)
        centre = np.median(mean, axis=0)
        # medians: a driver who is far from all others must not make all others differ
        off, errors = np.square(mean - centre), posterior[:, range(count), range(count)]
        found = PER_MEDIAN**2 * np.median(off, axis=0) + np.median(errors, axis=0)
        # a small number of drivers determines the spread poorly
        new = (len(own) * found + _AS_IF * _USUAL_STD**2) / (len(own) + _AS_IF)
        new = np.clip(new, LEAST_STD**2, LARGEST_STD**2)
        settled = np.abs(np.log(new / var)).max(initial=0.0) < _SETTLED
        var = new
        if settled:
            break
    return replace(model, prior_std=tuple(np.sqrt(var).tolist()), ahead=model.rows)
