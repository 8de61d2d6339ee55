"""The kinds of calibration: each driver alone, all drivers as one population, classes of drivers, drivers on tracks."""

from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from sugiyama_ros.calibration.result import CalibratedDriver, Calibration, Settings, of_fits
from sugiyama_ros.driver.parameters import index
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.classes import find_classes
from sugiyama_ros.fit.driver import Fit, JobMaker, SearchOptions, each_of
from sugiyama_ros.fit.smooth_positions import evenness
from sugiyama_ros.fit.standard_errors import is_determined, quadratic
from sugiyama_ros.laws.registry import PAPERS
from sugiyama_ros.progress import OnProgress
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.trajectories.trajectories import Trajectories
from sugiyama_ros.workers import workers


def calibrate_drivers(
    recording: Trajectories | Tracks, settings: Settings, scheduler: str | None, on_progress: OnProgress
) -> Calibration:
    """Calibrate the drivers of a recording in the way that the settings ask for. Raises InputError.

    scheduler: address of a Dask scheduler whose workers do the work.
    """
    if isinstance(recording, Tracks):
        # Imported here: drivers on one lane do not need what follows tracks, which loads slowly.
        from sugiyama_ros.calibration.on_tracks import calibrate_tracks

        names, profiled = settings.estimated, settings.profiled
        with workers(recording.runs, scheduler) as work:
            return calibrate_tracks(recording, names, profiled=profiled, work=work, on_progress=on_progress)
    estimated = settings.estimated or evenness(recording).estimated(settings.formulation)
    settings = replace(settings, estimated=estimated)
    with workers(len(recording.vehicle), scheduler) as work:
        if settings.is_pooled:
            return pooled(recording, settings, work)
        if settings.classes:
            return in_classes(recording, settings, work)
        return each_driver(recording, settings, work=work, on_progress=on_progress)


def each_driver(
    trajectories: Trajectories,
    settings: Settings,
    *,
    work: Executor | None = None,
    on_progress: OnProgress = lambda done, total: None,
) -> Calibration:
    """Calibrate the drivers one by one.

    The causal formulation makes two passes. The second pass gives the drivers ahead the parameters that the first pass
    found. Raises InputError.
    """
    passes, drivers = 1 if settings.formulation == "paper" else 2, len(trajectories.vehicle)
    maker = JobMaker(trajectories, settings.formulation, settings.estimated)
    fits: list[Fit] = []
    for number in range(passes):
        is_last = number == passes - 1
        options = SearchOptions(settings.is_regularised, settings.profiled and is_last, is_last, from_several=True)
        maker, fits = maker.knowing({fit.vehicle: fit.parameters for fit in fits}), []
        for fit in each_of(maker, options, work=work):
            fits.append(fit)
            on_progress(number * drivers + len(fits), passes * drivers)
    return of_fits(settings, _drivers(trajectories), fits, trajectories)


def in_classes(trajectories: Trajectories, settings: Settings, work: Executor) -> Calibration:
    """Calibrate classes of drivers. The drivers of a class share all parameters. Raises InputError."""
    drivers, count, estimated = len(trajectories.vehicle), settings.classes, settings.estimated
    if drivers < count:
        raise InputError(f"{trajectories.source}: {drivers} drivers, {count} classes; give --classes {drivers} at most")
    places, options = [index(name) for name in estimated], SearchOptions(with_errors=False)
    job_of = JobMaker(trajectories, settings.formulation, estimated)
    jobs = [replace(job_of(i), options=options) for i in range(drivers)]
    samples = int(np.isfinite(trajectories.position_m).sum())
    classes = find_classes(jobs, count, samples, settings.seed, work)
    likeliest = classes.probability.argmax(axis=1)
    rows, std = classes.rows[likeliest], classes.std[likeliest]
    return Calibration(
        settings=settings,
        drivers=_drivers(trajectories),
        rows=ROW.with_effects(rows),
        std=tuple(dict(zip(estimated, one, strict=True)) for one in std[:, places].tolist()),
        identified=tuple(dict(zip(estimated, one, strict=True)) for one in np.isfinite(std[:, places]).tolist()),
        interval=quadratic(rows, std),
        log_likelihood=classes.log_likelihood,
        trajectories=trajectories,
        classes=classes,
    )


def pooled(trajectories: Trajectories, settings: Settings, work: Executor) -> Calibration:
    """Calibrate all drivers together, as draws from one population (partial pooling), with the causal formulation.

    The distribution of the parameters over the population is estimated from the same drivers (empirical Bayes). Raises
    InputError.
    """
    # Imported here: drivers who are calibrated alone need no search for effects, which takes long to load.
    from sugiyama_ros.diagnosis.refine import with_named
    from sugiyama_ros.fit.joint import fit_base
    from sugiyama_ros.fit.law import in_filter
    from sugiyama_ros.fit.recording import prepare
    from sugiyama_ros.fit.sandwich import own_stds, shared_stds
    from sugiyama_ros.fit.smooth_positions import with_short_periods

    trajectories = with_short_periods(trajectories)
    data = prepare(trajectories)
    if settings.law == PAPERS:
        base = fit_base(data, [index(name) for name in settings.estimated], work)
    else:
        base = in_filter(data, settings.law, work)
    fitted = with_named(data, base, settings.effects, work)
    own, shared = own_stds(fitted), shared_stds(data, fitted, work)
    names = tuple(ROW.entries[k] for k in fitted.model.individual)
    if settings.law != PAPERS:
        settings = replace(settings, estimated=names)
    prior = np.array(fitted.model.prior_std)
    # a parameter is identified if the driver's own samples halve the prior's standard deviation at least, and if what
    # is left, beside all other parameters and drivers, is less than half of the value
    own_information = (s.information.sum(axis=0)[: len(names), : len(names)] for s in fitted.slopes)
    known = np.array([np.diag(np.linalg.inv(h + np.diag(prior**-2.0))) < 0.25 * prior**2 for h in own_information])
    stds = np.array([[s.get(name, 0.0) for name in ROW.entries] for s in own])
    places = list(fitted.model.individual)
    known &= is_determined(stds[:, places], fitted.model.rows[:, places])
    return Calibration(
        settings=settings,
        drivers=_drivers(trajectories),
        rows=fitted.model.rows,
        std=tuple(own),
        identified=tuple(dict(zip(names, one.tolist(), strict=True)) for one in known),
        interval=quadratic(fitted.model.rows, stds),
        log_likelihood=np.nansum(fitted.samples.log_likelihood, axis=1),
        trajectories=trajectories,
        shared_std=shared,
    )


def _drivers(trajectories: Trajectories) -> tuple[CalibratedDriver, ...]:
    return tuple(map(CalibratedDriver, trajectories.vehicle.tolist()))
