"""The kinds of calibration: each driver alone, all drivers as one population, classes of drivers."""

from concurrent.futures import Executor
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sugiyama_ros.calibration.result import (
    AUTO,
    MOST_CLASSES,
    VEHICLE,
    CalibratedDriver,
    Calibration,
    Settings,
    of_classes,
    of_fits,
)
from sugiyama_ros.driver.parameters import NAMES, index
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.coordinates import limits, with_open_ends
from sugiyama_ros.fit.driver import Fit, SearchOptions, calibrate, is_determined, quadratic
from sugiyama_ros.fit.driver_types import Population, Predictions
from sugiyama_ros.fit.recording import FOLDS
from sugiyama_ros.fit.smooth_positions import evenness
from sugiyama_ros.laws.registry import PAPERS
from sugiyama_ros.progress import OnProgress
from sugiyama_ros.results import counted
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.dense import DenseTracks, numbers_of, one_road, road_of_drivers
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.workers import workers

if TYPE_CHECKING:
    from sugiyama_ros.fit.model import PointwiseDensity
    from sugiyama_ros.fit.recording import Recorded

# What is known of a recording that only its positions are given of.
_ORIGIN = About()


def calibrate_drivers(
    tracks: Tracks,
    settings: Settings,
    scheduler: str | None = None,
    on_progress: OnProgress = lambda done, total: None,
    where: str = "",
) -> Calibration:
    """Calibrate the drivers of a recording in the way that the settings ask for. Raises InputError.

    scheduler: address of a Dask scheduler whose workers do the work; where: name of the file, for errors.
    """
    road = one_road(tracks, where) if settings.formulation == "paper" else road_of_drivers(tracks)
    with workers(tracks.runs, scheduler) as work:
        if settings.classes or settings.goals:
            return _in_classes(tracks, road, settings, work, on_progress, where)
        if settings.is_pooled(on_tracks=road is None):
            return _pooled(tracks, road, settings, work)
        if road is None:
            # Imported here: drivers on one road do not need what follows tracks, which loads slowly.
            from sugiyama_ros.calibration.on_tracks import calibrate_tracks

            return calibrate_tracks(tracks, settings, work, on_progress)
        estimated = settings.estimated or evenness(road).estimated(settings.formulation)
        settings = replace(settings, estimated=estimated)
        return each_driver(road, settings, tracks.about, work=work, on_progress=on_progress)


def each_driver(
    road: DenseTracks,
    settings: Settings,
    about: About = _ORIGIN,
    *,
    work: Executor | None = None,
    on_progress: OnProgress = lambda done, total: None,
) -> Calibration:
    """Calibrate the drivers of a whole road one by one.

    The causal formulation makes two passes. The second pass gives the drivers ahead the parameters that the first pass
    found.
    """
    is_paper, drivers = settings.formulation == "paper", len(_drivers(road))
    passes = 1 if is_paper else 2
    fits: list[Fit] = []
    for number in range(passes):
        is_last = number == passes - 1
        options = SearchOptions(
            bool(settings.is_regularised), settings.profiled and is_last, is_last, from_several=is_paper
        )
        known, fits = {fit.vehicle: fit.parameters for fit in fits}, []
        for fit in calibrate(road, settings.formulation, settings.estimated, options, known=known, work=work):
            fits.append(fit)
            on_progress(number * drivers + len(fits), passes * drivers)
    return of_fits(settings, _drivers(road), fits, about, road)


