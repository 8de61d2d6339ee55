"""A recorded run as arrays over samples and vehicles."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.driver.parameters import NAMES, UTILITY
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.laws.registry import LAWS
from sugiyama_ros.page.above import Above
from sugiyama_ros.results import Result, space_time
from sugiyama_ros.trajectories.about import SIMULATED
from sugiyama_ros.trajectories.dense import DenseTracks
from sugiyama_ros.trajectories.tracks import LINE, Tracks

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

_STATE = ("speed", "acceleration", "mean_action", "gap_m", "approach_rate")
_INNOVATION = ("innovation_m", "innovation_var", "nis", "scored")
# What a message is about, by its type.
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
_UTILITY = {NAMES[k] for k in UTILITY}


def name_of(source: str) -> str:
    """Name of a source: the file, or that drivers were simulated."""
    return "Simulated drivers" if SIMULATED in source else source


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
    trajectories : DenseTracks
        Measured positions.
    time_s : array (T,)
        Time of each sample [s].
    series : dict of arrays (T, N)
        What the estimators published, in SI units; NaN where nothing was published. Names: speed, speed_std,
        acceleration, mean_action, gap_m, approach_rate, innovation_m, innovation_var, nis, scored, and each parameter
        that they learnt with its standard deviation, such as v_star and v_star_std.
    verdict_s : array (K,)
        Time of each verdict [s].
    weights : dict of arrays (K,)
        Posterior probability of each model; NaN while the critic has no such model, as after its effect was added.
    added : tuple of str
        Effects that the estimators had at the end, as the critic heard; empty without a critic.
    identified : dict of arrays (N,)
        Whether the data determine a parameter, at the end, by the name of each parameter that was learnt.
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
    above : Above, optional
        The lanes from above, and the ways of the vehicles, where they are known.
    """

    trajectories: DenseTracks
    time_s: Array
    series: dict[str, Array]
    verdict_s: Array
    weights: dict[str, Array]
    identified: dict[str, Mask]
    changes: tuple[StyleChanged, ...] = ()
    types: dict[int, Array] = field(default_factory=dict)
    truth: dict[int, dict[str, float]] = field(default_factory=dict)
    added: tuple[str, ...] = ()
    path: Path | None = None
    model: str = ""
    above: Above | None = None

    def headline(self) -> str:
        """Say what was recorded, and how large the one-step errors are."""
        if not self.has_estimates:
            return f"{self.trajectories.headline()}; no estimates"
        squares = np.square(self.error_by_driver)
        error = math.sqrt(squares.sum() / max(np.count_nonzero(squares), 1))  # nobody follows a controlled vehicle
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
        return bool(self.truth) or SIMULATED in self.trajectories.source

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

    @property
    def learnt(self) -> list[str]:
        """Parameters of the law that were learnt; noises are not among them."""
        return [name for name in self.identified if is_of_law(name)]

    def at_end(self, name: str) -> Array:
        """Return the last known value (N,) of a series for each vehicle; NaN without any."""
        return np.array([of[np.isfinite(of)][-1] if np.isfinite(of).any() else math.nan for of in self.series[name].T])


def is_of_law(name: str) -> bool:
    """Whether a parameter decides how a driver acts by their law: a noise does not, nor does an effect."""
    return name in _UTILITY or name.partition(".")[0] in LAWS


def _beside_one_another(tracks: Tracks) -> Tracks:
    """The positions of all vehicles, whichever lanes and ways they are on: as on one lane."""
    about = replace(tracks.about, view="whole", leaders="found")
    left_out: dict[str, Any] = dict.fromkeys(("lane", *LINE, "leader_shift_m"))
    return replace(tracks, about=about, **left_out)


