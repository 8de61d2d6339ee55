"""Comparison of models on the same held-out samples, with paired standard errors."""

import os
from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.diagnosis.bootstrap import resample, seeds
from sugiyama_ros.diagnosis.candidates import Candidate, named
from sugiyama_ros.diagnosis.decisions import with_more_decisions
from sugiyama_ros.diagnosis.errors import HeldOutErrors, errors_of
from sugiyama_ros.diagnosis.noises import base_model
from sugiyama_ros.diagnosis.rivals import by_gaps, has_parameters, in_filter
from sugiyama_ros.diagnosis.screen import with_candidate
from sugiyama_ros.filters.extract import chain_behind, track
from sugiyama_ros.fit.cross_validation import Gain, gain, gain_of_samples, without_folds
from sugiyama_ros.fit.joint import JointFit, fit
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.model_file import ModelFile
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.score import filtered_states
from sugiyama_ros.fit.stretched import prepared
from sugiyama_ros.fit.vicinity import Vicinity
from sugiyama_ros.laws.registry import RIVALS
from sugiyama_ros.plots import bars
from sugiyama_ros.progress import OnStage
from sugiyama_ros.results import Result
from sugiyama_ros.simulation.collective import Collective, collective, wave_speed_error
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.trajectories.trajectories import Trajectories
from sugiyama_ros.workers import here_or_there, send

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Kind = Literal["base", "asked", "in_sample", "law", "simulated"]
#: Name of the base model on a recording that it simulates itself.
SIMULATED = "base, simulated"
#: Ending of the name of a model file that was fitted to the recording.
IN_SAMPLE = " (in sample)"
# A model is better beyond doubt by this many standard errors of the paired gain.
_CLEARLY = 2.0
# Number of lags of the autocorrelation.
_LAGS = 10
#: Number of models that a comparison shows first.
MAIN_ROWS = 6
# Number of simulations of a whole recording, for the collective measures.
_SIMULATIONS = 3


