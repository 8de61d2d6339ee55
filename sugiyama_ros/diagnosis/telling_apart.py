"""Which candidates the data cannot tell apart from the best one."""

from collections.abc import Iterable

from sugiyama_ros.fit.cross_validation import Gain, gain, held_out_nearly, sum_error
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.score import PointwiseDensity

# One candidate is clearly worse than another by this many standard errors (5 %), and at least this difference [nats].
_CLEARLY, _LEAST = 1.645, 3.0
# Drivers may do what a candidate says by a formula that is not quite its own. It may then lose a share of the gain, and
# of a small gain half, up to so many nats.
_OTHER_FORMULA, _OF_LITTLE, _LITTLE = 0.25, 0.5, 10.0


def indistinguishable(
    data: Recorded,
    base: PointwiseDensity,
    best: tuple[str, PointwiseDensity],
    others: Iterable[tuple[str, JointFit]],
) -> tuple[str, ...]:
    """Return the names of the mechanisms that do not predict held-out samples clearly worse than the best one.

    This is Vuong's test of models that are not nested (Econometrica 57 (1989) 307), one-sided, paired over drivers. It
    is known at this point that something is missing, so the p-value of a rival needs no correction. The test compares
    formulas, and a mechanism has many: the closest rival also stays if it has nearly all of the gain, or half of a
    small gain.

    Parameters
    ----------
    data : Recorded
        The recording.
    base : PointwiseDensity
        Held-out predictions of the model without any of them.
    best : (str, PointwiseDensity)
        Name of the best mechanism, and its held-out predictions, from searched folds where the fit in the sample
        promises too much.
    others : iterable of (str, JointFit)
        Names and fits of the other mechanisms.

    Returns
    -------
    tuple of str
        The names, each once.
    """
    name, by_best = best
    behind: dict[str, Gain] = {}
    for other, one in others:
        if other != name and other not in behind:
            behind[other] = gain(data, by_best, held_out_nearly(data, one))
    alike = [one for one, lost in behind.items() if lost.nats < max(_CLEARLY * sum_error(lost.drivers), _LEAST)]
    if behind and not alike:
        closest = min(behind, key=lambda one: behind[one].nats)
        won = gain(data, by_best, base).nats
        may_lose = max(_OTHER_FORMULA * won, min(_OF_LITTLE * won, _LITTLE))
        alike = [closest] if behind[closest].nats < may_lose else []
    return tuple(alike)
