"""The functions of the Python interface: what a notebook needs, on top of the rooms that do the work."""

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sugiyama_ros.arguments import Numbers, checked
from sugiyama_ros.arrays import Array
from sugiyama_ros.calibration.calibrate import calibrate_drivers
from sugiyama_ros.calibration.lane_changes import lane_changes as lane_changes
from sugiyama_ros.calibration.result import Calibration, Settings, number_of_classes
from sugiyama_ros.controllers.controller import Controlled
from sugiyama_ros.controllers.registry import controlled_by
from sugiyama_ros.diagnosis import diagnose as diagnosis
from sugiyama_ros.diagnosis.candidates import check_names
from sugiyama_ros.diagnosis.rounds import Diagnosis
from sugiyama_ros.driver.bicycle import CAR, car_of
from sugiyama_ros.driver.parameters import NAMES, defaults, population
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.plane import PlaneEstimates, PlaneFilter, plane_track
from sugiyama_ros.fit.driver import Formulation
from sugiyama_ros.fit.goals import goals_from
from sugiyama_ros.fit.model_file import drive_by, drivers_of, read_model
from sugiyama_ros.formats.choices import Choices, choices_of, read_choices, reference_of
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.formats.roads import read_road as read_road
from sugiyama_ros.formats.table import tracks_of_frame
from sugiyama_ros.laws.registry import ADAPTIVE_SEEK, PAPERS
from sugiyama_ros.page import recording
from sugiyama_ros.page.diagnosis import check_same, read_diagnosis
from sugiyama_ros.page.document import document as document_of
from sugiyama_ros.page.recording import Recording
from sugiyama_ros.progress import stages
from sugiyama_ros.results import plain
from sugiyama_ros.roads.network import Network
from sugiyama_ros.simulation.experiment import Experiment, carry_out, changed, set_up
from sugiyama_ros.simulation.idle import Asked, check_acts, check_somebody_drives
from sugiyama_ros.simulation.multilane import simulate_lane_changes as simulate_lane_changes
from sugiyama_ros.simulation.result import Simulation
from sugiyama_ros.trajectories.about import DEFAULT_LENGTH_M
from sugiyama_ros.trajectories.centre_line import CentreLine
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.verdict import compare as comparison
from sugiyama_ros.verdict.compare import Comparison

if TYPE_CHECKING:
    import pandas


#: Largest number of steps of a diagnosis that add something, unless somebody asks for more.
FEW_STEPS = 3
#: Bounds of settings of `simulate`.
_SIMULATE = {"duration_s": (1.0, math.inf), "horizon": (1, 100), "seed": (0, math.inf), "spread": (0.0, 1.0)}


@dataclass(frozen=True)
class _CalibrateSettings:
    """Further settings of `calibrate`.

    Parameters
    ----------
    classes : int, "auto" or "vehicle"
    goals : mapping of str to mapping
    seed : int
    law : str
    scheduler : str
    """

    classes: int | str = 0
    goals: Any = field(default_factory=dict)
    seed: int = 0
    law: str = PAPERS
    scheduler: str | None = None