@dataclass(frozen=True, eq=False)
class Compared:
    """One model in a comparison.

    Parameters
    ----------
    name : str
        Name of the model.
    errors : HeldOutErrors
        Held-out errors.
    gain : Gain or None
        Held-out gain over the base model.
    nis_mean, nis_std_error : float
        Mean of y^2/S and its standard error. The mean is 1 for a model that knows its own uncertainty.
    autocorrelation : tuple of float
        Autocorrelation of the normalised innovations at lags 1 to 10.
    band : float
        95 % of the autocorrelations of white innovations are smaller than this in size.
    collective : dict of str to (float, float)
        Mean and standard deviation of measures of the whole road, over simulations of the model.
    kind : {"base", "asked", "in_sample", "law", "simulated"}
        The base model; what was asked for; a model file that was fitted to this recording; another law; or the base
        model on a recording that it simulates itself.
    """

    name: str
    errors: HeldOutErrors
    gain: Gain | None
    nis_mean: float
    nis_std_error: float
    autocorrelation: tuple[float, ...]
    band: float
    collective: dict[str, tuple[float, float]]
    kind: Kind = "law"

    @property
    def is_held_out(self) -> bool:
        """Whether the errors are those of other models on the same samples, which no fit of the model has seen."""
        return self.kind not in ("in_sample", "simulated")


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Result):
    """Models on the same held-out samples.

    Parameters
    ----------
    models : tuple of Compared
        The base model first; last the base model on a recording that it simulates itself.
    vicinity : Vicinity
        The drivers of the recording that the models were compared on.
    measured : Collective or None
        Collective measures of the recording; None for tracks.
    wave_speed_se : float
        Standard error [m/s] of the speed of waves in the recording, over blocks of time; NaN without waves.
    seed : int
        Seed of the simulations.
    block : ndarray of int, shape (N, T)
        Number of the block of time of each sample.
    left_out : int
        Number of drivers who were left out because there were too many.
    """

    models: tuple[Compared, ...]
    vicinity: Vicinity
    measured: Collective | None
    wave_speed_se: float
    seed: int
    block: Ints
    left_out: int = 0

    def headline(self) -> str:
        """Say which model predicts best, how much better than the base model, and which ones are not clearly behind.

        A model file that was fitted to these samples comes first: it does not count.
        """
        own = [one.name.removesuffix(IN_SAMPLE) for one in self.models if one.kind == "in_sample"]
        said = self._best()
        return f"{own[0]} was fitted to these samples, so it does not count here. {said}" if own else said

    def _best(self) -> str:
        """The headline without the model that is in sample."""
        ranked = self.ranked()
        best, *others = ranked
        if best.gain is None or best.gain.nats <= _CLEARLY * best.gain.se:
            other = " other" if any(one.kind == "in_sample" for one in self.models) else ""
            return f"No{other} model predicts held-out samples clearly better than the base model."
        gained = f"{best.gain.nats:.0f} ± {best.gain.se:.0f} nats"
        behind = [(one, self._ahead(best, one)) for one in others]
        alike = [one.name for one, ahead in behind if ahead.nats <= _CLEARLY * ahead.se]
        text = f"{best.name} predicts held-out samples best: {gained} better than the base model"
        if alike:
            return f"{text}. Not clearly behind: {', '.join(alike)}."
        second, ahead = behind[0]
        return f"{text}, {ahead.nats:.0f} ± {ahead.se:.0f} nats better than {second.name}."

    def ranked(self) -> list[Compared]:
        """Return the models with held-out errors, the largest gain over the base model first."""
        found = [one for one in self.models if one.is_held_out]
        return sorted(found, key=lambda one: -one.gain.nats if one.gain is not None else 0.0)

    def _ahead(self, best: Compared, other: Compared) -> Gain:
        """What one model gains over another."""
        return gain_of_samples(self.block, best.errors.samples, other.errors.samples)

    def main(self) -> tuple[Compared, ...]:
        """Return about six models to look at first: what was asked for, the best ones, and the base model."""
        asked = [one for one in self.models if one.kind in ("base", "asked", "in_sample")]
        best = [one for one in self.ranked() if one not in asked]
        kept = [*asked, *best[: max(1, MAIN_ROWS - len(asked))]]
        return tuple(sorted(kept, key=lambda one: -one.gain.nats if one.gain is not None else 0.0))

    def records(self) -> list[dict[str, Any]]:
        """List the models: held-out errors, gain over the base model [nats] and mean NIS."""
        return [
            {
                "name": one.name,
                **one.errors.summary(),
                "heldout_gain_nats": one.gain.nats if one.gain else None,
                "heldout_gain_se": one.gain.se if one.gain else None,
                "nis_mean": one.nis_mean,
            }
            for one in self.models
        ]

    def draw(self, figure: "Figure") -> None:
        """Draw the errors of free runs after 10 s, and the gains over the base model."""
        left, right = figure.subplots(1, 2)
        errors = [one.errors.free_run_10s_m for one in self.models]
        bars(left, [one.name for one in self.models], errors, [0.0] * len(errors), "error after 10 s [m]")
        gains = [(one.name, one.gain) for one in self.models if one.gain is not None]
        names, values = [name for name, _ in gains], [gain.nats for _, gain in gains]
        bars(right, names, values, [gain.se for _, gain in gains], "held-out gain [nats]")


