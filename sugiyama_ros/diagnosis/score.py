"""Efficient scores: what every candidate would gain, before anything is fitted.

The change of the samples from the fitted model to a start of a candidate is a derivative by the strength, as a secant:
a derivative at zero says nothing of thresholds, limits, places and times. The score along it, less what the fitted
parameters take up, is a sum over blocks of each driver's time. All that the diagnosis says before a fit comes from
these sums: predicted gains, their distribution by chance, and who shows an effect.

References
----------
C. R. Rao, Proc. Camb. Philos. Soc. 44 (1948) 50; P. J. Bickel et al., Efficient and Adaptive Estimation for
Semiparametric Models (1993), chapter 2.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.diagnosis.candidates import OF_SOME, Candidate, Start, with_candidate
from sugiyama_ros.diagnosis.covariates import forces
from sugiyama_ros.effects.control import is_contaminated
from sugiyama_ros.fit.coordinates import coordinate, value
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.model import Model, PointwiseDensity, evaluate_each, moved
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.slopes import Column, column, density_slope, difference_steps, no_density

# A direction whose information is a smaller part of the largest one of its candidate says nothing.
_NOTHING = 1e-9
# Strengths of those who have it, in standard errors of a driver, and shares of drivers; two classes need some drivers.
_SIZES, _SHARES, _FEWEST = (1.0, 1.5, 2.0, 3.0, 4.5, 7.0, 10.0), (0.05, 0.1, 0.2, 0.35, 0.5, 0.75), 4


@dataclass(frozen=True, eq=False)
class Score:
    """The score of one candidate along K directions that are fitted together.

    candidate: The candidate; starts: The start at the end of each direction; the same one for all where the
    directions are derivatives; score: Efficient score of each of G blocks of a driver's time. Where ``information``
    is None: gain [nats] at the start, (G, K); information: Information of each block. None for a start that changes
    noises or decisions, whose gain is known there alone, (G, K, K); total: Information of all blocks, less what shared
    parameters take up; of each driver for individual values, (K, K) or (N, K, K); driver, time: Numbers of each
    block's driver, among those that were scored, and of its time, (G,); drivers: Number N of drivers that were scored.
    """

    candidate: Candidate
    starts: tuple[Start, ...]
    score: Array
    information: Array | None
    total: Array
    driver: Ints
    time: Ints
    drivers: int

    @property
    def is_one_sided(self) -> bool:
        """Whether only a positive score counts: for an effect that has a sign, along one start."""
        return self.candidate.has_sign and not self.candidate.individual and self.score.shape[1] == 1

    @property
    def gain(self) -> float:
        """Predicted gain [nats], in sample."""
        return float(self.gains(self.summed(self.score))[0])

    @property
    def strength(self) -> Array:
        """Strengths along the directions that gain most, (K,); of each driver, (N, K), for individual values."""
        if self.information is None:
            return np.ones(1)
        return np.asarray(np.einsum("...jk,...k->...j", _inverse(self.total), self.summed(self.score)[0]))

    @property
    def is_by_driver(self) -> bool:
        """Whether the gain depends on the score of each driver, and not on the sum alone."""
        return self.candidate.individual and self.information is not None

    def summed(self, score: Array, weights: Array | None = None) -> Array:
        """Sum scores (G, K) over the blocks, B times with weights (B, G), or once without.

        Returns (B, K), or (B, N, K) where the gain depends on each driver.
        """
        weights = np.ones((1, len(score))) if weights is None else weights
        if not self.is_by_driver:
            return np.asarray(weights @ score)
        own = [self.driver == i for i in range(self.drivers)]
        return np.stack([weights[:, mine] @ score[mine] for mine in own], axis=1)

    def gains(self, totals: Array) -> Array:
        """Return the gains (B,) [nats] that scores predict, (B, K) or (B, N, K)."""
        if self.information is None:
            return np.asarray(totals[:, 0])
        if self.is_one_sided:
            totals = np.maximum(totals, 0.0)
        inverse = _inverse(self.total)
        if self.candidate.individual:
            return np.asarray(0.5 * np.einsum("bnj,njk,bnk->b", totals, inverse, totals))
        return np.asarray(0.5 * np.einsum("bj,jk,bk->b", totals, inverse, totals))


@dataclass(frozen=True, eq=False)
class ScoreOfSome(Score):
    """The score of a candidate that only some drivers have, along one direction.

    A driver has it with a probability that all share: a mixture of two classes (G. McLachlan
    and D. Peel, Finite Mixture Models, 2000). The drivers of the candidate are those who more probably have it.
    """

    @property
    def is_one_sided(self) -> bool:
        """The mixture knows the sign itself."""
        return False

    @property
    def is_by_driver(self) -> bool:
        """The gain depends on the score of each driver."""
        return True

    @property
    def size(self) -> float:
        """Strength of the drivers who have it."""
        return float(self._best(self.summed(self.score))[1][0])

    @property
    def probability(self) -> Array:
        """Probability that each driver has it, (N,)."""
        totals = self.summed(self.score)
        _, (size,), (share,) = self._best(totals)
        ratio = np.exp(np.clip(self._ratios(totals[0, :, 0], size), -50.0, 50.0))
        return np.asarray(share * ratio / (1.0 - share + share * ratio))

    @property
    def strength(self) -> Array:
        """Expected strength of each driver, (N, 1)."""
        return np.asarray((self.size * self.probability)[:, None])

    def gains(self, totals: Array) -> Array:
        """Return the gains (B,) [nats] of the mixtures that fit scores (B, N, 1) best."""
        return self._best(totals)[0]

    def _ratios(self, totals: Array, size: Any) -> Array:
        """Logarithm of the likelihood ratio of drivers with a strength, for scores (..., N)."""
        return np.asarray(size * totals - 0.5 * size**2 * self.total[:, 0, 0])

    def _best(self, totals: Array) -> tuple[Array, Array, Array]:
        """Gain, strength and share of drivers of the best mixture, for scores (B, N, 1); (B,) each."""
        information = self.total[:, 0, 0]
        usual = 1.0 / np.sqrt(max(float(np.mean(information)), 1e-300))
        signs = (1.0,) if self.candidate.has_sign else (1.0, -1.0)
        gain, size, share = np.full((3, len(totals)), -np.inf)
        for one in (sign * k * usual for sign in signs for k in _SIZES):
            ratio = np.clip(self._ratios(totals[:, :, 0], one), -50.0, 50.0)
            for part in _SHARES:
                there = np.log1p(part * np.expm1(ratio)).sum(axis=1)
                better = there > gain
                gain[better], size[better], share[better] = there[better], one, part
        return gain, size, share


@dataclass(frozen=True, eq=False)
class GainOfSome(Score):
    """The gain at a start of a candidate that only some drivers have; a mixture of two classes, as `ScoreOfSome`."""

    @property
    def is_by_driver(self) -> bool:
        """The gain depends on the gain of each driver."""
        return True

    @property
    def probability(self) -> Array:
        """Probability that each driver has it, (N,)."""
        ratio = self.summed(self.score)[0, :, 0]
        _, share = self._best(ratio[None])
        return np.asarray(1.0 / (1.0 + (1.0 - share[0]) / share[0] * np.exp(-np.clip(ratio, -50.0, 50.0))))

    def gains(self, totals: Array) -> Array:
        """Return the gains (B,) [nats] of the best mixtures, for gains (B, N, 1) of all drivers."""
        return self._best(totals[:, :, 0])[0]

    def _best(self, ratio: Array) -> tuple[Array, Array]:
        """Gain and share of drivers of the best mixture, (B,) each; shares are tried, which counts as so many tests."""
        parts = np.array(_SHARES)[:, None, None]
        each = np.logaddexp(np.log1p(-parts), np.log(parts) + ratio).sum(axis=2)
        best = np.argmax(each, axis=0)
        return np.max(each, axis=0) - np.log(len(_SHARES)), np.array(_SHARES)[best]


def of_some(score: Score) -> Iterator[Score]:
    """Yield the score of a candidate that only some drivers have, along each direction of its score."""
    candidate = score.candidate
    if candidate.individual or candidate.is_random or candidate.kind != "effect" or score.drivers < _FEWEST:
        return
    if score.information is None:
        named = replace(candidate, name=candidate.name + OF_SOME)
        some = GainOfSome(named, score.starts, score.score, None, score.total, score.driver, score.time, score.drivers)
        who = tuple(np.flatnonzero(some.probability > 0.5).tolist())
        if 0 < len(who) < score.drivers:
            yield replace(some, candidate=replace(named, drivers=who))
        return
    per_driver = np.zeros((score.drivers, *score.total.shape))
    np.add.at(per_driver, score.driver, score.information)
    for j, start in enumerate(score.starts):
        part = slice(j, j + 1)
        one = ScoreOfSome(
            replace(candidate, name=candidate.name + OF_SOME),
            (start,),
            score.score[:, part],
            score.information[:, part, part],
            per_driver[:, part, part],
            score.driver,
            score.time,
            score.drivers,
        )
        who = tuple(np.flatnonzero(one.probability > 0.5).tolist())
        if 0 < len(who) < score.drivers:
            yield replace(one, candidate=replace(one.candidate, drivers=who))


class _Probe(NamedTuple):
    """A model at a distance ``step`` from the fitted one, along a direction of a candidate.

    group: directions with the same one are fitted together.
    """

    candidate: Candidate
    start: Start
    model: Model
    step: float
    group: tuple[object, ...]


class _Direction(NamedTuple):
    """A direction of a candidate: derivatives of each driver's samples; for noises, the model and the samples there."""

    candidate: Candidate
    start: Start
    columns: Sequence[Column]
    group: tuple[object, ...]
    there: tuple[Model, PointwiseDensity] | None