@checked()
def read(
    source: "str | Path | Sequence[str | Path] | pandas.DataFrame",
    ring_m: float | None = None,
    name: str = "auto",
    *,
    columns: str | Path | Mapping[str, Any] | None = None,
    reference: str | None = None,
    road: str | Path | Network | None = None,
) -> Tracks:
    """Read vehicles on one or many lanes from files, a folder or a data frame.

    Parameters
    ----------
    source : str, Path, sequence of them or pandas.DataFrame
        A file or a folder in any known format; several files, each of which is a recording; or a data frame with the
        columns vehicle, time_s [s] and s_m [m], and perhaps recording, road, lane, d_m, length_m, width_m [m], class,
        driver, leader, measured and controlled. A table with position_m in place of s_m, and without recordings, roads,
        lanes and leaders, is of one road on which everybody is in view.
    ring_m : float, optional
        Circumference [m] of the ring where the file does not tell; an open road without it.
    name : str
        Name of the format of a file; "auto" for the one that recognises it.
    columns : str, Path or mapping, optional
        Which column of the source is which column of tracks: a map in YAML, or its content, such as
        ``{"s_m": {"column": "Local_Y", "factor": 0.3048}, "lane": "Lane_ID"}``.
    reference : {"centre", "front", "rear"}, optional
        Which point of a vehicle the positions are of; by default as the format says.
    road : str, Path or Network, optional
        The road, or a file that `read_road` reads, for a file of vehicles in the plane: INTERACTION, inD, rounD, exiD,
        or floating car data of SUMO.

    Returns
    -------
    Tracks
        A table with a row for each vehicle and time, and the leader of each row; ``tracks.dense()`` gives positions
        on one lane as an array (T, N).

    Raises
    ------
    InputError
        With the line or the field, for what cannot be read, and if vehicles overlap.

    Examples
    --------
    >>> import sugiyama_ros as sg
    >>> sg.simulate(vehicles=3, ring_m=40.0, duration_s=10.0).save("three.csv")
    >>> sg.read("three.csv", ring_m=40.0)
    <Tracks: 3 vehicles in 1 recording, 93 rows, leaders known in 100 %, from three.csv>
    """
    choices = _choices(columns, reference, road)
    if ring_m is not None:
        choices = replace(choices, ring_m=ring_m)
    if isinstance(source, str | Path | list | tuple):
        return read_tracks(source, choices, name)
    if road is not None:
        raise InputError("road: a data frame has positions along a road of its own; leave it out")
    return tracks_of_frame(source, choices)


def _choices(
    columns: str | Path | Mapping[str, Any] | None, reference: str | None, road: str | Path | Network | None
) -> Choices:
    """What arguments of `read` say about a file."""
    choices = Choices()
    if columns is not None:
        is_file = isinstance(columns, str | Path)
        choices = read_choices(Path(columns)) if is_file else choices_of(columns, "columns")  # type: ignore[arg-type]
    if reference is not None:
        choices = replace(choices, reference=reference_of(reference, "reference"))
    if road is not None:
        choices = replace(choices, network=road if isinstance(road, Network) else read_road(road))
    return choices


@checked(Experiment)
def simulate(
    vehicles: int | None = None,
    *,
    parameters: Mapping[str, float] | None = None,
    effects: Mapping[str, Mapping[str, float]] | None = None,
    model: str | Path | None = None,
    law: str = PAPERS,
    controlled: Sequence[int] | None = None,
    controller: str | None = None,
    **settings: Any,
) -> Simulation:
    """Simulate drivers from rest on a ring or an open road; vehicle 0 starts at 0 m, behind all others.

    Parameters
    ----------
    vehicles : int, optional
        Number of vehicles; by default those of the model file, or 22.
    parameters : mapping of str to float, optional
        Parameters of all drivers, such as ``{"v_star": 8.0}``; the paper's where they are left out.
    effects : mapping of str to mapping, optional
        Effects on all drivers with their values, such as ``{"drag": {"c0": 0.3}}``.
    model : str or Path, optional
        Model file with the drivers, in the order in which they become vehicles, the road, and how often they decide.
    law : str
        Name of the law by which all drivers drive, such as ``"idm"``, with its usual values; the paper's by default.
    controlled : sequence of int, optional
        Numbers of vehicles, from 0, that a controller drives in place of their drivers.
    controller : str, optional
        The controller with its values, such as ``"constant_speed:target=7"``; `sugiyama_ros.controllers` has all.
    **settings
        Fields of `sugiyama_ros.simulation.experiment.Experiment`: ring_m [m] (0 for an open road), duration_s [s],
        gap_m [m], period_s [s], horizon, spread, seed, start ("jam" or "equal") and length_m [m].

    Returns
    -------
    Simulation
        What a camera would have measured (``measured``; ``dense`` as arrays), and the truth.

    Raises
    ------
    InputError
        For an unknown name, a value out of bounds, or vehicles that do not fit on the ring.

    Examples
    --------
    >>> import sugiyama_ros as sg
    >>> hidden = sg.simulate(vehicles=3, ring_m=40.0, duration_s=10.0, effects={"drag": {"c0": 0.3}})
    >>> hidden.dense.position_m.shape
    (31, 3)
    """
    _check_names("simulate", settings, Experiment.__dataclass_fields__)
    for name, bounds in _SIMULATE.items():
        _check_within(name, settings.get(name), *bounds)
    file = None if model is None else drivers_of(Path(model), law)
    count = vehicles if vehicles is not None else 22 if file is None else len(file.vehicle)
    experiment = Experiment(**{**(file.conditions.of_experiment(count) if file is not None else {}), **settings})
    experiment.check(count)
    rows = _usual_drivers(count, law) if file is None else file.simulated(count)
    by_controller = controlled_by(controlled, controller)
    return _simulated(experiment, law, by_controller, (rows, parameters or {}, effects or {}, experiment.road))


