"""Classes of drivers who share their parameters, for recordings that are too short to fit each driver alone.

The classes are a mixture model (latent classes). The log-likelihood of a driver is ln sum_c sum_g pi_c p(g | entry) exp
L(theta_c, g): each class c has a share pi_c and parameters theta_c, and the noises of the measurement belong to the
recording. A goal g is what a driver intends: to drive through, or to slow down for an exit. It is an effect with known
values, whose share depends on where the driver comes in. The search is Newton's method, whose information is the one
about the complete data, less the one that is missing because nobody sees the class of a driver. It is damped towards
the EM algorithm, which has the complete information alone.

References
----------
Dempster, Laird and Rubin, J. R. Stat. Soc. B 39 (1977) 1. Louis, J. R. Stat. Soc. B 44 (1982) 226. Sandwich estimate:
Huber, Proc. Fifth Berkeley Symp. Math. Stat. Prob. 1 (1967) 221.
"""

import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.special import logsumexp, softmax

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.coordinates import (
    ENOUGH_CAUSAL,
    LONGEST,
    Damping,
    coordinate,
    limits,
    value,
    with_open_ends,
)
from sugiyama_ros.fit.driver import SIGMAS, end_of_profile, untouched
from sugiyama_ros.fit.driver_types import OF_RECORDING, Classes
from sugiyama_ros.fit.goals import Goals, goals_of
from sugiyama_ros.fit.joint import LARGEST_STD, fit_base
from sugiyama_ros.fit.model import Model, PointwiseDensity, evaluate_each
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.slopes import difference_steps, slopes_of

# Largest size of the logit of a share: a share is never 0 for good.
_CERTAIN = 7.0
# A driver who belongs to a class with less than this probability says nothing about it.
_LEAST_PROBABILITY = 1e-3
_DAMPING = Damping(least=1e-3, least_after_failure=0.1, most=1e4, start=0.1)
# Predicted gain [nats] at which the searches from the starts end.
_ROUGHLY = 1.0
# Maximum number of steps of a search, and number of starts.
_STEPS, _STARTS = 40, 4
# Number of drivers of whom a start is sought, at most.
_SOME = 100


