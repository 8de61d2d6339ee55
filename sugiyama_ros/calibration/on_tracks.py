"""Calibration on tracks: vehicles that come and go, on several lanes, with leaders that change or are not known.

A driver's likelihood is the sum over the stretches in which the driver follows a known vehicle. Samples around the
driver's own lane changes do not count. There are two passes: in the first, drivers ahead count as typical
drivers; in the second, they have the parameters that the first pass found, or those of their class.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.calibration.result import (
    CalibratedDriver,
    Calibration,
    ClassMedians,
    Settings,
    medians_of,
    of_fits,
)
from sugiyama_ros.driver.parameters import SIGMA_A, index
from sugiyama_ros.filters.extract import Drive
from sugiyama_ros.fit.coordinates import lower_bounds, upper_bounds
from sugiyama_ros.fit.driver import (
    START_SIGMA_A,
    DriverChains,
    Fit,
    Job,
    SearchOptions,
    carry_out,
    most_seen,
    predicted,
)
from sugiyama_ros.fit.preparation import evenness_on, fastest_on, followers, following_s, run_of
from sugiyama_ros.progress import OnProgress
from sugiyama_ros.trajectories.dense import numbers_of
from sugiyama_ros.trajectories.time_base import on_time_base
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.workers import ordered_map

# The parameters are those that suit the recording.
_USUAL = Settings(estimated=())


def calibrate_tracks(
    tracks: Tracks,
    settings: Settings = _USUAL,
    work: Executor | None = None,
    on_progress: OnProgress = lambda done, total: None,
) -> Calibration:
    """Calibrate every driver who follows a known vehicle for long enough, with the causal formulation.

    Parameters are by default those that ``Evenness.estimated`` returns. Raises InputError.
    """
    tracks = on_time_base(tracks)
    found = followers(tracks)
    even, speed = evenness_on(found.every, found.decisions), fastest_on(found.every, found.decisions)
    settings = replace(settings, estimated=settings.estimated or even.estimated())
    places = np.array([index(name) for name in settings.estimated])
    options = SearchOptions(profiled=settings.profiled)
    search = Job(0, even.typical(speed), places, lower_bounds(even), upper_bounds(speed), options)
    fits, nis = _passes(tracks, found.enough, search, settings.estimated, work, on_progress)
    numbers = numbers_of(tracks)
    drivers = [_who(tracks, numbers, own, one) for own, one in zip(found.enough, nis, strict=True)]
    return of_fits(settings, drivers, fits, tracks.about)


def _quick(search: Job) -> Job:
    """The search without errors, from several starts with a larger acceleration noise."""
    start = search.start.copy()
    start[SIGMA_A] = START_SIGMA_A
    return replace(search, start=start, options=SearchOptions(with_errors=False, from_several=True))


class _DriversAhead:
    """Parameters of the drivers ahead.

    typical: (P,), parameters of a driver of whom nothing is known; known: (P,), parameters of calibrated drivers by
    recording and vehicle; classes: medians of classes of vehicles, and of everybody first.
    """

    def __init__(
        self,
        tracks: Tracks,
        typical: Array,
        known: Mapping[tuple[str, str], Array] = MappingProxyType({}),
        classes: Sequence[ClassMedians] = (),
    ) -> None:
        self._tracks, self._typical, self._known, self._classes = tracks, typical, known, classes

    def of(self, drivers: Sequence[Sequence[Drive]], fits: Sequence[Fit], estimated: Sequence[str]) -> "_DriversAhead":
        """Return the parameters of calibrated drivers, and of their classes."""
        stretches = [own[0].stretch for own in drivers]
        known = {(one.recording, one.vehicle): fit.parameters for one, fit in zip(stretches, fits, strict=True)}
        rows = np.array([fit.parameters for fit in fits])
        identified = [{name: fit.identified(name) for name in estimated} for fit in fits]
        groups = [[("", None)] * len(fits), [(one.vehicle_class, None) for one in stretches]]
        classes = [one for group in groups for one in medians_of(group, rows, identified)]
        return _DriversAhead(self._tracks, self._typical, known, classes)

    def __call__(self, own: Sequence[Drive]) -> tuple[Array, ...]:
        """Return the parameters (M - 1, P) of the vehicles that are ahead in most samples of each stretch."""
        return tuple(np.array([self._row(most_seen(one)) for one in d.chain.identity[:, 1:].T]) for d in own)

    def of_class(self, kind: str) -> Array:
        """Return the parameters (P,) of a class: its medians, or else everybody's, or else the typical ones."""
        row = self._typical.copy()
        for number, one in enumerate(self._classes):
            for name, median in one.medians.items() if number == 0 or one.vehicle_class == kind else ():
                row[index(name)] = row[index(name)] if median is None else median
        return row

    def _row(self, run: int) -> Array:
        if run < 0:
            return self._typical
        row, tracks = int(self._tracks.start[run]), self._tracks
        kind = "" if tracks.vehicle_class is None else tracks.vehicle_class.at(row)
        known = self._known.get((tracks.recording.at(row), tracks.vehicle.at(row)))
        return self.of_class(kind) if known is None else known


