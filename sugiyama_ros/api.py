"""The functions of the Python interface: what a notebook needs, on top of the rooms that do the work."""

import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sugiyama_ros.calibration.calibrate import each_driver, in_classes, pooled
from sugiyama_ros.calibration.result import Calibration, Settings
from sugiyama_ros.diagnosis import compare as comparison
from sugiyama_ros.diagnosis import diagnosis
from sugiyama_ros.diagnosis.compare import Comparison
from sugiyama_ros.diagnosis.diagnosis import Diagnosis
from sugiyama_ros.diagnosis.use import FEW_ADDITIONS, MANY_ADDITIONS, Goal
from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.driver import Formulation
from sugiyama_ros.fit.model_file import read_model
from sugiyama_ros.fit.smooth_positions import evenness
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.frames import from_frame, tracks_of_frame
from sugiyama_ros.formats.registry import read_tracks as tracks_of_file
from sugiyama_ros.formats.registry import read_trajectories
from sugiyama_ros.page import recording
from sugiyama_ros.page.recording import Recording
from sugiyama_ros.progress import stages
from sugiyama_ros.simulation.experiment import Experiment, carry_out, changed
from sugiyama_ros.simulation.result import Simulation
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.trajectories.trajectories import Trajectories
from sugiyama_ros.workers import workers

if TYPE_CHECKING:
    import pandas


def read(source: "str | Path | pandas.DataFrame", ring_m: float | None = None) -> Trajectories:
    """Read trajectories from a file or a data frame.

    Parameters
    ----------
    source : str, Path or pandas.DataFrame
        A file in any known format with one recording on one lane, or a data frame with the columns time_s [s],
        vehicle, position_m [m] and perhaps length_m [m].
    ring_m : float, optional
        Circumference [m] of the ring where the file does not tell; an open road without it.

    Returns
    -------
    Trajectories
        Positions (T, N) of N vehicles at T regular times.

    Raises
    ------
    InputError
        With the line or the field, for what cannot be read.

    Examples
    --------
    >>> import sugiyama_ros as sg
    >>> sg.simulate(vehicles=3, ring_m=40.0, duration_s=10.0).save("three.csv")
    >>> sg.read("three.csv", ring_m=40.0)
    <Trajectories: 3 vehicles on a ring of 40 m, 31 samples of 0.3333 s, from three.csv>
    """
    if isinstance(source, str | Path):
        return read_trajectories(Path(source), ring_m)
    return from_frame(source, ring_m)


def read_tracks(source: "str | Path | pandas.DataFrame", ring_m: float | None = None, name: str = "auto") -> Tracks:
    """Read vehicles on any number of lanes from a file, a folder or a data frame.

    Parameters
    ----------
    source : str, Path or pandas.DataFrame
        A file or a folder in any known format, or a data frame with the columns vehicle, time_s [s] and s_m [m], and
        perhaps recording, road, lane, d_m, length_m, width_m [m], class, driver, leader and measured.
    ring_m : float, optional
        Circumference [m] of the ring where the file does not tell; an open road without it.
    name : str
        Name of the format of a file; "auto" for the one that recognises it.

    Returns
    -------
    Tracks
        A table with a row for each vehicle and time, and the leader of each row.

    Raises
    ------
    InputError
        With the line or the field, for what cannot be read, and if vehicles overlap.

    Examples
    --------
    >>> import sugiyama_ros as sg
    >>> sg.simulate(vehicles=3, ring_m=40.0, duration_s=10.0).save("three.csv")
    >>> sg.read_tracks("three.csv", ring_m=40.0)
    <Tracks: 3 vehicles in 1 recording, 93 rows, leaders known in 100 %, from three.csv>
    """
    if isinstance(source, str | Path):
        return tracks_of_file(Path(source), Choices(ring_m=ring_m), name)
    return tracks_of_frame(source, Choices(ring_m=ring_m))