class _Layout(NamedTuple):
    """Where everything stands in one vector (D,): parameters of classes, noises of recordings, logits of shares.

    A component j is a class with a goal; there are J = K G of them. typical: (width,), row of a driver of whom nothing
    is known; own, noise: places in a row of the parameters of a class, and of a recording; recording: (N,), number of
    the recording of each driver; may: (N, J), whether a driver may belong to a component.
    """

    typical: Array
    own: tuple[int, ...]
    noise: tuple[int, ...]
    recording: Ints
    goals: Goals
    may: Mask

    @property
    def components(self) -> int:
        return self.may.shape[1]

    @property
    def classes(self) -> int:
        return self.components // len(self.goals.names)

    @property
    def places(self) -> list[int]:
        return [*self.own, *self.noise]

    @property
    def ends(self) -> tuple[int, int, int, int]:
        """Ends of the classes' parameters, the recordings' noises, and the logits of classes and of goals."""
        first = self.classes * len(self.own)
        second = first + (int(self.recording.max()) + 1) * len(self.noise)
        third = second + self.classes - 1
        return first, second, third, third + len(self.goals.entries) * (len(self.goals.names) - 1)

    def columns(self, k: int) -> Ints:
        """Entries (N, P) of the vector that are the parameters of each driver in class k."""
        own = k * len(self.own) + np.arange(len(self.own))
        noise = self.ends[0] + self.recording[:, None] * len(self.noise) + np.arange(len(self.noise))
        return np.concatenate([np.tile(own, (len(self.recording), 1)), noise], axis=1)

    def rows(self, x: Array, j: int) -> Array:
        """Rows (N, width) of the drivers if they belong to component j."""
        k, g = divmod(j, len(self.goals.names))
        rows = np.tile(self.typical, (len(self.recording), 1))
        rows[:, self.places] = value(x[self.columns(k)], self.places)
        return np.where(self.goals.row[g] != 0.0, self.goals.row[g], rows)

    def shares(self, x: Array) -> tuple[Array, Array]:
        """Shares (K,) of the classes, and (E, G) of the goals at each entry."""
        _, second, third, _ = self.ends
        goals = x[third:].reshape(len(self.goals.entries), -1)
        return softmax(np.append(0.0, x[second:third])), softmax(np.pad(goals, ((0, 0), (1, 0))), axis=1)

    def weights(self, x: Array) -> Array:
        """Log-probabilities (N, J) of the components before anything is seen of a driver but the entry."""
        share, of_goals = self.shares(x)
        both = np.log(share)[:, None] + np.log(of_goals)[self.goals.entry][:, None, :]
        return np.where(self.may, both.reshape(len(self.may), -1), -np.inf)

    def slopes_of_weights(self, x: Array) -> tuple[Array, Array]:
        """Derivatives (N, J, L) of the log-probabilities by the L logits, and their information (N, L, L)."""
        share, of_goals = self.shares(x)
        _, second, third, end = self.ends
        goals, drivers = len(self.goals.names), len(self.may)
        each = np.zeros((drivers, self.classes, goals, end - second))
        each[..., : third - second] = (np.eye(self.classes) - share)[:, None, 1:]
        by_goal = np.eye(goals)[None] - of_goals[self.goals.entry][:, None]
        for e in range(len(self.goals.entries)):
            first = third - second + e * (goals - 1)
            here = self.goals.entry == e
            each[here, :, :, first : first + goals - 1] = by_goal[here][:, None, :, 1:]
        slopes = each.reshape(drivers, self.components, -1)
        expected = share[:, None] * of_goals[self.goals.entry][:, None, :]
        return slopes, np.einsum("nj,nja,njb->nab", expected.reshape(drivers, -1), slopes, slopes)

    def vector(self, centres: Array, noise: Array) -> Array:
        """Vector of classes and goals with equal shares; centres: (K, own), noise: (R, noise), coordinates."""
        return np.concatenate([centres.ravel(), noise.ravel(), np.zeros(self.ends[3] - self.ends[1])])


class _Mixture(NamedTuple):
    """A point of a search: the vector, the predictions of each class, log-likelihoods (N,), probabilities (N, K).

    ahead: (N,), class that each driver counts as in front of another driver.
    """

    x: Array
    ahead: Ints
    models: list[Model]
    samples: list[PointwiseDensity]
    log_likelihood: Array
    probability: Array


def find_classes(
    data: Recorded,
    count: int,
    estimated: Sequence[int],
    work: Executor,
    *,
    seed: int = 0,
    known: Sequence[str] = (),
    goals: Goals | None = None,
) -> Classes:
    """Divide drivers into ``count`` classes; ``estimated``: places of the parameters in a row.

    known: class of each driver, if the classes are known; there are as many classes as names; goals: what the drivers
    may intend, if it is not the same for all.
    """
    search = search_of(data, count, estimated, work, known, goals)
    at = search.maximise(search.start(fit_base(data, estimated, work).model.rows, seed))
    return search.result(at, sorted(set(known)))


def search_of(
    data: Recorded,
    count: int,
    estimated: Sequence[int],
    work: Executor,
    known: Sequence[str] = (),
    goals: Goals | None = None,
) -> "Search":
    """Return the search for classes; arguments as for ``find_classes``."""
    if known:
        may = np.array([[name == own for name in sorted(set(known))] for own in known])
    else:
        may = np.ones((data.drivers, count), np.bool_)
    return Search(data, _layout(data, estimated, may, goals), work)


