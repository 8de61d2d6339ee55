"""A recorded run as arrays over samples and vehicles, and its estimates against the truth of simulated drivers."""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.formats.registry import read_trajectories
from sugiyama_ros.formats.truth import read_truth
from sugiyama_ros.results import Result, TextTable, space_time
from sugiyama_ros.trajectories.trajectories import Trajectories
from sugiyama_ros.trajectories.truth import Truth

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

_FIELDS = {
    "state": ("speed", "acceleration", "mean_action", "gap_m", "approach_rate"),
    "innovation": ("innovation_m", "innovation_var", "nis", "scored"),
}
# What a message is about, by its type. Where all drivers are in one message, the fields of the other two are arrays.
_KINDS = {
    "sugiyama_msgs/msg/VehicleState": "state",
    "sugiyama_msgs/msg/Innovation": "innovation",
    "sugiyama_msgs/msg/DriverArray": "drivers",
    "sugiyama_msgs/msg/Verdict": "verdict",
    "sugiyama_msgs/msg/DriverParameters": "parameters",
    "sugiyama_msgs/msg/StyleChange": "change",
    "sugiyama_msgs/msg/DriverType": "type",
    "sugiyama_msgs/msg/TrueParameters": "truth",
}
#: Source of what the package simulates.
SIMULATED = "adaptiveSeek"
# Parameters that the page shows over time.
_ADAPTED = ("v_star", "v_star_std", "kappa_v", "kappa_v_std")


def name_of(source: str) -> str:
    """Name of a source: the file, or that drivers were simulated."""
    return "Simulated drivers" if source == SIMULATED else source


class StyleChanged(NamedTuple):
    """A driver has changed style at a time [s]: a parameter was multiplied by a factor."""

    time_s: float
    vehicle: int
    name: str
    factor: float


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Result):
    """A recorded run: T samples of N vehicles, and K verdicts of the critic.

    Attributes
    ----------
    trajectories : Trajectories
        Measured positions.
    time_s : array (T,)
        Time of each sample [s].
    series : dict of arrays (T, N)
        What the estimators published, in SI units; NaN where nothing was published. Names: speed, speed_std,
        acceleration, mean_action, gap_m, approach_rate, innovation_m, innovation_var, nis, scored, and the parameters
        v_star, v_star_std, kappa_v, kappa_v_std.
    verdict_s : array (K,)
        Time of each verdict [s].
    weights : dict of arrays (K,)
        Posterior probability of each model; NaN while the critic has no such model, as after its effect was added.
    added : tuple of str
        Effects that the estimators had at the end, as the critic heard; empty without a critic.
    changes : tuple of StyleChanged
        Changes of style, in the order in which they were published.
    types : dict of arrays (C,)
        Probabilities that a driver belongs to each class, at the end, by vehicle; empty without classes.
    truth : dict of dict
        True parameters of simulated drivers, by vehicle and name; empty where the bag does not say them.
    path : Path, optional
        The bag.
    model : str
        Model file that the estimators started from; empty without one.
    """

    trajectories: Trajectories
    time_s: Array
    series: dict[str, Array]
    verdict_s: Array
    weights: dict[str, Array]
    changes: tuple[StyleChanged, ...] = ()
    types: dict[int, Array] = field(default_factory=dict)
    truth: dict[int, dict[str, float]] = field(default_factory=dict)
    added: tuple[str, ...] = ()
    path: Path | None = None
    model: str = ""

    def headline(self) -> str:
        """Say what was recorded, and how large the one-step errors are."""
        if not self.has_estimates:
            return f"{self.trajectories.headline()}; no estimates"
        error = float(np.sqrt(np.mean(np.square(self.error_by_driver))))
        return f"{self.trajectories.headline()}; one-step error {error:.3f} m"

    def records(self) -> list[dict[str, Any]]:
        """List all samples of all vehicles: the measured position [m] and what was published; SI units."""
        t = self.trajectories
        return [
            {
                "time_s": time,
                "vehicle": vehicle,
                "position_m": float(t.position_m[k, i]),
                **{name: float(values[k, i]) for name, values in self.series.items()},
            }
            for k, time in enumerate(self.time_s.tolist())
            for i, vehicle in enumerate(t.vehicle.tolist())
        ]

    def draw(self, figure: "Figure | SubFigure") -> None:
        """Draw the measured positions over time, coloured by the estimated speed."""
        space_time(figure, self.time_s, self.trajectories.position_m, self.series["speed"])

    @property
    def is_simulated(self) -> bool:
        """Whether drivers of the package's simulator were recorded."""
        return bool(self.truth) or self.trajectories.source == SIMULATED

    @property
    def name(self) -> str:
        """Name of what was recorded: the file, or that drivers were simulated."""
        return name_of(self.trajectories.source) or "recording"

    @property
    def has_estimates(self) -> bool:
        """Whether estimators have run."""
        return bool(np.isfinite(self.series["speed"]).any())

    @property
    def error_by_driver(self) -> Array:
        """Root mean square (N,) of the one-step errors [m]; 0 for a driver without any."""
        y = np.where(self.series["scored"] > 0.0, self.series["innovation_m"], np.nan)
        known = np.isfinite(y)
        mean = np.square(np.where(known, y, 0.0)).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        return np.asarray(np.sqrt(mean), dtype=np.float64)

    @property
    def followers(self) -> Mask:
        """Whether (N,) something was learnt of a driver: there are errors, and there was a leader."""
        return np.asarray((self.error_by_driver > 0.0) & (self.trajectories.leader >= 0).any(axis=0))


