"""A model fitted without the last part of a recording, into which it then drives by itself."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.diagnosis.free_runs import FreeRuns, free_runs
from sugiyama_ros.diagnosis.refits import fit_from_nothing
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.joint import JointFit, maximise
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.recording import BLOCK_S, FOLDS, Recorded, prepare
from sugiyama_ros.fit.score import follow
from sugiyama_ros.fit.slopes import sums

# Part of the recording that is fitted.
_FITTED = 0.6
_STEPS = 6


@dataclass(frozen=True, eq=False)
class LastPart:
    """Errors of a model in the last part of a recording, which it was not fitted to.

    Parameters
    ----------
    runs : FreeRuns
        Free runs that start there.
    drivers : ndarray, shape (N,)
        Log-likelihood of the samples of each driver [nats].
    period_s : float
        Time between two samples [s].
    """

    runs: FreeRuns
    drivers: Array
    period_s: float

    @property
    def collisions(self) -> int:
        """Number of cars that touch their leaders at a horizon of a coupled run without noise."""
        return int((self.runs.touches[self.runs.gap > 0.0] > 0.0).sum())


def last_part(data: Recorded, fitted: JointFit, work: Executor) -> LastPart:
    """Fit a model to the first part of a recording, and let it drive into the last part.

    What happens at one moment, in the last part or in the block before it, cannot be learnt from the first part. Its
    parameters stay as they are.

    Parameters
    ----------
    data : Recorded
        The recording.
    fitted : JointFit
        The model fitted to the whole recording.
    work : Executor
        Runs the filters.

    Returns
    -------
    LastPart
        Errors in the last part.
    """
    begin = _last_part_begins(data)
    fold = np.minimum(data.block % (FOLDS - 1), FOLDS - 2)
    fold[:, begin:] = FOLDS - 1
    split = replace(data, fold=fold)
    samples, model, rows = fitted.samples, fitted.model, fitted.model.rows
    begin_s = data.chains[0].start_s + begin * data.vicinity.period_s - BLOCK_S
    learnt = [j for j, k in enumerate(model.shared) if _happens_at_s(rows, k) < begin_s]
    shared, own = tuple(model.shared[j] for j in learnt), len(model.individual)
    first = replace(model, shared=shared, few=tuple(one for one in model.few if one[0] in shared))
    slopes = []
    for i, s in enumerate(fitted.slopes):
        columns = (*s.columns[:own], *(s.columns[own + j] for j in learnt))
        slopes.append(sums(samples.of(i), columns, rows[i], fold[i]))
    start, known = JointFit(first, samples, tuple(slopes)), range(FOLDS - 1)
    found = maximise(split, start, work, folds=known, iterations=_STEPS, renewals=1)
    return _driven_on(data, found.model, work)


def _happens_at_s(rows: Array, place: int) -> float:
    """Time [s] at which the effect acts to which a parameter belongs; minus infinity if it always does."""
    name = ROW.entries[place].partition(".")[0]
    if name not in ROW.places:
        return -np.inf
    times = [k for k in range(ROW.width)[ROW.places[name]] if ROW.declared[k].axis == "time"]
    return float(rows[:, times].max(initial=-np.inf))


def last_part_from_nothing(data: Recorded, effects: Sequence[Candidate], work: Executor) -> LastPart:
    """Fit a model to the first part of a recording alone, from nothing, and let it drive into the last part.

    Parameters
    ----------
    data : Recorded
        The recording of a whole road.
    effects : sequence of Candidate
        What the model has beyond the base model, for all drivers.
    work : Executor
        Runs the filters.

    Returns
    -------
    LastPart
        Errors in the last part.
    """
    whole = data.trajectories
    assert whole is not None
    first = prepare(replace(whole, position_m=whole.position_m[: _last_part_begins(data)]))
    return _driven_on(data, fit_from_nothing(replace(first, even=data.even), effects, work).model, work)


def _last_part_begins(data: Recorded) -> int:
    """First sample of the last part."""
    return int(_FITTED * data.samples)


def _driven_on(data: Recorded, model: Model, work: Executor) -> LastPart:
    """Errors in the last part of a model."""
    begin = _last_part_begins(data)
    predicted, states = follow(data, model, work)
    runs = free_runs(data, model, states, work)
    chosen = runs.start >= begin
    cut = {name: values[chosen] for name, values in vars(runs).items()}
    return LastPart(FreeRuns(**cut), np.nansum(predicted.log_likelihood[:, begin:], axis=1), data.vicinity.period_s)
