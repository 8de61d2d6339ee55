"""Which candidates the data cannot tell apart from the best one."""

from collections.abc import Iterable

from sugiyama_ros.fit.cross_validation import gain, held_out_nearly, sum_error
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.recording import Recorded

# One candidate is clearly worse than another by this many standard errors (5 %), and at least this difference [nats].
_CLEARLY, _LEAST_DIFFERENCE = 1.645, 3.0


def indistinguishable(
    data: Recorded, best: tuple[str, JointFit], others: Iterable[tuple[str, JointFit]]
) -> tuple[str, ...]:
    """Return the names of the mechanisms that do not predict held-out samples clearly worse than the best one.

    This is Vuong's test of models that are not nested (Econometrica 57 (1989) 307), one-sided, paired over drivers. It
    is known at this point that something is missing, so the p-value of a rival needs no correction.

    Parameters
    ----------
    data : Recorded
        The recording.
    best : (str, JointFit)
        Name of the best mechanism, and its fit.
    others : iterable of (str, JointFit)
        Names and fits of the other mechanisms.

    Returns
    -------
    tuple of str
        The names, each once.
    """
    name, fitted = best
    names: list[str] = []
    by_best = held_out_nearly(data, fitted)
    for other, one in others:
        if other not in (name, *names):
            behind = gain(data, by_best, held_out_nearly(data, one))
            if behind.nats < max(_CLEARLY * sum_error(behind.drivers), _LEAST_DIFFERENCE):
                names.append(other)
    return tuple(names)