def read_recording(path: Path) -> Recording:
    """Read a bag that `sugiyama run` recorded, or a file of trajectories in a bag. Raises InputError."""
    t = read_trajectories(path, None)
    reading = _Reading(t)
    with Bag(path) as bag:
        model = bag.info().metadata.get("sugiyama", {}).get("model", "")
        wanted = {topic.name for topic in bag.info().topics if topic.type in _KINDS}
        for _, type_name, _, message in bag.messages(wanted, skip_misfits=True) if wanted else ():
            reading.take(_KINDS[type_name], message)
    for values in (reading.series[name] for name in _ADAPTED):
        _hold(values)
        values[~_learnt(t.position_m, reading.series["scored"])] = np.nan
    return Recording(
        t,
        np.asarray(t.start_s + np.arange(len(t.position_m)) * t.period_s, dtype=np.float64),
        reading.series,
        np.array(reading.verdict_s),
        reading.weights(),
        tuple(reading.changes),
        {v: np.array(p) for v, p in sorted(reading.types.items())},
        dict(sorted(reading.truth.items())),
        reading.added,
        path,
        model,
    )


def preferred(weights: Mapping[str, Array]) -> tuple[str, float]:
    """Return the model that a critic prefers at the end, and by how many nats it leads the base model.

    weights: probability of each model, among them ``base``, at each verdict of the critic.
    """
    last = {name: float(np.nan_to_num(series[-1])) for name, series in weights.items()}
    best = max(last, key=lambda name: last[name])
    base = last.get("base", 0.0)
    return best, math.log(last[best] / base) if base > 0.0 else math.inf


