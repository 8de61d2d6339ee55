"""What estimators learnt of simulated drivers, against the truth."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.formats.truth import read_truth
from sugiyama_ros.page.names import parameter_title
from sugiyama_ros.page.recording import Recording, StyleChanged, is_of_law, read_recording
from sugiyama_ros.results import TextTable
from sugiyama_ros.trajectories.truth import Truth

# Half width of a 95 % interval, in standard deviations.
_WIDE = 1.96


@dataclass(frozen=True)
class EstimateAgainstTruth:
    """One parameter of one driver at the end of a run: the estimate, its 95 % interval, and the truth; SI units."""

    vehicle: int
    name: str
    truth: float
    estimate: float
    lower: float
    upper: float
    identified: bool

    @property
    def covered(self) -> bool:
        """Whether the truth is within the interval."""
        return self.lower <= self.truth <= self.upper


@dataclass(frozen=True)
class TrueChange:
    """A change of a driver's parameter while they drove, and when the estimator told of it; NaN if it did not."""

    time_s: float
    vehicle: int
    name: str
    before: float
    after: float
    told_s: float


@dataclass(frozen=True)
class AgainstTruth:
    """Estimates of a run compared with the truth.

    parameters: all parameters that were learnt of all drivers, at the end; coverage: share of the drivers whose 95 %
    interval holds the truth, by parameter; errors: root mean square errors of the estimated speed [m/s], acceleration
    [m/s^2] and gap [m]; the share of samples in which the 95 % interval of the speed holds the truth; changes: changes
    of parameters during the run; false_alarms: changes of style that an estimator told of, although the driver had not
    changed; collisions: vehicles that ran into their leader; the model has no meaning after that.
    """

    parameters: tuple[EstimateAgainstTruth, ...]
    coverage: dict[str, float]
    errors: dict[str, float]
    changes: tuple[TrueChange, ...]
    false_alarms: int
    collisions: int

    @property
    def names(self) -> list[str]:
        """Parameters of the law; those of noises are in the document alone."""
        return list(filter(is_of_law, self.coverage))

    def of(self, name: str) -> dict[int, EstimateAgainstTruth]:
        """Return the estimates of one parameter, by vehicle."""
        return {one.vehicle: one for one in self.parameters if one.name == name}

    def table(self) -> TextTable:
        """Estimates and truth as a table, one row for each driver."""
        known = {name: self.of(name) for name in self.names}
        headings = ["vehicle"]
        for name in known:
            headings += [ROW.heading(name), "95 % interval", "truth"]
        rows = []
        for vehicle in sorted({one.vehicle for one in self.parameters}):
            cells = [str(vehicle)]
            for one in (of.get(vehicle) for of in known.values()):
                if one is None:
                    cells += ["", "", ""]
                    continue
                outside = "" if one.covered else " !"
                cells += [f"{one.estimate:.3f}", f"{one.lower:.3f}-{one.upper:.3f}", f"{one.truth:.3f}{outside}"]
            rows.append(tuple(cells))
        return TextTable("Estimates against the truth (!: outside of the interval)", tuple(headings), tuple(rows))

    def lines(self) -> list[str]:
        """What else is to be said, in lines of text."""
        holds = "the 95 % interval holds the truth"
        lines = [f"{parameter_title(n)} ({n}): {holds} for {self.coverage[n]:.0%} of the drivers" for n in self.names]
        if e := self.errors:
            lines.append(
                f"errors: speed {e['speed_rmse']:.2f} m/s, acceleration {e['acceleration_rmse']:.2f} m/s², gap"
                f" {e['gap_rmse_m']:.2f} m; for the speed, {holds} in {e['speed_coverage']:.0%} of the samples"
            )
        for c in self.changes:
            told = f"told {c.told_s - c.time_s:.1f} s later" if math.isfinite(c.told_s) else "not told"
            lines.append(f"vehicle {c.vehicle}: {c.name} {c.before:.3g} to {c.after:.3g} at {c.time_s:.1f} s: {told}")
        if self.false_alarms:
            lines.append(f"{self.false_alarms} changes of style told of drivers who had not changed")
        if self.collisions:
            lines.append(f"{self.collisions} collisions: the model has no meaning after the first")
        return lines