def _in_classes(
    tracks: Tracks, road: DenseTracks | None, settings: Settings, work: Executor, on_progress: OnProgress, where: str
) -> Calibration:
    """Calibrate classes of drivers. The drivers of a class share all parameters, and a recording has its own noises."""
    # Imported here: drivers who are calibrated alone need no classes, which load slowly.
    from sugiyama_ros.fit.classes import find_classes
    from sugiyama_ros.fit.goals import goals_of
    from sugiyama_ros.fit.held_out_drivers import chosen, predict_held_out
    from sugiyama_ros.fit.model import Model, evaluate

    data, estimated = _prepared(tracks, road, settings)
    places = tuple(index(name) for name in estimated)
    settings = replace(settings, estimated=estimated)
    settings.check_classes(data.drivers, where or tracks.about.source)
    known: list[str] = []
    held_out: tuple[Predictions, ...] = ()
    count = max(settings.classes, 1) if isinstance(settings.classes, int) else 1
    goals = goals_of(settings.goals, _entries(tracks, data)) if settings.goals else None
    for one in settings.goals:
        one.check_within(float(tracks.s_m.min()), float(tracks.s_m.max()), data.speed)
    if settings.classes == VEHICLE:
        known = [one.vehicle_class for one in data.vicinity.names]
        if len(set(known)) < 2:
            raise InputError(f"{tracks.about.source}: all vehicles are of one class; give a number of classes")
    elif settings.classes == AUTO:
        most = min(MOST_CLASSES, data.drivers // FOLDS)
        if most < 1:
            raise InputError(
                f"{tracks.about.source}: {counted(data.drivers, 'driver')}, too few to hold some out; give a number of"
                " classes"
            )
        held_out = tuple(predict_held_out(data, places, most, work, settings.seed, on_progress))
        count = chosen(held_out)
    classes = find_classes(data, count, places, work, seed=settings.seed, known=known, goals=goals)
    model = Model(classes.own_rows, places, (), (1.0,) * len(places), classes.own_rows)
    drivers = _drivers(road) if road is not None else _followers(data, evaluate(data, model, work))
    return of_classes(settings, drivers, classes, tracks.about, road, held_out)


def _entries(tracks: Tracks, data: "Recorded") -> list[str]:
    """The lane on which each driver comes in; empty where the tracks do not say."""
    if tracks.lane is None:
        return [""] * data.drivers
    first = dict(zip(numbers_of(tracks).tolist(), tracks.start[:-1].tolist(), strict=True))
    return [tracks.lane.at(first[one.number]) for one in data.vicinity.names]


def _prepared(tracks: Tracks, road: DenseTracks | None, settings: Settings) -> tuple["Recorded", tuple[str, ...]]:
    """The recording prepared for a fit of all drivers, and the names of the parameters of the paper's driver."""
    from sugiyama_ros.fit.preparation import prepare_road, prepare_stretches

    data = prepare_stretches(tracks) if road is None else prepare_road(road)
    return data, settings.estimated or (data.even if road is None else evenness(road)).estimated()


def _pooled(tracks: Tracks, road: DenseTracks | None, settings: Settings, work: Executor) -> Calibration:
    """Calibrate all drivers together, as draws from one population (partial pooling), with the causal formulation.

    The distribution of the parameters over the population is estimated from the same drivers (empirical Bayes).
    """
    # Imported here: drivers who are calibrated alone need no search for effects, which takes long to load.
    from sugiyama_ros.diagnosis.refine import with_named
    from sugiyama_ros.fit.joint import fit_base
    from sugiyama_ros.fit.law import in_filter
    from sugiyama_ros.fit.smooth_positions import with_short_periods
    from sugiyama_ros.fit.standard_errors import own_stds, shared_stds

    data, estimated = _prepared(tracks, road, settings)
    if settings.law == PAPERS:
        base = fit_base(data, [index(name) for name in estimated], work)
    else:
        base = in_filter(data, settings.law, work)
    fitted = with_named(data, base, settings.effects, work)
    own, shared = own_stds(fitted), shared_stds(data, fitted, work)
    names = tuple(ROW.entries[k] for k in fitted.model.individual)
    settings = replace(settings, estimated=names if settings.law != PAPERS else estimated)
    prior = np.array(fitted.model.prior_std)
    # a parameter is identified if the driver's own samples halve the prior's standard deviation at least, and if what
    # is left, beside all other parameters and drivers, is less than half of the value
    own_information = (s.information.sum(axis=0)[: len(names), : len(names)] for s in fitted.slopes)
    known = np.array([np.diag(np.linalg.inv(h + np.diag(prior**-2.0))) < 0.25 * prior**2 for h in own_information])
    stds = np.array([[s.get(name, 0.0) for name in ROW.entries] for s in own])
    places = list(fitted.model.individual)
    medians = np.median(fitted.model.rows[:, places], axis=0).tolist()
    of_paper = {n: (m, float(s)) for n, m, s in zip(names, medians, prior, strict=True) if n in NAMES}
    interval = quadratic(fitted.model.rows, stds)
    interval[:, places] = with_open_ends(interval[:, places], places, limits(places, data.lower, data.upper))
    known &= is_determined(stds[:, places], fitted.model.rows[:, places], interval[:, places])
    return Calibration(
        settings=settings,
        drivers=_drivers(road) if road is not None else _followers(data, fitted.samples),
        rows=fitted.model.rows,
        std=tuple(own),
        identified=tuple(dict(zip(names, one.tolist(), strict=True)) for one in known),
        interval=interval,
        log_likelihood=np.nansum(fitted.samples.log_likelihood, axis=1),
        about=tracks.about,
        road=None if road is None else with_short_periods(road),
        shared_std=shared,
        population=Population(of_paper) if settings.law == PAPERS else None,
    )


def _drivers(road: DenseTracks) -> tuple[CalibratedDriver, ...]:
    known = zip(road.vehicle.tolist(), road.names or road.vehicle.tolist(), strict=True)
    return tuple(CalibratedDriver(name, number) for number, name in known if number not in road.controlled)


def _followers(data: "Recorded", samples: "PointwiseDensity") -> tuple[CalibratedDriver, ...]:
    """Drivers on tracks, with the samples that the fitted model predicts."""
    drivers = []
    for i, name in enumerate(data.vicinity.names):
        counts = np.isfinite(samples.log_likelihood[i])
        squares = samples.innovation_m[i, counts] ** 2 / samples.innovation_var[i, counts]
        led = data.chains[i].identity[:, :2] >= 0
        drivers.append(
            CalibratedDriver(
                vehicle=name.vehicle,
                number=name.number,
                recording=name.recording,
                vehicle_class=name.vehicle_class,
                stretches=len(np.unique(data.chains[i].identity[led[:, 0], 0])),
                following_s=float((data.scored[i] & led.all(axis=1)).sum()) * data.vicinity.period_s,
                nis=float(squares.mean()) if len(squares) else float("nan"),
            )
        )
    return tuple(drivers)