def predicted_by(search: "Search", at: "_Mixture", data: Recorded, seen: Ints, out: Ints) -> Array:
    """Return the log-likelihood (n,) of the drivers ``out`` under classes that were fitted to the drivers ``seen``.

    data: all drivers; in a recording without a driver of the fit, the noises are those of the largest recording.
    """
    names = [one.recording for one in data.vicinity.names]
    known, count = np.unique([names[i] for i in seen], return_counts=True)
    number = {name: k for k, name in enumerate(known.tolist())}
    layout = search.layout._replace(
        recording=np.array([number.get(name, int(count.argmax())) for name in names]),
        goals=goals_of((), [""] * data.drivers),
        may=np.ones((data.drivers, search.layout.classes), np.bool_),
    )
    ahead = np.full(data.drivers, int(at.probability.sum(axis=0).argmax()))
    ahead[seen] = at.probability.argmax(axis=1)
    return Search(data, layout, search.work, out.tolist()).at(at.x, ahead).log_likelihood


def _layout(data: Recorded, estimated: Sequence[int], may: Mask, goals: Goals | None = None) -> _Layout:
    """The layout of classes (N, K) to which drivers may belong, with their goals."""
    goals = goals_of((), [""] * data.drivers) if goals is None else goals
    names = [one.recording for one in data.vicinity.names]
    return _Layout(
        typical=ROW.with_effects(data.even.typical(data.speed)),
        own=tuple(k for k in estimated if k not in OF_RECORDING),
        noise=tuple(k for k in estimated if k in OF_RECORDING),
        recording=np.unique(names, return_inverse=True)[1],
        goals=goals,
        may=(may[:, :, None] & goals.may[:, None, :]).reshape(data.drivers, -1),
    )


