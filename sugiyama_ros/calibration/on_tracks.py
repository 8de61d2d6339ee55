"""Calibration on tracks: vehicles that come and go, on several lanes, with leaders that change or are not known.

A driver's likelihood is the sum over the stretches in which the driver follows a known vehicle. Samples around the
driver's own lane changes do not count. A driver who follows for a short time says too little about four parameters, and
gets the parameters of the class of vehicles (``vehicle_classes``). There are two passes: in the first, drivers ahead
count as typical drivers; in the second, they have the parameters that the first pass found, or those of their class.
"""

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.calibration.drivers_ahead import DriversAhead
from sugiyama_ros.calibration.result import NOT_IDENTIFIED
from sugiyama_ros.calibration.vehicle_classes import (
    BriefDriver,
    ClassMedians,
    brief_driver,
    leader_class,
    medians_of,
)
from sugiyama_ros.driver.parameters import PARAMETERS, SIGMA_A, index
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.filters.extract import Drive
from sugiyama_ros.fit.bounds import lower_bounds, upper_bounds
from sugiyama_ros.fit.driver import START_SIGMA_A, Fit, Job, SearchOptions, carry_out
from sugiyama_ros.fit.driver_score import DriverChains, predicted
from sugiyama_ros.fit.stretched import LEAST_FOLLOWING_S, evenness_on, fastest_on, followers, following_s
from sugiyama_ros.plots import BLUE
from sugiyama_ros.progress import OnProgress
from sugiyama_ros.results import Result
from sugiyama_ros.tables import TextTable
from sugiyama_ros.trajectories.time_base import on_time_base
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.workers import in_turn

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class CalibratedDriver:
    """A calibrated driver on tracks.

    Parameters
    ----------
    recording, vehicle, vehicle_class : str
        Who drives; empty where the tracks do not say.
    stretches : int
        Number of stretches in which the driver follows.
    following_s : float
        Time [s] that counts.
    fit : Fit
        The estimate.
    nis : float
        Mean of the squared normalised innovations; 1 for a filter that knows its own errors.
    leader_class : str
        Class of the vehicle ahead most of the time.
    """

    recording: str
    vehicle: str
    vehicle_class: str
    stretches: int
    following_s: float
    fit: Fit
    nis: float
    leader_class: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class TracksCalibration(Result):
    """Calibrated drivers on tracks.

    Parameters
    ----------
    estimated : tuple of str
        Names of the estimated parameters.
    drivers : tuple of CalibratedDriver
        In the order of the tracks.
    brief : tuple of BriefDriver
        Drivers who follow a known vehicle for less than ``LEAST_FOLLOWING_S``, with the parameters of their class.
    profiled : bool
        Whether the intervals come from the profile likelihood.
    """

    estimated: tuple[str, ...]
    drivers: tuple[CalibratedDriver, ...]
    brief: tuple[BriefDriver, ...]
    profiled: bool = False

    @property
    def left_out(self) -> int:
        """Number of drivers without parameters of their own."""
        return len(self.brief)

    @property
    def classes(self) -> tuple[ClassMedians, ...]:
        """Medians of each class."""
        return self._medians([(d.vehicle_class, None) for d in self.drivers])

    @property
    def pairs(self) -> tuple[ClassMedians, ...]:
        """Medians of each class behind each class."""
        return self._medians([(d.vehicle_class, d.leader_class) for d in self.drivers])

    def headline(self) -> str:
        """Say how many drivers were calibrated, and for how many of them each parameter is identified."""
        held = ", ".join(f"{n} of {sum(d.fit.identified(n) for d in self.drivers)}" for n in self.estimated)
        total = sum(d.fit.log_likelihood for d in self.drivers)
        few = ""
        if self.brief:
            few = f"; {self.left_out} follow for less than {LEAST_FOLLOWING_S:g} s, with the parameters of their class"
        return f"{len(self.drivers)} drivers on tracks, log-likelihood {total:.1f}; identified: {held}{few}"

    def records(self) -> list[dict[str, Any]]:
        """List the drivers, as ``Calibration.records``, with what tracks say of them."""
        return [
            {
                "recording": d.recording,
                "vehicle": d.vehicle,
                "class": d.vehicle_class,
                "stretches": d.stretches,
                "following_s": d.following_s,
                **{
                    column: value
                    for name in self.estimated
                    for column, value in (
                        (name, float(d.fit.parameters[index(name)])),
                        (f"{name}_std", float(d.fit.std[index(name)])),
                        (f"{name}_low", float(d.fit.interval[index(name), 0])),
                        (f"{name}_high", float(d.fit.interval[index(name), 1])),
                        (f"{name}_identified", d.fit.identified(name)),
                    )
                },
                "log_likelihood": d.fit.log_likelihood,
                "nis": d.nis,
            }
            for d in self.drivers
        ]

    def document(self, wall_s: float) -> dict[str, Any]:
        """Collect all results in plain types and SI units, for ``--json``; infinite standard errors are None."""
        drivers = []
        for d in self.drivers:
            std = {n: float(d.fit.std[index(n)]) for n in self.estimated}
            drivers.append(
                {
                    "recording": d.recording,
                    "vehicle": d.vehicle,
                    "class": d.vehicle_class,
                    "stretches": d.stretches,
                    "following_s": d.following_s,
                    **{n: float(d.fit.parameters[index(n)]) for n in self.estimated},
                    "log_likelihood": d.fit.log_likelihood,
                    "nis": d.nis if math.isfinite(d.nis) else None,
                    "std": dict(zip(std, _finite(np.array(list(std.values()))), strict=True)),
                    "interval": {n: _finite(d.fit.interval[index(n)]) for n in self.estimated},
                    "identified": {n: d.fit.identified(n) for n in self.estimated},
                }
            )
        total = float(sum(d.fit.log_likelihood for d in self.drivers))
        return {
            "formulation": "causal",
            "drivers": drivers,
            "left_out": self.left_out,
            "brief_drivers": [self._brief(d) for d in self.brief],
            "classes": {one.vehicle_class: dict(one.medians) for one in self.classes},
            "class_pairs": [
                {"class": one.vehicle_class, "leader_class": one.leader_class, "drivers": one.drivers, **one.medians}
                for one in self.pairs
            ],
            "log_likelihood": total,
            "wall_s": wall_s,
        }

    def table(self) -> TextTable:
        """Make a table of each driver's parameters, and of the medians over classes and over pairs of classes."""
        rows = []
        for d in self.drivers:
            cells = [self._cell(d.fit, n) for n in self.estimated]
            name = f"{d.recording} {d.vehicle}".strip()
            rows.append((name, d.vehicle_class, f"{d.following_s:.0f}", *cells, f"{d.nis:.2f}"))
        pairs = self.pairs if len({one.leader_class for one in self.pairs} - {""}) > 1 else ()
        for one in (*self.classes, *pairs):
            cells = ["" if (m := one.medians[n]) is None else f"{m:.3g}" for n in self.estimated]
            rows.append((f"median of {one.drivers}", one.shown, "", *cells, ""))
        for few in self.brief:
            cells = [f"{few.parameters[index(n)]:.3g} (of the class)" for n in self.estimated]
            name = f"{few.recording} {few.vehicle}".strip()
            rows.append((name, few.vehicle_class, f"{few.following_s:.0f}", *cells, f"{few.nis:.2f}"))
        headings = ("vehicle", "class", "following [s]", *map(ROW.heading, self.estimated), "NIS")
        return TextTable("Calibration on tracks", headings, tuple(rows), left=2)

    def draw(self, figure: "Figure") -> None:
        """Draw each estimated parameter over the time that the driver follows; open circles are not identified."""
        axes = figure.subplots(len(self.estimated), 1, sharex=True, squeeze=False)[:, 0]
        for one, name in zip(axes, self.estimated, strict=True):
            for d in self.drivers:
                face = BLUE if d.fit.identified(name) else "none"
                one.plot(d.following_s, d.fit.parameters[index(name)], "o", color=BLUE, mfc=face, ms=4)
            one.set(ylabel=f"{name} [{PARAMETERS[index(name)].unit}]")
        axes[-1].set(xlabel="following [s]")

    def _cell(self, fit: Fit, name: str) -> str:
        k = index(name)
        known = "{:.3g} to {:.3g}".format(*fit.interval[k]) if self.profiled else f"± {fit.std[k]:.2g}"
        return f"{fit.parameters[k]:.3g} {known}" if fit.identified(name) else NOT_IDENTIFIED

    def _medians(self, groups: Sequence[tuple[str, str | None]]) -> tuple[ClassMedians, ...]:
        return medians_of(groups, [d.fit for d in self.drivers], self.estimated)

    def _brief(self, d: BriefDriver) -> dict[str, Any]:
        """What ``document`` says of a driver without own parameters."""
        return {
            "recording": d.recording,
            "vehicle": d.vehicle,
            "class": d.vehicle_class,
            "following_s": d.following_s,
            "parameters_of": "class",
            **{n: float(d.parameters[index(n)]) for n in self.estimated},
            "log_likelihood": d.log_likelihood,
            "nis": d.nis if math.isfinite(d.nis) else None,
        }


