"""The model beside others on the same held-out samples, with paired standard errors, and beside its own floor."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from sugiyama_ros.criticism.bootstrap import resample, seeds
from sugiyama_ros.criticism.candidates import candidates, recording_of
from sugiyama_ros.criticism.diagnosis import INDIVIDUAL
from sugiyama_ros.criticism.errors import Errors, errors_of
from sugiyama_ros.criticism.fitting import (
    Fit,
    Gain,
    Model,
    Recorded,
    fit,
    fit_base,
    gain,
    prepare,
    without_folds,
)
from sugiyama_ros.criticism.free_run import filtered_states
from sugiyama_ros.criticism.model_file import ModelFile
from sugiyama_ros.criticism.rivals import by_gaps, in_filter, laws
from sugiyama_ros.criticism.screening import glance
from sugiyama_ros.errors import InputError
from sugiyama_ros.trajectories import Trajectories

_LAGS = 10


@dataclass(frozen=True, eq=False)
class Compared:
    """One model's held-out errors, its gain over the base model, and how its innovations look.

    nis_mean and nis_std_error: mean of y^2/S, 1 for a model that knows its own uncertainty; autocorrelation: of the
    normalised innovations at lags 1 to 10, within ``band`` for white ones at the 95 % level.
    """

    name: str
    errors: Errors
    gain: Gain | None
    nis_mean: float
    nis_std_error: float
    autocorrelation: tuple[float, ...]
    band: float


def compare(
    trajectories: Trajectories,
    effects: Sequence[str] = (),
    model: ModelFile | None = None,
    *,
    seed: int = 0,
    workers: int = 4,
    on_progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> list[Compared]:
    """Base model, base model with ``effects``, a model from a file (not refitted), rivals, and the floor.

    The floor is the base model on data that it has simulated itself: no model can be expected to do better.
    Raises InputError for an unknown effect or a recording that is too short.
    """
    with ThreadPoolExecutor(workers) as work:
        data = prepare(trajectories)
        possible = {c.name: c for c in candidates(recording_of(data), data.drivers)}
        for name in effects:
            if name not in possible:
                raise InputError(f"effect {name!r}: not among what can be added here: {', '.join(possible)}")
        steps = 3 + 2 * len(laws()) + len(effects) + (model is not None)
        done = 0

        def next_step(what: str) -> None:
            nonlocal done
            on_progress(what, done, steps)
            done += 1

        next_step("base")
        base = fit_base(data, INDIVIDUAL, work)
        found = [_compared("base", data, without_folds(data, base, work), None, work)]
        current = base
        for name in effects:
            next_step(name)
            current = fit(data, glance(data, current, possible[name], work).fit.model, work)
        if effects:
            models = without_folds(data, current, work)
            found.append(_compared("base + " + " + ".join(effects), data, models, found[0].errors, work))
        if model is not None:
            next_step("model file")
            rows = model.rows_of(trajectories.vehicle)
            given = Model(rows, (), (), (), rows)
            found.append(
                _compared(f"file: {', '.join(model.effects) or 'base'}", data, [given] * 5, found[0].errors, work)
            )
        for law in laws():
            next_step(law)
            fitted = in_filter(data, law, work)
            models = without_folds(data, fitted, work)
            found.append(_compared(law, data, models, found[0].errors, work))
            next_step(f"{law}, least squares")
            found.append(
                _compared(f"{law}_least_squares", data, by_gaps(data, law, fitted, work), found[0].errors, work)
            )
        next_step("floor")
        found.append(_floor(data, base, seed, work))
        on_progress("done", steps, steps)
    return found


def _compared(
    name: str, data: Recorded, models: Sequence[Model], base: Errors | None, work: ThreadPoolExecutor
) -> Compared:
    errors = errors_of(data, models, work)
    s = errors.samples
    scored = np.isfinite(s.log_likelihood)
    normal = np.where(scored, s.innovation_m / np.sqrt(s.innovation_var), np.nan)
    nis = np.nanmean(np.square(normal), axis=1)
    return Compared(
        name,
        errors,
        gain(data, s, base.samples) if base is not None else None,
        float(np.nanmean(nis)),
        float(np.nanstd(nis) / np.sqrt(max(len(nis) - 1, 1))),
        tuple(float(np.nanmean(normal[:, k:] * normal[:, :-k])) for k in range(1, _LAGS + 1)),
        float(1.96 / np.sqrt(max(scored.sum(), 1))),
    )


def _floor(data: Recorded, base: Fit, seed: int, work: ThreadPoolExecutor) -> Compared:
    simulated = resample(data, base.model, filtered_states(data, base.model, work), seeds(seed, 1)[0])
    fitted = fit(simulated, base.model, work)
    return _compared("floor", simulated, without_folds(simulated, fitted, work), None, work)
