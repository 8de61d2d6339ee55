"""The three kinds of calibration: each driver alone, all drivers as one population, or classes of drivers."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from sugiyama_ros.calibration.result import Calibration, Settings
from sugiyama_ros.driver.parameters import index
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.classes import find_classes
from sugiyama_ros.fit.driver import Fit, SearchOptions
from sugiyama_ros.fit.each_driver import JobMaker, each_of
from sugiyama_ros.fit.intervals import quadratic
from sugiyama_ros.laws.registry import PAPERS
from sugiyama_ros.progress import OnProgress
from sugiyama_ros.trajectories.trajectories import Trajectories


def each_driver(
    trajectories: Trajectories,
    settings: Settings,
    *,
    work: Executor | None = None,
    on_progress: OnProgress = lambda done, total: None,
) -> Calibration:
    """Calibrate the drivers one by one.

    The causal formulation makes two passes. The second pass gives the drivers ahead the
    parameters that the first pass found.

    Raises InputError, OutputError.
    """
    passes, drivers = 1 if settings.formulation == "paper" else 2, len(trajectories.vehicle)
    maker = JobMaker(trajectories, settings.formulation, settings.estimated, {})
    fits: list[Fit] = []
    for number in range(passes):
        is_last = number == passes - 1
        options = SearchOptions(
            is_regularised=settings.is_regularised,
            profiled=settings.profiled and is_last,
            with_errors=is_last,
            from_several=True,
        )
        maker, fits = maker.knowing({fit.vehicle: fit.parameters for fit in fits}), []
        for fit in each_of(maker, options, work=work):
            fits.append(fit)
            on_progress(number * drivers + len(fits), passes * drivers)
    estimated = settings.estimated
    return Calibration(
        trajectories=trajectories,
        settings=settings,
        rows=ROW.with_effects(np.array([fit.parameters for fit in fits])),
        std=tuple({name: float(fit.std[index(name)]) for name in estimated} for fit in fits),
        identified=tuple({name: fit.identified(name) for name in estimated} for fit in fits),
        interval=np.array([fit.interval for fit in fits]),
        log_likelihood=np.array([fit.log_likelihood for fit in fits]),
        shared_std={},
    )


def in_classes(trajectories: Trajectories, settings: Settings, count: int, work: Executor) -> Calibration:
    """Calibrate classes of drivers. The drivers of a class share all parameters. Raises InputError."""
    drivers = len(trajectories.vehicle)
    if drivers < count:
        raise InputError(f"{trajectories.source}: {drivers} drivers, {count} classes; give --classes {drivers} at most")
    estimated = settings.estimated
    places, options = [index(name) for name in estimated], SearchOptions(with_errors=False)
    job_of = JobMaker(trajectories, settings.formulation, estimated, {})
    jobs = [replace(job_of(i), options=options) for i in range(drivers)]
    samples = int(np.isfinite(trajectories.position_m).sum())
    found = find_classes(jobs, count, samples, settings.seed, work)
    likeliest = found.probability.argmax(axis=1)
    rows, std = found.rows[likeliest], found.std[likeliest]
    return Calibration(
        trajectories=trajectories,
        settings=settings,
        rows=ROW.with_effects(rows),
        std=tuple(dict(zip(estimated, one.tolist(), strict=True)) for one in std[:, places]),
        identified=tuple(dict(zip(estimated, one.tolist(), strict=True)) for one in np.isfinite(std[:, places])),
        interval=quadratic(rows, std),
        log_likelihood=found.log_likelihood,
        shared_std={},
        classes=found,
    )


def pooled(trajectories: Trajectories, settings: Settings, effects: Sequence[str], work: Executor) -> Calibration:
    """Calibrate all drivers together, as draws from one population (partial pooling), with the causal formulation.

    The distribution of the parameters over the population is estimated from the same drivers (empirical Bayes).

    Raises InputError.
    """
    # Imported here: drivers who are calibrated alone need no search for effects, which takes long to load.
    from sugiyama_ros.diagnosis.refine import with_named
    from sugiyama_ros.fit.law import in_filter
    from sugiyama_ros.fit.model_file import own_stds
    from sugiyama_ros.fit.population import fit_base
    from sugiyama_ros.fit.recording import prepare
    from sugiyama_ros.fit.sampling import with_short_periods
    from sugiyama_ros.fit.sandwich import shared_stds

    trajectories = with_short_periods(trajectories)
    data = prepare(trajectories)
    if settings.law == PAPERS:
        base = fit_base(data, [index(name) for name in settings.estimated], work)
    else:
        base = in_filter(data, settings.law, work)
    fitted = with_named(data, base, effects, work)
    own, shared = own_stds(fitted), shared_stds(data, fitted, work)
    names = [ROW.entries[k] for k in fitted.model.individual]
    settings = settings if settings.law == PAPERS else replace(settings, estimated=tuple(names))
    prior = np.array(fitted.model.prior_std)
    # a parameter is identified if the data hold more than three times the prior's information
    known = [
        np.array([s.information.sum(axis=0)[k, k] for k in range(len(names))]) > 3.0 / np.square(prior)
        for s in fitted.slopes
    ]
    stds = np.array([[s.get(name, 0.0) for name in ROW.entries] for s in own])
    return Calibration(
        trajectories=trajectories,
        settings=settings,
        rows=fitted.model.rows,
        std=tuple(own),
        identified=tuple({n: bool(k) for n, k in zip(names, one, strict=True)} for one in known),
        interval=quadratic(fitted.model.rows, stds),
        log_likelihood=np.nansum(fitted.samples.log_likelihood, axis=1),
        shared_std=shared,
    )