def simulate(
    vehicles: int = 22,
    *,
    parameters: Mapping[str, float] | None = None,
    effects: Mapping[str, Mapping[str, float]] | None = None,
    model: str | Path | None = None,
    **settings: Any,
) -> Simulation:
    """Simulate drivers from rest on a ring or an open road.

    Parameters
    ----------
    vehicles : int
        Number of vehicles.
    parameters : mapping of str to float, optional
        Parameters of all drivers, such as ``{"v_star": 8.0}``; the paper's where they are left out.
    effects : mapping of str to mapping, optional
        Effects on all drivers with their values, such as ``{"drag": {"c0": 0.3}}``.
    model : str or Path, optional
        Model file with parameters and effects of each driver.
    **settings
        Fields of `sugiyama_ros.simulation.experiment.Experiment`: ring_m [m] (0 for an open road), duration_s [s],
        gap_m [m], period_s [s], horizon, spread, seed, start ("jam" or "equal") and length_m [m].

    Returns
    -------
    Simulation
        What a camera would have measured (``measured``), and the truth.

    Raises
    ------
    InputError
        For an unknown name, a value out of bounds, or vehicles that do not fit on the ring.

    Examples
    --------
    >>> import sugiyama_ros as sg
    >>> hidden = sg.simulate(vehicles=3, ring_m=40.0, duration_s=10.0, effects={"drag": {"c0": 0.3}})
    >>> hidden.measured.position_m.shape
    (31, 3)
    """
    unknown = sorted(set(settings) - set(Experiment.__dataclass_fields__))
    if unknown:
        raise InputError(f"simulate: {unknown[0]!r} is not known; give {', '.join(Experiment.__dataclass_fields__)}")
    experiment = Experiment(**settings)
    experiment.check(vehicles)
    rows = ROW.with_effects(defaults(vehicles))
    if model is not None:
        rows = read_model(Path(model)).rows_of(np.arange(vehicles))
    return carry_out(experiment, changed(rows, parameters or {}, effects or {}))


def calibrate(
    trajectories: Trajectories,
    formulation: Formulation = "causal",
    parameters: Sequence[str] = (),
    *,
    effects: Sequence[str] = (),
    regularise: bool = False,
    profile: bool = False,
    classes: int = 0,
    seed: int = 0,
) -> Calibration:
    """Estimate every driver's parameters by maximum likelihood.

    Parameters
    ----------
    trajectories : Trajectories
        The recording.
    formulation : {"causal", "paper"}
        Whether perceived states are filtered, or smoothed as in the paper.
    parameters : sequence of str
        Names of what is estimated. By default what the paper estimates, and more noises where positions are smooth.
    effects : sequence of str
        Names of effects that are fitted with it, with drivers as draws of one population (causal formulation).
    regularise : bool
        Causal: drivers are draws of one population; paper: with the paper's penalty.
    profile : bool
        Whether the intervals come from the profile likelihood, which takes longer.
    classes : int
        Number of classes of drivers who share all parameters; 0 for parameters of each driver.
    seed : int
        Seed of all random numbers.

    Returns
    -------
    Calibration
        Parameters of each driver with their errors, and whether the data hold them.

    Raises
    ------
    InputError
        For an unknown name, or data that the formulation cannot take.

    Examples
    --------
    >>> import sugiyama_ros as sg
    >>> recording = sg.simulate(vehicles=4, ring_m=45.0, duration_s=60.0, seed=1).measured
    >>> found = sg.calibrate(recording, "paper", ["v_star", "kappa_v"])
    >>> found.to_frame().shape
    (4, 12)
    """
    chosen = tuple(parameters) or evenness(trajectories).estimated(formulation)
    settings = Settings(formulation, chosen, regularise and formulation == "paper", profile, 0, seed)
    if effects and formulation == "paper":
        raise InputError("effects: the paper's formulation knows none; use the causal formulation")
    with stages() as advance, workers(len(trajectories.vehicle)) as work:
        if effects or (regularise and formulation == "causal"):
            return pooled(trajectories, settings, list(effects), work)
        if classes:
            return in_classes(trajectories, settings, classes, work)
        return each_driver(trajectories, settings, work=work, on_progress=partial(advance, "calibrating"))


