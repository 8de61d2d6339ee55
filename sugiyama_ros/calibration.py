"""Calibration as a user asks for it: one formulation, some parameters, perhaps a population or effects with them."""

import contextlib
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from sugiyama_ros.diagnosis.candidates import named
from sugiyama_ros.diagnosis.screen import with_candidate
from sugiyama_ros.driver.parameters import NAMES, index
from sugiyama_ros.effects.registry import ENTRIES, whole
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.checkpoint import Checkpoint
from sugiyama_ros.fit.classes import Classes, find_classes
from sugiyama_ros.fit.driver import Fit, Formulation, calibrate, job_of, upper_bounds
from sugiyama_ros.fit.driver_types import DriverTypes
from sugiyama_ros.fit.fitting import fit_base, prepare
from sugiyama_ros.fit.intervals import quadratic
from sugiyama_ros.fit.model_file import stds_of, write_drivers
from sugiyama_ros.progress import OnProgress
from sugiyama_ros.road import Array
from sugiyama_ros.trajectories.trajectories import Trajectories


@dataclass(frozen=True, eq=False)
class Calibrated:
    """Drivers with their parameters: rows (N, WIDTH), std and identified of each by name, log-likelihood (N,).

    interval: (N, P, 2), ends of the 95 % intervals of the base model's parameters; shared_std: of what all drivers have
    in common; classes: those that the drivers were divided into, if they were.
    """

    trajectories: Trajectories
    rows: Array
    std: tuple[dict[str, float], ...]
    identified: tuple[dict[str, bool], ...]
    interval: Array
    log_likelihood: Array
    shared_std: Mapping[str, float]
    classes: Classes | None = None

    def write(self, path: Path) -> None:
        """Write a model file. Raises OutputError."""
        total, types = float(self.log_likelihood.sum()), None
        if self.classes is not None:
            types = DriverTypes(self.classes.share, self.classes.rows)
        write_drivers(path, self.trajectories, self.rows, self.std, self.shared_std, total, types)


def each_for_himself(
    trajectories: Trajectories,
    formulation: Formulation,
    estimated: Sequence[str],
    *,
    is_regularised: bool = False,
    profiled: bool = False,
    hops: int = 0,
    seed: int = 0,
    work: Executor | None = None,
    kept: Path | None = None,
    on_progress: OnProgress = lambda done, total: None,
) -> Calibrated:
    """Calibrate the drivers one by one; the causal formulation twice, then with the drivers ahead as they were found.

    profiled: whether intervals come from the profile likelihood; hops: of basinhopping before the search; kept: file in
    which the fits are kept until all is done, so that a calibration that was cut off can go on.
    """
    passes = 1 if formulation == "paper" else 2
    total = passes * len(trajectories.vehicle)
    found: dict[int, Fit] = {}
    with contextlib.ExitStack() as stack:
        resume = None
        if kept is not None:
            about = {
                "sha256": trajectories.sha256,
                "ring_m": trajectories.road.circumference_m,
                "formulation": formulation,
                "estimated": list(estimated),
                "regularised": is_regularised,
                "profiled": profiled,
                "hops": [hops, seed],
            }
            resume = stack.enter_context(Checkpoint(kept, about)).resume
        for number in range(passes):
            starts, is_last = {v: fit.parameters for v, fit in found.items()}, number == passes - 1
            one_pass = partial(
                calibrate,
                trajectories,
                formulation,
                estimated,
                is_regularised=is_regularised,
                profiled=profiled and is_last,
                with_errors=is_last,
                hops=hops,
                seed=seed,
                starts=starts,
                work=work,
            )
            latest: dict[int, Fit] = {}
            for fit in resume(f"pass {number + 1}", one_pass) if resume else one_pass():
                latest[fit.vehicle] = fit
                on_progress(number * len(trajectories.vehicle) + len(latest), total)
            found = latest
    fits = [found[v] for v in trajectories.vehicle.tolist()]
    return Calibrated(
        trajectories,
        whole(np.array([fit.parameters for fit in fits])),
        tuple({name: float(fit.std[index(name)]) for name in estimated} for fit in fits),
        tuple({name: fit.identified(name) for name in estimated} for fit in fits),
        np.array([fit.interval for fit in fits]),
        np.array([fit.log_likelihood for fit in fits]),
        {},
    )


def in_classes(
    trajectories: Trajectories,
    formulation: Formulation,
    estimated: Sequence[str],
    count: int,
    seed: int,
    work: Executor,
) -> Calibrated:
    """Calibrate ``count`` classes of drivers who share their parameters; each has those of his likeliest class.

    Raises InputError for fewer drivers than classes.
    """
    drivers = len(trajectories.vehicle)
    if drivers < count:
        raise InputError(f"{trajectories.source}: {drivers} drivers, {count} classes; give --classes {drivers} at most")
    places, upper = np.array([index(name) for name in estimated]), upper_bounds(trajectories)
    jobs = [replace(job_of(trajectories, i, formulation, places, upper, {}), with_errors=False) for i in range(drivers)]
    found = find_classes(jobs, count, int(np.isfinite(trajectories.position_m).sum()), seed, work)
    of = found.probability.argmax(axis=1)
    rows, std = found.rows[of], found.std[of]
    return Calibrated(
        trajectories,
        whole(rows),
        tuple(dict(zip(estimated, one.tolist(), strict=True)) for one in std[:, places]),
        tuple(dict.fromkeys(estimated, True) for _ in of),
        quadratic(rows, std),
        found.log_likelihood,
        {},
        found,
    )


def all_together(
    trajectories: Trajectories, estimated: Sequence[str], effects: Sequence[str], work: Executor
) -> Calibrated:
    """Calibrate all drivers together, as draws of one population (partial pooling), with effects if any are given.

    The prior over the drivers is found from themselves (empirical Bayes). Raises InputError for an unknown effect.
    """
    data = prepare(trajectories)
    chosen = named(data, effects)
    fitted = fit_base(data, [index(name) for name in estimated], work)
    for candidate in chosen:
        fitted = with_candidate(data, fitted, candidate, work)
    own, shared = stds_of(fitted)
    names = [ENTRIES[k] for k in fitted.model.individual]
    prior = np.array(fitted.model.prior_std)
    # what the prior leaves as wide as it was is not in the data
    known = [
        np.array([s.information.sum(axis=0)[k, k] for k in range(len(names))]) > 3.0 / np.square(prior)
        for s in fitted.slopes
    ]
    return Calibrated(
        trajectories,
        fitted.model.rows,
        tuple(own),
        tuple({n: bool(k) for n, k in zip(names, one, strict=True)} for one in known),
        quadratic(fitted.model.rows[:, : len(NAMES)], np.array([[s.get(name, 0.0) for name in NAMES] for s in own])),
        np.nansum(fitted.samples.log_likelihood, axis=1),
        shared,
    )