def calibrate_tracks(
    tracks: Tracks,
    estimated: Sequence[str] = (),
    *,
    profiled: bool = False,
    work: Executor | None = None,
    on_progress: OnProgress = lambda done, total: None,
) -> TracksCalibration:
    """Calibrate every driver who follows a known vehicle for long enough, with the causal formulation.

    Parameters
    ----------
    tracks : Tracks
        Tracks with leaders.
    estimated : sequence of str
        Names of the parameters to estimate; by default those of ``Evenness.estimated``.
    profiled : bool
        Whether the intervals come from the profile likelihood, which takes longer.
    work : Executor, optional
        Runs the searches; without an executor, the searches run one after the other.
    on_progress : callable
        Called after each fit with the number of finished fits and the number of all fits.

    Returns
    -------
    TracksCalibration
        The calibrated drivers.

    Raises
    ------
    InputError
        For an unknown parameter, or if no driver follows a known vehicle for long enough.
    """
    tracks = on_time_base(tracks)
    found = followers(tracks)
    even, speed = evenness_on(found.every, found.decisions), fastest_on(found.every, found.decisions)
    names = tuple(estimated) or even.estimated()
    places = np.array([index(name) for name in names])
    options = SearchOptions(profiled=profiled)
    search = Job(0, even.typical(speed), places, lower_bounds(even), upper_bounds(speed), options)
    fits = _passes(tracks, found.enough, search, names, work, on_progress)
    drivers = []
    for own, (fit, nis) in zip(found.enough, fits, strict=True):
        who = own[0].stretch
        counts = len(own), following_s(own), fit, nis, leader_class(tracks, own)
        drivers.append(CalibratedDriver(who.recording, who.vehicle, who.vehicle_class, *counts))
    ahead = DriversAhead(tracks, search.start).of(found.enough, [d.fit for d in drivers], names)
    few = [own for own in found.few if following_s(own) > 0.0]
    brief = [brief_driver(own, ahead.of_class(own[0].stretch.vehicle_class), ahead(own)) for own in few]
    return TracksCalibration(names, tuple(drivers), tuple(brief), profiled)


