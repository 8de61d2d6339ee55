"""Whether a driver keeps their lane, or changes to the left or to the right: the Boltzmann rule over three manoeuvres.

A lane is worth the utility of its best action: the paper's utility behind the vehicle that leads there. A lane that
ends is a standing leader at its end. Changing costs something, and so does the risk of the vehicle that would follow:
the paper's risk with the roles exchanged. Manoeuvres are chosen as actions are, with a rationality of their own.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.parameters import REFERENCE_HORIZON, REFERENCE_PERIOD_S, Parameter
from sugiyama_ros.driver.utility import (
    ACTIONS,
    GRID_ROW,
    UTILITY_ROW,
    Preferences,
    preferences,
    risk_behind,
    scratch_for,
    utilities,
)
from sugiyama_ros.jit import kernel

#: Manoeuvres, in the order of all arrays, and the lanes to which they lead: lane numbers grow to the left.
MANOEUVRES = ("keep", "left", "right")
KEEP, LEFT, RIGHT = range(3)
TO_LANE = (0, 1, -1)
#: Duration [s] of the movement across the road, in which a driver makes no other decision. Durations are 5 to 6 s on
#: average (Toledo and Zohar, Transportation Research Record 1999 (2007) 71).
CHANGE_S = 5.0
#: Parameters of a driver's decisions about lanes; they hold for one decision in each reference period.
LANE_PARAMETERS = (
    Parameter("lane_rationality", "λ_m", "1", 100.0, 0.0, 1e5, "sharpness of the choice among manoeuvres"),
    Parameter("politeness", "p", "1", 0.5, -10.0, 10.0, "weight of the follower's risk on the new lane"),
    Parameter("change_cost", "c", "1", 0.07, -10.0, 10.0, "utility that a change of lane must gain"),
)


class LaneSpan(NamedTuple):
    """Where drivers can change into a lane and out of it: from ``opens_m`` [m] to its end ``end_m`` [m]."""

    opens_m: float = -np.inf
    end_m: float = np.inf


class OnLanes(NamedTuple):
    """R vehicles on numbered lanes of one or more roads or moments.

    group: (R,), number of the road and the moment; who is in another group is not seen; lane: (R,), numbers of the
    lanes, which grow to the left; s_m: (R,), positions [m] of the centres; speed: (R,), speeds [m/s]; length_m: (R,),
    lengths [m].
    """

    group: Ints
    lane: Ints
    s_m: Array
    speed: Array
    length_m: Array


class ThreeLanes(NamedTuple):
    """What R drivers see on their lane, on the lane to the left and on the lane to the right.

    Parameters
    ----------
    speed, length_m : ndarray, shape (R,)
        Own speeds [m/s] and lengths [m].
    gap_m, leader_speed : ndarray, shape (R, 3)
        Gap [m] to the vehicle ahead on each lane, infinite where there is none, and its speed [m/s].
    rear_gap_m, rear_speed : ndarray, shape (R, 3)
        Gap [m] of the vehicle behind on each lane, infinite where there is none, and its speed [m/s].
    end_m : ndarray, shape (R, 3)
        Distance [m] from the front bumper to the end of each lane; infinite where it goes on.
    is_open : ndarray of bool, shape (R, 3)
        Whether there is such a lane here.
    """

    speed: Array
    length_m: Array
    gap_m: Array
    leader_speed: Array
    rear_gap_m: Array
    rear_speed: Array
    end_m: Array
    is_open: Mask

    @property
    def can_choose(self) -> Mask:
        """Whether each manoeuvre is possible, shape (R, 3): there is a lane, and nobody drives abreast there."""
        can = self.is_open & (self.gap_m > 0.0) & (self.rear_gap_m > 0.0) & (self.end_m > 0.0)
        can[:, KEEP] = True
        return can


def neighbours(on: OnLanes) -> tuple[Ints, Ints]:
    """Find the next vehicle ahead and behind on the own lane, to the left and to the right, (R, 3) each; -1 for nobody.

    A vehicle on another lane at the very same position counts as ahead.
    """
    width = int(np.ptp(on.lane)) + 3 if len(on.lane) else 1
    span = float(np.ptp(on.s_m)) + 1.0 if len(on.s_m) else 1.0
    place = on.group * width + (on.lane - on.lane.min(initial=0) + 1)
    along = on.s_m - on.s_m.min(initial=np.inf)
    order = np.argsort(place * span + along, kind="stable")
    key, sorted_place = (place * span + along)[order], place[order]
    ahead, behind = (np.full((len(place), 3), -1, dtype=np.int64) for _ in range(2))
    rank = np.empty(len(place), dtype=np.int64)
    rank[order] = np.arange(len(place))
    for m, shift in enumerate(TO_LANE):
        wanted = place + shift
        after = rank + 1 if m == KEEP else np.searchsorted(key, wanted * span + along, side="left")
        before = (rank if m == KEEP else after) - 1
        for found, at in ((ahead, after), (behind, before)):
            inside = np.clip(at, 0, max(len(place) - 1, 0))
            there = (at == inside) & (sorted_place[inside] == wanted)
            found[there, m] = order[inside[there]]
    return ahead, behind


def see_lanes(on: OnLanes, spans: Mapping[int, LaneSpan]) -> ThreeLanes:
    """Work out what every driver sees; ``spans`` has all lanes by their numbers."""
    ahead, behind = neighbours(on)
    half = 0.5 * on.length_m

    def gap(other: Ints, sign: float) -> Array:
        way = sign * (on.s_m[other] - on.s_m[:, None]) - half[other] - half[:, None]
        return np.where(other >= 0, way, np.inf)

    numbers = sorted(spans)
    target = on.lane[:, None] + np.array(TO_LANE)
    at = np.clip(np.searchsorted(numbers, target), 0, len(numbers) - 1)
    opens, ends = (np.array([getattr(spans[n], name) for n in numbers])[at] for name in LaneSpan._fields)
    exists = np.array(numbers)[at] == target
    is_open = exists & (on.s_m[:, None] >= opens) & (on.s_m[:, None] < ends)
    is_open &= is_open[:, [KEEP]]
    is_open[:, KEEP] = True
    end_m = np.where(exists, ends - on.s_m[:, None] - half[:, None], np.inf)
    speeds = [np.where(other >= 0, on.speed[other], 0.0) for other in (ahead, behind)]
    return ThreeLanes(on.speed, on.length_m, gap(ahead, 1.0), speeds[0], gap(behind, -1.0), speeds[1], end_m, is_open)


@kernel
def _worth(
    speed: float, leader: tuple[float, float, float], scratch: Array, period: float, horizon: int, driver: Preferences
) -> tuple[float, float]:
    """Compute the utility of the best action, and this action [m/s^2].

    leader: gap [m] and speed [m/s] of the leader, and the distance [m] to the end of the lane.
    """
    gap, leader_speed, end = leader
    utilities(gap, speed, leader_speed, driver, scratch, period, horizon)
    if end < np.inf:
        worst = scratch[UTILITY_ROW].copy()
        utilities(end, speed, 0.0, driver, scratch, period, horizon)
        scratch[UTILITY_ROW] = np.minimum(scratch[UTILITY_ROW], worst)
    best = np.argmax(scratch[UTILITY_ROW])
    return scratch[UTILITY_ROW, best], scratch[GRID_ROW, best]


@kernel
def _features(lanes: ThreeLanes, parameters: Array, grid: Array, period: float, horizon: int) -> Array:
    """Compute the features of ``lane_features`` for parameters (R, P) and actions (K,) [m/s^2]."""
    scratch, features = scratch_for(grid), np.zeros((len(lanes.speed), 3, 3))
    for r in range(len(lanes.speed)):
        driver = preferences(parameters[r])
        for m in range(3):
            if not lanes.is_open[r, m]:
                continue
            leader = (lanes.gap_m[r, m], lanes.leader_speed[r, m], lanes.end_m[r, m])
            worth, action = _worth(lanes.speed[r], leader, scratch, period, horizon, driver)
            features[r, m, 0] = worth
            if m > 0:
                features[r, m, 2] = -1.0
                if lanes.rear_gap_m[r, m] < np.inf:
                    gap, behind = lanes.rear_gap_m[r, m], lanes.rear_speed[r, m]
                    risk = risk_behind(gap, lanes.speed[r], behind, action, period, horizon, driver)
                    features[r, m, 1] = driver[5] * risk
    return features


def lane_features(lanes: ThreeLanes, parameters: Array) -> Array:
    """Compute what the utility of a manoeuvre consists of.

    The utility of a manoeuvre is worth + politeness * risk + change_cost * change.

    Parameters
    ----------
    lanes : ThreeLanes
        What the drivers see.
    parameters : ndarray, shape (R, P) or (P,)
        Parameters of the drivers at the reference period.

    Returns
    -------
    ndarray, shape (R, 3, 3)
        For keep, left and right: the utility of the lane's best action, omega_2 times the risk of the follower there,
        and -1 for a change. The last two are 0 for keep.
    """
    rows = np.ascontiguousarray(np.broadcast_to(parameters, (len(lanes.speed), parameters.shape[-1])), dtype=np.float64)
    return np.asarray(_features(lanes, rows, ACTIONS, REFERENCE_PERIOD_S, REFERENCE_HORIZON))


def log_probabilities(features: Array, weights: Array, can_choose: Mask) -> Array:
    """Compute the logarithms of the probabilities of manoeuvres by the Boltzmann rule.

    Parameters
    ----------
    features : ndarray, shape (R, 3, F)
        Features of each manoeuvre.
    weights : ndarray, shape (F,) or (R, F)
        Weights of the features.
    can_choose : ndarray of bool, shape (R, 3)
        Whether each manoeuvre is possible.

    Returns
    -------
    ndarray, shape (R, 3)
        Log-probabilities; minus infinity for what is not possible.
    """
    score = np.einsum("rmf,rf->rm", features, np.broadcast_to(weights, (len(features), features.shape[2])))
    score = np.where(can_choose, score, -np.inf)
    score = score - score.max(axis=1, keepdims=True)
    return np.asarray(score - np.log(np.exp(score).sum(axis=1, keepdims=True)))


def weights_of(lane_parameters: Array) -> Array:
    """Return the weights (..., 3) of `lane_features` for parameters (..., 3) in the order of `LANE_PARAMETERS`."""
    rationality = lane_parameters[..., :1]
    return np.concatenate((rationality, rationality * lane_parameters[..., 1:]), axis=-1)


def choose(lanes: ThreeLanes, parameters: Array, lane_parameters: Array) -> Array:
    """Compute the probabilities of keep, left and right.

    Parameters
    ----------
    lanes : ThreeLanes
        What R drivers see.
    parameters : ndarray, shape (R, P) or (P,)
        Parameters of the drivers at the reference period.
    lane_parameters : ndarray, shape (R, 3) or (3,)
        Rationality, politeness and cost of a change, in the order of `LANE_PARAMETERS`.

    Returns
    -------
    ndarray, shape (R, 3)
        Probabilities.

    Examples
    --------
    A slow leader, and a free lane to the left:

    >>> import numpy as np
    >>> from sugiyama_ros.driver.parameters import defaults
    >>> none, speeds = np.full((1, 3), np.inf), np.full((1, 3), 8.0)
    >>> lanes = ThreeLanes(np.array([8.0]), np.array([4.33]), np.array([[3.0, np.inf, np.inf]]), speeds - 4.0,
    ...                    none, speeds, none, np.array([[True, True, False]]))
    >>> keep, left, right = choose(lanes, defaults(), np.array([100.0, 0.5, 0.07]))[0]
    >>> bool(left > 0.99), float(right)
    (True, 0.0)
    """
    features = lane_features(lanes, parameters)
    return np.exp(log_probabilities(features, weights_of(lane_parameters), lanes.can_choose))
