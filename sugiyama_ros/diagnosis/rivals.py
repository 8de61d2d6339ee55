"""Other car-following laws on the same samples: what a model has to be ahead of."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from sugiyama_ros.diagnosis.forecast import Surroundings, forecasts
from sugiyama_ros.diagnosis.refine import without_folds
from sugiyama_ros.diagnosis.table import CLEARLY, Entry, sum_error
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.joint import fit_nearly
from sugiyama_ros.fit.law import in_filter, start_of_drivers
from sugiyama_ros.fit.recording import Recorded, some_drivers
from sugiyama_ros.laws.registry import LAWS, name_of

# Number of drivers to whom a law is fitted first, as many as filters run side by side.
_FIRST = 8


def laws(data: Recorded, around: Surroundings, final: Entry, work: ThreadPoolExecutor) -> tuple[Entry, ...]:
    """Fit all other laws that are not far behind a model one step ahead; ``around``: the traffic of the forecasts."""
    return tuple(_laws(data, around, final, work))


def _laws(data: Recorded, around: Surroundings, final: Entry, work: ThreadPoolExecutor) -> Iterator[Entry]:
    own = name_of(float(final.fit.model.rows[0, ROW.law]))
    for law in LAWS:
        if law == own or _is_far_behind(data, law, final, work):
            continue
        fit = in_filter(data, law, work)
        models = without_folds(data, fit, work)
        yield Entry(law, (), fit, models, forecasts(data, around, models, work))


def _is_far_behind(data: Recorded, law: str, final: Entry, work: ThreadPoolExecutor) -> bool:
    """Whether a law predicts some drivers one step ahead clearly worse, although it was fitted to these samples."""
    if data.drivers <= 2 * _FIRST:
        return False
    who = [k * data.drivers // _FIRST for k in range(_FIRST)]
    some = some_drivers(data, who)
    start = start_of_drivers(some, law)
    fit = fit_nearly(some, start.individual, work, start)
    ahead = np.nansum(final.forecasts.one_step[who], axis=1) - np.nansum(fit.samples.log_likelihood, axis=1)
    return bool(ahead.sum() > 2.0 * CLEARLY * sum_error(ahead))
