"""Fits of all other laws, beside the search for what is missing."""

import os
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import NamedTuple

from sugiyama_ros.diagnosis.errors import HeldOutErrors, errors_of, held_out_errors
from sugiyama_ros.diagnosis.rivals import by_gaps, errors_of_law, has_parameters, in_filter
from sugiyama_ros.fit.cross_validation import gain
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.laws.registry import RIVALS
from sugiyama_ros.workers import send

# Number of drivers to whom a quick diagnosis fits a law first, as many as filters run side by side; and number of those
# who decide about a law, or up to twice as many.
_FIRST, _ENOUGH = 8, 24
# A law is far behind if it loses by more than so many standard errors, and by what a fit that did not come to the end
# may lack [nats].
_FAR, _LACKS = 4.0, 60.0


class RivalErrors(NamedTuple):
    """Held-out errors of a rival, and whether it is so far behind that it was fitted to a few drivers, less closely."""

    errors: HeldOutErrors
    is_far: bool = False

    def summary(self, drivers: int) -> dict[str, float]:
        """Return the main errors by name; with the number of its drivers if the recording has more who follow."""
        found, fitted = self.errors.summary(), len(self.errors.predicted_drivers)
        return found if fitted >= drivers else {**found, "drivers": fitted}


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
        some = list(data.spread(_ENOUGH))
        return {
            law: _far_behind(data, work, to_beat, law) or RivalErrors(errors_of_law(data, law, to_beat, some, work))
        }
    fitted = in_filter(data, law, work)
    found = {law: RivalErrors(held_out_errors(data, fitted, work, searched=True))}
    if has_parameters(law):
        errors = errors_of(data, by_gaps(data, law, fitted, work), work)
        found[f"{law}_least_squares"] = RivalErrors(errors)
    return found


def _far_behind(data: Recorded, work: ThreadPoolExecutor, to_beat: HeldOutErrors, law: str) -> RivalErrors | None:
    """Errors of a rival for some drivers, if it predicts all of them worse and drives no closer to what they did."""
    if data.drivers <= 2 * _FIRST:
        return None
    some = [k * data.drivers // _FIRST for k in range(_FIRST)]
    found = errors_of_law(data, law, to_beat, some, work, nearly=True)
    won = gain(data, found.samples, to_beat.samples)
    is_behind = max(won.drivers, default=0.0) < 0.0 and won.nats < -_FAR * won.se - _LACKS
    model, ours = to_beat.free_run_10s_beside(found)
    return RivalErrors(found, is_far=True) if is_behind and ours >= model else None
