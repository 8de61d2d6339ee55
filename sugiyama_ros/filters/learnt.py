"""What an online filter has learnt of a driver's parameters, and how it is recalled."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.filters.engine import Engine
from sugiyama_ros.filters.noise import NOISES


@dataclass(frozen=True, eq=False)
class Learnt:
    """Logarithms (A,) of adapted parameters at the reference period, by name, and their covariance (A, A).

    Parameters of effects, such as ``drag.c0``, stand with their values, not with logarithms.
    """

    names: tuple[str, ...]
    mean: Array
    covariance: Array


def adapted_names(kalman: Engine) -> tuple[str, ...]:
    """Return the names of the parameters that are adapted, noises first."""
    noises = NOISES if kalman.learning is not None else ()
    return tuple(NAMES[k] for k in (*noises, *kalman.model.adapted))


def known_parameters(kalman: Engine) -> Array:
    """Return the driver's row (WIDTH,) as known now, at the reference period."""
    model = kalman.model
    known = model.row.copy()
    for k in model.adapted:
        known[k] = kalman.rows[0, k]
    if kalman.noises is not None:
        known[NOISES] *= kalman.rows[0, NOISES] / model.rows[0, NOISES]
    return known


def parameter_covariance(kalman: Engine) -> Array:
    """Return the covariance (WIDTH, WIDTH) of ``known_parameters``; zero for parameters that are not adapted."""
    covariance, parameters = np.zeros((ROW.width, ROW.width)), known_parameters(kalman)
    places, entries = kalman.model.adapted, kalman.model.adapted_entries
    covariance[np.ix_(places, places)] = kalman.P[entries, entries]
    if kalman.noises is not None:
        covariance[np.ix_(NOISES, NOISES)] = kalman.noises.covariance
    return covariance * np.outer(parameters, parameters)


def learnt_of(kalman: Engine) -> Learnt:
    """Return all that is known of the driver's adapted parameters."""
    entries = kalman.model.adapted_entries
    parts = [(kalman.x[entries], kalman.P[entries, entries])]
    if kalman.noises is not None:
        parts.insert(0, (kalman.noises.mean - kalman.model.noise_shift, kalman.noises.covariance))
    means, covariances = zip(*parts, strict=True)
    return Learnt(adapted_names(kalman), np.concatenate(means), block_diag(*covariances))


def identified_names(kalman: Engine) -> tuple[str, ...]:
    """Return the adapted parameters whose standard deviation is less than half of the prior's."""
    now = np.sqrt(np.diag(learnt_of(kalman).covariance))
    noise_std = kalman.learning.prior_std if kalman.learning else ()
    before = np.concatenate([noise_std, np.sqrt(kalman.model.prior_var)])
    return tuple(name for name, a, b in zip(adapted_names(kalman), now, before, strict=True) if a < 0.5 * b)


def recall(kalman: Engine, learnt: Learnt) -> None:
    """Go on from what was learnt before."""
    model, noises = kalman.model, kalman.noises
    at = {name: k for k, name in enumerate(learnt.names)}
    of_noises = [at[NAMES[k]] for k in NOISES if NAMES[k] in at]
    if noises is not None and len(of_noises) == len(NOISES):
        noises.recall(learnt.mean[of_noises] + model.noise_shift, learnt.covariance[np.ix_(of_noises, of_noises)])
        kalman.rows[0, NOISES] = noises.values
    own, entries = [at[NAMES[k]] for k in model.adapted if NAMES[k] in at], model.adapted_entries
    if len(own) == len(model.adapted):
        kalman.x[entries] = kalman.next_mean[entries] = learnt.mean[own]
        kalman.P[entries, :], kalman.P[:, entries] = 0.0, 0.0
        kalman.P[entries, entries] = learnt.covariance[np.ix_(own, own)]
        kalman.rows[0, model.adapted] = np.exp(learnt.mean[own])
