"""A recorded run as arrays over samples and vehicles."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.formats.registry import read_trajectories
from sugiyama_ros.plots import space_time
from sugiyama_ros.results import Result
from sugiyama_ros.trajectories.trajectories import Trajectories

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
# Parameters that the page shows over time.
_ADAPTED = ("v_star", "v_star_std", "kappa_v", "kappa_v_std")


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

    def draw(self, figure: "Figure") -> None:
        """Draw the measured positions over time, coloured by the estimated speed."""
        space_time(figure, self.time_s, self.trajectories.position_m, self.series["speed"])

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