def _passes(
    tracks: Tracks,
    drivers: Sequence[Sequence[Drive]],
    search: Job,
    names: Sequence[str],
    work: Executor | None,
    on_progress: OnProgress,
) -> list[tuple[Fit, float]]:
    """Make both passes; returns the fit and the mean of the squared normalised innovations of each driver.

    search: the search of the second pass, from a typical driver and without data.
    """
    typical, total = search.start, 2 * len(drivers)
    start = typical.copy()
    start[SIGMA_A] = START_SIGMA_A
    quick = replace(search, start=start, options=SearchOptions(with_errors=False))
    ahead, first = DriversAhead(tracks, typical), []
    for fit in in_turn(carry_out, (_job(quick, k, own, ahead) for k, own in enumerate(drivers)), work):
        first.append(fit)
        on_progress(len(first), total)
    ahead, second = ahead.of(drivers, first, names), []
    searches = (replace(search, start=fit.parameters) for fit in first)
    jobs = (_job(one, k, own, ahead) for k, (one, own) in enumerate(zip(searches, drivers, strict=True)))
    for found in in_turn(_with_nis, jobs, work):
        second.append(found)
        on_progress(total // 2 + len(second), total)
    return second


def _job(search: Job, number: int, own: Sequence[Drive], ahead: DriversAhead) -> Job:
    """The search for a driver."""
    followed = DriverChains(tuple(d.chain for d in own), ahead(own), tuple(d.scored for d in own))
    return replace(search, vehicle=number, followed=followed)


def _with_nis(job: Job) -> tuple[Fit, float]:
    """Carry out a search; returns the fit and the mean of the squared normalised innovations."""
    fit, followed = carry_out(job), job.followed
    assert followed is not None
    innovation, variance, density = predicted(followed, [fit.parameters])[0]
    squares = (innovation**2 / variance)[np.isfinite(density)]
    return fit, float(squares.mean()) if len(squares) else float("nan")


def _finite(values: Array) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values.tolist()]
