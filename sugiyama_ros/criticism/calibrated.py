"""Calibration as a user asks for it: one formulation, some parameters, perhaps a population or effects with them."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from sugiyama_ros.criticism.candidates import candidates, recording_of
from sugiyama_ros.criticism.fitting import fit_base, prepare
from sugiyama_ros.criticism.model_file import stds_of, write_drivers
from sugiyama_ros.criticism.screening import glance, refine
from sugiyama_ros.driver.parameters import index
from sugiyama_ros.effects.catalogue import ENTRIES, whole
from sugiyama_ros.errors import InputError
from sugiyama_ros.estimation.calibration import Fit, Formulation, calibrate
from sugiyama_ros.estimation.checkpoint import Checkpoint
from sugiyama_ros.road import Array
from sugiyama_ros.trajectories import Trajectories

#: Called with the fits done, and to do.
OnProgress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Calibrated:
    """Drivers with their parameters: rows (N, WIDTH), std and identified of each by name, log-likelihood (N,).

    shared_std: of what all drivers have in common.
    """

    trajectories: Trajectories
    rows: Array
    std: tuple[dict[str, float], ...]
    identified: tuple[dict[str, bool], ...]
    log_likelihood: Array
    shared_std: Mapping[str, float]

    def write(self, path: Path) -> None:
        """Write a model file. Raises OutputError."""
        total = float(self.log_likelihood.sum())
        write_drivers(path, self.trajectories, self.rows, self.std, self.shared_std, total)


def each_for_himself(
    trajectories: Trajectories,
    formulation: Formulation,
    estimated: Sequence[str],
    *,
    is_regularised: bool = False,
    work: Executor | None = None,
    kept: Path | None = None,
    on_progress: OnProgress = lambda done, total: None,
) -> Calibrated:
    """Calibrate the drivers one by one; the causal formulation twice, then with the drivers ahead as they were found.

    kept: file in which the fits are kept until all is done, so that a calibration that was cut off can go on.
    """
    passes = 1 if formulation == "paper" else 2
    total = passes * len(trajectories.vehicle)
    found: dict[int, Fit] = {}

    def run(resume: Callable[[str, Callable[[Collection[int]], Iterator[Fit]]], Iterator[Fit]]) -> None:
        nonlocal found
        for number in range(passes):
            starts = {v: fit.parameters for v, fit in found.items()}
            fits = partial(_fits, trajectories, formulation, estimated, is_regularised, starts, work)
            latest = {}
            for fit in resume(f"pass {number + 1}", fits):
                latest[fit.vehicle] = fit
                on_progress(number * len(trajectories.vehicle) + len(latest), total)
            found = latest

    if kept is None:
        run(lambda _, fits: fits(()))
    else:
        about = {
            "sha256": trajectories.sha256,
            "ring_m": trajectories.road.circumference_m,
            "formulation": formulation,
            "estimated": list(estimated),
            "regularised": is_regularised,
        }
        with Checkpoint(kept, about) as checkpoint:
            run(checkpoint.resume)
    fits = [found[v] for v in trajectories.vehicle.tolist()]
    return Calibrated(
        trajectories,
        whole(np.array([fit.parameters for fit in fits])),
        tuple({name: float(fit.std[index(name)]) for name in estimated} for fit in fits),
        tuple({name: fit.identified(name) for name in estimated} for fit in fits),
        np.array([fit.log_likelihood for fit in fits]),
        {},
    )


def _fits(
    trajectories: Trajectories,
    formulation: Formulation,
    estimated: Sequence[str],
    is_regularised: bool,
    starts: Mapping[int, Array],
    work: Executor | None,
    skip: Collection[int],
) -> Iterator[Fit]:
    return calibrate(
        trajectories,
        formulation,
        estimated,
        is_regularised=is_regularised,
        starts=starts,
        skip=skip,
        work=work,
    )


def as_population(
    trajectories: Trajectories, estimated: Sequence[str], effects: Sequence[str], work: Executor
) -> Calibrated:
    """Calibrate all drivers together, as draws of one population (partial pooling), with effects if any are given.

    The prior over the drivers is found from themselves (empirical Bayes). Raises InputError for an unknown effect.
    """
    data = prepare(trajectories)
    possible = {c.name: c for c in candidates(recording_of(data), data.drivers)}
    for name in effects:
        if name not in possible:
            raise InputError(f"effect {name!r}: not among what can be added here: {', '.join(possible)}")
    fitted = fit_base(data, [index(name) for name in estimated], work)
    for name in effects:
        fitted = refine(data, glance(data, fitted, possible[name], work), work)
    own = len(fitted.model.individual)
    stds = stds_of(fitted)
    names = [ENTRIES[k] for k in fitted.model.individual]
    prior = np.array(fitted.model.prior_std)
    # what the prior leaves as wide as it was is not in the data
    known = [
        np.array([s.information.sum(axis=0)[k, k] for k in range(own)]) > 3.0 / np.square(prior) for s in fitted.slopes
    ]
    return Calibrated(
        trajectories,
        fitted.model.rows,
        tuple({n: float(s) for n, s in zip(names, std, strict=False)} for std in stds),
        tuple({n: bool(k) for n, k in zip(names, one, strict=True)} for one in known),
        np.nansum(fitted.samples.log_likelihood, axis=1),
        {ENTRIES[k]: float(s) for k, s in zip(fitted.model.shared, stds[0][own:], strict=True)},
    )
