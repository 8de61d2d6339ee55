"""Fits of a model with candidates, and the same fits without each fold."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidates import (
    FORCE,
    FORCE_ALONG,
    OF_SOME,
    PUSH,
    Candidate,
    candidates,
    chosen,
    with_candidate,
)
from sugiyama_ros.diagnosis.score import Score, ScoreOfSome, directions, scores
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.coordinates import is_linear
from sugiyama_ros.fit.joint import NEAR_STEPS, JointFit, at_model, maximise, renewed
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.slopes import no_density

# Places of what happens once, in one car at one moment.
_ONCE = range(ROW.width)[ROW.places[PUSH]]


def refined(data: Recorded, fitted: JointFit, candidate: Candidate, found: Sequence[Score], work: Executor) -> JointFit:
    """Add a candidate to a fitted model, and fit the new model in full, as of ``finished``."""
    return finished(data, fitted, candidate, begun(data, fitted, candidate, found, work), work)


def begun(data: Recorded, fitted: JointFit, candidate: Candidate, found: Sequence[Score], work: Executor) -> JointFit:
    """Add a candidate to a fitted model, and take the first steps from the best start."""
    # another start of what some drivers have would be of other drivers
    near = [one for one in found[:2] if one.candidate.drivers == candidate.drivers]
    tried = [model for one in near for model in _starts(fitted.model, one)]
    tried = tried or [with_candidate(fitted.model, candidate, start) for start in candidate.starts]
    there = [_beside(data, fitted, model, work) for model in tried]
    start = renewed(data.roughly, max(there, key=lambda one: one.objective), work)
    return maximise(data.roughly, start, work, iterations=NEAR_STEPS, renewals=0)


def finished(data: Recorded, fitted: JointFit, candidate: Candidate, first: JointFit, work: Executor) -> JointFit:
    """Fit a model with a candidate in full after its first steps; then the drivers ahead get the parameters found.

    Where the candidate does nothing, or does not make the model better, the fitted model itself is returned.
    """
    found = maximise(data.roughly, first, work, renewals=2, fresh=False)
    found = at_model(data, found, replace(found.model, ahead=found.model.rows), work)
    found = maximise(data, found, work, iterations=NEAR_STEPS, renewals=0, fresh=False)
    if _does_nothing(data, found.model, candidate) or found.objective <= fitted.objective:
        return fitted
    return replace(found, beside=fitted if first.model.held else None)


def _does_nothing(data: Recorded, model: Model, candidate: Candidate) -> bool:
    """Whether all strengths of an effect are as small as a search lets them be."""
    places = list(candidate.switches)
    least = np.where(is_linear(places), 0.0, data.lower[places])
    return bool(places) and bool((np.abs(model.rows[:, places]) <= least).all())


def with_named(data: Recorded, fitted: JointFit, names: Sequence[str], work: Executor) -> JointFit:
    """Add candidates by their names to a fitted model, one after the other."""
    possible = candidates(data)
    for name in names:
        # names are checked before anything is fitted; which forces there are, the fitted model says
        if not name.startswith(FORCE):
            chosen(data, possible, name)
    for name in names:
        fitted = with_one(data, fitted, name, work)[1]
    return fitted


def with_one(data: Recorded, fitted: JointFit, name: str, work: Executor) -> tuple[Candidate, JointFit]:
    """Add a candidate by its name to a fitted model; who has it if only some drivers do, its scores say."""
    is_force = name.startswith((FORCE, FORCE_ALONG))
    one = None if is_force else chosen(data, candidates(data), name.removesuffix(OF_SOME))
    along = directions(data, fitted, [one] if one else [], work, with_forces=is_force)
    found = sorted(scores(data, fitted, along, work), key=lambda s: -s.gain)
    of_some = [s.candidate for s in found if s.candidate.name == name and name.endswith(OF_SOME)]
    candidate = next(iter(of_some), one) or chosen(data, [force.candidate for force in found], name)
    own = [s for s in found if s.candidate.name == candidate.name]
    return candidate, refined(data, fitted, candidate, own, work)


def without_folds(data: Recorded, fitted: JointFit, work: Executor, beside: Sequence[Model] = ()) -> tuple[Model, ...]:
    """Return a model for every fold, fitted to the other folds from the fit to all folds.

    What a model holds comes from a fit that has not seen the fold, either; ``beside``: this fit's models, if known.
    """
    others = [[k for k in range(FOLDS) if k != f] for f in range(FOLDS)]
    if fitted.beside is None:
        return tuple(_without_fold(data, fitted, folds, work) for folds in others)
    places, found = list(fitted.model.held), []
    for model, folds in zip(beside or without_folds(data, fitted.beside, work), others, strict=True):
        rows = fitted.model.rows.copy()
        rows[:, places] = model.rows[:, places]
        found.append(_from_rows(data, fitted, rows, folds, work))
    return tuple(found)


def _without_fold(data: Recorded, fitted: JointFit, folds: Sequence[int], work: Executor) -> Model:
    """The fit to some folds: first each driver alone, so that no shared parameter keeps drivers where they are."""
    own = len(fitted.model.individual)
    slopes = tuple(
        replace(s, score=s.score[:, :own], information=s.information[:, :own, :own], columns=s.columns[:own])
        for s in fitted.slopes
    )
    alone = JointFit(replace(fitted.model, shared=(), few=()), fitted.samples, slopes)
    found = maximise(data, alone, work, folds=folds, iterations=NEAR_STEPS, renewals=0).model
    if not fitted.model.shared:
        return found
    return _from_rows(data, fitted, found.rows, folds, work)


def _from_rows(data: Recorded, fitted: JointFit, rows: Array, folds: Sequence[int], work: Executor) -> Model:
    """The fit of all drivers together to some folds, from rows (N, WIDTH) near those of a fit."""
    # of what happens once, the other folds say nothing
    held = (*fitted.model.held, *(k for k in fitted.model.shared if k in _ONCE))
    start = at_model(data, fitted, replace(fitted.model, rows=rows, held=held), work)
    return maximise(data, start, work, folds=folds, iterations=NEAR_STEPS, renewals=0).model


def without(data: Recorded, fitted: JointFit, candidate: Candidate, work: Executor) -> JointFit:
    """Return a fitted model without one of its candidates; its parameters are still to be fitted again."""
    model = fitted.model
    entries = sorted({*candidate.places, *(k for start in candidate.starts for k in start)})
    rows, ahead = model.rows.copy(), model.ahead.copy()
    rows[:, entries] = ahead[:, entries] = [ROW.declared[k].default for k in entries]
    own = [j for j, k in enumerate(model.individual) if k not in candidate.places]
    less = replace(
        model,
        rows=rows,
        ahead=ahead,
        individual=tuple(model.individual[j] for j in own),
        prior_std=tuple(model.prior_std[j] for j in own),
        shared=tuple(k for k in model.shared if k not in candidate.places),
        few=tuple((k, who) for k, who in model.few if k not in candidate.places),
    )
    return renewed(data, _beside(data, fitted, less, work), work)


def _starts(model: Model, score: Score) -> list[Model]:
    """The start of a score, with the strengths that the score predicts, and as it is declared."""
    candidate, strength = score.candidate, score.strength
    declared = with_candidate(model, candidate, score.starts[0])
    if candidate.kind == "force":
        rows = declared.rows.copy()
        rows[:, candidate.places] = strength
        return [replace(declared, rows=rows)]
    if not score.starts[0] or score.information is None:
        return [declared]
    scaled: dict[int, float | Array] = dict(score.starts[0])
    for j, start in enumerate(score.starts):
        for k in candidate.strengths or candidate.places[:1]:
            if np.any(start[k]):
                size = score.size if isinstance(score, ScoreOfSome) else strength[..., j]
                scaled[k] = np.clip(size * np.asarray(start[k]), ROW.declared[k].lower, ROW.declared[k].upper)
    as_predicted = with_candidate(model, candidate, scaled)
    return [as_predicted] if len(score.starts) > 1 else [as_predicted, declared]


def _beside(data: Recorded, fitted: JointFit, model: Model, work: Executor) -> JointFit:
    """A fit at a model with further parameters, whose slopes are still to be computed."""
    known = [*fitted.model.individual, *fitted.model.shared]
    zeros = no_density(data.samples)
    nothing = (zeros, zeros, zeros)
    slopes = tuple(
        replace(
            s,
            columns=tuple(
                s.columns[known.index(k)] if k in known else nothing for k in (*model.individual, *model.shared)
            ),
        )
        for s in fitted.slopes
    )
    return at_model(data, JointFit(fitted.model, fitted.samples, slopes), model, work)