def scores(
    data: Recorded,
    fitted: JointFit,
    candidates: Sequence[Candidate],
    work: Executor,
    *,
    with_forces: bool = True,
) -> list[Score]:
    """Score candidates, and forces along all covariates, beside a fitted model."""
    nuisance = _Nuisance(data, fitted)
    together: dict[tuple[object, ...], list[_Direction]] = {}
    for one in _directions(data, fitted, candidates, work, with_forces=with_forces):
        together.setdefault(one.group, []).append(one)
    random = [parts[0] for parts in together.values() if parts[0].there]
    responded = [nuisance.responded(data, *one.there) for one in random if one.there]
    asked = [nuisance.score(parts) for parts in together.values() if not parts[0].there]
    for one, at in zip(random, evaluate_each(data.roughly, responded, work), strict=True):
        asked.append(nuisance.gain(one, at))
    found = [one for one in asked if one is not None]
    return [*found, *(some for one in found for some in of_some(one))]


def _directions(
    data: Recorded,
    fitted: JointFit,
    candidates: Sequence[Candidate],
    work: Executor,
    *,
    with_forces: bool,
) -> Iterator[_Direction]:
    """All directions of all candidates, then those of forces."""
    probes = [probe for c in candidates for probe in _probes(data, fitted.model, c)]
    drivers = range(data.drivers)
    there = evaluate_each(data.roughly, [probe.model for probe in probes], work)
    for (c, start, model, step, group), at in zip(probes, there, strict=True):
        # a change of the mean or of the variance; what changes bad measurements is judged by its gain
        columns = [
            (*column(fitted.samples.of(i), at.of(i), step, model.rows[i])[:2], no_density(data.samples))
            for i in drivers
        ]
        yield _Direction(c, start, columns, group, (model, at) if c.is_judged_at_starts and start else None)
    zeros = no_density(data.samples)
    for force, changes in forces(data, fitted, work) if with_forces else ():
        for change in changes:
            columns = [(change[i], zeros, zeros) for i in drivers]
            yield _Direction(force, force.starts[0], columns, (force.name,), None)


