"""Score of one driver's likelihood in the causal formulation, and the paper's regularisation."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.parameters import COUNT, KAPPA_V, V_STAR
from sugiyama_ros.filters.chain import Chain
from sugiyama_ros.filters.paper import Scored

# Steps of the difference quotients of the causal filter: as part of a parameter's std; shortest, longest and first step
# of a logarithm.
_PART_OF_STD, _SHORTEST_STEP, _LONGEST_STEP, _FIRST_STEP = 0.5, 5e-3, 0.05, 0.03
#: The paper's regularisation, Eq. Regularized_SSM_Likelihood: centre and weight of v* [m/s] and kappa_v [s].
REGULARISATION = ((V_STAR, 11.0, 50.0), (KAPPA_V, 0.5, 500.0))


class DriverChains(NamedTuple):
    """One driver in the filter: one chain or several, of different times.

    chains: data of the driver and of the vehicles ahead; ahead: (M - 1, P), for each chain the parameters of the
    drivers ahead; scored: (T,), samples of each chain that count, besides those that the filter leaves out; empty if
    all others count.
    """

    chains: tuple[Chain, ...]
    ahead: tuple[Array, ...]
    scored: tuple[Mask, ...] = ()


def causal_score(
    followed: DriverChains,
    places: Ints,
    parameters: Array,
    information: Array | None,
    central: bool = False,
    here: Array | None = None,
) -> Scored:
    """Return the score from difference quotients of innovations and variances, by the logarithms of the parameters.

    places: (K,), places of the parameters in the search; parameters: (P,), parameters of the driver; information: (P,
    P), information at nearby parameters, which sets the steps; none if it is not known; here: (3, samples), what
    ``predicted`` returns for these parameters, if it is known.
    """
    steps = np.full(len(places), _FIRST_STEP)
    if information is not None:
        held = np.diag(information)[places] * parameters[places] ** 2
        steps = np.clip(_PART_OF_STD / np.sqrt(np.maximum(held, 1e-12)), _SHORTEST_STEP, _LONGEST_STEP)
    signs = (1.0, -1.0) if central else (1.0,)
    moved = np.tile(parameters, (len(signs), len(places), 1))
    for sign, rows in zip(signs, moved, strict=True):
        rows[np.arange(len(places)), places] *= np.exp(sign * steps)
    here = predicted(followed, [parameters])[0] if here is None else here
    there = predicted(followed, [*moved.reshape(-1, len(parameters))])
    density = here[2]
    scored = np.isfinite(density)
    y, variance = here[:2, scored]
    up = there[: len(places), :2, scored]
    down = there[len(places) :, :2, scored] if central else here[:2, scored]
    dy, dvar = np.moveaxis((up - down) / (len(signs) * steps[:, None, None]), 1, 0)
    slopes = -(dy * (y / variance) + 0.5 * dvar * (1.0 - y * y / variance) / variance)
    curvature = (dy / variance) @ dy.T + 0.5 * (dvar / variance**2) @ dvar.T
    gradient, full, scatter = np.zeros(COUNT), np.zeros((COUNT, COUNT)), np.zeros((COUNT, COUNT))
    scale = parameters[places]
    block = np.ix_(places, places)
    gradient[places] = slopes.sum(axis=1) / scale
    full[block] = curvature / np.outer(scale, scale)
    scatter[block] = slopes @ slopes.T / np.outer(scale, scale)
    return Scored(float(density[scored].sum()), gradient, full, scatter)


def predicted(followed: DriverChains, rows: Sequence[Array]) -> Array:
    """Predict all samples of a driver.

    rows: (P,), R rows of parameters. Returns (R, 3, samples of all chains), innovation, its variance and its
    log-likelihood.
    """
    # Imported here: the paper's formulation does not need the causal filter, which takes long to load.
    from sugiyama_ros.filters import causal

    if not rows:  # one parameter alone has a profile, too
        return np.empty((0, 3, sum(len(chain.position_m) for chain in followed.chains)))
    each_chain = list(zip(followed.chains, followed.ahead, strict=True))
    jobs = [causal.ChainJob(chain, row, ahead) for row in rows for chain, ahead in each_chain]
    each, count = causal.predict_samples(jobs), len(followed.chains)
    found = [np.concatenate([np.array(one) for one in each[k : k + count]], axis=1) for k in range(0, len(jobs), count)]
    samples = np.array(found)
    if followed.scored:
        samples[:, 2, ~np.concatenate(followed.scored)] = np.nan
    return samples


def regularised(scored: Scored, parameters: Array) -> Scored:
    """Add the paper's regularisation, Eq. Regularized_SSM_Likelihood, to a score.

    parameters: (P,), parameters at which the score holds.
    """
    value, gradient, information = scored.log_likelihood, scored.gradient.copy(), scored.information.copy()
    for k, centre, weight in REGULARISATION:
        off = parameters[k] - centre
        value -= weight * off * off
        gradient[k] -= 2.0 * weight * off
        information[k, k] += 2.0 * weight
    return Scored(value, gradient, information)