def _simulated(experiment: Experiment, law: str, controlled: Controlled | None, asked: Asked) -> Simulation:
    """Simulate what was asked for, once everything that was asked is known to change something."""
    if experiment.horizon is not None and not np.any(asked[0][:, ROW.law] == ADAPTIVE_SEEK):
        raise InputError("horizon: drivers by another law than the paper's do not look ahead; leave it out, or the law")
    check_somebody_drives(len(asked[0]), () if controlled is None else controlled.vehicles, law, experiment.spread)
    check_acts(lambda drivers: [set_up(experiment, drivers, controlled)], experiment.samples - 1, asked)
    return carry_out(experiment, changed(*asked), controlled)


def _usual_drivers(vehicles: int, law: str) -> Array:
    """Rows (N, width) of drivers who are all alike."""
    rows = ROW.with_effects(defaults(vehicles))
    return rows if law == PAPERS else np.array([drive_by(row, law) for row in rows])


@checked(_CalibrateSettings)
def calibrate(
    tracks: Tracks | Simulation,
    formulation: Formulation = "causal",
    parameters: Sequence[str] = (),
    *,
    effects: Sequence[str] = (),
    regularise: bool | None = None,
    profile: bool = False,
    **settings: Any,
) -> Calibration:
    """Estimate every driver's parameters by maximum likelihood.

    Parameters
    ----------
    tracks : Tracks or Simulation
        The recording, or a simulated one. The paper's formulation needs one lane.
    formulation : {"causal", "paper"}
        Whether perceived states are filtered, or smoothed as in the paper.
    parameters : sequence of str
        Names of what is estimated. By default what the paper estimates, and more noises where positions are smooth.
    effects : sequence of str
        Names of effects that are fitted with it, with drivers as draws of one population (causal formulation).
    regularise : bool, optional
        Causal: drivers are draws of one population; paper: with the paper's penalty. By default only on tracks, where
        drivers come and go.
    profile : bool
        Whether the intervals come from the profile likelihood, which takes longer.
    **settings
        classes: number of classes of drivers who share all parameters, 0 for parameters of each driver, "auto" for the
        number that predicts held-out drivers best, "vehicle" for the classes of the vehicles; goals: what drivers may
        intend besides driving through, such as ``{"exit": {"place": 500.0, "speed": 8.0}}``; law: name of the law by
        which the drivers drive, all of whose parameters are estimated; seed: seed of the search for classes and
        goals; scheduler: address of a Dask scheduler whose workers do the work.

    Returns
    -------
    Calibration
        Parameters of each driver with their errors, and whether the data hold them.

    Raises
    ------
    InputError
        For an unknown name, options that contradict each other, or data that the formulation cannot take.

    Examples
    --------
    >>> import sugiyama_ros as sg
    >>> simulated = sg.simulate(vehicles=4, ring_m=45.0, duration_s=60.0, seed=1)
    >>> found = sg.calibrate(simulated, "paper", ["v_star", "kappa_v"])
    >>> found.to_frame().shape
    (4, 12)
    """
    _check_names("calibrate", settings, _CalibrateSettings.__dataclass_fields__)
    said = _CalibrateSettings(**settings)
    _check_within("seed", said.seed, 0, math.inf)
    of_search = (said.seed, said.law, tuple(effects), number_of_classes(said.classes), goals_from(said.goals))
    asked = Settings(formulation, tuple(parameters), regularise, profile, *of_search)
    asked.check()
    with stages() as on:
        return calibrate_drivers(_tracks(tracks), asked, said.scheduler, partial(on, "calibrating"))


