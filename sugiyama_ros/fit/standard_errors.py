"""Standard errors of joint fits; those of shared parameters hold for an approximate, rough likelihood.

The likelihood of a filter is rough at small scales, so derivatives overstate how well a parameter is known. The error
therefore comes from the profile of the log posterior: how far a parameter can move, while all others respond, until the
log posterior has fallen clearly. Where drivers or blocks of time pull in different directions by more than the
information allows, the error grows by this factor (the sandwich estimate, with drivers and blocks as clusters).

References
----------
Huber, Proc. Fifth Berkeley Symp. Math. Stat. Prob. 1 (1967) 221. Cameron and Miller, J. Human Resources 50 (2015) 317.
"""

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.coordinates import is_linear
from sugiyama_ros.fit.joint import JointFit, at_model
from sugiyama_ros.fit.model import moved
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.slopes import density_slope


def own_stds(fitted: JointFit) -> list[dict[str, float]]:
    """Return standard deviations of the individual parameters of each driver, by name, from a fit's information.

    The drivers are draws from a population, whose centre is known from these drivers alone.
    """
    places, found = list(fitted.model.individual), []
    inverses, lifts, shared = _arrow(fitted, with_centre=True)
    for inverse, lift, row in zip(inverses, lifts, fitted.model.rows[:, places], strict=True):
        variances = np.diag(inverse + lift @ shared @ lift.T)
        # from a coordinate to the parameter itself: d p = p d log p
        stds = np.sqrt(np.maximum(variances, 0.0)) * np.where(is_linear(places), 1.0, np.abs(row))
        found.append(dict(zip((ROW.entries[k] for k in places), stds.tolist(), strict=True)))
    return found


def _arrow(fitted: JointFit, *, with_centre: bool = False) -> tuple[Array, Array, Array]:
    """Return the parts of the inverse information of a fit, which has the shape of an arrow.

    The inverses (N, I, I) of each driver alone, the responses (N, I, S) of the individual parameters to the shared
    ones, and the covariance (S, S) of the shared ones. The centre of the population counts as known, or is in front of
    the shared parameters.
    """
    model, own = fitted.model, len(fitted.model.individual)
    prior, has = np.diag(1.0 / np.array(model.prior_std) ** 2), model.has[:, None]
    h: Array = np.array([s.information.sum(axis=0) for s in fitted.slopes])
    inverses: Array = np.asarray(np.linalg.inv(h[:, :own, :own] + prior), np.float64)
    cross, both = np.where(has, h[:, :own, own:], 0.0), has & has.transpose(0, 2, 1)
    block = np.where(both, h[:, own:, own:], 0.0)
    if with_centre:
        cross = np.concatenate([np.broadcast_to(-prior, (len(h), own, own)), cross], axis=2)
        block = np.pad(block, ((0, 0), (own, 0), (own, 0)))
        block[:, :own, :own] = prior
    lifts: Array = inverses @ cross
    reduced = (block - cross.transpose(0, 2, 1) @ lifts).sum(axis=0)
    return inverses, lifts, np.asarray(np.linalg.pinv(reduced + 1e-9 * np.eye(len(reduced))), np.float64)


def shared_stds(data: Recorded, fitted: JointFit, work: Executor) -> dict[str, float]:
    """Return standard deviations of the shared parameters of a fit."""
    model = fitted.model
    shared = list(model.shared)
    if not shared:
        return {}
    _, lifts, inverse = _arrow(fitted)
    stds = np.sqrt(np.maximum(np.diag(inverse), 1e-300)) * _disagreement(data, fitted, lifts, inverse)
    for j in range(len(shared)):
        direction = inverse[:, j] / np.sqrt(max(inverse[j, j], 1e-300))
        stds[j] *= _stretch(data, fitted, direction, lifts, work)
    # from a coordinate to the parameter itself: d p = p d log p
    stds *= np.where(is_linear(shared), 1.0, _sizes(fitted))
    return dict(zip((ROW.entries[k] for k in shared), stds.tolist(), strict=True)) | dict(fitted.stds)


