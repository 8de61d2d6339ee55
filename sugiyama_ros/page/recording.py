"""A recorded run as arrays over samples and vehicles."""

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sugiyama_ros.arrays import Array
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
}


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
        acceleration, mean_action, gap_m, approach_rate, innovation_m, innovation_var, nis, scored.
    verdict_s : array (K,)
        Time of each verdict [s].
    weights : dict of arrays (K,)
        Posterior probability of each model.
    """

    trajectories: Trajectories
    time_s: Array
    series: dict[str, Array]
    verdict_s: Array
    weights: dict[str, Array]

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


def read_recording(path: Path) -> Recording:
    """Read a bag that `sugiyama run` recorded, or a file of trajectories in a bag. Raises InputError."""
    trajectories = read_trajectories(path, None)
    t = trajectories
    samples, vehicles = t.position_m.shape
    names = ["speed_std", *(name for fields in _FIELDS.values() for name in fields)]
    series: dict[str, Array] = {name: np.full((samples, vehicles), np.nan) for name in names}
    column = {int(v): k for k, v in enumerate(t.vehicle)}
    weights: defaultdict[str, list[float]] = defaultdict(list)
    times: list[float] = []
    with Bag(path) as bag:
        wanted = {topic.name for topic in bag.info().topics if topic.type in _KINDS}
        for _, type_name, _, message in bag.messages(wanted, skip_misfits=True) if wanted else ():
            time_s = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
            kind = _KINDS[type_name]
            if kind == "verdict":
                if len(message.model) == len(message.weight):
                    times.append(time_s)
                    for name, weight in zip(message.model, message.weight, strict=True):
                        weights[name].append(float(weight))
                continue
            step = round((time_s - t.start_s) / t.period_s)
            if 0 <= step < samples:
                enter = _enter_all if kind == "drivers" else _enter
                enter(message, kind, step, series, column)
    return Recording(
        t,
        np.asarray(t.start_s + np.arange(samples) * t.period_s, dtype=np.float64),
        series,
        np.array(times),
        {name: np.array(values) for name, values in weights.items() if len(values) == len(times)},
    )


def _enter(message: Any, kind: str, step: int, series: dict[str, Array], column: dict[int, int]) -> None:
    """Enter a state or an innovation of one driver into the series."""
    k = column.get(int(message.vehicle))
    if k is None:
        return
    for name in _FIELDS[kind]:
        series[name][step, k] = getattr(message, name)
    if kind == "state":
        series["speed_std"][step, k] = np.sqrt(max(float(message.covariance[4]), 0.0))


def _enter_all(message: Any, _: str, step: int, series: dict[str, Array], column: dict[int, int]) -> None:
    """Enter states and innovations of all drivers into the series."""
    at = [k for k, vehicle in enumerate(message.vehicle.tolist()) if vehicle in column]
    columns = [column[vehicle] for vehicle in message.vehicle[at].tolist()]
    for name in (*_FIELDS["state"], *_FIELDS["innovation"]):
        series[name][step, columns] = getattr(message, name)[at]
    speed_var = message.state_covariance.reshape(-1, 9)[at, 4]
    series["speed_std"][step, columns] = np.sqrt(np.maximum(speed_var, 0.0))
