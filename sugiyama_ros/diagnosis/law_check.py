"""Whether another law does better in the data than in recordings that the model itself simulates.

A law that predicts nearly as well as the model, or whose free runs end closer, says little by itself: free runs without
noise end closer where a law damps the waves, and short recordings cannot tell laws apart. The recordings that the model
simulates show what to expect if the model is right (Cox, J. R. Stat. Soc. B 24 (1962) 406).
"""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from sugiyama_ros.diagnosis.chance import p_value_of
from sugiyama_ros.diagnosis.errors import HeldOutErrors
from sugiyama_ros.diagnosis.rivals import errors_of_law
from sugiyama_ros.fit.cross_validation import Gain, gain
from sugiyama_ros.fit.recording import Recorded

#: A law is better, or worse, beyond doubt by this many standard errors of a paired gain.
CLEARLY = 2.0
#: Factor by which free runs of a law must end closer to count at all.
FURTHER = 1.2
#: Probability below which a law does better in the data than in simulations.
LEVEL_OF_LAWS = 0.01
# A law that explains as much as the additions loses this part of their gain at most.
_MAY_LOSE = 0.5
# Common std of gains as a part of their mean, and of the logarithm of a ratio of free runs.
_PART_OF_GAIN, _LOG_RATIO = 0.25, 0.2


@dataclass(frozen=True)
class LawCheck:
    """What a law does in recordings that the model simulates, beside the model fitted to them.

    Parameters
    ----------
    gains : tuple of float
        Held-out gain of the law over the model [nats], one for each recording.
    ratios : tuple of float
        Logarithm of the error of the model's free runs over the error of the law's free runs.
    """

    gains: tuple[float, ...]
    ratios: tuple[float, ...]

    def p_of_gain(self, won: Gain) -> float:
        """Return the probability of a gain as large as ``won`` if the model is right."""
        return p_value_of(won.nats, self.gains, math.hypot(won.se, _PART_OF_GAIN * float(np.mean(self.gains))))

    def p_of_ratio(self, ratio: float) -> float:
        """Return the probability of a logarithm of the ratio as large as ``ratio`` if the model is right."""
        return p_value_of(ratio, self.ratios, _LOG_RATIO)


def log_ratio(model: HeldOutErrors, law: HeldOutErrors) -> float:
    """Return the logarithm of the error of the model's free runs over the error of the law's free runs."""
    ours, theirs = model.free_run_10s_beside(law)
    return math.log(max(ours, 1e-6) / max(theirs, 1e-6))


def laws_say_as_much(
    data: Recorded, base: HeldOutErrors, final: HeldOutErrors, laws: Mapping[str, HeldOutErrors]
) -> list[str]:
    """Say which law explains what was missing about as well as the additions: it may be what the drivers follow.

    Parameters
    ----------
    data : Recorded
        The recording.
    base, final : HeldOutErrors
        Held-out errors of the model without and with the additions.
    laws : mapping of str to HeldOutErrors
        Held-out errors of the laws, by name.

    Returns
    -------
    list of str
        A sentence about the law that comes closest; empty if it is clearly worse than the final model, or gains less
        than half of what the additions gain.
    """
    behind = {law: gain(data, final.samples, errors.samples) for law, errors in laws.items()}
    closest = min(behind, key=lambda law: behind[law].nats, default="")
    lost, gained = behind.get(closest), gain(data, final.samples, base.samples).nats
    if lost is None or lost.nats > min(CLEARLY * lost.se, _MAY_LOSE * gained):
        return []
    won = gain(data, laws[closest].samples, base.samples)
    return [
        f"{closest} explains what was missing about as well: it predicts better than the model without the additions by"
        f" {won.nats:.0f} ± {won.se:.0f} nats, and {_beside(lost)} the model with them"
    ]


def _beside(lost: Gain) -> str:
    """Where a law is beside a model that predicts better than the law by ``lost``."""
    return f"is {lost.nats:.0f} ± {lost.se:.0f} nats behind" if lost.nats > 0.0 else "is not behind"


def open_laws(data: Recorded, model: HeldOutErrors, laws: Mapping[str, HeldOutErrors]) -> tuple[str, ...]:
    """Return the laws that only simulations can judge: they predict as well, or their free runs end closer.

    Where samples are far apart, simulations also judge a law that predicts better.

    Parameters
    ----------
    data : Recorded
        The recording.
    model : HeldOutErrors
        Held-out errors of the model.
    laws : mapping of str to HeldOutErrors
        Held-out errors of the laws, by name.

    Returns
    -------
    tuple of str
        At most two names.
    """
    gains = {name: gain(data, errors.samples, model.samples) for name, errors in laws.items()}
    best = max(gains, key=lambda name: gains[name].nats, default=None)
    closest = min(laws, key=lambda name: laws[name].free_run_10s_m, default=None)
    found = []
    if best is not None:
        clearly = CLEARLY * gains[best].se
        if -clearly <= gains[best].nats and (data.is_sparse or gains[best].nats <= clearly):
            found.append(best)
    if closest is not None and log_ratio(model, laws[closest]) > math.log(FURTHER):
        found.append(closest)
    return tuple(dict.fromkeys(found))


def closer_laws(model: HeldOutErrors, laws: Mapping[str, HeldOutErrors]) -> dict[str, float]:
    """Return the laws whose free runs end clearly closer than those of the model, whatever the reason.

    Parameters
    ----------
    model : HeldOutErrors
        Held-out errors of the model.
    laws : mapping of str to HeldOutErrors
        Held-out errors of the laws, by name.

    Returns
    -------
    dict of str to float
        Error after 10 s [m] by name, the smallest first.
    """
    found = {
        name: errors.free_run_10s_m
        for name, errors in laws.items()
        if log_ratio(model, errors) > math.log(FURTHER) and not model.no_worse_than(errors)
    }
    return dict(sorted(found.items(), key=lambda one: one[1]))


def check_laws(
    laws: Mapping[str, HeldOutErrors],
    simulations: Sequence[tuple[Recorded, HeldOutErrors]],
    work: ThreadPoolExecutor,
) -> dict[str, LawCheck]:
    """Fit laws to recordings that the model simulates.

    Parameters
    ----------
    laws : mapping of str to HeldOutErrors
        Held-out errors in the data of the laws to check, by name. A law is fitted to the same drivers in simulations.
    simulations : sequence of (Recorded, HeldOutErrors)
        Simulated recordings, with the errors of the model fitted to them.
    work : ThreadPoolExecutor
        Runs the filters.

    Returns
    -------
    dict of str to LawCheck
        What each law does there.
    """
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in laws}
    for simulated, model in simulations:
        for name, errors in laws.items():
            law = errors_of_law(simulated, name, model, errors.predicted_drivers, work)
            won = gain(simulated, law.samples, model.samples).nats
            found[name].append((won, log_ratio(model, law)))
    return {name: LawCheck(*zip(*pairs, strict=True)) for name, pairs in found.items() if pairs}
