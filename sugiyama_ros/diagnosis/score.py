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

from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.diagnosis.candidates import OF_SOME, Candidate, Start, with_candidate
from sugiyama_ros.diagnosis.forces import forces
from sugiyama_ros.fit.coordinates import coordinate, value
from sugiyama_ros.fit.efficient import EfficientDriver
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.model import Model, PointwiseDensity, evaluate_each, moved
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.response import Response
from sugiyama_ros.fit.slopes import Column, column, difference_steps, no_density

# A direction whose information is a smaller part of the largest one of its candidate says nothing.
_NOTHING = 1e-9
# Number of places or moments of a candidate, of all that are tried, at which the filter runs.
_PLACES = 3
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
        ratio = np.exp(np.clip(_ratios(totals[0, :, 0], self.total[:, 0, 0], size), -50.0, 50.0))
        return np.asarray(share * ratio / (1.0 - share + share * ratio))

    @property
    def strength(self) -> Array:
        """Expected strength of each driver, (N, 1)."""
        return np.asarray((self.size * self.probability)[:, None])

    def gains(self, totals: Array) -> Array:
        """Return the gains (B,) [nats] of the mixtures that fit scores (B, N, 1) best."""
        return self._best(totals)[0]

    def _best(self, totals: Array) -> tuple[Array, Array, Array]:
        """Gain, strength and share of drivers of the best mixture, for scores (B, N, 1); (B,) each."""
        information = self.total[:, 0, 0]
        usual = 1.0 / np.sqrt(max(float(np.mean(information)), 1e-300))
        signs = (1.0,) if self.candidate.has_sign else (1.0, -1.0)
        gain, size, share = np.full((3, len(totals)), -np.inf)
        # single precision: half of the time
        most = float(np.finfo(np.float32).max)
        own, known = (np.clip(one, -most, most).astype(np.float32) for one in (totals[:, :, 0], information))
        for one in (sign * k * usual for sign in signs for k in _SIZES):
            ratio = np.clip(_ratios(own, known, np.float32(one)), np.float32(-50.0), np.float32(50.0))
            for part in _SHARES:
                there = np.log1p(part * np.expm1(ratio)).sum(axis=1)
                better = there > gain
                gain[better], size[better], share[better] = there[better], one, part
        return gain, size, share


def _ratios(totals: Any, information: Any, size: Any) -> Array:
    """Logarithm of the likelihood ratio of drivers with a strength, for scores (..., N) and information (N,)."""
    return np.asarray(size * (totals - np.float32(0.5) * size * information))


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


class Direction(NamedTuple):
    """A direction of a candidate: derivatives of each driver's samples; for noises, the model and the samples there.

    group: directions with the same one are fitted together.
    """

    candidate: Candidate
    start: Start
    columns: Sequence[Column]
    group: tuple[object, ...]
    there: tuple[Model, PointwiseDensity] | None


def scores(data: Recorded, fitted: JointFit, along: Iterable[Direction], work: Executor) -> list[Score]:
    """Score candidates along their directions beside a fitted model.

    Derivatives may belong to a model before, which hardly changes them: any direction gives a valid score. Those of the
    best places and moments, which come from the response to first order, are computed again by the filter.
    """
    nuisance = _Nuisance(data, fitted)
    together: dict[tuple[object, ...], list[Direction]] = {}
    for one in along:
        together.setdefault(one.group, []).append(one)
    random = [parts[0] for parts in together.values() if parts[0].there]
    responded = [nuisance.responded(data, *one.there) for one in random if one.there]
    found = {group: _forms(nuisance.score(parts)) for group, parts in together.items() if not parts[0].there}
    for one, at in zip(random, evaluate_each(data.roughly, responded, work), strict=True):
        found[one.group] = _forms(nuisance.gain(one, at))
    near = _best_places(found)
    for group, parts in zip(near, _filtered(data, fitted, [together[group] for group in near], work), strict=True):
        found[group] = _forms(nuisance.score(parts))
    return [one for forms in found.values() for one in forms]