def read_recording(path: Path) -> Recording:
    """Read a bag that `sugiyama run` recorded, or a file of trajectories in a bag. Raises InputError."""
    t = _beside_one_another(read_tracks(path)).dense(str(path))
    reading = _Reading(t)
    with Bag(path) as bag:
        model = bag.info().metadata.get("sugiyama", {}).get("model", "")
        wanted = {topic.name for topic in bag.info().topics if topic.type in _KINDS}
        for _, type_name, _, message in bag.messages(wanted, skip_misfits=True) if wanted else ():
            try:
                reading.take(_KINDS[type_name], message)
            except (ValueError, IndexError):  # arrays of unequal length
                continue
    is_learnt = _is_learnt(t.position_m, reading.series["scored"])
    for values in (reading.series[name + end] for name in reading.identified for end in ("", "_std")):
        _hold(values)
        values[~is_learnt] = np.nan
    return Recording(
        trajectories=t,
        time_s=np.asarray(t.start_s + np.arange(len(t.position_m)) * t.period_s, dtype=np.float64),
        series=reading.series,
        verdict_s=np.array(reading.verdict_s),
        weights=reading.weights(),
        identified=reading.identified,
        changes=tuple(reading.changes),
        types={v: np.array(p) for v, p in sorted(reading.types.items())},
        truth=dict(sorted(reading.truth.items())),
        added=reading.added,
        path=path,
        model=model,
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

    def __init__(self, trajectories: DenseTracks) -> None:
        self._t = trajectories
        self._column = {int(v): k for k, v in enumerate(trajectories.vehicle)}
        self.series = {name: self._nothing() for name in (*_STATE, "speed_std", *_INNOVATION)}
        self.identified: dict[str, Mask] = {}
        self._verdicts: list[dict[str, float]] = []
        self.verdict_s: list[float] = []
        self.changes: list[StyleChanged] = []
        self.types: dict[int, list[float]] = {}
        self.truth: dict[int, dict[str, float]] = {}
        self.added: tuple[str, ...] = ()

    def _nothing(self) -> Array:
        return np.full(self._t.position_m.shape, np.nan)

    def take(self, kind: str, message: Any) -> None:
        """Enter one message. Raises ValueError, IndexError."""
        time_s = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        if kind == "verdict":
            if len(message.model) == len(message.weight):
                self.verdict_s.append(time_s)
                self.added = tuple(map(str, message.added))
                self._verdicts.append(dict(zip(message.model, map(float, message.weight), strict=True)))
            return
        step = round((time_s - self._t.start_s) / self._t.period_s)
        is_here = 0 <= step < len(self._t.position_m)
        if kind == "drivers":
            if is_here:
                self._take_all(step, message)
        elif (vehicle := int(message.vehicle)) not in self._column:
            return
        elif kind == "change":
            self.changes.append(StyleChanged(time_s, vehicle, str(message.name), float(message.factor)))
        elif kind == "type":
            self.types[vehicle] = [float(p) for p in message.probability]
        elif kind == "truth":
            self.truth[vehicle] = dict(zip(message.name, map(float, message.value), strict=False))
        elif is_here:
            self._take_one(kind, step, self._column[vehicle], message)

    def weights(self) -> dict[str, Array]:
        """Probability of each model at each verdict; NaN while the critic has no such model."""
        names = dict.fromkeys(name for verdict in self._verdicts for name in verdict)
        return {name: np.array([verdict.get(name, np.nan) for verdict in self._verdicts]) for name in names}

    def _take_one(self, kind: str, step: int, column: int, message: Any) -> None:
        """Enter what a message says of one driver."""
        if kind == "parameters":
            count, estimated = len(message.name), np.flatnonzero(message.estimated)
            variance = np.reshape(message.covariance, (count, count)).diagonal()
            of_each = (np.asarray(of)[None, estimated] for of in (message.value, variance, message.identified))
            self._learn(step, [column], [message.name[k] for k in estimated], *of_each)
            return
        for name in _STATE if kind == "state" else _INNOVATION:
            self.series[name][step, column] = getattr(message, name)
        if kind == "state":
            self.series["speed_std"][step, column] = math.sqrt(max(message.covariance[4], 0.0))

    def _take_all(self, step: int, message: Any) -> None:
        """Enter what a message says of all drivers."""
        at = [k for k, vehicle in enumerate(message.vehicle.tolist()) if vehicle in self._column]
        columns = [self._column[vehicle] for vehicle in message.vehicle[at].tolist()]
        for name in (*_STATE, *_INNOVATION):
            self.series[name][step, columns] = getattr(message, name)[at]
        speed_var = message.state_covariance.reshape(-1, 9)[at, 4]
        self.series["speed_std"][step, columns] = np.sqrt(np.maximum(speed_var, 0.0))
        drivers, estimated = len(message.vehicle), np.flatnonzero(message.estimated)
        value = np.reshape(message.value, (drivers, len(message.name)))[:, estimated]
        covariance = np.reshape(message.parameter_covariance, (drivers, len(estimated), len(estimated)))
        identified = np.reshape(message.identified, (drivers, len(estimated)))
        of_each = (of[at] for of in (value, np.diagonal(covariance, axis1=1, axis2=2), identified))
        self._learn(step, columns, [message.name[k] for k in estimated], *of_each)

    def _learn(self, step: int, columns: list[int], names: list[str], *of_each: Array) -> None:
        """Enter values, variances and whether the data determine them, each (drivers, names)."""
        value, variance, identified = of_each
        for k, name in enumerate(map(str, names)):
            if name not in self.identified:
                self.series[name], self.series[f"{name}_std"] = self._nothing(), self._nothing()
                self.identified[name] = np.zeros(len(self._column), dtype=np.bool_)
            self.series[name][step, columns] = value[:, k]
            self.series[f"{name}_std"][step, columns] = np.sqrt(np.maximum(variance[:, k], 0.0))
            self.identified[name][columns] = identified[:, k]


def _is_learnt(position_m: Array, scored: Array) -> Mask:
    """Where (T, N) a driver is on the road, or missing for a moment, who can be learnt from: who follows somebody."""
    seen = np.isfinite(position_m)
    here = np.logical_or.accumulate(seen, axis=0) & np.logical_or.accumulate(seen[::-1], axis=0)[::-1]
    follows = (scored > 0.0).any(axis=0)
    return np.asarray(here & (follows | ~follows.any()))


def _hold(values: Array) -> None:
    """Hold what was published once a second until it is published again, (T, N) in place."""
    latest = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values))[:, None], 0), axis=0)
    values[:] = np.take_along_axis(values, latest, axis=0)
