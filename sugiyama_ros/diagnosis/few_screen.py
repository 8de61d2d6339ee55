"""A screen for effects that only a few drivers have.

All drivers share the strength of an effect, so a fit to all of them hides what a few do. Here each driver has a
strength of their own. Where the gains of a few drivers stand out, the effect is worth a fit to these drivers.
"""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidates import Candidate, added
from sugiyama_ros.diagnosis.few import LEVEL_OF_FEW, Few, FitOfFew, at_most, cost_of, fit_few, switches_of
from sugiyama_ros.diagnosis.forms import best_forms
from sugiyama_ros.diagnosis.prescreen import Prescreen
from sugiyama_ros.diagnosis.response import while_own_respond
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.score import predict_each
from sugiyama_ros.fit.slopes import Column, column, sums
from sugiyama_ros.progress import OnStage
from sugiyama_ros.workers import at_once

# With more starts of an effect, every other one is left out.
_MOST_STARTS = 6
# Number of mechanisms that are fitted to a few drivers in full.
_FITS = 3


@dataclass(frozen=True)
class ShownByFew:
    """An effect by which a few drivers would gain, each with a strength of their own.

    Parameters
    ----------
    candidate : Candidate
        The effect.
    few : Few
        The drivers.
    gain : float
        Predicted gain of these drivers [nats], less what the choice of the drivers and of the start gains by chance.
    """

    candidate: Candidate
    few: Few
    gain: float


def shown_by_few(
    data: Recorded,
    base: JointFit,
    possible: Sequence[Candidate],
    work: Executor,
    on_progress: OnStage,
    seen: Mapping[str, Prescreen] | None = None,
) -> list[ShownByFew]:
    """Predict for each effect which few drivers would gain most by it.

    Parameters
    ----------
    data : Recorded
        The recording.
    base : JointFit
        The fitted model without the effects.
    possible : sequence of Candidate
        The effects; those without a strength that drivers share are left out.
    work : Executor
        Runs the filters.
    on_progress : callable
        Called with the name of the stage, the number of steps done, and the number of all steps.
    seen : mapping of str to Prescreen, optional
        Prescreens of effects beside the same model, by name.

    Returns
    -------
    list of ShownByFew
        One for each effect, the largest gain first; empty with too few drivers, and where samples are far apart: there,
        effects gain by chance what only simulations can say, and the choice of drivers is not simulated.
    """
    if not at_most(data.drivers) or data.is_sparse:
        return []

    def look(candidate: Candidate) -> ShownByFew:
        # a prescreen takes several strengths one at a time
        known = (seen or {}).get(candidate.name) if len(candidate.strengths) < 2 else None
        gains = _gains(data, base, candidate, known, work)
        few, gain = max((chosen(g) for g in gains), key=lambda one: one[1])
        return ShownByFew(candidate, few, gain - math.log(len(gains)))

    shown = at_once(look, [c for c in possible if switches_of(c)], "effects of a few drivers", on_progress)
    return sorted(shown, key=lambda one: -one.gain)


def fits_of_few(
    data: Recorded,
    base: JointFit,
    shown: Sequence[ShownByFew],
    candidates: int,
    work: Executor,
    on_progress: OnStage,
) -> list[FitOfFew]:
    """Fit effects to the few drivers who show them.

    Parameters
    ----------
    data : Recorded
        The recording.
    base : JointFit
        The fitted model without the effects.
    shown : sequence of ShownByFew
        The effects, each with its drivers.
    candidates : int
        Number of effects among which these were chosen, for the correction of the p-value.
    work : Executor
        Runs the filters.
    on_progress : callable
        Called with the name of the stage, the number of steps done, and the number of all steps.

    Returns
    -------
    list of FitOfFew
        At most three mechanisms, each in its best form, the largest gain first. What chance explains is left out.
    """

    def fit(one: ShownByFew) -> FitOfFew:
        return fit_few(data, base, one.candidate, one.few, candidates, work)

    fits = at_once(fit, shown, "fits to a few drivers", on_progress)
    forms = best_forms([f for f in fits if f.p_value <= LEVEL_OF_FEW])
    return sorted(forms, key=lambda f: f.few.cost - f.gain)[:_FITS]


def chosen(gains: Array) -> tuple[Few, float]:
    """Choose the few drivers who gain most, by what they gain beyond what their choice gains by chance.

    Parameters
    ----------
    gains : ndarray, shape (N,)
        Gain of each driver [nats].

    Returns
    -------
    (Few, float)
        The drivers, and their gain less the cost of the choice [nats].
    """
    order = np.argsort(-gains)
    sizes = range(1, at_most(len(gains)) + 1)
    costs = [cost_of(k, len(gains)) for k in sizes]
    left = [float(gains[order[:k]].sum()) - cost for k, cost in zip(sizes, costs, strict=True)]
    best = int(np.argmax(left))
    return Few(tuple(sorted(order[: best + 1].tolist())), costs[best]), left[best]


def _starts(candidate: Candidate) -> Sequence[int]:
    """Numbers of the starts that differ in more than the strength, which the screen scales anyway.

    Places and moments lie so close together that every other one will do.
    """
    strengths = switches_of(candidate)
    seen: dict[tuple[object, ...], int] = {}
    for number, start in enumerate(candidate.starts):
        seen.setdefault(tuple(v for k, v in start.items() if k not in strengths), number)
    numbers = tuple(seen.values())
    return numbers[:: 1 if len(numbers) <= _MOST_STARTS else 2]


def _gains(data: Recorded, base: JointFit, candidate: Candidate, seen: Prescreen | None, work: Executor) -> list[Array]:
    """Predict what each driver would gain (N,) [nats] by an effect at each of its starts, scaled for this driver.

    A strength of either sign is predicted for each sign, because those who share an effect share its sign.
    """
    signs = (1.0, -1.0) if ROW.declared[switches_of(candidate)[0]].lower < 0.0 else (1.0,)
    numbers, gains = _starts(candidate), []
    models = [added(base.model, candidate, candidate.starts[number]) for number in numbers]
    others = [i for i in range(data.drivers) if not (seen and i in seen.some)]
    for number, there, found in zip(numbers, models, predict_each(data.roughly, models, others, work), strict=True):
        new = dict(seen.changes[number]) if seen else {}
        new |= {i: column(base.samples.of(i), at, 1.0, there.rows[i]) for i, at in zip(others, found, strict=True)}
        slopes, scales = np.array(_scaled(data, base, [new[i] for i in range(data.drivers)])).T
        gains += [np.where(sign * scales > 0.0, 0.5 * slopes * scales, 0.0) for sign in signs]
    return gains


def _scaled(data: Recorded, base: JointFit, new: Sequence[Column]) -> list[tuple[float, float]]:
    """Slope of each driver's log posterior by a strength, and the best strength, while their own parameters respond."""
    own, found = len(base.model.individual), []
    for i, (s, row) in enumerate(zip(base.slopes, base.model.rows, strict=True)):
        at = sums(base.samples.of(i), (*s.columns[:own], new[i]), row, data.fold[i])
        slope, bend = (float(part.item()) for part in while_own_respond(base, i, at))
        found.append((slope, slope / bend if bend > 0.0 else 0.0))
    return found
