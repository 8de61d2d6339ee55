"""Drivers' decisions about lanes, out of tracks: maximum likelihood of what they chose, and MOBIL beside it.

The log-probability of a manoeuvre is linear in its features but for a common constant (a conditional logit model). So
the log-likelihood is concave, and Newton's method finds its one maximum.

References
----------
McFadden, in Frontiers in Econometrics (1974) 105.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.lane_change import (
    CHANGE_S,
    KEEP,
    LANE_PARAMETERS,
    TO_LANE,
    LaneSpan,
    OnLanes,
    ThreeLanes,
    lane_features,
    log_probabilities,
    see_lanes,
)
from sugiyama_ros.driver.parameters import REFERENCE_PERIOD_S, V_STAR, defaults
from sugiyama_ros.errors import InputError
from sugiyama_ros.laws.idm import LAW as IDM
from sugiyama_ros.results import Result
from sugiyama_ros.results import figure as in_words
from sugiyama_ros.simulation.mobil import mobil_features
from sugiyama_ros.trajectories.leaders import ticks
from sugiyama_ros.trajectories.tracks import Tracks

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

#: Parts of the drivers, each of which is predicted by a fit of all others.
FOLDS = 5
_STEPS, _ENOUGH = 100, 1e-10


class Decisions(NamedTuple):
    """R decisions between lanes.

    row: (R,), row of the tracks; run: (R,), run of the tracks, which stands for the driver; chosen: (R,), KEEP, LEFT or
    RIGHT; lanes: what the drivers saw.
    """

    row: Ints
    run: Ints
    chosen: Ints
    lanes: ThreeLanes


class ChoiceFit(NamedTuple):
    """Weights (F,) of the features of a choice, their covariance (F, F), and the log-likelihood [nats]."""

    weights: Array
    covariance: Array
    log_likelihood: float


def decisions_of(tracks: Tracks, spans: Mapping[int, LaneSpan] | None = None) -> Decisions:
    """Find out what drivers saw and chose, once in each reference period.

    A driver who has changed lanes does not decide anew for ``CHANGE_S``. Speeds are differences of positions.

    Parameters
    ----------
    tracks : Tracks
        Vehicles on numbered lanes of open roads.
    spans : mapping of int to LaneSpan, optional
        Where lanes open and end, by their numbers, which grow to the left; other lanes of the tracks have no ends.

    Returns
    -------
    Decisions
        Decisions in the order of the rows. Rows with a single lane to choose tell nothing, and are left out.

    Raises
    ------
    InputError
        For tracks without numbered lanes, on a ring, or with samples that are more than the reference period apart.
    """
    lane, there = _numbers(tracks)
    period_s, every = _sampling(tracks)
    number = np.arange(len(tracks))
    later: Ints = np.minimum(number + every, tracks.start[tracks.run + 1] - 1)
    manoeuvre = np.select([lane[later] - lane == way for way in TO_LANE], range(3), -1)
    is_next = np.abs(tracks.time_s[later] - tracks.time_s - every * period_s) < 0.5 * period_s
    is_next &= there[later] & (_roads(tracks)[later] == _roads(tracks))
    decides = there & is_next & (manoeuvre >= 0) & ~_is_moving(tracks, lane)
    decides &= (number - tracks.start[tracks.run]) % every == 0
    known = {name: LaneSpan() for name in np.unique(lane[there]).tolist()} | dict(spans or {})
    lanes, row, kept = see_lanes(_on_lanes(tracks, lane, there), known), number[there], decides[there]
    can = lanes.can_choose
    kept &= (can.sum(axis=1) > 1) & can[np.arange(len(row)), np.maximum(manoeuvre[row], 0)]
    seen = ThreeLanes(*(field[kept] for field in lanes))  # type: ignore[arg-type]
    return Decisions(row[kept], tracks.run[row[kept]], manoeuvre[row[kept]], seen)


def _on_lanes(tracks: Tracks, lane: Ints, rows: Mask) -> OnLanes:
    """Return the vehicles of some rows, with the numbers of the lanes of all rows (R,)."""
    return OnLanes(_groups(tracks)[rows], lane[rows], tracks.s_m[rows], _speeds(tracks)[rows], tracks.length_m[rows])


def _numbers(tracks: Tracks) -> tuple[Ints, Mask]:
    """Return the numbers of the lanes, and whether they are known, (R,) each. Raises InputError."""
    if tracks.lane is None or tracks.about.ring_m:
        raise InputError("lanes: changes of lane need tracks with lanes on an open road")
    try:
        numbers = np.array([*map(int, tracks.lane.text), 0], dtype=np.int64)
    except ValueError:
        raise InputError("lanes: must have whole numbers as names, which grow to the left") from None
    return numbers[tracks.lane.code], np.asarray(tracks.lane.code >= 0)


def _sampling(tracks: Tracks) -> tuple[float, int]:
    """Return the time [s] between two samples, and the samples from one decision to the next. Raises InputError."""
    step = np.diff(tracks.time_s)[np.diff(tracks.run) == 0]
    period_s, longest_s = float(np.median(step)) if len(step) else np.inf, 1.5 * REFERENCE_PERIOD_S
    if period_s > longest_s:
        raise InputError(f"lanes: samples are {period_s:.3g} s apart; record one every {longest_s:g} s, or more often")
    return period_s, max(1, round(REFERENCE_PERIOD_S / period_s))


def _roads(tracks: Tracks) -> Ints:
    """Return the numbers of the roads (R,)."""
    return np.zeros(len(tracks), dtype=np.int64) if tracks.road is None else tracks.road.code.astype(np.int64)


def _groups(tracks: Tracks) -> Ints:
    """Number the recordings, roads and moments (R,)."""
    columns = np.stack((tracks.recording.code.astype(np.int64), ticks(tracks.time_s), _roads(tracks)))
    return np.asarray(np.unique(columns, axis=1, return_inverse=True)[1].ravel(), dtype=np.int64)


def _speeds(tracks: Tracks) -> Array:
    """Compute speeds (R,) [m/s] as differences of positions, over a sample on either side where there is one."""
    rows = np.arange(len(tracks))
    after = np.minimum(rows + 1, tracks.start[tracks.run + 1] - 1)
    before = np.maximum(rows - 1, tracks.start[tracks.run])
    time = tracks.time_s[after] - tracks.time_s[before]
    return np.asarray((tracks.s_m[after] - tracks.s_m[before]) / np.where(time > 0.0, time, np.inf))


def _is_moving(tracks: Tracks, lane: Ints) -> Mask:
    """Whether a driver is on the way across the road (R,): their lane has changed within ``CHANGE_S``."""
    same = (np.diff(tracks.run) == 0) & (np.diff(_roads(tracks)) == 0)
    changed = np.append(False, (np.diff(lane) != 0) & same)
    last = np.maximum.accumulate(np.where(changed, np.arange(len(tracks)), -1))
    since = tracks.time_s - tracks.time_s[np.maximum(last, 0)]
    return np.asarray((last >= tracks.start[tracks.run]) & (since < CHANGE_S - 1e-6))


def fit_choice(features: Array, can_choose: Mask, chosen: Ints) -> ChoiceFit:
    """Maximise the likelihood of choices.

    Parameters
    ----------
    features : ndarray, shape (R, M, F)
        Features of each of M alternatives.
    can_choose : ndarray of bool, shape (R, M)
        Whether each alternative is possible.
    chosen : ndarray of int, shape (R,)
        The alternative that was chosen.

    Returns
    -------
    ChoiceFit
        Weights, and their covariance from the Hessian.

    Raises
    ------
    InputError
        If the choices do not determine the weights: nobody chose another alternative, or a feature never differs.
    """
    weights: Array = np.zeros(features.shape[2])
    scale = np.maximum(np.abs(features).max(axis=(0, 1), initial=0.0), 1e-300)
    x, row = features / scale, np.arange(len(chosen))
    value = _likelihood(x, weights, can_choose, chosen)
    for _ in range(_STEPS):
        p = np.exp(log_probabilities(x, weights, can_choose))
        mean = np.einsum("rm,rmf->rf", p, x)
        gradient = (x[row, chosen] - mean).sum(axis=0)
        information = np.einsum("rm,rmf,rmg->fg", p, x, x) - mean.T @ mean
        if np.linalg.cond(information) > 1e12:
            raise InputError("lanes: the decisions do not determine the parameters; record more changes of lane")
        move = np.linalg.solve(information, gradient)
        while (better := _likelihood(x, weights + move, can_choose, chosen)) < value and np.abs(move).max() > _ENOUGH:
            move = 0.5 * move
        weights, value = weights + move, max(value, better)
        if gradient @ move < _ENOUGH:
            break
    return ChoiceFit(weights / scale, np.linalg.inv(information) / np.outer(scale, scale), value)


def _likelihood(features: Array, weights: Array, can_choose: Mask, chosen: Ints) -> float:
    """Compute the log-likelihood [nats] of choices."""
    return float(log_probabilities(features, weights, can_choose)[np.arange(len(chosen)), chosen].sum())


@dataclass(frozen=True, eq=False, repr=False)
class LaneChoices(Result):
    """How drivers choose among lanes, and how well this predicts drivers of whom the fit knows nothing.

    Parameters
    ----------
    estimate, std : ndarray, shape (3,)
        Rationality, politeness and cost of a change, in the order of ``LANE_PARAMETERS``, and their standard errors.
    covariance : ndarray, shape (3, 3)
        Covariance of the estimates.
    decisions, changes, drivers : int
        Numbers of decisions, of those that were a change, and of drivers.
    log_loss, mobil_log_loss : float
        Held-out log-loss [nats] of a decision, for this model and for MOBIL with a logistic link.
    gain, gain_std : float
        MOBIL's log-loss minus this model's, and the standard error of this paired difference over drivers.
    """

    estimate: Array
    std: Array
    covariance: Array
    decisions: int
    changes: int
    drivers: int
    log_loss: float
    mobil_log_loss: float
    gain: float
    gain_std: float

    def headline(self) -> str:
        """Say how many decisions there are, and how they are predicted."""
        return (
            f"{self.decisions} decisions of {self.drivers} drivers, {self.changes} changes of lane; held-out log-loss"
            f" {in_words(self.log_loss)} nats a decision, with MOBIL {in_words(self.mobil_log_loss)}: a gain of"
            f" {in_words(self.gain)} ± {in_words(self.gain_std, 2)}"
        )

    def records(self) -> list[dict[str, Any]]:
        """List the parameters with their standard errors."""
        return [
            {"parameter": p.name, "estimate": float(value), "std": float(std)}
            for p, value, std in zip(LANE_PARAMETERS, self.estimate, self.std, strict=True)
        ]

    def draw(self, figure: "Figure | SubFigure") -> None:
        """Draw the estimates relative to their standard errors."""
        axes = figure.subplots(1, len(LANE_PARAMETERS))
        for ax, p, value, std in zip(axes, LANE_PARAMETERS, self.estimate, self.std, strict=True):
            ax.errorbar([0], [value], yerr=[2.0 * std], fmt="o")
            ax.set(title=p.name, xticks=[])


def lane_parameters_of(fit: ChoiceFit) -> tuple[Array, Array]:
    """Return the parameters (3,) in the order of ``LANE_PARAMETERS``, and their covariance (3, 3) (delta method)."""
    rationality, risk, change = fit.weights
    jacobian = np.array(
        [
            [1.0, 0.0, 0.0],
            [-risk / rationality**2, 1.0 / rationality, 0.0],
            [-change / rationality**2, 0.0, 1.0 / rationality],
        ]
    )
    return np.array([rationality, risk / rationality, change / rationality]), jacobian @ fit.covariance @ jacobian.T


def fit_lane_changes(
    tracks: Tracks, parameters: Array | None = None, spans: Mapping[int, LaneSpan] | None = None
) -> LaneChoices:
    """Fit how drivers choose among lanes, and compare with MOBIL.

    Parameters
    ----------
    tracks : Tracks
        Vehicles on numbered lanes of open roads.
    parameters : ndarray, shape (V, P) or (P,), optional
        Parameters of the drivers of the V runs at the reference period; the paper's if left out.
    spans : mapping of int to LaneSpan, optional
        The lanes by their numbers; see `decisions_of`.

    Returns
    -------
    LaneChoices
        One set of parameters for all drivers.

    Raises
    ------
    InputError
        As for `decisions_of` and `fit_choice`.
    """
    made = decisions_of(tracks, spans)
    rows = np.broadcast_to(defaults() if parameters is None else parameters, (tracks.runs, len(defaults())))[made.run]
    # IDM with the published constants, and the desired speed of each driver
    law = np.tile([p.default for p in IDM.parameters], (len(rows), 1))
    law[:, 0] = rows[:, V_STAR]
    ours, mobil = lane_features(made.lanes, rows), mobil_features(made.lanes, law)
    fit = fit_choice(ours, made.lanes.can_choose, made.chosen)
    estimate, covariance = lane_parameters_of(fit)
    loss, rival = held_out_loss(ours, made), held_out_loss(mobil, made)
    _, driver = np.unique(made.run, return_inverse=True)
    drivers = int(driver.max()) + 1
    # a driver's decisions are not independent of each other, so that the error is of sums over drivers
    won = np.bincount(driver, rival - loss, drivers)
    gain = float(np.mean(rival - loss))
    of_drivers = won - gain * np.bincount(driver, minlength=drivers)
    return LaneChoices(
        estimate,
        np.sqrt(np.diag(covariance)),
        covariance,
        len(loss),
        int(np.sum(made.chosen != KEEP)),
        drivers,
        float(loss.mean()),
        float(rival.mean()),
        gain,
        float(np.sqrt(np.sum(np.square(of_drivers)) * drivers / (drivers - 1)) / len(loss)),
    )


def held_out_loss(features: Array, made: Decisions) -> Array:
    """Compute the log-loss (R,) [nats] of each decision by a fit of the drivers of other folds."""
    loss, fold, can = np.empty(len(made.chosen)), made.run % FOLDS, made.lanes.can_choose
    for k in range(FOLDS):
        own = fold == k
        if np.any(own):
            fit = fit_choice(features[~own], can[~own], made.chosen[~own])
            log_p = log_probabilities(features[own], fit.weights, can[own])
            loss[own] = -log_p[np.arange(int(own.sum())), made.chosen[own]]
    return loss