def _probes(data: Recorded, model: Model, c: Candidate) -> Iterator[_Probe]:
    """Where the filters run for a candidate: at its starts, each with one strength at a time, or a step away."""
    for number, start in enumerate(c.starts):
        if not start:
            steps = difference_steps(data, c.places)
            for k, step in zip(c.places, steps.tolist(), strict=True):
                rows = model.rows.copy()
                rows[:, [k]] = value(coordinate(rows[:, [k]], [k]) + step, [k])
                yield _Probe(c, {}, replace(with_candidate(model, c, {}), rows=rows), step, (c.name,))
            continue
        alone = [k for k in c.strengths if np.any(start[k])]
        if c.is_judged_at_starts or not alone:
            yield _Probe(c, start, with_candidate(model, c, start), 1.0, (c.name, number))
            continue
        where = tuple(repr(v) for place, v in start.items() if place not in c.strengths)
        for k in alone:
            one = {**start, **{other: 0.0 for other in c.strengths if other != k}}
            yield _Probe(c, one, with_candidate(model, c, one), 1.0, (c.name, *where))


class _Nuisance:
    """The fitted parameters, which respond to every candidate."""

    def __init__(self, data: Recorded, fitted: JointFit) -> None:
        self._fitted = fitted
        blocks = [
            np.unique(own[np.isfinite(at)]) for own, at in zip(data.block, fitted.samples.log_likelihood, strict=True)
        ]
        self._of = np.repeat(np.arange(len(blocks)), [len(b) for b in blocks]), np.concatenate(blocks)
        self._known = [_Driver(data, fitted, i, own) for i, own in enumerate(blocks)]
        shared = sum((one.shared for one in self._known), np.zeros((len(fitted.model.shared),) * 2))
        self._shared_inverse = np.linalg.pinv(shared)

    def score(self, parts: Sequence[_Direction]) -> Score | None:
        """The efficient score along directions that are fitted together; None where nothing is known of them."""
        count = len(parts)
        u, h, cross = [], [], []
        for place, one in enumerate(self._known):
            score, information, by_shared = one.efficient([p.columns[place] for p in parts])
            u.append(score)
            h.append(information)
            cross.append(by_shared)
        if not all(np.isfinite(one).all() for one in (*u, *h)):
            return None
        candidate = parts[0].candidate
        information = np.concatenate(h)
        gives_way = self._shared_inverse @ np.sum(cross, axis=0)
        shared_score = np.concatenate([one.score_of_shared for one in self._known])
        score = np.concatenate(u) - shared_score @ gives_way
        total = information.sum(axis=0) - np.sum(cross, axis=0).T @ gives_way
        if candidate.individual:
            total = np.array([one.sum(axis=0) for one in h]) + np.eye(count)
        size = np.diagonal(total, axis1=-2, axis2=-1)
        if not (size > _NOTHING).any():
            return None
        if candidate.is_single_event:
            # what was chosen among many places must gain more than the best one of them does by chance
            known, (strength, *_), start = float(total[0, 0]), candidate.places, dict(parts[0].start)
            change = float(score.sum()) / known
            start[strength] = change * start[strength]
            gain, where = 0.5 * known * change**2 - candidate.look_elsewhere_nats, np.zeros(1, np.int64)
            return Score(candidate, (start,), np.array([[gain]]), None, total, where, where, 1)
        return Score(
            candidate,
            tuple(p.start for p in parts),
            score,
            information,
            total,
            self._of[0],
            self._of[1],
            len(self._known),
        )

    def responded(self, data: Recorded, model: Model, at: PointwiseDensity) -> Model:
        """A model at a start that changes noises, after one step of the drivers' own parameters."""
        change = np.zeros((data.drivers, len(model.individual)))
        for known in self._known:
            change[known.number, : known.own] = known.response(at, model.rows[known.number])
        return moved(data, model, change, np.zeros(len(model.shared)))

    def gain(self, one: _Direction, responded: PointwiseDensity) -> Score | None:
        """The gain at a start that changes noises: of each driver there, or after the own parameters have responded."""
        assert one.there is not None
        found = []
        for known in self._known:
            before = self._fitted.samples.log_likelihood[known.number]
            ways = [at.log_likelihood[known.number] - before for at in (one.there[1], responded)]
            by_block = [known.over_blocks(way[None])[:, 0] for way in ways]
            found.append(max(by_block, key=lambda sums: float(np.nan_to_num(sums, nan=-np.inf).sum())))
        values = np.concatenate(found)[:, None]
        if not np.isfinite(values).all():
            return None
        return Score(one.candidate, (one.start,), values, None, np.ones((1, 1)), *self._of, len(self._known))


