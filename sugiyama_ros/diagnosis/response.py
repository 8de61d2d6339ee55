"""What a candidate promises after the parameters of the base model have responded to it."""

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.score import PointwiseDensity
from sugiyama_ros.fit.slopes import Slopes, density_slope


def predicted(base: JointFit, model: Model, samples: PointwiseDensity) -> float:
    """Predict the log-likelihood of all drivers [nats]; see ``predicted_by_driver``."""
    return float(predicted_by_driver(base, model, samples).sum())


def predicted_by_driver(base: JointFit, model: Model, samples: PointwiseDensity) -> Array:
    """Predict the log-likelihood after the parameters of the base model have responded to a candidate, to first order.

    Half of their predicted gain counts, because the prediction is too large at a distant start.

    Parameters
    ----------
    base : JointFit
        The fitted model without the candidate.
    model : Model
        The model at a start of the candidate.
    samples : PointwiseDensity
        The samples there.

    Returns
    -------
    ndarray, shape (N,)
        Log-likelihood of each driver [nats].
    """
    own, total = len(base.model.individual), np.nansum(samples.log_likelihood, axis=1)
    prior = np.diag(1.0 / np.array(base.model.prior_std) ** 2)
    for i, (s, row) in enumerate(zip(base.slopes, model.rows, strict=True)):
        y, variance, density = samples.of(i)
        by = s.derivatives
        slope = density_slope(y, variance, by.innovation[:own], by.variance[:own], row)
        score = slope[:, np.isfinite(density)].sum(axis=1)
        total[i] += 0.25 * float(score @ np.linalg.solve(s.information.sum(axis=0)[:own, :own] + prior, score))
    return np.asarray(total)


def while_own_respond(base: JointFit, driver: int, at: Slopes) -> tuple[Array, Array]:
    """Return the slope of a driver's log posterior by other parameters while the driver's own respond, and its decline.

    Parameters
    ----------
    base : JointFit
        The fitted model.
    driver : int
        Number of the driver.
    at : Slopes
        Sums over the driver's samples: first by the individual parameters of the model, then by K others.

    Returns
    -------
    score : ndarray, shape (K,)
        Slope.
    information : ndarray, shape (K, K)
        Information that is left, which is the decline of the slope.
    """
    own, std = len(base.model.individual), np.array(base.model.prior_std)
    h, g = at.information.sum(axis=0), at.score.sum(axis=0)
    gives_way = np.linalg.solve(h[:own, :own] + np.diag(1.0 / std**2), h[:own, own:])
    score = g[own:] - gives_way.T @ (g[:own] - base.model.away[driver] / std)
    return score, h[own:, own:] - gives_way.T @ h[:own, own:]