def compare(
    trajectories: Trajectories | Tracks,
    effects: Sequence[str] = (),
    model: str | Path | None = None,
    *,
    seed: int = 0,
) -> Comparison:
    """Compare the model with measurements and with other laws, on samples that no fit has seen.

    Parameters
    ----------
    trajectories : Trajectories or Tracks
        The recording, at least 8 s long; or tracks on which somebody follows a known vehicle for 15 s.
    effects : sequence of str
        Names of effects that are added to the base model.
    model : str or Path, optional
        Model file that is compared as it is, without a fit.
    seed : int
        Seed of all random numbers.

    Returns
    -------
    Comparison
        Held-out errors and gains of all models.

    Raises
    ------
    InputError
        For an unknown effect, or a recording that is too short.

    Examples
    --------
    >>> import sugiyama_ros as sg
    >>> recording = sg.simulate(vehicles=4, ring_m=45.0, duration_s=60.0, seed=1).measured
    >>> compared = sg.compare(recording)
    >>> compared.models[0].name
    'base'
    """
    given = read_model(Path(model)) if model is not None else None
    with stages() as advance:
        return comparison.compare(
            trajectories, effects, given, seed=seed, workers=os.cpu_count() or 1, on_progress=advance
        )


def diagnose(
    trajectories: Trajectories | Tracks,
    *,
    quick: bool = False,
    add: str | None = None,
    refit: int | None = None,
    seed: int = 0,
) -> Diagnosis:
    """Find out which physical effect the model lacks.

    Parameters
    ----------
    trajectories : Trajectories or Tracks
        The recording, at least 8 s long; or tracks on which somebody follows a known vehicle for 15 s.
    quick : bool
        Whether to simulate fewer recordings: sooner, with rougher p-values.
    add : {None, "auto"}
        ``"auto"`` adds effects until nothing more is supported; else at most three are added.
    refit : int
        Number of simulated recordings to which the final model is fitted, for its standard errors.
    seed : int
        Seed of all random numbers.

    Returns
    -------
    Diagnosis
        What was added, the candidates, and where the model fails before and after.

    Raises
    ------
    InputError
        For a recording that is too short.

    Examples
    --------
    >>> import sugiyama_ros as sg
    >>> recording = sg.simulate(vehicles=4, ring_m=45.0, duration_s=60.0, seed=1).measured
    >>> sg.diagnose(recording, quick=True)
    <Diagnosis: nothing that is missing can be detected in these data>
    """
    if add not in (None, "auto"):
        raise InputError(f"add: {add!r} is not known; give 'auto' or None")
    with stages() as advance:
        return diagnosis.diagnose(
            trajectories,
            seed=seed,
            quick=quick,
            goal=Goal(forces=add is not None, most=MANY_ADDITIONS if add else FEW_ADDITIONS),
            refit=refit,
            workers=os.cpu_count() or 1,
            on_progress=advance,
        )


def read_recording(path: str | Path) -> Recording:
    """Read what the estimators published in a bag that ``sugiyama run`` recorded.

    Parameters
    ----------
    path : str or Path
        The bag.

    Returns
    -------
    Recording
        Trajectories, and everything published, as arrays (T, N) by name.

    Raises
    ------
    InputError
        For a file that is not such a bag.

    Examples
    --------
    >>> import sugiyama_ros as sg
    >>> sg.simulate(vehicles=3, ring_m=40.0, duration_s=10.0).save("three.mcap")
    >>> sg.read_recording("three.mcap").has_estimates
    False
    """
    return recording.read_recording(Path(path))