def _tracks(given: Tracks | Simulation) -> Tracks:
    """A recording; of a simulation, what a camera would have measured."""
    return given.measured if isinstance(given, Simulation) else given


def _check_names(function: str, given: Mapping[str, Any], known: Iterable[str]) -> None:
    unknown = sorted(set(given) - set(known))
    if unknown:
        raise InputError(f"{function}: {unknown[0]!r} is not known; give {', '.join(known)}")


def _check_within(name: str, value: float | None, lower: float, upper: float) -> None:
    if value is not None and not lower <= value <= upper:
        most = f" to {upper:g}" if upper < math.inf else " or more"
        raise InputError(f"{name}: {value:g} is not possible; give {lower:g}{most}")


@checked()
def compare(
    tracks: Tracks | Simulation,
    effects: Sequence[str] = (),
    model: str | Path | None = None,
    *,
    seed: int = 0,
) -> Comparison:
    """Compare the model with measurements and with other laws, on samples that no fit has seen.

    Parameters
    ----------
    tracks : Tracks or Simulation
        The recording, at least 8 s long, of one road on which everybody is recorded; or of drivers who follow a known
        vehicle for 5 s.
    effects : sequence of str
        Names of effects that are added to the base model.
    model : str or Path, optional
        Model file. What it says of the road and of all drivers is taken as it is, and each driver's own parameters are
        fitted to this recording. If the file was fitted to this recording, it is taken as it is, in sample.
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
    _check_within("seed", seed, 0, math.inf)
    given = read_model(Path(model)) if model is not None else None
    with stages() as advance:
        return comparison.compare(
            _tracks(tracks), effects, given, seed=seed, workers=os.cpu_count() or 1, on_progress=advance
        )


@checked()
def diagnose(
    tracks: Tracks | Simulation,
    *,
    add: str | Sequence[str] | None = None,
    law: str = PAPERS,
    simulations: int = 2,
    seed: int = 0,
) -> Diagnosis:
    """Find out which physical effect the model lacks.

    Parameters
    ----------
    tracks : Tracks or Simulation
        The recording, at least 8 s long, of one road on which everybody is recorded; or of drivers who follow a known
        vehicle for 5 s.
    add : {None, "auto"} or sequence of str
        By default, what the data ask for is added in at most three steps; with ``"auto"``, in as many as they ask for.
        Names, such as ``["drag"]``, are added whatever the data say of them: effects, their forms, groups of constants
        such as ``"response_constants"``, or ``"discovered_force:speed"``.
    law : str
        Name of the law by which the drivers of the base model drive, such as ``"idm"``; the paper's by default.
    simulations : int
        Number of recordings that each model simulates, 1000 at most, which say what the filter's approximations do.
    seed : int
        Seed of all random numbers.

    Returns
    -------
    Diagnosis
        What was added, the candidates, and where the model fails before and after.

    Raises
    ------
    InputError
        For a recording that is too short, or a name that cannot be added.

    Examples
    --------
    >>> import sugiyama_ros as sg
    >>> simulated = sg.simulate(vehicles=4, ring_m=45.0, duration_s=60.0, seed=1)
    >>> found = sg.diagnose(simulated)
    >>> print(found.summary().splitlines()[0])
    The model is adequate: no check fails.
    """
    _check_within("simulations", simulations, 1, 1000)
    _check_within("seed", seed, 0, math.inf)
    names = () if add in (None, "auto") else (add,) if isinstance(add, str) else tuple(add or ())
    check_names(names, law)
    with stages() as advance:
        return diagnosis.diagnose(
            _tracks(tracks),
            add=names,
            most=None if add else FEW_STEPS,
            law=law,
            seed=seed,
            simulations=simulations,
            workers=os.cpu_count() or 1,
            on_progress=advance,
        )


@checked()
def filter_plane(
    x_m: Numbers,
    y_m: Numbers,
    line: Numbers,
    period_s: float,
    *,
    heading: Numbers | None = None,
    ahead_m: Numbers | None = None,
    length_m: float = DEFAULT_LENGTH_M,
    parameters: Mapping[str, float] | None = None,
) -> PlaneEstimates:
    """Filter a car in the plane, as a kinematic bicycle along a wanted line behind the vehicles on this line.

    Parameters
    ----------
    x_m, y_m : array_like, shape (T,)
        Measured places [m] of the car; NaN where missing.
    line : array_like, shape (K, 2)
        Points [m] of the wanted line in the direction of driving; a ring if the last point is the first.
    period_s : float
        Time [s] between two samples.
    heading : array_like, shape (T,), optional
        Measured heading [rad], counter-clockwise from the x axis; NaN where missing.
    ahead_m : array_like, shape (T,) or (T, M - 1), optional
        Measured positions [m] along the line of the vehicles ahead, the nearest first; nobody is ahead without it.
    length_m : float
        Length [m] of the vehicles.
    parameters : mapping of str to float, optional
        Parameters of the driver and of the car, such as ``{"v_star": 8.0, "l_f": 1.1}``; the usual ones where they are
        left out.

    Returns
    -------
    PlaneEstimates
        Place, heading, speed, acceleration and steering angle at each sample, and how well each was predicted.

    Raises
    ------
    InputError
        For arrays of different lengths, a line that is none, and parameters that are not known or out of bounds.

    Examples
    --------
    >>> import numpy as np
    >>> import sugiyama_ros as sg
    >>> angle = np.linspace(0.0, 2.0 * np.pi, 361)
    >>> circle = 37.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    >>> turned = 8.0 * 0.1 * np.arange(100) / 37.0
    >>> x_m, y_m = 37.0 * np.cos(turned), 37.0 * np.sin(turned)
    >>> found = sg.filter_plane(x_m, y_m, circle, 0.1, parameters={"v_star": 8.0})
    >>> round(float(found.speed[-1]), 1)
    8.0
    """
    points = np.asarray(line, np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"line: has shape {points.shape}; give points as (K, 2)")
    _check_within("period_s", period_s, 1e-3, 10.0)
    track = plane_track(x_m, y_m, heading, ahead_m, length_m)
    driver, car = _driver_and_car(parameters or {})
    return PlaneFilter(CentreLine(*points.T), period_s, track.vehicles, driver, car=car).run(track)


def _driver_and_car(given: Mapping[str, float]) -> tuple[Array, Array]:
    """Parameters of a driver and of a car, the usual ones where they are not given."""
    driver, car, of_car = population(), car_of(), [p.name for p in CAR]
    _check_names("parameters", given, (*NAMES, *of_car))
    for name, value in given.items():
        if name in NAMES:
            driver[NAMES.index(name)] = value
        else:
            car[of_car.index(name)] = value
    return driver, car


@checked()
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


@checked()
def report(run: str | Path, output: str | Path, diagnosis: Diagnosis | str | Path | None = None) -> Path:
    """Write an HTML page about a recorded run, as ``sugiyama report``.

    Parameters
    ----------
    run : str or Path
        Bag that ``sugiyama run`` recorded, or that `Simulation.save` wrote.
    output : str or Path
        Page to write; a page of this name is replaced.
    diagnosis : Diagnosis, str or Path, optional
        What `diagnose` returns for the same data, or the document of it in a file.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        For a file that is no such bag, or no such document, or a diagnosis of another recording.
    OutputError
        If the page cannot be written.

    Examples
    --------
    >>> import sugiyama_ros as sg
    >>> sg.simulate(vehicles=3, ring_m=40.0, duration_s=10.0).save("three.mcap")
    >>> sg.report("three.mcap", "three.html").name
    'three.html'
    """
    from sugiyama_ros.page.report import write_report
    from sugiyama_ros.page.truth import against_truth

    if isinstance(diagnosis, Diagnosis):
        document: dict[str, Any] | None = plain(document_of(diagnosis))
    else:
        document = read_diagnosis(Path(diagnosis)) if diagnosis is not None else None
    bag, page = Path(run), Path(output)
    read = recording.read_recording(bag)
    if document is not None:
        name = "diagnosis" if isinstance(diagnosis, Diagnosis) else str(diagnosis)
        check_same(document, name, read.trajectories, bag)
    write_report(read, document, page, against_truth(bag, read))
    return page