def _forms(score: Score | None) -> list[Score]:
    """A score, and those of its candidate for some drivers alone."""
    return [] if score is None else [score, *of_some(score)]


def _best_places(found: Mapping[tuple[object, ...], Sequence[Score]]) -> list[tuple[object, ...]]:
    """The groups with the best places or moments of each candidate that acts somewhere."""
    best: dict[str, list[tuple[float, tuple[object, ...]]]] = {}
    for group, forms in found.items():
        if forms and forms[0].candidate.is_somewhere:
            best.setdefault(forms[0].candidate.name, []).append((max(one.gain for one in forms), group))
    return [group for own in best.values() for _, group in sorted(own, key=lambda one: -one[0])[:_PLACES]]


def _filtered(
    data: Recorded, fitted: JointFit, groups: Sequence[Sequence[Direction]], work: Executor
) -> Iterator[list[Direction]]:
    """Yield groups of directions with derivatives from passes of the filter."""
    models = [with_candidate(fitted.model, one.candidate, one.start) for parts in groups for one in parts]
    there = zip(models, evaluate_each(data.roughly, models, work), strict=True)
    for parts in groups:
        yield [
            one._replace(columns=_columns(fitted, at, 1.0, model.rows))
            for one, (model, at) in zip(parts, there, strict=False)
        ]


def _columns(fitted: JointFit, at: PointwiseDensity, step: float, rows: Array) -> list[Column]:
    """Derivatives of mean and variance; what changes bad measurements is judged by its gain."""
    nothing = no_density(at.log_likelihood.shape[1])
    return [(*column(fitted.samples.of(i), at.of(i), step, row)[:2], nothing) for i, row in enumerate(rows)]


def directions(
    data: Recorded, fitted: JointFit, candidates: Sequence[Candidate], work: Executor, *, with_forces: bool = False
) -> Iterator[Direction]:
    """Yield all directions of candidates, then those of forces along all covariates.

    What acts at some place or moment is scored at many of them: its directions come from the response to what drivers
    do otherwise along the filtered path, and those of everything else from passes of the filter.
    """
    probes = [probe for c in candidates for probe in _probes(data, fitted.model, c)]
    far = [probe for probe in probes if not probe.candidate.is_somewhere]
    there = iter(evaluate_each(data.roughly, [one.model for one in far], work))
    response = Response(data, fitted, work) if with_forces or len(far) < len(probes) else None
    for c, start, model, step, group in probes:
        if response and c.is_somewhere:
            yield Direction(c, start, _moved(response.to_rows(model.rows)), group, None)
            continue
        at = next(there)
        columns = _columns(fitted, at, step, model.rows)
        yield Direction(c, start, columns, group, (model, at) if c.is_judged_at_starts and start else None)
    for force, changes in forces(data, response) if response and with_forces else ():
        yield from (Direction(force, force.starts[0], _moved(one), (force.name,), None) for one in changes)


def _moved(change: Array) -> list[Column]:
    """Derivatives of the mean alone, (N, T)."""
    return [(one, np.zeros_like(one), np.zeros_like(one)) for one in change]


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
        self._known = [EfficientDriver(data, fitted, i, own) for i, own in enumerate(blocks)]
        shared = sum((one.shared for one in self._known), np.zeros((len(fitted.model.shared),) * 2))
        self._shared_inverse = np.linalg.pinv(shared)

    def score(self, parts: Sequence[Direction]) -> Score | None:
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

    def gain(self, one: Direction, responded: PointwiseDensity) -> Score | None:
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


def _inverse(information: Array) -> Array:
    """Inverse of information (..., K, K), without directions of which nothing is known."""
    size = np.diagonal(information, axis1=-2, axis2=-1)
    scale = np.sqrt(np.maximum(size, _NOTHING * np.maximum(size.max(axis=-1, keepdims=True), 1e-300)))
    relative = information / (scale[..., :, None] * scale[..., None, :])
    inverse = np.linalg.inv(relative + 1e-6 * np.eye(information.shape[-1]))
    return np.asarray(inverse / (scale[..., :, None] * scale[..., None, :]))
