"""Forces without a name that a model may lack, along everything that they may depend on."""

from collections.abc import Iterator

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidates import Candidate, force_along
from sugiyama_ros.diagnosis.where import BINS, FEWEST
from sugiyama_ros.effects.discovered_force import COVARIATES, KNOTS
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.response import Response
from sugiyama_ros.fit.surroundings import covariates_of


def forces(data: Recorded, response: Response) -> Iterator[tuple[Candidate, Array]]:
    """Yield a force along each covariate that the recording shows, one after the other.

    With it comes the change of the innovations [m] by 1 m/s^2 at each knot, (K, N, T).
    """
    seen, around = covariates_of(data, response.states), data.vicinity
    for name in COVARIATES:
        values = seen[name].T
        known = values[np.isfinite(values)]
        if len(known) < BINS * FEWEST or (name == "time" and not around.is_whole_road):
            continue
        ring = name == "place" and around.road.is_ring
        first, last = (0.0, around.road.circumference_m) if ring else np.quantile(known, (0.02, 0.98)).tolist()
        if last > first:
            yield force_along(name, first, last), response.to_push(_weights(values, first, last, is_periodic=ring))


def _weights(values: Array, first: float, last: float, *, is_periodic: bool) -> Array:
    """Weight of each knot at each sample (K, N, T), for values (N, T); 0 where the covariate is unknown."""
    intervals = KNOTS if is_periodic else KNOTS - 1
    known = np.isfinite(values)
    s = intervals * np.clip(np.where(known, (values - first) / (last - first), 0.0), 0.0, 1.0)
    k = np.minimum(s.astype(np.int64), intervals - 1)
    weights = np.zeros((KNOTS, *s.shape))
    for knot, weight in ((k, 1.0 - s + k), ((k + 1) % KNOTS, s - k)):
        np.put_along_axis(weights, knot[None], np.where(known, weight, 0.0)[None], axis=0)
    return weights