class Search:
    """The search for the vector of a layout, by the drivers in ``who``."""

    def __init__(self, data: Recorded, layout: _Layout, work: Executor, who: Sequence[int] | None = None) -> None:
        self.data, self.layout, self.work = data, layout, work
        self.who = np.arange(data.drivers) if who is None else np.asarray(who)
        low, high = np.sort(coordinate(limits(layout.places, data.lower, data.upper), layout.places), axis=0)
        self.low, self.high = np.full((2, layout.ends[3]), [[-_CERTAIN], [_CERTAIN]])
        for k in range(layout.classes):
            columns = layout.columns(k)
            self.low[columns], self.high[columns] = low, high

    def at(self, x: Array, ahead: Ints) -> _Mixture:
        """The point at a vector; ``ahead``: as in a point."""
        layout, own = self.layout, tuple(self.layout.places)
        each = [layout.rows(x, j) for j in range(layout.components)]
        leaders = np.array(each)[ahead, np.arange(self.data.drivers)]
        models = [Model(rows, own, (), (LARGEST_STD,) * len(own), leaders) for rows in each]
        samples = evaluate_each(self.data, models, self.work, self.who.tolist())
        density = np.array([np.nansum(one.log_likelihood[self.who], axis=1) for one in samples]).T
        joint = density + layout.weights(x)[self.who]
        total = logsumexp(joint, axis=1)
        return _Mixture(x, ahead, models, samples, total, np.exp(joint - total[:, None]))

    def derivatives(self, at: _Mixture) -> tuple[Array, Array, Array]:
        """Gradient (N, D) of each driver, complete information (D, D), and the information that is missing."""
        layout, drivers, size = self.layout, len(self.who), len(at.x)
        each, complete = np.zeros((drivers, layout.components, size)), np.zeros((size, size))
        steps = np.tile(difference_steps(self.data, layout.places), (self.data.drivers, 1))
        for j, (model, samples) in enumerate(zip(at.models, at.samples, strict=True)):
            near = np.flatnonzero(at.probability[:, j] > _LEAST_PROBABILITY)
            who, columns = self.who[near], layout.columns(j // len(layout.goals.names))[self.who[near]]
            found = slopes_of(self.data, model, samples, steps, self.work, who.tolist())
            for i, cols, s in zip(near, columns, found, strict=True):
                each[i, j, cols] = s.score.sum(axis=0)
                complete[np.ix_(cols, cols)] += at.probability[i, j] * s.information.sum(axis=0)
        logits, (slopes, information) = slice(layout.ends[1], None), layout.slopes_of_weights(at.x)
        each[:, :, logits] = slopes[self.who]
        complete[logits, logits] = information[self.who].sum(axis=0)
        expected = np.einsum("nk,nkd->nd", at.probability, each)
        missing = np.einsum("nk,nka,nkb->ab", at.probability, each, each) - expected.T @ expected
        return expected, complete, missing

    def maximise(self, here: _Mixture, enough: float = ENOUGH_CAUSAL) -> _Mixture:
        """Return the point at the maximum of the log-likelihood.

        Drivers ahead have the class that is likeliest so far, as long as the log-likelihood rises by it. ``enough``:
        predicted gain [nats] of a step at which the search ends.
        """
        damping, known, follows = _DAMPING.start, self.derivatives(here), True
        for _ in range(_STEPS):
            gradient, complete, missing = known[0].sum(axis=0), *known[1:]
            step = _step(gradient, complete, missing, damping)
            x = np.clip(here.x + np.clip(step, -LONGEST, LONGEST), self.low, self.high)
            if 0.5 * gradient @ (x - here.x) < enough or damping > _DAMPING.most:
                break
            ahead = here.ahead.copy()
            if follows:
                ahead[self.who] = here.probability.argmax(axis=1)
            there = self.at(x, ahead)
            is_better = bool(there.log_likelihood.sum() > here.log_likelihood.sum())
            if not is_better and (ahead != here.ahead).any():
                follows = False
                continue
            damping = float(_DAMPING.updated(damping, is_better, not is_better))
            if is_better:
                here, follows = there, True
                known = self.derivatives(here)
        return here

    def start(self, drivers: Array, seed: int) -> _Mixture:
        """The start next to the highest maximum that some of the drivers lead to.

        The searches begin at centres of clusters of the rows (N, width) of drivers who are draws from one population.
        """
        layout = self.layout
        points = coordinate(drivers[:, layout.own], layout.own)
        centre, scale = np.median(points, axis=0), np.maximum(points.std(axis=0), 1e-6)
        noise = np.array(
            [
                np.median(coordinate(drivers[layout.recording == r][:, layout.noise], layout.noise), axis=0)
                for r in range(int(layout.recording.max()) + 1)
            ]
        )
        goals = len(layout.goals.names)
        may: Mask = np.asarray(layout.may.reshape(len(layout.may), -1, goals).any(axis=2))
        if not may.all():
            centres = np.array([points[who].mean(axis=0) for who in may.T])
            return self.at(layout.vector(centres, noise), goals * may.argmax(axis=1))
        # a driver who is far from all others must not be a class of their own
        near = np.clip((points - centre) / scale, -2.0, 2.0)
        some = Search(self.data.roughly, layout, self.work, range(0, self.data.drivers, -(-self.data.drivers // _SOME)))
        tried = []
        for k in range(_STARTS):
            rng = np.random.default_rng(seed + k)
            with np.errstate(invalid="ignore"), warnings.catch_warnings():
                # where several drivers are alike, a cluster may be empty: its centre stays where it began
                warnings.simplefilter("ignore", UserWarning)
                centres, label = kmeans2(near, layout.classes, minit="++", rng=rng, missing="warn")
            x = layout.vector(centre + centres * scale, noise)
            tried.append(some.maximise(some.at(x, goals * label.astype(np.int64)), _ROUGHLY))
        best = max(tried, key=lambda point: float(point.log_likelihood.sum()))
        return self.at(best.x, best.ahead)

    def result(self, at: _Mixture, names: Sequence[str] = ()) -> Classes:
        """The classes at the maximum, the largest one first; ``names``: of the classes, if they are known."""
        layout = self.layout
        each, complete, missing = self.derivatives(at)
        observed = complete - missing
        covariance = np.linalg.pinv(observed, hermitian=True)
        # the sandwich estimate, if drivers pull in different directions by more than the information allows
        scatter = np.square((each - each.mean(axis=0)) @ covariance).sum(axis=0) * len(each) / max(len(each) - 1, 1)
        errors = np.maximum(_errors(observed), np.sqrt(scatter))
        (share, of_goals), goals = layout.shares(at.x), len(layout.goals.names)
        rows = np.array([model.rows[0] for model in at.models[::goals]])
        interval = np.stack([rows, rows], axis=-1)
        for k in range(layout.classes):
            columns = layout.columns(k)[0]
            own, of_class = len(layout.own), columns[: len(layout.own)]
            # what the other classes, the noises and the shares add to the errors of the class alone
            alone = _errors(observed[np.ix_(of_class, of_class)])
            away = np.tile(np.array([-SIGMAS, SIGMAS]), (len(columns), 1)) * errors[columns, None]
            wider = np.divide(errors[of_class], alone, out=np.ones(own), where=np.isfinite(alone))
            away[:own] = _ClassAlone(self, at, k).ends(alone) * wider[:, None]
            interval[k, layout.places] = self._interval(at.x[columns], away, columns)
        order = np.argsort(-share)
        probability = at.probability.reshape(len(self.who), layout.classes, goals)
        # in the likeliest class, and without a goal, which nobody knows for sure
        likeliest = goals * probability.sum(axis=2).argmax(axis=1)
        own_rows = np.array([at.models[j].rows[i] for i, j in zip(self.who, likeliest, strict=True)])
        return Classes(
            names=tuple(names[k] for k in order) if names else (),
            rows=rows[order],
            interval=interval[order],
            share=share[order],
            probability=probability.sum(axis=2)[:, order],
            own_rows=own_rows,
            log_likelihood=at.log_likelihood,
            goals=layout.goals.names,
            goal_probability=probability.sum(axis=1),
            entries=layout.goals.entries,
            goal_share=of_goals,
        )

    def _interval(self, x: Array, away: Array, columns: Ints) -> Array:
        """Intervals (P, 2) of the parameters of a class, from the distances (P, 2) of their ends in coordinates."""
        places, low, high = self.layout.places, self.low[columns, None], self.high[columns, None]
        ends = value(np.clip(x[:, None] + away, low, high).T, places).T
        return with_open_ends(np.sort(ends, axis=-1), places, limits(places, self.data.lower, self.data.upper))


class _ClassAlone:
    """One class of a mixture whose other parameters stay as they are: intervals from its profile likelihood."""

    def __init__(self, search: Search, at: _Mixture, k: int) -> None:
        layout, goals = search.layout, len(search.layout.goals.names)
        mine = slice(k * goals, (k + 1) * goals)
        near = np.flatnonzero(at.probability[:, mine].sum(axis=1) > _LEAST_PROBABILITY)
        self.data, self.work, self.who = search.data.roughly, search.work, search.who[near]
        self.places, self.models, columns = layout.own, at.models[mine], layout.columns(k)[0, : len(layout.own)]
        self.x, self.low, self.high = at.x[columns], search.low[columns], search.high[columns]
        self.weights = layout.weights(at.x)[self.who, mine]
        others = np.delete(at.probability[near], range(layout.components)[mine], axis=1).sum(axis=1)
        self.others = at.log_likelihood[near] + np.log(np.maximum(others, 1e-300))
        self.height = float(at.log_likelihood[near].sum())
        self.steps = np.tile(difference_steps(self.data, self.places), (self.data.drivers, 1))

    def ends(self, errors: Array) -> Array:
        """Distances (P, 2) from the maximum to the ends of 95 % intervals, in coordinates; errors: (P,), a guess."""
        found = np.zeros((len(self.x), 2))
        for j, error in enumerate(errors):
            for side, sign in enumerate((-1.0, 1.0)):
                furthest = float(self.high[j] - self.x[j] if sign > 0.0 else self.x[j] - self.low[j])
                found[j, side] = sign * end_of_profile(self._fall(j, sign), float(error), max(0.0, furthest))
        return found

    def _fall(self, j: int, sign: float) -> Callable[[float], float]:
        """Square root of twice the fall of the profile, at a distance from the maximum in coordinate j."""
        last, others = self.x.copy(), np.arange(len(self.x)) != j

        def fall(distance: float) -> float:
            last[j] = self.x[j] + sign * distance
            height = self._climb(last, others)
            return float(np.sqrt(2.0 * max(0.0, self.height - height)))

        return fall

    def _climb(self, x: Array, free: Mask) -> float:
        """Move the free coordinates of x (P,) to the maximum, in place; returns the log-likelihood there."""
        height, damping = -np.inf, _DAMPING.start
        there = x.copy()
        for _ in range(_STEPS):
            models, samples, probability, risen = self._at(there)
            is_better = risen > height
            damping = float(_DAMPING.updated(damping, is_better, not is_better))
            if is_better:
                x[:], height = there, risen
                gradient, complete, missing = self._derivatives(models, samples, probability, free)
            step = np.clip(_step(gradient, complete, missing, damping), -LONGEST, LONGEST)
            there = x.copy()
            there[free] = np.clip(x[free] + step, self.low[free], self.high[free])
            if 0.5 * gradient @ (there[free] - x[free]) < ENOUGH_CAUSAL or damping > _DAMPING.most:
                break
        return height

    def _derivatives(
        self, models: Sequence[Model], samples: Sequence[PointwiseDensity], probability: Array, free: Mask
    ) -> tuple[Array, Array, Array]:
        """Gradient, complete and missing information by the free coordinates; probability: (n, G) of the components."""
        count = int(free.sum())
        score, complete = np.zeros((*probability.shape, count)), np.zeros((count, count))
        for g, (model, predicted) in enumerate(zip(models, samples, strict=True)):
            for i, s in enumerate(slopes_of(self.data, model, predicted, self.steps, self.work, self.who.tolist())):
                score[i, g] = s.score.sum(axis=0)[free]
                complete += probability[i, g] * s.information.sum(axis=0)[np.ix_(free, free)]
        expected = np.einsum("ng,nga->na", probability, score)
        both = np.einsum("ng,nga,ngb->ab", probability, score, score)
        return expected.sum(axis=0), complete, both - expected.T @ expected

    def _at(self, x: Array) -> tuple[list[Model], list[PointwiseDensity], Array, float]:
        """Models and predictions of the class with each goal, probabilities (n, G), and the log-likelihood."""
        models = []
        for one in self.models:
            rows = one.rows.copy()
            rows[:, self.places] = value(x, self.places)
            prior = (LARGEST_STD,) * len(self.places)
            models.append(replace(one, rows=rows, individual=self.places, prior_std=prior))
        samples = evaluate_each(self.data, models, self.work, self.who.tolist())
        density = np.array([np.nansum(one.log_likelihood[self.who], axis=1) for one in samples]).T
        joint = self.weights + density
        total = logsumexp(np.column_stack([self.others, joint]), axis=1)
        return models, samples, np.exp(joint - total[:, None]), float(total.sum())


def _errors(information: Array) -> Array:
    """Standard deviations (D,) from an information (D, D) about coordinates; infinite where it says nothing."""
    variance = np.diag(np.linalg.pinv(information, hermitian=True))
    vague = untouched(information, np.ones(len(information))) | (variance <= 0.0)
    return np.where(vague, np.inf, np.sqrt(np.maximum(variance, 0.0)))


def _step(gradient: Array, complete: Array, missing: Array, damping: float) -> Array:
    """Newton's step (D,) with the observed information, damped towards the complete one until it points uphill."""
    while True:
        information = complete * (1.0 + damping) - missing + 1e-9 * np.eye(len(gradient))
        try:
            np.linalg.cholesky(information)
        except np.linalg.LinAlgError:
            damping = max(10.0 * damping, 0.1)
            continue
        return np.asarray(np.linalg.solve(information, gradient))
