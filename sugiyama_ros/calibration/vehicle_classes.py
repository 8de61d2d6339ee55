"""Classes of vehicles on tracks: what drivers of a class have in common, and drivers who are recorded too briefly.

A driver who follows for less than ``LEAST_FOLLOWING_S`` says too little about parameters of their own. The parameters
of the driver's class of vehicles then stand for theirs.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import index
from sugiyama_ros.filters.causal import ChainJob, predict_samples
from sugiyama_ros.filters.extract import Drive
from sugiyama_ros.fit.driver import Fit
from sugiyama_ros.trajectories.tracks import Tracks


@dataclass(frozen=True, eq=False)
class BriefDriver:
    """A driver who follows too briefly for parameters of their own, with the parameters of the class.

    recording, vehicle, vehicle_class: who drives; empty where the tracks do not say; following_s: time [s] that counts;
    parameters: (P,), parameters of the class; log_likelihood: log-likelihood of the driver's samples with these
    parameters [nats]; nis: mean of the squared normalised innovations with these parameters.
    """

    recording: str
    vehicle: str
    vehicle_class: str
    following_s: float
    parameters: Array
    log_likelihood: float
    nis: float


@dataclass(frozen=True)
class ClassMedians:
    """What drivers of a class, or of a class behind another class, have in common.

    vehicle_class: class of the drivers' vehicles; leader_class: class of the vehicles ahead; none for all of them;
    drivers: number of drivers; medians: median of each estimated parameter, over the drivers for whom it is identified;
    none without any.
    """

    vehicle_class: str
    leader_class: str | None
    drivers: int
    medians: Mapping[str, float | None]

    @property
    def shown(self) -> str:
        """Name in tables."""
        own = self.vehicle_class or "all"
        return own if self.leader_class is None else f"{own} behind {self.leader_class or 'unknown'}"


def leader_class(tracks: Tracks, own: Sequence[Drive]) -> str:
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


def medians_of(
    groups: Sequence[tuple[str, str | None]], fits: Sequence[Fit], estimated: Sequence[str]
) -> tuple[ClassMedians, ...]:
    """Return the medians of each group of drivers."""
    found = []
    for group in sorted(set(groups), key=lambda one: (one[0], one[1] or "")):
        own = [fit for fit, of in zip(fits, groups, strict=True) if of == group]
        medians: dict[str, float | None] = {}
        for name in estimated:
            known = [float(fit.parameters[index(name)]) for fit in own if fit.identified(name)]
            medians[name] = float(np.median(known)) if known else None
        found.append(ClassMedians(group[0], group[1], len(own), medians))
    return tuple(found)


def rows_of_classes(classes: Sequence[ClassMedians], everybody: ClassMedians, typical: Array) -> Callable[[str], Array]:
    """Return what gives the parameters (P,) of a class of vehicles.

    typical: (P,), parameters for what nobody tells, and for what was not estimated.
    """

    def row_of(*sources: ClassMedians) -> Array:
        row = typical.copy()
        for source in sources:
            for name, median in source.medians.items():
                row[index(name)] = row[index(name)] if median is None else median
        return row

    rows, others = {one.vehicle_class: row_of(everybody, one) for one in classes}, row_of(everybody)
    return lambda kind: rows.get(kind, others)


def brief_driver(own: Sequence[Drive], row: Array, ahead: Sequence[Array]) -> BriefDriver:
    """Give a driver who follows too briefly the parameters of the class.

    row: (P,), parameters of the class; ahead: (M - 1, P), parameters of the drivers ahead on each stretch.
    """
    squares, densities, samples = [], [], 0
    jobs = [ChainJob(d.chain, row, rows) for d, rows in zip(own, ahead, strict=True)]
    for drive, predicted in zip(own, predict_samples(jobs), strict=True):
        counts = drive.scored & np.isfinite(predicted.log_likelihood)
        squares.append((predicted.innovation**2 / predicted.innovation_var)[counts])
        densities.append(predicted.log_likelihood[counts])
        samples += int((drive.scored & (drive.chain.identity[:, 1] >= 0)).sum())
    normal, who = np.concatenate(squares), own[0].stretch
    return BriefDriver(
        recording=who.recording,
        vehicle=who.vehicle,
        vehicle_class=who.vehicle_class,
        following_s=samples * own[0].chain.period_s,
        parameters=row,
        log_likelihood=float(np.concatenate(densities).sum()),
        nis=float(normal.mean()) if len(normal) else float("nan"),
    )