def compare(
    recording: Trajectories | Tracks,
    effects: Sequence[str] = (),
    model: ModelFile | None = None,
    *,
    seed: int = 0,
    workers: int | Executor = 4,
    on_progress: OnStage = lambda what, done, total: None,
) -> "Comparison":
    """Compare models: the base model with and without effects, a model from a file, and other laws.

    The last one is the base model on a recording that it simulates itself: the errors that its own noise makes.

    Parameters
    ----------
    recording : Trajectories or Tracks
        The recording: a whole road, or tracks of vehicles that come and go.
    effects : sequence of str
        Names of effects to add to the base model.
    model : ModelFile, optional
        A model to compare without a fit.
    seed : int
        Seed of the simulations.
    workers : int or Executor
        Number of threads; or the executor of a Dask cluster, whose workers then fit the other laws.
    on_progress : callable
        Called with the name of the stage, the number of steps done, and the number of all steps.

    Returns
    -------
    Comparison
        The models on the same held-out samples.

    Raises
    ------
    InputError
        For an unknown effect or a recording that is too short.
    """
    with here_or_there(workers) as (work, cluster):
        data = prepared(recording)
        chosen = named(data, effects)
        steps = 3 + len(RIVALS) + len(effects) + (model is not None)
        on_progress("fitting the base model", 0, steps)
        data, base = base_model(data, work)
        data, base = with_more_decisions(recording, data, base, work) or (data, base)
        sent = send(cluster, _rival_there, (data, seed), RIVALS) if cluster is not None else []
        comparison = _Models(data, seed, steps, work, on_progress)
        comparison.begin("base")
        comparison.add_fitted("base", base)
        comparison.add_effects(base, chosen)
        if model is not None:
            comparison.add_file(model)
        for k, law in enumerate(RIVALS):
            comparison.begin(law)
            comparison.found += sent[k].result() if sent else _rival(data, law, seed, work)
        comparison.begin(SIMULATED)
        first = comparison.found[0]
        found = (first, *(_beside(data, one, first) for one in comparison.found[1:]), _floor(data, base, seed, work))
        on_progress("done", steps, steps)
    return Comparison(found, data.vicinity, *_measured(data), seed, data.block, data.left_out)


class _Models:
    """Models compared so far, the base model first; ``steps``: number of models in all, for the progress."""

    def __init__(self, data: Recorded, seed: int, steps: int, work: ThreadPoolExecutor, on_progress: OnStage) -> None:
        self._data, self._seed, self._steps, self._work, self._on_progress = data, seed, steps, work, on_progress
        self._done = 1
        self.found: list[Compared] = []

    def begin(self, what: str) -> None:
        """Report the start of a step."""
        self._on_progress(what, self._done, self._steps)
        self._done += 1

    def add_fitted(self, name: str, fitted: JointFit) -> None:
        """Add a fitted model, with a new search for each fold that is left out."""
        models = without_folds(self._data, fitted, self._work, searched=True)
        self._add(name, "base" if not self.found else "asked", models, fitted.model)

    def add_effects(self, base: JointFit, chosen: Sequence[Candidate]) -> None:
        """Add the base model with candidates, if there are any."""
        current = base
        for candidate in chosen:
            self.begin(candidate.name)
            current = with_candidate(self._data, current, candidate, self._work)
        if chosen:
            self.add_fitted("base + " + " + ".join(candidate.name for candidate in chosen), current)

    def add_file(self, model: ModelFile) -> None:
        """Add a model from a file without a fit. What was fitted to this recording is in sample."""
        self.begin("model file")
        rows = model.rows_of(np.array(self._data.vicinity.numbers))
        given = Model(rows, (), (), (), rows)
        name, own = f"file: {', '.join(model.effects) or 'base'}", self._data.vicinity.sha256
        if own and own == model.sha256:
            self._add(f"{name}{IN_SAMPLE}", "in_sample", [given] * FOLDS, given)
        else:
            self._add(name, "asked", [given] * FOLDS, given)

    def _add(self, name: str, kind: Kind, models: Sequence[Model], simulated: Model) -> None:
        of_road = _of_road(self._data, simulated, self._seed, self._work)
        self.found.append(replace(_compared(name, self._data, models, of_road, self._work), kind=kind))


def _rival(data: Recorded, law: str, seed: int, work: Executor) -> list[Compared]:
    """A rival law, fitted in the filter and, if it has parameters, also by least squares on gaps."""
    fitted = in_filter(data, law, work)
    models = without_folds(data, fitted, work, searched=True)
    found = [_compared(law, data, models, _of_road(data, fitted.model, seed, work), work)]
    if has_parameters(law):
        found.append(_compared(f"{law}_least_squares", data, by_gaps(data, law, fitted, work), {}, work))
    return found


