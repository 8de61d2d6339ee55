"""Estimates compared with the truth, where the drivers of a recorded run were simulated."""

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.formats.truth import read_truth
from sugiyama_ros.page.recording import Recording
from sugiyama_ros.tables import TextTable
from sugiyama_ros.trajectories.truth import Truth

#: Parameters that are shown, with their units; others are in the document alone.
SHOWN = {"v_star": "m/s", "kappa_v": "s"}
# Half width of a 95 % interval, in standard deviations.
_WIDE = 1.96
_PARAMETERS, _ARRAY = "sugiyama_msgs/msg/DriverParameters", "sugiyama_msgs/msg/DriverArray"
_STYLE = "sugiyama_msgs/msg/StyleChange"


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

    parameters: all adapted parameters of all drivers at the end; coverage: share of the drivers whose 95 % interval
    holds the truth, by parameter; errors: root mean square errors of the estimated speed [m/s], acceleration [m/s^2]
    and gap [m]; the share of samples in which the 95 % interval of the speed holds the truth; changes: changes of
    parameters during the run; false_alarms: changes of style that an estimator told of, although the driver had not
    changed; collisions: vehicles that ran into their leader; the model has no meaning after that.
    """

    parameters: tuple[EstimateAgainstTruth, ...]
    coverage: dict[str, float]
    errors: dict[str, float]
    changes: tuple[TrueChange, ...]
    false_alarms: int
    collisions: int

    def table(self) -> TextTable:
        """Estimates and truth as a table, one row for each driver."""
        headings = ["vehicle"]
        for name, unit in SHOWN.items():
            headings += [f"{name} [{unit}]", "95 % interval", "truth"]
        of: defaultdict[int, dict[str, EstimateAgainstTruth]] = defaultdict(dict)
        for one in self.parameters:
            of[one.vehicle][one.name] = one
        rows = []
        for vehicle, known in sorted(of.items()):
            cells = [str(vehicle)]
            for name in SHOWN:
                found = known.get(name)
                if found is None:
                    cells += ["", "", ""]
                    continue
                cells += [f"{found.estimate:.3f}", f"{found.lower:.3f}-{found.upper:.3f}", f"{found.truth:.3f}"]
                cells[-1] += "" if found.covered else " !"
            rows.append(tuple(cells))
        return TextTable("Estimates against the truth (!: outside of the interval)", tuple(headings), tuple(rows))

    def lines(self) -> list[str]:
        """What else is to be said, in lines of text."""
        lines = [
            f"{name}: the 95 % interval holds the truth for {share:.0%} of the drivers"
            for name, share in self.coverage.items()
            if name in SHOWN
        ]
        e = self.errors
        if e:
            lines.append(
                f"errors: speed {e['speed_rmse']:.2f} m/s, acceleration {e['acceleration_rmse']:.2f} m/s^2, gap"
                f" {e['gap_rmse_m']:.2f} m; the 95 % interval of the speed holds the truth in"
                f" {e['speed_coverage']:.0%} of the samples"
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
    """Compare the estimates of a recorded run with the truth. Raises InputError."""
    truth = read_truth(path)
    if truth is None:
        return None
    last, told = _estimates(path)
    final: dict[int, dict[str, float]] = {}
    changes: list[tuple[float, int, str, float, float]] = []
    for drive in truth.drivers:
        before = final.get(drive.vehicle, {})
        for name, after in drive.parameters.items():
            if name in before and before[name] != after:
                changes.append((drive.time_s, drive.vehicle, name, before[name], after))
        final[drive.vehicle] = dict(drive.parameters)
    parameters = tuple(
        EstimateAgainstTruth(vehicle, e.name, final[vehicle][e.name], e.value, *_interval(e.value, e.var), e.identified)
        for vehicle, found in sorted(last.items())
        for e in found
        if e.name in final.get(vehicle, {})
    )
    names = dict.fromkeys(one.name for one in parameters)
    coverage = {name: float(np.mean([one.covered for one in parameters if one.name == name])) for name in names}
    touching = np.nan_to_num(truth.gap_m, nan=np.inf) <= 0.0
    began = touching & ~np.vstack([np.zeros_like(touching[:1]), touching[:-1]])
    return AgainstTruth(
        parameters,
        coverage,
        _errors(truth, recording) if recording is not None and recording.has_estimates else {},
        tuple(TrueChange(*change, _first_told(told, change)) for change in changes),
        sum(not any(v == vehicle and t <= time_s for t, v, *_ in changes) for time_s, vehicle, _ in told),
        int(began.sum()),
    )


class _Estimate(NamedTuple):
    """A parameter as an estimator knows it, with its variance."""

    name: str
    value: float
    var: float
    identified: bool


def _interval(value: float, var: float) -> tuple[float, float]:
    """A 95 % interval. Estimators know logarithms of parameters, so it is one of the logarithm."""
    wide = math.exp(_WIDE * math.sqrt(max(var, 0.0)) / value) if value > 0.0 else math.nan
    return value / wide, value * wide


def _first_told(told: Sequence[tuple[float, int, str]], change: tuple[float, int, str, float, float]) -> float:
    """Time [s] at which a change was first told; NaN if it was not."""
    time_s, vehicle, name, *_ = change
    return next((t for t, v, n in told if v == vehicle and n == name and t >= time_s), math.nan)


def _estimates(path: Path) -> tuple[dict[int, list[_Estimate]], list[tuple[float, int, str]]]:
    """The last estimates of each driver, and the changes of style that were told: time [s], vehicle, parameter."""
    last: dict[int, list[_Estimate]] = {}
    told: list[tuple[float, int, str]] = []
    with Bag(path) as bag:
        kinds = {topic.name: topic.type for topic in bag.info().topics if topic.count}
        wanted = {name for name, kind in kinds.items() if kind in (_PARAMETERS, _ARRAY, _STYLE)}
        for _, kind, _, m in bag.messages(wanted, skip_misfits=True) if wanted else ():
            if kind == _STYLE:
                told.append((m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec, int(m.vehicle), str(m.name)))
                continue
            try:
                last |= _of_driver(m) if kind == _PARAMETERS else _of_array(m)
            except ValueError:  # arrays of unequal length
                continue
    return last, told


def _of_driver(message: Any) -> dict[int, list[_Estimate]]:
    """The estimates of one driver."""
    count = len(message.name)
    variances = np.reshape(message.covariance, (count, count)).diagonal().tolist()
    every = zip(message.name, message.value.tolist(), variances, message.identified, message.estimated, strict=True)
    return {int(message.vehicle): [_Estimate(str(n), v, s, bool(i)) for n, v, s, i, is_known in every if is_known]}


def _of_array(message: Any) -> dict[int, list[_Estimate]]:
    """The estimates of all drivers in one message."""

    def each() -> Iterator[tuple[int, list[_Estimate]]]:
        estimated = [k for k, is_estimated in enumerate(message.estimated) if is_estimated]
        drivers = len(message.vehicle)
        value = np.reshape(message.value, (drivers, -1))[:, estimated]
        var = np.reshape(message.parameter_covariance, (drivers, len(estimated), -1)).diagonal(axis1=1, axis2=2)
        identified = np.reshape(message.identified, (drivers, -1))
        names = [str(message.name[k]) for k in estimated]
        for k, vehicle in enumerate(message.vehicle.tolist()):
            own = zip(names, value[k].tolist(), var[k].tolist(), identified[k].tolist(), strict=True)
            yield int(vehicle), [_Estimate(*one) for one in own]

    return dict(each())


def _errors(truth: Truth, r: Recording) -> dict[str, float]:
    """Errors of the estimated states, over all samples with a truth."""
    rows = np.round((truth.time_s - r.trajectories.start_s) / r.trajectories.period_s).astype(np.int64)
    here = (rows >= 0) & (rows < len(r.time_s))
    column = {int(v): k for k, v in enumerate(r.trajectories.vehicle)}
    both = [(k, column[int(v)]) for k, v in enumerate(truth.vehicle) if int(v) in column]
    true, ours = (np.array(part, dtype=np.int64) for part in zip(*both, strict=True))

    def off(name: str, of: Array) -> Array:
        return np.asarray(r.series[name][np.ix_(rows[here], ours)] - of[np.ix_(here, true)])

    def rms(values: Array) -> float:
        known = values[np.isfinite(values)]
        return float(np.sqrt(np.mean(np.square(known)))) if len(known) else math.nan

    speed = off("speed", truth.speed)
    std = r.series["speed_std"][np.ix_(rows[here], ours)]
    known = np.isfinite(speed) & (std > 0.0)
    with np.errstate(invalid="ignore"):  # without a leader, both gaps are infinite
        gap = off("gap_m", truth.gap_m)
    return {
        "speed_rmse": rms(speed),
        "acceleration_rmse": rms(off("acceleration", truth.acceleration)),
        "gap_rmse_m": rms(gap),
        "speed_coverage": float(np.mean(np.abs(speed[known]) <= _WIDE * std[known])) if known.any() else math.nan,
    }
