"""An effect that a diagnosis has added to the model, and advice on what to record to tell it from other effects."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from sugiyama_ros.diagnosis.candidacy import LEAST_GAIN
from sugiyama_ros.diagnosis.candidates import Candidate, Kind
from sugiyama_ros.diagnosis.errors import MANY_DRIVERS, HeldOutErrors
from sugiyama_ros.diagnosis.few import rises
from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.fit.cross_validation import Gain, sum_error
from sugiyama_ros.fit.joint import JointFit

#: An effect of some drivers only, freed constants and forces without a name take so many standard errors of their
#: held-out gain.
FLEXIBLE = 2.0
#: Nothing predicts more than it fits: beyond so many times the gain of the fit, a step to a held-out model failed.
FEIGNED = 1.1
# One of very many candidates may gain this much [nats] by chance: gains that the filter's approximations give have
# long tails, which six simulations do not show.
_BY_CHANCE = 20.0


@dataclass(frozen=True, eq=False)
class Addition:
    """An effect that a diagnosis has added to the model, with everything that the verdict says about it.

    Parameters
    ----------
    name : str
        Name of the candidate.
    kind : {"effect", "measurement", "constants"}
        What the candidate changes.
    parameters : dict of str to float
        Fitted values by name.
    indistinguishable : tuple of str
        Names of candidates that explain the data as well.
    advice : tuple of str
        What to record to tell the candidates apart.
    p_value : float
        Probability that chance alone gives such a gain, corrected for the number of candidates.
    heldout : Gain
        Held-out gain over the model without the addition.
    before, after : HeldOutErrors
        Held-out errors without and with the addition.
    fit : JointFit
        The model with the addition.
    form : str
        Name of the effect that was added: one form of the mechanism ``name``.
    drivers : tuple of int
        Columns of the drivers who have it, or who bring nearly all of its gain; empty for all.
    worse : tuple of str
        Where the model with the addition does worse in the last part of the recording than the base model, in words.
    is_supported : bool
        Whether the data ask for it. What somebody asks for is added even if they do not.
    """

    name: str
    kind: Kind
    parameters: dict[str, float]
    indistinguishable: tuple[str, ...]
    advice: tuple[str, ...]
    p_value: float
    heldout: Gain
    before: HeldOutErrors
    after: HeldOutErrors
    fit: JointFit
    form: str
    drivers: tuple[int, ...] = ()
    worse: tuple[str, ...] = ()
    is_supported: bool = True

    @property
    def is_of_others_too(self) -> bool:
        """Whether drivers have it who gain nothing by it: nothing was found that only the drivers who gain have."""
        return bool(self.drivers) and all(who != self.drivers for _, who in self.fit.model.few)


def addition_of(
    candidate: Candidate,
    fitted: JointFit,
    errors: tuple[HeldOutErrors, HeldOutErrors],
    won: Gain,
    p_value: float,
    rivals: tuple[str, ...],
) -> Addition:
    """Return a candidate as an addition to the model.

    Parameters
    ----------
    candidate : Candidate
        The candidate.
    fitted : JointFit
        The model with the candidate.
    errors : tuple of HeldOutErrors
        Held-out errors without and with the candidate.
    won : Gain
        Held-out gain over the model without the candidate.
    p_value : float
        Probability that chance alone gives such a gain.
    rivals : tuple of str
        Names of candidates that explain the data as well.

    Returns
    -------
    Addition
        The addition.
    """
    return Addition(
        name=candidate.mechanism,
        form=candidate.name,
        kind=candidate.kind,
        parameters=parameters_of(fitted, candidate),
        indistinguishable=rivals,
        advice=advice_for(candidate.mechanism, rivals),
        p_value=p_value,
        heldout=won,
        before=errors[0],
        after=errors[1],
        fit=fitted,
        drivers=candidate.drivers,
    )


def advice_for(name: str, others: Iterable[str]) -> tuple[str, ...]:
    """Return what to record to tell an effect from others that explain the data as well.

    Parameters
    ----------
    name : str
        Name of the effect.
    others : iterable of str
        Names of the other effects.

    Returns
    -------
    tuple of str
        One piece of advice for each pair of effects that declares some.
    """
    about = {name, *others}
    return tuple(
        text
        for first in EFFECTS.values()
        for second, text in first.advice.items()
        if name in (first.name, second) and {first.name, second} <= about
    )


def parameters_of(fitted: JointFit, candidate: Candidate) -> dict[str, float]:
    """Return the values of a candidate's parameters by name; the median over the drivers for individual parameters."""
    places = candidate.entries
    who = list(candidate.drivers) or slice(None)
    rows = np.median(fitted.model.rows[who][:, places], axis=0)
    return {ROW.declared[k].name: float(v) for k, v in zip(places, rows, strict=True)}


def feigning(before: tuple[JointFit, HeldOutErrors], after: tuple[JointFit, HeldOutErrors]) -> list[int]:
    """Return the numbers of the drivers without whom a held-out gain would not exceed the gain of the fit.

    These are the drivers who gain more held out than by the fit, by a nat and by more than a tenth; those who gain most
    come first, and no more of them than it takes.
    """
    held_out = [np.nansum(errors.samples.log_likelihood, axis=1) for _, errors in (before, after)]
    gains, risen = held_out[1] - held_out[0], rises(before[0], after[0])
    excess = gains - FEIGNED * np.maximum(risen, 0.0) - 1.0
    order = np.argsort(-excess)
    too_much = gains.sum() - FEIGNED * risen.sum() - LEAST_GAIN
    enough = int(np.searchsorted(np.cumsum(excess[order]), too_much)) + 1
    return sorted(int(i) for i in order[:enough] if excess[i] > 0.0)


def least_gain(won: Gain, candidate: Candidate) -> float:
    """Return the smallest held-out gain [nats] with which something is added.

    It is the standard error of the gain over drivers, or over blocks of time where drivers are few.
    An effect of some drivers only is chosen among very many, so it takes two standard errors. So do freed constants,
    which take in part of whatever is missing. A gain that chance may give, although few simulations show it, must be
    two standard errors over drivers as well as over blocks. What happens once cannot be held out.
    """
    if candidate.happens_once:
        return -math.inf
    if candidate.drivers:
        return FLEXIBLE * sum_error(won.blocks)
    if won.nats < _BY_CHANCE:
        return FLEXIBLE * won.se
    error = sum_error(won.drivers) if len(won.drivers) >= MANY_DRIVERS else won.se
    return FLEXIBLE * error if candidate.kind == "constants" else error