def _rival_there(common: tuple[Recorded, int], law: str) -> list[Compared]:
    """What ``_rival`` returns, on a worker of a cluster; common: the recording and the seed."""
    data, seed = common
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as work:
        return _rival(data, law, seed, work)


def _beside(data: Recorded, one: Compared, base: Compared) -> Compared:
    """A model with its gain over the base model."""
    return replace(one, gain=gain(data, one.errors.samples, base.errors.samples))


def _measured(data: Recorded) -> tuple[Collective | None, float]:
    """Collective measures of the recording, and the standard error of the speed of waves; nothing for tracks."""
    if data.trajectories is None:
        return None, float("nan")
    motion = _motion(data.trajectories)
    return collective(*motion), wave_speed_error(*motion)


def collective_of(trajectories: Trajectories) -> Collective:
    """Return collective measures of trajectories; the speeds come from a filter without a driver model."""
    return collective(*_motion(trajectories))


def _motion(t: Trajectories) -> tuple[Array, Array, Ints, float]:
    """Speeds, headways and leaders, each (T, N), and the period [s]."""
    tracks = [track(chain_behind(t, i, vehicles=1)) for i in range(len(t.vehicle))]
    position, speed = (np.stack([one[:, k] for one in tracks], axis=1) for k in range(2))
    led = t.leader >= 0
    ahead = np.take_along_axis(position, np.maximum(t.leader, 0), axis=1)
    headway = np.where(led, t.road.space_headway(ahead, position), np.nan)
    return speed, headway, np.where(led, t.leader, -1), t.period_s


def _of_road(data: Recorded, model: Model, seed: int, work: Executor) -> dict[str, tuple[float, float]]:
    """Mean and standard deviation of the collective measures, over simulations of a whole road; nothing for tracks."""
    if data.trajectories is None:
        return {}
    states = filtered_states(data, model, work)
    runs = [resample(data, model, states, rng).trajectories for rng in seeds(seed, _SIMULATIONS)]
    found = [asdict(one) for one in work.map(collective_of, [run for run in runs if run is not None])]
    return {name: _mean_and_std(np.array([one[name] for one in found])) for name in found[0]}


def _mean_and_std(values: Array) -> tuple[float, float]:
    """Mean and standard deviation of the values that are known; NaN for too few of them."""
    known = values[np.isfinite(values)]
    mean = float(np.mean(known)) if len(known) else float("nan")
    return mean, float(np.std(known, ddof=1)) if len(known) > 1 else float("nan")


def _compared(
    name: str, data: Recorded, models: Sequence[Model], of_road: dict[str, tuple[float, float]], work: Executor
) -> Compared:
    errors = errors_of(data, models, work)
    s = errors.samples
    scored = np.isfinite(s.log_likelihood)
    normal = np.where(scored, s.innovation_m / np.sqrt(s.innovation_var), np.nan)[:, :: data.every]
    nis = np.nanmean(np.square(normal[scored.any(axis=1)]), axis=1)
    return Compared(
        name=name,
        errors=errors,
        gain=None,
        nis_mean=float(np.mean(nis)),
        nis_std_error=float(np.std(nis) / np.sqrt(max(len(nis) - 1, 1))),
        autocorrelation=tuple(_mean(normal[:, k:] * normal[:, :-k]) for k in range(1, _LAGS + 1)),
        band=float(1.96 / np.sqrt(max(scored.sum(), 1))),
        collective=of_road,
    )


def _mean(values: Array) -> float:
    """Mean of the known values; NaN where a short recording has none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")


def _floor(data: Recorded, base: JointFit, seed: int, work: Executor) -> Compared:
    simulated = resample(data, base.model, filtered_states(data, base.model, work), seeds(seed, 1)[0])
    fitted = fit(simulated, base.model, work)
    models = without_folds(simulated, fitted, work, searched=True)
    return replace(_compared(SIMULATED, simulated, models, {}, work), kind="simulated")
