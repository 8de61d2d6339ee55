"""Calibration as a user asks for it: each driver alone, all drivers as one population, or classes of drivers."""

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.calibration.result import Calibration, Settings
from sugiyama_ros.driver.parameters import NAMES, index
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.bounds import upper_bounds
from sugiyama_ros.fit.checkpoint import Checkpoint
from sugiyama_ros.fit.classes import find_classes
from sugiyama_ros.fit.driver import Fit, SearchOptions, calibrate, job_of
from sugiyama_ros.fit.intervals import quadratic
from sugiyama_ros.progress import OnProgress
from sugiyama_ros.trajectories.trajectories import Trajectories


def each_driver(
    trajectories: Trajectories,
    settings: Settings,
    *,
    work: Executor | None = None,
    kept: Path | None = None,
    on_progress: OnProgress = lambda done, total: None,
) -> Calibration:
    """Calibrate the drivers one by one.

    The causal formulation calibrates twice: the second time, the drivers ahead have the parameters that were found the
    first time.

    Parameters
    ----------
    trajectories
        The recording.
    settings
        What to estimate, and how to search.
    work
        Executor that carries out the searches; without one, they are carried out in turn.
    kept
        File that keeps the fits while the calibration runs, so that a calibration that was stopped can go on.
    on_progress
        Called after each fit.

    Raises
    ------
    InputError
        For an unknown parameter, or for data that the formulation cannot use.
    OutputError
        If ``kept`` cannot be written.
    """
    passes = 1 if settings.formulation == "paper" else 2
    drivers = len(trajectories.vehicle)
    found: dict[int, Fit] = {}
    with contextlib.ExitStack() as stack:
        resume = None
        if kept is not None:
            resume = stack.enter_context(Checkpoint(kept, _about(trajectories, settings))).resume
        for number in range(passes):
            starts = {v: fit.parameters for v, fit in found.items()}
            one_pass = _one_pass(trajectories, settings, starts, number == passes - 1, work)
            latest: dict[int, Fit] = {}
            for fit in resume(f"pass {number + 1}", one_pass) if resume else one_pass():
                latest[fit.vehicle] = fit
                on_progress(number * drivers + len(latest), passes * drivers)
            found = latest
    fits = [found[v] for v in trajectories.vehicle.tolist()]
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


def _about(trajectories: Trajectories, settings: Settings) -> dict[str, Any]:
    """What must be the same for kept fits to be used again."""
    return {
        "sha256": trajectories.sha256,
        "ring_m": trajectories.road.circumference_m,
        "formulation": settings.formulation,
        "estimated": list(settings.estimated),
        "regularised": settings.is_regularised,
        "profiled": settings.profiled,
        "hops": [settings.hops, settings.seed],
    }


def _one_pass(
    trajectories: Trajectories, settings: Settings, starts: Mapping[int, Array], is_last: bool, work: Executor | None
) -> Callable[..., Iterator[Fit]]:
    """The fits of all drivers, from ``starts``, as a function; only the last pass needs errors and intervals."""
    return partial(
        calibrate,
        trajectories,
        settings.formulation,
        settings.estimated,
        SearchOptions(
            is_regularised=settings.is_regularised,
            profiled=settings.profiled and is_last,
            hops=settings.hops,
            seed=settings.seed,
            with_errors=is_last,
        ),
        starts=starts,
        work=work,
    )


def in_classes(trajectories: Trajectories, settings: Settings, count: int, work: Executor) -> Calibration:
    """Calibrate classes of drivers who share all parameters; each driver gets the parameters of the likeliest class.

    Parameters
    ----------
    trajectories
        The recording.
    settings
        Formulation, parameters to estimate, and seed; the other settings are for drivers who are calibrated alone.
    count
        Number of classes.
    work
        Executor that carries out the searches.

    Raises
    ------
    InputError
        If there are fewer drivers than classes.
    """
    drivers = len(trajectories.vehicle)
    if drivers < count:
        raise InputError(f"{trajectories.source}: {drivers} drivers, {count} classes; give --classes {drivers} at most")
    estimated = settings.estimated
    places, upper = np.array([index(name) for name in estimated]), upper_bounds(trajectories)
    options = SearchOptions(with_errors=False)
    jobs = [
        replace(job_of(trajectories, i, settings.formulation, places, upper, {}), options=options)
        for i in range(drivers)
    ]
    samples = int(np.isfinite(trajectories.position_m).sum())
    found = find_classes(jobs, count, samples, settings.seed, work)
    likeliest = found.probability.argmax(axis=1)
    rows, std = found.rows[likeliest], found.std[likeliest]
    return Calibration(
        trajectories=trajectories,
        settings=settings,
        rows=ROW.with_effects(rows),
        std=tuple(dict(zip(estimated, one.tolist(), strict=True)) for one in std[:, places]),
        identified=tuple(dict.fromkeys(estimated, True) for _ in likeliest),
        interval=quadratic(rows, std),
        log_likelihood=found.log_likelihood,
        shared_std={},
        classes=found,
    )


def pooled(trajectories: Trajectories, settings: Settings, effects: Sequence[str], work: Executor) -> Calibration:
    """Calibrate all drivers together, as draws of one population (partial pooling), by the causal formulation.

    The distribution of the parameters over the drivers is estimated from the drivers themselves (empirical Bayes).

    Parameters
    ----------
    trajectories
        The recording.
    settings
        Parameters to estimate; the other settings are for drivers who are calibrated alone.
    effects
        Names of the effects to fit together with the parameters.
    work
        Executor that carries out the searches.

    Raises
    ------
    InputError
        For an unknown effect, or a recording that is too short.
    """
    # Imported here: drivers who are calibrated alone need no search for effects, which takes long to load.
    from sugiyama_ros.diagnosis.candidates import named
    from sugiyama_ros.diagnosis.screen import with_candidate
    from sugiyama_ros.fit.model_file import stds_of
    from sugiyama_ros.fit.population import fit_base
    from sugiyama_ros.fit.recording import prepare

    data = prepare(trajectories)
    chosen = named(data, effects)
    fitted = fit_base(data, [index(name) for name in settings.estimated], work)
    for candidate in chosen:
        fitted = with_candidate(data, fitted, candidate, work)
    own, shared = stds_of(fitted)
    names = [ROW.entries[k] for k in fitted.model.individual]
    prior = np.array(fitted.model.prior_std)
    # where the prior stays as wide as it was, the data say nothing
    known = [
        np.array([s.information.sum(axis=0)[k, k] for k in range(len(names))]) > 3.0 / np.square(prior)
        for s in fitted.slopes
    ]
    stds = np.array([[s.get(name, 0.0) for name in NAMES] for s in own])
    return Calibration(
        trajectories=trajectories,
        settings=settings,
        rows=fitted.model.rows,
        std=tuple(own),
        identified=tuple({n: bool(k) for n, k in zip(names, one, strict=True)} for one in known),
        interval=quadratic(fitted.model.rows[:, : len(NAMES)], stds),
        log_likelihood=np.nansum(fitted.samples.log_likelihood, axis=1),
        shared_std=shared,
    )
