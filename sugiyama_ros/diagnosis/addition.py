"""An effect that a diagnosis has added to the model, and what to record to tell it from others."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from sugiyama_ros.diagnosis.candidates import Candidate, Kind
from sugiyama_ros.diagnosis.errors import HeldOutErrors
from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.fit.cross_validation import Gain
from sugiyama_ros.fit.joint import JointFit


@dataclass(frozen=True, eq=False)
class Addition:
    """An effect that was added, with everything that a verdict says about it.

    parameters: values by name; indistinguishable: names of candidates that explain the data as well; advice: what to
    record to tell them apart; heldout: gain over the model before; before, after: held-out errors; fit: the new model.
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


def advice_for(name: str, others: Iterable[str]) -> tuple[str, ...]:
    """What to record to tell an effect from others that explain the data as well."""
    about = {name, *others}
    return tuple(
        text
        for first in EFFECTS.values()
        for second, text in first.advice.items()
        if name in (first.name, second) and {first.name, second} <= about
    )


def parameters_of(fitted: JointFit, candidate: Candidate) -> dict[str, float]:
    """Values of a candidate's parameters by name; the median driver's where every driver has a value."""
    places = sorted({*candidate.places, *candidate.starts[0]})
    rows = np.median(fitted.model.rows[:, places], axis=0)
    return {ROW.declared[k].name: float(v) for k, v in zip(places, rows, strict=True)}