class _Driver:
    """The samples of one driver, with the response of the driver's own parameters."""

    def __init__(self, data: Recorded, fitted: JointFit, i: int, blocks: Ints) -> None:
        self.number, model, self.own = i, fitted.model, len(fitted.model.individual)
        self._columns = fitted.slopes[i].columns
        self._row, self._at = model.rows[i], fitted.samples.of(i)
        self._scored = np.isfinite(self._at.log_likelihood)
        self._block = np.searchsorted(blocks, data.block[i][self._scored])
        self._count = len(blocks)
        has = np.concatenate([np.ones(self.own, np.bool_), model.has[i]])
        self._slope, self._roots = self._derivatives(self._columns)
        self._slope[~has] = 0.0
        self._roots[~has] = 0.0
        h = self._roots.reshape(len(has), -1) @ self._roots.reshape(len(has), -1).T
        prior = np.diag(np.array(model.prior_std) ** -2.0)
        own = self.own
        self._inverse = np.linalg.inv(h[:own, :own] + prior)
        self._takes = self._inverse @ h[:own, own:]
        self.shared = h[own:, own:] - h[own:, :own] @ self._takes
        # the prior counts evenly in all blocks
        g = self.over_blocks(self._slope, is_scored=True)
        away = model.away[i] / np.array(model.prior_std) / max(self._count, 1)
        self._own_score = g[:, :own] - away
        self.score_of_shared = g[:, own:] - self._own_score @ self._takes

    def _derivatives(self, columns: Sequence[Column]) -> tuple[Array, Array]:
        """Slopes of the log-likelihood (K, T'), and roots of the information (K, 2, T') of samples that count."""
        dy, dvar, direct = (self._stacked(columns, part) for part in range(3))
        y, var, _ = self._at
        slope = (density_slope(y, var, dy, dvar, self._row) + direct)[:, self._scored]
        if is_contaminated(self._row):
            return slope, np.stack([slope, np.zeros_like(slope)], axis=1)
        var = var[self._scored]
        by_mean, by_var = dy[:, self._scored] / np.sqrt(var), dvar[:, self._scored] / (np.sqrt(2.0) * var)
        return slope, np.stack([by_mean, by_var], axis=1)

    def _stacked(self, columns: Sequence[Column], part: int) -> Array:
        """One part of columns, (K, T)."""
        return np.array([c[part] for c in columns], np.float64).reshape(len(columns), len(self._scored))

    def over_blocks(self, values: Array, *, is_scored: bool = False) -> Array:
        """Sum values (K, T) of samples that count over the blocks: (B, K)."""
        kept = values if is_scored else values[:, self._scored]
        return np.array([np.bincount(self._block, row, self._count) for row in kept]).reshape(len(kept), -1).T

    def efficient(self, columns: Sequence[Column]) -> tuple[Array, Array, Array]:
        """Score (B, K) and information (B, K, K) of each block, and information (S, K) shared with the parameters S."""
        slope, roots = self._derivatives(columns)
        count, own = len(columns), self.own
        known, new = (r.reshape(len(r), -1) for r in (self._roots, roots))
        cross = known @ new.T
        takes = self._inverse @ cross[:own]
        by_shared = cross[own:] - self._takes.T @ cross[:own]
        # what is left of each direction, sample by sample
        left = roots - np.einsum("ok,ojt->kjt", takes, self._roots[:own])
        products = np.einsum("ajt,bjt->abt", left, left).reshape(count * count, -1)
        information = self.over_blocks(products, is_scored=True).reshape(self._count, count, count)
        return self.over_blocks(slope, is_scored=True) - self._own_score @ takes, information, by_shared

    def response(self, at: PointwiseDensity, row: Array) -> Array:
        """Change of the coordinates of the driver's own parameters (I,) at a start, to first order."""
        y, var, density = at.of(self.number)
        dy, dvar = (self._stacked(self._columns[: self.own], part) for part in range(2))
        slope = density_slope(y, var, dy, dvar, row)[:, np.isfinite(density) & self._scored].sum(axis=1)
        return np.asarray(self._inverse @ slope)


def _inverse(information: Array) -> Array:
    """Inverse of information (..., K, K), without directions of which nothing is known."""
    size = np.diagonal(information, axis1=-2, axis2=-1)
    scale = np.sqrt(np.maximum(size, _NOTHING * np.maximum(size.max(axis=-1, keepdims=True), 1e-300)))
    relative = information / (scale[..., :, None] * scale[..., None, :])
    inverse = np.linalg.inv(relative + 1e-6 * np.eye(information.shape[-1]))
    return np.asarray(inverse / (scale[..., :, None] * scale[..., None, :]))
