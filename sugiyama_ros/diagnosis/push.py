"""Pushes from outside: which car, and when, as the innovations suggest."""

import math

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.effects.external_push import EFFECT
from sugiyama_ros.effects.registry import index_of
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.score import PointwiseDensity

# Lengths of a run of innovations [s] that are tried.
_RUNS_S = (1.0, 2.0, 4.0)
# Acceleration [m/s^2] at the peak of a push at which the search begins.
_START = 0.5


def push_candidate(data: Recorded, samples: PointwiseDensity) -> Candidate | None:
    """Return a push of the car and at the moment with the largest run of standardised innovations.

    Parameters
    ----------
    data : Recorded
        The recording.
    samples : PointwiseDensity
        Predictions of the model without the push.

    Returns
    -------
    Candidate or None
        The push, with the gain that the choice of the car and of the moment brings by chance; None where nothing is
        predicted, and on tracks, where a push would need a time that all stretches share.
    """
    around = data.vicinity
    if not around.is_whole_road:
        return None
    scored = np.isfinite(samples.log_likelihood)
    z = np.where(scored, samples.innovation_m / np.sqrt(samples.innovation_var), 0.0)
    places, best = 0.0, (0.0, 0, 0, 0.0)
    for run_s in _RUNS_S:
        length = max(1, round(run_s / around.period_s))
        if length >= z.shape[1]:
            continue
        strength = _runs(z, length)
        car, at = divmod(int(np.argmax(np.abs(strength))), strength.shape[1])
        value = float(strength[car, at])
        # runs that overlap by half count as one place
        places += 2.0 * scored.sum() / length
        if abs(value) > abs(best[0]):
            best = (value, car, at, run_s)
    value, car, at, run_s = best
    if not run_s:
        return None
    index = {p.name: index_of(EFFECT.name, p.name) for p in EFFECT.parameters}
    spared = np.ones(data.drivers)
    spared[car] = 0.0
    start: dict[int, float | Array] = {
        index["strength"]: math.copysign(_START, value),
        # the innovations of a pushed car are of one sign from the push on, until the filter has understood
        index["time"]: float(around.time_s[at, car]),
        index["duration"]: 0.5 * run_s,
        index["spared"]: spared,
    }
    return Candidate(
        name=EFFECT.name,
        kind="effect",
        places=tuple(index[name] for name in ("strength", "time", "duration")),
        starts=(start,),
        summary=EFFECT.summary,
        strengths=(index["strength"],),
        elsewhere=math.log(max(places, 1.0)),
        is_variant=True,
    )


def _runs(z: Array, length: int) -> Array:
    """Return the sums of ``length`` numbers in a row over the square root of their count, (N, T - length + 1)."""
    total = np.cumsum(np.pad(z, ((0, 0), (1, 0))), axis=1)
    return np.asarray((total[:, length:] - total[:, :-length]) / math.sqrt(length))