class _Reading:
    """Enters the messages of a bag, one after another."""

    def __init__(self, trajectories: Trajectories) -> None:
        self._t = trajectories
        shape = trajectories.position_m.shape
        names = ["speed_std", *_ADAPTED, *(name for fields in _FIELDS.values() for name in fields)]
        self.series: dict[str, Array] = {name: np.full(shape, np.nan) for name in names}
        self._column = {int(v): k for k, v in enumerate(trajectories.vehicle)}
        self._verdicts: list[dict[str, float]] = []
        self.verdict_s: list[float] = []
        self.changes: list[StyleChanged] = []
        self.types: dict[int, list[float]] = {}
        self.truth: dict[int, dict[str, float]] = {}
        self.added: tuple[str, ...] = ()

    def take(self, kind: str, message: Any) -> None:
        """Enter one message."""
        time_s = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        if kind == "verdict":
            if len(message.model) == len(message.weight):
                self.verdict_s.append(time_s)
                self.added = tuple(map(str, message.added))
                self._verdicts.append(dict(zip(message.model, map(float, message.weight), strict=True)))
        elif kind == "drivers":
            self._take_all(self._step(time_s), message)
        elif int(message.vehicle) in self._column:
            self._take_one(kind, time_s, message)

    def weights(self) -> dict[str, Array]:
        """Probability of each model at each verdict; NaN while the critic has no such model."""
        names = dict.fromkeys(name for verdict in self._verdicts for name in verdict)
        return {name: np.array([verdict.get(name, np.nan) for verdict in self._verdicts]) for name in names}

    def _step(self, time_s: float) -> int | None:
        step = round((time_s - self._t.start_s) / self._t.period_s)
        return step if 0 <= step < len(self._t.position_m) else None

    def _take_one(self, kind: str, time_s: float, message: Any) -> None:
        """Enter what a message says of one driver."""
        vehicle, step = int(message.vehicle), self._step(time_s)
        k = self._column[vehicle]
        if kind == "change":
            self.changes.append(StyleChanged(time_s, vehicle, str(message.name), float(message.factor)))
        elif kind == "type":
            self.types[vehicle] = [float(p) for p in message.probability]
        elif kind == "truth":
            self.truth[vehicle] = dict(zip(message.name, map(float, message.value), strict=False))
        elif step is None:
            return
        elif kind == "parameters":
            names = list(message.name)
            covariance = np.asarray(message.covariance, dtype=np.float64)
            if len(covariance) == len(names) ** 2:
                std = np.sqrt(np.maximum(covariance.reshape(len(names), len(names)).diagonal(), 0.0))
                self._adapted(step, [k], names, np.array([message.value]), std[None])
        else:
            for name in _FIELDS[kind]:
                self.series[name][step, k] = getattr(message, name)
            if kind == "state":
                self.series["speed_std"][step, k] = np.sqrt(max(float(message.covariance[4]), 0.0))

    def _take_all(self, step: int | None, message: Any) -> None:
        """Enter what a message says of all drivers."""
        if step is None:
            return
        at = [k for k, vehicle in enumerate(message.vehicle.tolist()) if vehicle in self._column]
        columns = [self._column[vehicle] for vehicle in message.vehicle[at].tolist()]
        for name in (*_FIELDS["state"], *_FIELDS["innovation"]):
            self.series[name][step, columns] = getattr(message, name)[at]
        speed_var = message.state_covariance.reshape(-1, 9)[at, 4]
        self.series["speed_std"][step, columns] = np.sqrt(np.maximum(speed_var, 0.0))
        names, estimated = list(message.name), np.flatnonzero(message.estimated)
        value = message.value.reshape(-1, len(names))[at]
        covariance = message.parameter_covariance.reshape(-1, len(estimated), len(estimated))[at]
        std = np.zeros_like(value)
        std[:, estimated] = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
        self._adapted(step, columns, names, value, std)

    def _adapted(self, step: int, columns: list[int], names: list[str], value: Array, std: Array) -> None:
        """Enter the parameters that the page shows; value and std: (drivers, names)."""
        for name in ("v_star", "kappa_v"):
            if name in names:
                self.series[name][step, columns] = value[:, names.index(name)]
                self.series[f"{name}_std"][step, columns] = std[:, names.index(name)]


def _learnt(position_m: Array, scored: Array) -> Mask:
    """Where (T, N) a driver is on the road, or missing for a moment, who can be learnt from: who follows somebody."""
    seen = np.isfinite(position_m)
    here = np.logical_or.accumulate(seen, axis=0) & np.logical_or.accumulate(seen[::-1], axis=0)[::-1]
    follows = (scored > 0.0).any(axis=0)
    return np.asarray(here & (follows | ~follows.any()))


def _hold(values: Array) -> None:
    """Hold what was published once a second until it is published again, (T, N) in place."""
    latest = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values))[:, None], 0), axis=0)
    values[:] = np.take_along_axis(values, latest, axis=0)


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
        _errors_of_states(truth, recording) if recording is not None and recording.has_estimates else {},
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


def _errors_of_states(truth: Truth, r: Recording) -> dict[str, float]:
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