def against_truth(path: Path, recording: Recording | None = None) -> AgainstTruth | None:
    """Compare a recorded run with the truth; None if the bag does not say it. Raises InputError.

    recording: the run, if it has been read already.
    """
    truth = read_truth(path)
    if truth is None:
        return None
    r = recording or read_recording(path)
    final: dict[int, Mapping[str, float]] = {}
    changes = []
    for drive in truth.drivers:
        for name, before in final.get(drive.vehicle, {}).items():
            after = drive.parameters.get(name, before)
            if after != before:
                told_s = _first_told(r.changes, drive.vehicle, name, drive.time_s)
                changes.append(TrueChange(drive.time_s, drive.vehicle, name, before, after, told_s))
        final[drive.vehicle] = drive.parameters
    parameters = tuple(_estimates(r, final))
    names = dict.fromkeys(one.name for one in parameters)
    touching = np.nan_to_num(truth.gap_m, nan=np.inf) <= 0.0
    began = touching & ~np.vstack([np.zeros_like(touching[:1]), touching[:-1]])
    return AgainstTruth(
        parameters,
        {name: float(np.mean([one.covered for one in parameters if one.name == name])) for name in names},
        _errors_of_states(truth, r) if r.has_estimates else {},
        tuple(changes),
        sum(not any(c.vehicle == told.vehicle and c.time_s <= told.time_s for c in changes) for told in r.changes),
        int(began.sum()),
    )


def _estimates(r: Recording, final: Mapping[int, Mapping[str, float]]) -> list[EstimateAgainstTruth]:
    """What was learnt of each driver at the end; a 95 % interval is one of the logarithm, which estimators know."""
    found = []
    ends = {name: (r.at_end(name), r.at_end(f"{name}_std"), is_known) for name, is_known in r.identified.items()}
    for k, vehicle in enumerate(r.trajectories.vehicle.tolist()):
        for name, (value, std, is_known) in ends.items():
            if name in final.get(vehicle, {}) and np.isfinite(value[k]):
                estimate = float(value[k])
                wide = math.exp(_WIDE * float(std[k]) / estimate) if estimate > 0.0 else math.nan
                interval = estimate / wide, estimate * wide
                true = float(final[vehicle][name])
                found.append(EstimateAgainstTruth(vehicle, name, true, estimate, *interval, bool(is_known[k])))
    return found


def _first_told(told: Sequence[StyleChanged], vehicle: int, name: str, since_s: float) -> float:
    """Time [s] at which a change was first told; NaN if it was not."""
    times = (one.time_s for one in told if (one.vehicle, one.name) == (vehicle, name) and one.time_s >= since_s)
    return next(times, math.nan)


def _errors_of_states(truth: Truth, r: Recording) -> dict[str, float]:
    """Errors of the estimated states, over all samples with a truth."""
    rows = np.round((truth.time_s - r.trajectories.start_s) / r.trajectories.period_s).astype(np.int64)
    here = (rows >= 0) & (rows < len(r.time_s))
    _, true, ours = np.intersect1d(truth.vehicle, r.trajectories.vehicle, return_indices=True)

    def estimated(name: str) -> Array:
        return np.asarray(r.series[name][np.ix_(rows[here], ours)])

    def rms(name: str, of: Array) -> float:
        with np.errstate(invalid="ignore"):  # without a leader, both gaps are infinite
            off = estimated(name) - of[np.ix_(here, true)]
        known = off[np.isfinite(off)]
        return float(np.sqrt(np.mean(np.square(known)))) if len(known) else math.nan

    off, std = estimated("speed") - truth.speed[np.ix_(here, true)], estimated("speed_std")
    known = np.isfinite(off) & (std > 0.0)
    return {
        "speed_rmse": rms("speed", truth.speed),
        "acceleration_rmse": rms("acceleration", truth.acceleration),
        "gap_rmse_m": rms("gap_m", truth.gap_m),
        "speed_coverage": float(np.mean(np.abs(off[known]) <= _WIDE * std[known])) if known.any() else math.nan,
    }
