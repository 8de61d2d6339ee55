"""Comparison of models on the same held-out samples: the base model, what somebody adds or gives, and other laws."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from sugiyama_ros.diagnosis.base import base_model, with_more_decisions
from sugiyama_ros.diagnosis.check import collective_of
from sugiyama_ros.diagnosis.forecast import Forecasts, forecasts
from sugiyama_ros.diagnosis.refine import with_named, without_folds
from sugiyama_ros.diagnosis.table import Difference, gains
from sugiyama_ros.filters.extract import motion_of
from sugiyama_ros.fit.given import Given, check_given, fit_people, prepare_for
from sugiyama_ros.fit.joint import JointFit, fit
from sugiyama_ros.fit.law import by_gaps, in_filter
from sugiyama_ros.fit.model import Model, filtered_states
from sugiyama_ros.fit.model_file import ModelFile
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.fit.recording import Recorded, Vicinity
from sugiyama_ros.fit.simulated import resample, seeds
from sugiyama_ros.laws.registry import LAWS, RIVALS
from sugiyama_ros.progress import OnStage
from sugiyama_ros.results import Result, bars, needs, plain
from sugiyama_ros.simulation.collective import Collective, collective, wave_speed_error
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.workers import here_or_there, send

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure, SubFigure

#: The base model; what was asked for; a model file that was fitted to this recording; one that was fitted to another
#: recording; another law; or the base model on a recording that it simulates itself.
Kind = Literal["base", "asked", "in_sample", "given", "law", "simulated"]
# Simulations of the whole road by each model, for the mean of what it does.
_SIMULATIONS = 4


@dataclass(frozen=True, eq=False)
class Compared:
    """One model of a comparison.

    name: Name of the model; kind: What the model is; forecasts: Its forecasts, held out unless ``kind`` is
    ``in_sample``; gain: Gain over the base model [nats], by column; empty for the base model on its own simulation;
    collective: Mean and standard deviation of measures of the whole road, over simulations of the model; empty on
    tracks.
    """

    name: str
    kind: Kind
    forecasts: Forecasts
    gain: dict[str, Difference]
    collective: dict[str, tuple[float, float]]


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Result):
    """Models on the same held-out samples.

    Parameters
    ----------
    models : tuple of Compared
        The base model first; last the base model on a recording that it simulates itself.
    data : Recorded
        The recording.
    measured : Collective or None
        Collective measures of the recording; None for tracks.
    wave_speed_se : float
        Standard error [m/s] of the speed of waves in the recording, over blocks of time; NaN without waves.
    seed : int
        Seed of the simulations.
    given : Given or None
        How the model of a file was used that was fitted to another recording.
    """

    models: tuple[Compared, ...]
    data: Recorded
    measured: Collective | None
    wave_speed_se: float
    seed: int
    given: Given | None = None

    @property
    def vicinity(self) -> Vicinity:
        """The drivers that the models were compared on."""
        return self.data.vicinity

    def headline(self) -> str:
        """Say which model predicts best, how much better than the base model, and which ones are not clearly behind."""
        from sugiyama_ros.page.document import comparison_document
        from sugiyama_ros.page.words import best_model

        return best_model(plain(comparison_document(self)))

    def records(self) -> list[dict[str, Any]]:
        """List the models: held-out errors, and the gain over the base model [nats]."""
        from sugiyama_ros.page.document import comparison_document

        left_out = ("gains", "behind", "collective", "drivers")
        models = plain(comparison_document(self))["models"]
        return [{name: value for name, value in one.items() if name not in left_out} for one in models]

    def to_xarray(self) -> "xarray.Dataset":
        """Return the held-out log-likelihood of every sample, for other tools of model comparison such as ArviZ.

        Returns
        -------
        xarray.Dataset
            ``log_likelihood`` [nats] of the measured position, given the samples before, with the dimensions ``model``,
            ``driver`` and ``sample``; NaN where nothing is predicted.

        Raises
        ------
        InputError
            If xarray is not installed.
        """
        needs("xarray", "to_xarray()")
        import xarray

        models = [one for one in self.models if one.kind != "simulated"]
        nats = xarray.DataArray(
            np.stack([one.forecasts.one_step for one in models]),
            dims=("model", "driver", "sample"),
            coords={"model": [one.name for one in models], "driver": list(self.vicinity.numbers)},
            attrs={"units": "nats"},
        )
        return xarray.Dataset({"log_likelihood": nats}, attrs={"recording": self.vicinity.source})

    def draw(self, figure: "Figure | SubFigure") -> None:
        """Draw the errors of free runs after 10 s, and the gains over the base model."""
        left, right = figure.subplots(1, 2, sharey=True)
        rows = self.records()
        run = "free_run" if self.vicinity.is_whole_road else "single_car"
        ends = [one[f"{run}_10s_m"] or 0.0 for one in rows]
        bars(left, [one["name"] for one in rows], ends, [0.0] * len(ends), "error after 10 s [m]")
        known = [one for one in rows if one["heldout_gain_nats"] is not None]
        won, se = ([one[f"heldout_gain_{what}"] for one in known] for what in ("nats", "se"))
        bars(right, [one["name"] for one in known], won, se, "held-out gain [nats]")


def compare(
    recording: Tracks,
    effects: Sequence[str] = (),
    model: ModelFile | None = None,
    *,
    seed: int = 0,
    workers: int | Executor = 4,
    on_progress: OnStage = lambda what, done, total: None,
) -> Comparison:
    """Compare models: the base model with and without effects, a model from a file, and other laws.

    The last one is the base model on a recording that it simulates itself: the errors that its own noise makes.

    Parameters
    ----------
    recording : Tracks
        What was recorded.
    effects : sequence of str
        Names of effects to add to the base model.
    model : ModelFile, optional
        A model from a file. On the recording that it was fitted to, it is taken as it is. On another one, what it says
        of the road and of all drivers is taken, and the drivers' own parameters are fitted as those of the base model.
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
        For an unknown effect, a recording that is too short, or a model of drivers by several laws.
    """
    if model is not None:
        check_given(model)
    with here_or_there(workers) as (work, cluster):
        steps = 3 + len(RIVALS) + (model is not None) + bool(effects)
        data, base = _base(recording, model, work, lambda: on_progress("fitting the base model", 0, steps))
        sent = send(cluster, _law_there, (data, seed), RIVALS) if cluster is not None else []
        found = [_fitted("base", "base", data, base, seed, work)]
        on_progress("the base model with effects", 1, steps)
        if effects:
            asked = with_named(data, base, effects, work)
            found.append(_fitted(f"base + {' + '.join(effects)}", "asked", data, asked, seed, work))
        of_file, given = _of_file(model, data, base, seed, work)
        found += of_file
        for k, law in enumerate(RIVALS):
            on_progress(law, steps - 1 - len(RIVALS) + k, steps)
            found += sent[k].result() if sent else _law(law, data, seed, work)
        on_progress("the base model on its own simulation", steps - 1, steps)
        models = [replace(one, gain=gains(data, one.forecasts, found[0].forecasts)) for one in found]
        models.append(_simulated(data, base, seed, work))
    return Comparison(tuple(models), data, *_measured(data), seed, given)


def _fitted(name: str, kind: Kind, data: Recorded, fitted: JointFit, seed: int, work: ThreadPoolExecutor) -> Compared:
    """A fitted model, with its fits without each fold."""
    return _held_out(name, kind, data, without_folds(data, fitted, work), fitted.model, seed, work)


def _held_out(
    name: str,
    kind: Kind,
    data: Recorded,
    models: Sequence[Model],
    whole: Model | None,
    seed: int,
    work: ThreadPoolExecutor,
) -> Compared:
    """Models of all folds, or one; ``whole``: what simulates the road, if it is to be simulated."""
    return Compared(name, kind, forecasts(data, models, work), {}, _of_road(data, whole, seed, work))


def _base(
    recording: Tracks, model: ModelFile | None, work: ThreadPoolExecutor, on_prepared: Callable[[], None]
) -> tuple[Recorded, JointFit]:
    """The recording with the base model; drivers decide as often as those of a model file, if it says how often."""
    as_in_file = None if model is None else prepare_for(recording, model)
    data = prepare(recording) if as_in_file is None else as_in_file
    on_prepared()
    data, base = base_model(data, work)
    found = None if as_in_file is not None else with_more_decisions(recording, data, base, work)
    return found or (data, base)


def _of_file(
    model: ModelFile | None, data: Recorded, base: JointFit, seed: int, work: ThreadPoolExecutor
) -> tuple[list[Compared], Given | None]:
    """A model from a file: as it is on the recording that it was fitted to, and with other people on another one."""
    if model is None:
        return [], None
    if model.is_of(data.vicinity.sha256):
        rows = model.rows_of(np.array(data.vicinity.numbers))
        as_it_is = Model(rows, (), (), (), rows)
        return [_held_out(model.name(), "in_sample", data, [as_it_is], as_it_is, seed, work)], None
    fitted, given = fit_people(data, base, model, work)
    return [_fitted(model.name(given.left_out), "given", data, fitted, seed, work)], given


def _law(law: str, data: Recorded, seed: int, work: ThreadPoolExecutor) -> list[Compared]:
    """Another law, fitted in the filter and, if it has parameters, also by least squares on gaps."""
    fit_ = in_filter(data, law, work)
    found = [_fitted(law, "law", data, fit_, seed, work)]
    if LAWS[law].parameters:
        models = by_gaps(data, law, fit_, work)
        found.append(_held_out(f"{law}_least_squares", "law", data, models, None, seed, work))
    return found


def _law_there(common: tuple[Recorded, int], law: str) -> list[Compared]:
    """What ``_law`` returns, on a worker of a cluster; common: the recording and the seed."""
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as work:
        return _law(law, *common, work)


def _simulated(data: Recorded, base: JointFit, seed: int, work: ThreadPoolExecutor) -> Compared:
    """The base model on a recording that it simulates itself."""
    one = resample(data, base.model, filtered_states(data, base.model, work), seeds(seed, 1)[0])
    again = fit(one, base.model, work)
    models = without_folds(one, again, work)
    return Compared("base, simulated", "simulated", forecasts(one, models, work), {}, {})


def _measured(data: Recorded) -> tuple[Collective | None, float]:
    """Collective measures of the recording, and the standard error of the speed of waves; nothing for tracks."""
    if data.trajectories is None:
        return None, float("nan")
    motion = motion_of(data.trajectories)
    return collective(*motion), wave_speed_error(*motion)


def _of_road(
    data: Recorded, model: Model | None, seed: int, work: ThreadPoolExecutor
) -> dict[str, tuple[float, float]]:
    """Mean and standard deviation of the collective measures, over simulations of a whole road; nothing for tracks."""
    if data.trajectories is None or model is None:
        return {}
    states = filtered_states(data, model, work)
    runs = [resample(data, model, states, rng).trajectories for rng in seeds(seed, _SIMULATIONS)]
    found = [asdict(one) for one in work.map(collective_of, [r for r in runs if r is not None])]
    return {name: _mean_and_std(np.array([one[name] for one in found])) for name in found[0]}


def _mean_and_std(values: Any) -> tuple[float, float]:
    """Mean and standard deviation of the values that are known; NaN for too few of them."""
    known = values[np.isfinite(values)]
    return (float(known.mean()), float(known.std(ddof=1))) if len(known) > 1 else (float("nan"), float("nan"))
