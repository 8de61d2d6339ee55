"""Fits of all other laws, beside the search for what is missing."""

import os
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import NamedTuple

from sugiyama_ros.diagnosis.errors import HeldOutErrors, errors_of, held_out_errors
from sugiyama_ros.diagnosis.free_runs import rmse
from sugiyama_ros.diagnosis.rivals import by_gaps, has_parameters, in_filter
from sugiyama_ros.fit.cross_validation import gain
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.score import PointwiseDensity
from sugiyama_ros.fit.some_drivers import some_drivers
from sugiyama_ros.laws.registry import RIVALS
from sugiyama_ros.workers import send

# Number of drivers to whom a quick diagnosis fits a law first: as many as filters run side by side.
_FIRST = 8
# A law is far behind if it loses by more than so many standard errors.
_FAR = 4.0


class RivalErrors(NamedTuple):
    """Held-out errors of a rival, and the number of drivers to whom it was fitted."""

    errors: HeldOutErrors
    drivers: int

    def summary(self, drivers: int) -> dict[str, float]:
        """Return the main errors by name; with the number of its drivers if the recording has more."""
        found = self.errors.summary()
        return found if self.drivers == drivers else {**found, "drivers": self.drivers}


def start_rivals(
    data: Recorded, to_beat: HeldOutErrors | None, work: ThreadPoolExecutor, where: Executor
) -> list[Future[dict[str, RivalErrors]]]:
    """Start the fits of all rivals.

    Parameters
    ----------
    data : Recorded
        The recording.
    to_beat : HeldOutErrors or None
        Errors of the driver model in a quick diagnosis, which takes shortcuts; None for all fits in full.
    work : ThreadPoolExecutor
        Runs the filters.
    where : Executor
        Carries out the fits: threads of this machine, or a cluster.

    Returns
    -------
    list of Future
        For each law its errors, by name.
    """
    if isinstance(where, ThreadPoolExecutor):
        return [where.submit(_rival, data, work, to_beat, law) for law in RIVALS]
    return send(where, _rival_there, (data, to_beat), RIVALS)


def _rival_there(common: tuple[Recorded, HeldOutErrors | None], law: str) -> dict[str, RivalErrors]:
    """What ``_rival`` returns, on a worker of a cluster; common: the recording, and what is to be beaten."""
    data, to_beat = common
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as work:
        return _rival(data, work, to_beat, law)


def _rival(data: Recorded, work: ThreadPoolExecutor, to_beat: HeldOutErrors | None, law: str) -> dict[str, RivalErrors]:
    """Errors of a rival fitted in the filter and, unless quick, of the rival fitted to gaps."""
    if to_beat is not None:
        return {law: _far_behind(data, work, to_beat, law) or _in_filter(data, work, law, to_beat.samples.total)}
    fitted = in_filter(data, law, work)
    found = {law: RivalErrors(held_out_errors(data, fitted, work, searched=True), data.drivers)}
    if has_parameters(law):
        errors = errors_of(data, by_gaps(data, law, fitted, work), work)
        found[f"{law}_least_squares"] = RivalErrors(errors, data.drivers)
    return found


def _far_behind(data: Recorded, work: ThreadPoolExecutor, to_beat: HeldOutErrors, law: str) -> RivalErrors | None:
    """Errors of a rival for some drivers, if it predicts all of them worse and drives no closer to what they did."""
    if data.drivers <= 2 * _FIRST:
        return None
    who = [k * data.drivers // _FIRST for k in range(_FIRST)]
    some = some_drivers(data, who)
    samples = to_beat.samples
    model = PointwiseDensity(samples.innovation_m[who], samples.innovation_var[who], samples.log_likelihood[who])
    found = _in_filter(some, work, law, model.total)
    won = gain(some, found.errors.samples, model)
    is_behind = max(won.drivers, default=0.0) < 0.0 and won.nats < -_FAR * won.se
    runs = rmse(found.errors.runs.single[:, -1])
    return found if is_behind and runs >= rmse(to_beat.runs.single[:, -1, who]) else None


def _in_filter(data: Recorded, work: ThreadPoolExecutor, law: str, to_beat: float) -> RivalErrors:
    """Errors of a rival fitted in the filter; to_beat: log-likelihood of the driver model [nats]."""
    fitted = in_filter(data, law, work, to_beat)
    return RivalErrors(held_out_errors(data, fitted, work, searched=False), data.drivers)
