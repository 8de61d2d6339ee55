"""Which candidates the data cannot tell apart from the best one."""

from collections.abc import Sequence

from sugiyama_ros.diagnosis.candidacy import Candidacy
from sugiyama_ros.fit.cross_validation import gain, held_out_nearly, sum_error
from sugiyama_ros.fit.recording import Recorded

# One candidate is clearly worse than another by this many standard errors (5 %), and at least this difference [nats].
_CLEARLY, _LEAST_DIFFERENCE = 1.645, 3.0


def indistinguishable(data: Recorded, best: Candidacy, scored: Sequence[Candidacy]) -> tuple[str, ...]:
    """Return the names of the candidates that do not predict held-out samples clearly worse than the best candidate.

    This is Vuong's test of models that are not nested (Econometrica 57 (1989) 307), one-sided, paired over drivers. It
    is known at this point that something is missing, so the p-value of a rival needs no correction.

    Parameters
    ----------
    data : Recorded
        The recording.
    best : Candidacy
        The best candidate.
    scored : sequence of Candidacy
        All candidates; only those with a full fit count.

    Returns
    -------
    tuple of str
        The names.
    """
    by_best = held_out_nearly(data, best.fit)
    names = []
    for one in scored:
        if one.refined and one.candidate.name != best.candidate.name:
            behind = gain(data, by_best, held_out_nearly(data, one.fit))
            if behind.nats < max(_CLEARLY * sum_error(behind.drivers), _LEAST_DIFFERENCE):
                names.append(one.candidate.name)
    return tuple(names)
