"""A scan for forces that a model lacks, along many covariates, by score tests.

A push of one period moves the innovations of the next seconds, by nearly the same amounts at any speed. The filter
shows these amounts once. The change of the samples by any small force is then the force convolved with them, so a curve
over a covariate is fitted by one Newton step without running the filter. The other parameters respond to the force.
Curves are compared by what they gain for drivers whom they were not fitted to.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.covariates import covariates_of, further_covariates, some_time_ago
from sugiyama_ros.diagnosis.discover import FORCE, INNER, Discovery, against, p_value_of_force
from sugiyama_ros.effects.registry import index_of
from sugiyama_ros.fit.cross_validation import sum_error
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.score import evaluate, filtered_states
from sugiyama_ros.fit.slopes import no_density, sums

_FIRST = index_of(FORCE, "covariate")
# Size [m/s^2] and knot of a push, the drivers who are pushed at most, and how often.
_PUSH, _KNOT, _PUSHED, _PUSHES = 0.3, 3, 22, 4
# A push shows in the innovations for so long [s].
_SHOWS_S = 4.0
# Numbers of knots of a curve, and further ones over what need not be smooth.
_KNOTS, _FINER = (4, 8), {"place": (16,), "time": (16, 32)}
# What may act some time later, and times [s].
_LATER, _AGO_S = ("speed", "acceleration"), tuple(float(s) for s in range(1, 9))
# Std [m/s^2] of the prior of a force at a knot.
_PRIOR_STD = 1.0
# Fewest samples at which a covariate must be known.
_FEWEST = 100
# A force predicts better by so many standard errors of its held-out gain.
_CLEARLY = 2.0
# A covariate that gains this share of the best one may be told apart by a test alone: one-sided at 5 %.
_SHARE, _ONE_SIDED = 0.5, 1.645


@dataclass(frozen=True, eq=False)
class _Basis:
    """Straight lines between knots over a covariate; ``values`` (T, N)."""

    covariate: str
    values: Array
    first: float
    last: float
    knots: int
    is_periodic: bool = False
    ago_s: float = 0.0

    @property
    def places(self) -> Array:
        """Values of the covariate at the knots (K,)."""
        count = self.knots if self.is_periodic else self.knots - 1
        return self.first + (self.last - self.first) * np.arange(self.knots) / count

    def functions(self) -> Array:
        """Weight of each knot at each sample (T, N, K); 0 where the covariate is unknown."""
        intervals = self.knots if self.is_periodic else self.knots - 1
        known = np.isfinite(self.values)
        s = np.where(known, (self.values - self.first) / (self.last - self.first), 0.0)
        s = intervals * np.clip(s, 0.0, 1.0)
        k = np.minimum(s.astype(np.int64), intervals - 1)
        weights = np.zeros((*s.shape, self.knots))
        for knot, weight in ((k, 1.0 - s + k), ((k + 1) % self.knots, s - k)):
            np.put_along_axis(weights, knot[..., None], np.where(known, weight, 0.0)[..., None], axis=2)
        return weights


@dataclass(frozen=True, eq=False)
class ScoredForce:
    """What a force along a covariate would gain.

    Parameters
    ----------
    force : Discovery
        The force, with its gain in sample.
    heldout : ndarray, shape (N,)
        Gain [nats] for each driver, of a force that was fitted to the others.
    """

    force: Discovery
    heldout: Array

    @property
    def total(self) -> float:
        """Held-out gain for all drivers [nats]."""
        return float(self.heldout.sum())

    @property
    def is_clear(self) -> bool:
        """Whether the held-out gain is above two standard errors."""
        return self.total > _CLEARLY * sum_error(self.heldout)

    def is_as_good_as(self, best: "ScoredForce") -> bool:
        """Whether the held-out gain is not clearly less than that of another force."""
        behind = best.heldout - self.heldout
        return self.total > _SHARE * best.total and float(behind.sum()) <= _ONE_SIDED * sum_error(behind)


def forces_left(
    data: Recorded,
    fitted: JointFit,
    simulations: Sequence[tuple[Recorded, JointFit]],
    level: float,
    work: Executor,
) -> list[Discovery]:
    """Find the forces that a model lacks.

    Parameters
    ----------
    data : Recorded
        The recording.
    fitted : JointFit
        The model.
    simulations : sequence of (Recorded, JointFit)
        Recordings that the model simulates, with the fits to them.
    level : float
        Level of significance.
    work : Executor
        Runs the filters.

    Returns
    -------
    list of Discovery
        The force that predicts best, with the covariates that cannot be told apart from its own, and the other forces.
    """
    found = [one for one in scan(data, fitted, work) if one.force.p_value < level and one.is_clear]
    if found:
        gains: dict[str, list[float]] = {one.force.covariate: [] for one in found}
        for simulated, own in simulations:
            for one in scan(simulated, own, work, tuple(gains)):
                gains[one.force.covariate].append(one.force.gain_nats)
        again = [replace(one, force=against(one.force, gains[one.force.covariate])) for one in found]
        found = sorted((one for one in again if one.force.p_value < level), key=lambda one: -one.total)
    if not found:
        return []
    alike = tuple(one.force.covariate for one in found[1:] if one.is_as_good_as(found[0]))
    return [replace(found[0].force, alike=alike), *(one.force for one in found[1:])]


def scan(data: Recorded, fitted: JointFit, work: Executor, only: Sequence[str] = ()) -> list[ScoredForce]:
    """Return what a force along each covariate would gain, with the number of knots and the time that predict best.

    Parameters
    ----------
    data : Recorded
        The recording.
    fitted : JointFit
        The model.
    work : Executor
        Runs the filters.
    only : sequence of str
        Names of covariates; all by default.

    Returns
    -------
    list of ScoredForce
        One for each covariate.
    """
    bases = list(_bases(data, filtered_states(data, fitted.model, work)))
    response = _response(data, fitted, work)
    best: dict[str, ScoredForce] = {}
    for basis in bases:
        if only and basis.covariate not in only:
            continue
        one = _scored(data, fitted, basis, response, len(bases))
        if basis.covariate not in best or one.total > best[basis.covariate].total:
            best[basis.covariate] = one
    return list(best.values())


def _bases(data: Recorded, states: Array) -> Iterator[_Basis]:
    """All curves that are tried."""
    around = data.vicinity
    seen = covariates_of(data, states)
    seen |= further_covariates(data, states, seen)
    if not around.is_whole_road:
        del seen["time"]
    tried = [(name, values, 0.0) for name, values in seen.items()]
    tried += [(f"past_{name}", some_time_ago(data, seen[name], s), s) for name in _LATER for s in _AGO_S]
    for name, values, ago_s in tried:
        known = values[np.isfinite(values)]
        if len(known) < _FEWEST:
            continue
        ring = name == "place" and around.road.is_ring
        first, last = (0.0, around.road.circumference_m) if ring else np.quantile(known, INNER).tolist()
        if last > first:
            for knots in (*_KNOTS, *_FINER.get(name, ())):
                yield _Basis(name, values, first, last, knots, ring, ago_s)


def _response(data: Recorded, fitted: JointFit, work: Executor) -> Array:
    """Change of the innovation [m] by a push of 1 m/s^2 in one period, after 0, 1, 2, ... samples."""
    samples, period = data.samples, data.vicinity.period_s
    length = min(round(_SHOWS_S / period) + 1, samples - data.every + 1)
    who = range(0, data.drivers, -(-data.drivers // _PUSHED))
    changes = []
    # where vehicles are measured in one sample of so many, pushes before each of the samples in between
    for n, share in enumerate(np.linspace(0.1, 0.8, max(_PUSHES, data.every))):
        at = int(share * (samples - length))
        at += (n - at) % data.every
        rows = fitted.model.rows.copy()
        # the force depends on the time, and its knots are one sample apart
        rows[:, _FIRST], rows[:, _FIRST + 3 + _KNOT] = 5.0, _PUSH
        for back, place in ((_KNOT, _FIRST + 1), (_KNOT - 7, _FIRST + 2)):
            rows[:, place] = data.vicinity.time_s[at] - back * period
        pushed = evaluate(data, replace(fitted.model, rows=rows), work, who)
        change = (pushed.innovation_m - fitted.samples.innovation_m)[:, at : at + length] / _PUSH
        changes.append(change[np.any(np.nan_to_num(change) != 0.0, axis=1)])
    known = np.concatenate(changes)
    seen, response = np.isfinite(known).any(axis=0), np.zeros(length)
    response[seen] = np.nanmedian(known[:, seen], axis=0)
    return response


def _scored(data: Recorded, fitted: JointFit, basis: _Basis, response: Array, tests: int) -> ScoredForce:
    """The gain of a force by one Newton step, in sample and for each driver by a fit to the others."""
    by_knot = lfilter(response, [1.0], basis.functions(), axis=0)
    score, information = _profiled(data, fitted, by_knot)
    known, all_of = len(fitted.model.shared), score.shape[1]
    prior = np.zeros(all_of)
    prior[known:] = _PRIOR_STD**-2

    def step(g: Array, h: Array, count: int) -> Array:
        return np.asarray(np.linalg.solve(h[:count, :count] + np.diag(prior[:count] + 1e-9), g[:count]))

    def won(of: slice, more: Array, less: Array) -> float:
        g, h = score[of].sum(axis=0), information[of].sum(axis=0)
        return sum(s * float(g[: len(d)] @ d - 0.5 * d @ h[: len(d), : len(d)] @ d) for s, d in ((1, more), (-1, less)))

    g, h = score.sum(axis=0), information.sum(axis=0)
    force = step(g, h, all_of)
    heldout = np.zeros(data.drivers)
    for i in range(data.drivers):
        others = g - score[i], h - information[i]
        heldout[i] = won(slice(i, i + 1), step(*others, all_of), step(*others, known))
    gained = won(slice(None), force, step(g, h, known))
    if data.drivers == 1:
        # nobody is left out; a parameter gains about a nat by chance (Akaike)
        heldout[:] = gained - (all_of - known)
    at_knots = force[known:]
    found = Discovery(
        covariate=basis.covariate,
        strength=float(np.ptp(at_knots)),
        p_value=p_value_of_force(gained, basis.knots - 1, tests),
        gain_nats=gained,
        knots=tuple(basis.places.tolist()),
        force=tuple(at_knots.tolist()),
        ago_s=basis.ago_s,
        tests=tests,
    )
    return ScoredForce(found, heldout)


def _profiled(data: Recorded, fitted: JointFit, by_knot: Array) -> tuple[Array, Array]:
    """Score (N, S + K) and information (N, S + K, S + K) of each driver by the S shared parameters and by K knots.

    The individual parameters respond. by_knot: change of the innovations (T, N, K).
    """
    model, zeros = fitted.model, no_density(data.samples)
    own, count = len(model.individual), len(model.individual) + len(model.shared) + by_knot.shape[2]
    std = np.array(model.prior_std)
    has = np.concatenate([np.ones((data.drivers, own), np.bool_), model.has], axis=1)
    score, information = np.zeros((data.drivers, count - own)), np.zeros((data.drivers, count - own, count - own))
    for i, (s, row) in enumerate(zip(fitted.slopes, model.rows, strict=True)):
        columns = [*s.columns, *((column, zeros, zeros) for column in by_knot[:, i].T)]
        sums_ = sums(fitted.samples.of(i), columns, row, data.fold[i])
        there = np.append(has[i], np.ones(by_knot.shape[2], np.bool_))
        g = np.where(there, sums_.score.sum(axis=0), 0.0)
        h = np.where(there & there[:, None], sums_.information.sum(axis=0), 0.0)
        g[:own] -= model.away[i] / std
        gives_way = np.linalg.solve(h[:own, :own] + np.diag(std**-2.0), h[:own, own:])
        score[i] = g[own:] - gives_way.T @ g[:own]
        information[i] = h[own:, own:] - h[own:, :own] @ gives_way
    return score, information