def away_from_0(data: Recorded, fitted: JointFit, places: Sequence[int], work: Executor) -> list[float]:
    """Return by how many standard errors some shared parameters of a fit are away from 0.

    From how far the log posterior falls halfway to 0, while all others respond: by z^2 / 8 if it is a parabola.
    """
    _, lifts, inverse = _arrow(fitted)
    disagreement, sizes, stds = _disagreement(data, fitted, lifts, inverse), _sizes(fitted), dict(fitted.stds)
    found = []
    for place in places:
        j = fitted.model.shared.index(place)
        if ROW.entries[place] in stds:
            found.append(float(sizes[j] / stds[ROW.entries[place]]))
            continue
        value = fitted.model.rows[fitted.model.has[:, j], place].max()
        half = 0.5 * value if is_linear([place])[0] else math.log(2.0)
        direction = -half * inverse[:, j] / max(inverse[j, j], 1e-300)
        halved = moved(data, fitted.model, -lifts @ direction, direction)
        fall = fitted.objective - at_model(data, fitted, halved, work).objective
        found.append(math.sqrt(8.0 * max(fall, 0.0)) / float(disagreement[j]))
    return found


def _sizes(fitted: JointFit) -> Array:
    """Largest size (S,) of each shared parameter, of those who have it."""
    model = fitted.model
    return np.array([np.abs(model.rows[model.has[:, j], k]).max(initial=0.0) for j, k in enumerate(model.shared)])


def _disagreement(data: Recorded, fitted: JointFit, lifts: Array, inverse: Array) -> Array:
    """By how much drivers, or blocks of time, differ more than the information allows, (S,), at least 1."""
    model, own, blocks = fitted.model, len(fitted.model.individual), np.unique(data.block)
    scores = np.zeros((data.drivers, len(blocks), len(model.shared)))
    for i, (s, row, has) in enumerate(zip(fitted.slopes, model.rows, model.has, strict=True)):
        y, variance, density = fitted.samples.of(i)
        derivatives = s.derivatives
        slope = density_slope(y, variance, derivatives.innovation, derivatives.variance, row) + derivatives.density
        slope = np.where(np.isfinite(density), slope, 0.0)
        efficient = np.where(has[:, None], slope[own:], 0.0) - lifts[i].T @ slope[:own]
        scores[i] = [efficient[:, data.block[i] == b].sum(axis=1) for b in blocks]
    scatter = np.max([_scatter(np.asarray(scores.sum(axis=k)), inverse) for k in (0, 1)], axis=0)
    return np.asarray(np.sqrt(np.maximum(scatter / np.maximum(np.diag(inverse), 1e-300), 1.0)))


def _stretch(data: Recorded, fitted: JointFit, direction: Array, lifts: Array, work: Executor) -> float:
    """By how much the log posterior is wider than the information says, at least 1.

    direction: (S,), one std of a parameter, with the response of the others; lifts: (N, I, S), response of individuals.
    """
    for doublings in range(1, 8):
        share = 2.0**doublings
        falls = []
        for sign in (-share, share):
            model = moved(data, fitted.model, -sign * lifts @ direction, sign * direction)
            falls.append(fitted.objective - at_model(data, fitted, model, work).objective)
        fall = float(np.mean(falls))
        if fall >= 4.0:  # nats, which stand out from the roughness of the log posterior
            break
    return max(share / math.sqrt(2.0 * max(fall, 0.5)), 1.0)


def _scatter(scores: Array, inverse: Any) -> Array:
    """Variances (S,) from the scores (C, S) of C clusters, and from the inverse of the information (S, S)."""
    count = len(scores)
    if count < 2:
        return np.zeros(len(inverse))
    change = (scores - scores.mean(axis=0)) @ inverse
    return np.asarray(count / (count - 1.0) * np.square(change).sum(axis=0))
