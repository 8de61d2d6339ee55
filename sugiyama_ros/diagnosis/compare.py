"""The model beside others on the same held-out samples, with paired standard errors, and beside its own floor."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass

import numpy as np

from sugiyama_ros.diagnosis.bootstrap import resample, seeds
from sugiyama_ros.diagnosis.candidates import named
from sugiyama_ros.diagnosis.diagnosis import INDIVIDUAL
from sugiyama_ros.diagnosis.errors import Errors, errors_of
from sugiyama_ros.diagnosis.rivals import by_gaps, has_parameters, in_filter
from sugiyama_ros.diagnosis.screen import with_candidate
from sugiyama_ros.filters.extract import chain_behind, track
from sugiyama_ros.fit.cross_validation import Gain, gain, without_folds
from sugiyama_ros.fit.joint import Fit, fit
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.model_file import ModelFile
from sugiyama_ros.fit.population import fit_base
from sugiyama_ros.fit.recording import FOLDS, Recorded, prepare
from sugiyama_ros.fit.score import filtered_states
from sugiyama_ros.laws.registry import RIVALS
from sugiyama_ros.simulation.collective import Collective, collective
from sugiyama_ros.trajectories.trajectories import Trajectories

_LAGS = 10
# Simulations of a whole recording for the collective measures.
_SIMULATIONS = 3


@dataclass(frozen=True, eq=False)
class Compared:
    """One model's held-out errors, its gain over the base model, and how its innovations look.

    collective: measures of the whole road in simulations of the model, averaged over runs, each with their std.
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
    collective: dict[str, tuple[float, float]]


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
        chosen = named(data, effects)
        steps = 2 + sum(1 + has_parameters(law) for law in RIVALS) + len(effects) + (model is not None)
        done = 0

        def next_step(what: str) -> None:
            nonlocal done
            on_progress(what, done, steps)
            done += 1

        def judged(name: str, models: Sequence[Model], simulated: Model | None) -> Compared:
            base = found[0].errors if found else None
            of_road = _simulated_collective(data, simulated, seed, work) if simulated is not None else {}
            return _compared(name, data, models, base, of_road, work)

        found: list[Compared] = []
        next_step("base")
        base = fit_base(data, INDIVIDUAL, work)
        found.append(judged("base", without_folds(data, base, work, searched=True), base.model))
        current = base
        for candidate in chosen:
            next_step(candidate.name)
            current = with_candidate(data, current, candidate, work)
        if effects:
            found.append(
                judged(
                    "base + " + " + ".join(effects), without_folds(data, current, work, searched=True), current.model
                )
            )
        if model is not None:
            next_step("model file")
            rows = model.rows_of(trajectories.vehicle)
            given = Model(rows, (), (), (), rows)
            found.append(judged(f"file: {', '.join(model.effects) or 'base'}", [given] * FOLDS, given))
        for law in RIVALS:
            next_step(law)
            fitted = in_filter(data, law, work)
            found.append(judged(law, without_folds(data, fitted, work, searched=True), fitted.model))
            if has_parameters(law):
                next_step(f"{law}, least squares")
                found.append(judged(f"{law}_least_squares", by_gaps(data, law, fitted, work), None))
        next_step("floor")
        found.append(_floor(data, base, seed, work))
        on_progress("done", steps, steps)
    return found


def collective_of(trajectories: Trajectories) -> Collective:
    """Collective measures of trajectories, with speeds from a filter that knows no driver model."""
    t = trajectories
    tracks = [track(chain_behind(t, i, vehicles=1)) for i in range(len(t.vehicle))]
    position, speed = (np.stack([one[:, k] for one in tracks], axis=1) for k in range(2))
    led = t.leader >= 0
    ahead = np.take_along_axis(position, np.maximum(t.leader, 0), axis=1)
    headway = np.where(led, t.road.space_headway(ahead, position), np.nan)
    return collective(speed, headway, np.where(led, t.leader, -1), t.period_s)


def _simulated_collective(
    data: Recorded, model: Model, seed: int, work: ThreadPoolExecutor
) -> dict[str, tuple[float, float]]:
    """Mean and std over simulations of the whole recording by a model."""
    states = filtered_states(data, model, work)
    runs = [resample(data, model, states, rng).trajectories for rng in seeds(seed, _SIMULATIONS)]
    found = [asdict(one) for one in work.map(collective_of, runs)]
    return {
        name: (float(np.mean([one[name] for one in found])), float(np.std([one[name] for one in found], ddof=1)))
        for name in found[0]
    }


def _compared(
    name: str,
    data: Recorded,
    models: Sequence[Model],
    base: Errors | None,
    of_road: dict[str, tuple[float, float]],
    work: ThreadPoolExecutor,
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
        of_road,
    )


def _floor(data: Recorded, base: Fit, seed: int, work: ThreadPoolExecutor) -> Compared:
    simulated = resample(data, base.model, filtered_states(data, base.model, work), seeds(seed, 1)[0])
    fitted = fit(simulated, base.model, work)
    return _compared("floor", simulated, without_folds(simulated, fitted, work, searched=True), None, {}, work)