def _passes(
    tracks: Tracks,
    drivers: Sequence[Sequence[Drive]],
    search: Job,
    names: Sequence[str],
    work: Executor | None,
    on_progress: OnProgress,
) -> tuple[list[Fit], list[float]]:
    """Make both passes; ``search``: the search of the second pass, from a typical driver and without data.

    Returns the fits, and the mean of the squared normalised innovations of each driver.
    """
    total, quick = 2 * len(drivers), _quick(search)
    ahead, first = _DriversAhead(tracks, search.start), []
    for fit in ordered_map(carry_out, (_job(quick, k, own, ahead) for k, own in enumerate(drivers)), work):
        first.append(fit)
        on_progress(len(first), total)
    ahead, second = ahead.of(drivers, first, names), []
    searches = (replace(search, start=fit.parameters) for fit in first)
    jobs = (_job(one, k, own, ahead) for k, (one, own) in enumerate(zip(searches, drivers, strict=True)))
    for found in ordered_map(_with_nis, jobs, work):
        second.append(found)
        on_progress(total // 2 + len(second), total)
    return [fit for fit, _ in second], [nis for _, nis in second]


def _job(search: Job, number: int, own: Sequence[Drive], ahead: _DriversAhead) -> Job:
    return replace(search, vehicle=number, followed=_chains(own, ahead))


def _chains(own: Sequence[Drive], ahead: _DriversAhead) -> DriverChains:
    return DriverChains(tuple(d.chain for d in own), ahead(own), tuple(d.scored for d in own))


def _with_nis(job: Job) -> tuple[Fit, float]:
    """Carry out a search; returns the fit and the mean of the squared normalised innovations."""
    fit, followed = carry_out(job), job.followed
    assert followed is not None
    return fit, _summary(followed, fit.parameters)[0]


def _summary(followed: DriverChains, row: Array) -> tuple[float, float]:
    """Mean of a driver's squared normalised innovations, and the log-likelihood, with the parameters ``row``."""
    innovation, variance, density = predicted(followed, [row])[0]
    counts = np.isfinite(density)
    squares = (innovation**2 / variance)[counts]
    return float(squares.mean()) if len(squares) else float("nan"), float(density[counts].sum())


def _who(tracks: Tracks, numbers: Ints, own: Sequence[Drive], nis: float) -> CalibratedDriver:
    who = own[0].stretch
    return CalibratedDriver(
        vehicle=who.vehicle,
        number=int(numbers[run_of(own)]),
        recording=who.recording,
        vehicle_class=who.vehicle_class,
        leader_class=_leader_class(tracks, own),
        stretches=len(own),
        following_s=following_s(own),
        nis=nis,
    )


def _leader_class(tracks: Tracks, own: Sequence[Drive]) -> str:
    """Return the class of the vehicle ahead of a driver in most scored samples; empty where it is not known."""
    if tracks.vehicle_class is None:
        return ""
    seen: Counter[str] = Counter()
    for drive in own:
        runs, counts = np.unique(drive.chain.identity[drive.scored, 1], return_counts=True)
        for run, count in zip(runs.tolist(), counts.tolist(), strict=True):
            if run >= 0:
                seen[tracks.vehicle_class.at(int(tracks.start[run]))] += count
    return seen.most_common(1)[0][0] if seen else ""
