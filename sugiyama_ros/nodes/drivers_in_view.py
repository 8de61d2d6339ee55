"""The drivers in view: their filters, what is published of them, and what was learnt of drivers who have gone."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rcl_interfaces.msg import ParameterDescriptor
from sugiyama_msgs.msg import Road as RoadMessage

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import NAMES
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.classes import DriverTypes
from sugiyama_ros.fit.model_file import ModelFile
from sugiyama_ros.nodes.base.cdr_messages import NS, Sample
from sugiyama_ros.nodes.base.driver_array_messages import KnownDriver
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.driver_parameters import (
    Adapted,
    check_driver,
    declare_adapt,
    declare_driver,
    declare_model,
    declare_path,
)
from sugiyama_ros.nodes.driver_topics import DriverTopics
from sugiyama_ros.nodes.follower import UNKNOWN, DivergedError, Follower
from sugiyama_ros.nodes.outputs.registry import StandardTopics
from sugiyama_ros.nodes.saved_state import Kept, file_of, read_learnt, write_learnt
from sugiyama_ros.road import Road


@dataclass(frozen=True, eq=False)
class DriversSettings:
    """From what the drivers start, and where what is learnt of them goes.

    model: the model file, or what stands for one; save_state, resume: directories, None without; has_vehicle_topics:
    whether each driver has topics of their own instead of one message for all; adapted: what is learnt; standard: what
    is published for others.
    """

    model: ModelFile
    save_state: Path | None
    resume: Path | None
    has_vehicle_topics: bool
    adapted: Adapted
    standard: StandardTopics

    @property
    def effects(self) -> Array:
        """Row (WIDTH,) with the effects of the model file."""
        nobody: Ints = np.array([-1])
        return self.model.rows_of(nobody)[0]

    @property
    def types(self) -> DriverTypes | None:
        """Types of drivers, if the model file has any."""
        return self.model.types


def read_settings(node: PacedNode) -> DriversSettings:
    """Declare the parameters of a node that follows all drivers, and read what they name. Raises InputError."""
    model = declare_model(node)
    save_state = declare_path(node, "save_state", "directory in which to keep what was learnt, for resume")
    resume = declare_path(node, "resume", "directory with what an earlier run has learnt, to go on from")
    about = ParameterDescriptor(
        description="whether each driver has topics of their own, not `drivers`", read_only=True
    )
    vehicle_topics = bool(node.declare_parameter("vehicle_topics", False, about).value)
    standard = StandardTopics(node)
    settings = DriversSettings(model, save_state, resume, vehicle_topics, declare_adapt(node, model.rows), standard)
    declare_driver(node, settings.effects)
    check_driver(node)
    return settings


@dataclass(eq=False)
class _InView:
    """A driver in view: the filter, what is published, and the stamp [ns] at which the vehicle was last seen."""

    follower: Follower
    topics: DriverTopics
    seen_ns: int


class DriversInView:
    """All drivers in view.

    node: the node that publishes; settings: from what the drivers start; road: the road; effects: (WIDTH,), row with
    the effects of all drivers; counts: numbers of samples; what the filters count is added; window_s: time [s] by which
    a sample may be late; most: drivers who are followed at the same time, at most; drivers: the drivers, by the numbers
    of their vehicles; left_out: vehicles of the last sample that are not followed, because there are too many; counts:
    drivers who came, who came again, and who were retired; failure: what the first failure of a filter was; empty
    without one.
    """

    def __init__(
        self,
        node: PacedNode,
        settings: DriversSettings,
        road: RoadMessage,
        effects: Array,
        counts: dict[str, int],
        window_s: float,
        most: int,
    ) -> None:
        self._node, self._settings, self._effects = node, settings, effects
        self._period_s, self._road = road.period_s, Road(road.circumference_m)
        self._of_filters, self._window_s, self._most = counts, window_s, most
        self._known: dict[int, Kept] = {}
        self._collected: list[KnownDriver] = []
        self.drivers: dict[int, _InView] = {}
        self.left_out: set[int] = set()
        self.counts = {"came": 0, "came again": 0, "retired": 0}
        self.failure = ""

    def take_in(self, sample: Sample, late: bool) -> list[KnownDriver]:
        """Take in a sample."""
        self._collected = []
        self.left_out.clear()
        for vehicle in sample.place:
            driver = self.drivers.get(vehicle)
            if driver is None:
                if late:
                    continue
                if len(self.drivers) >= self._most:
                    self.left_out.add(vehicle)
                    continue
                driver = self._meet(vehicle)
            self._follow(driver, sample, late)
        return self._collected

    def _follow(self, driver: _InView, sample: Sample, late: bool) -> None:
        follower = driver.follower
        try:
            estimate = follower.sort_in(sample) if late else follower.follow(sample)
        except Exception as error:
            vehicle = follower.vehicle
            self.failure = self.failure or f"vehicle {vehicle} at {sample.stamp_ns / NS:.3f} s: {error!r}"
            if isinstance(error, DivergedError):
                driver.topics.close()
                del self.drivers[vehicle]
                driver = self._meet(vehicle)
                driver.follower.stamp_ns = sample.stamp_ns
            estimate = UNKNOWN
        driver.seen_ns = max(driver.seen_ns, sample.stamp_ns)
        change = driver.follower.filter.change_of_style if estimate is not None else None
        if estimate is None:
            return
        self._of_filters["changes of style"] += change is not None
        driver.topics.publish_estimate(sample.stamp_ns, estimate, change)
        driver.topics.publish_parameters(sample.stamp_ns, driver.follower.filter, False)
        if not late:
            follower, standard = driver.follower, self._settings.standard
            standard.publish(self._road, follower, estimate, sample.stamp_ns, f"vehicle_{follower.vehicle:02}/")

    # What a topic of all drivers needs: `DriverTopics` puts each driver here.
    def join(self, node: PacedNode) -> None:
        """Nothing is waited for: a sample is over when all its vehicles were taken in."""

    def put(self, node: PacedNode, stamp_ns: int, driver: KnownDriver | None) -> None:
        """Take what is known of a driver after a sample."""
        if driver is not None:
            self._collected.append(driver)

    def restart(self) -> None:
        """Forget where the vehicles are, after a jump in time, and keep what was learnt."""
        for driver in self.drivers.values():
            driver.follower.restart()
            driver.topics.restart()
            driver.seen_ns = -(1 << 62)

    def change(self, effects: Array) -> None:
        """Go on with other effects (WIDTH,). Raises InputError if the filters cannot."""
        for driver in self.drivers.values():
            driver.follower.change(effects)
            driver.topics.choose_parameters(effects, driver.follower.filter)
        self._effects = effects

    def retire(self, before_ns: int | None) -> None:
        """Retire drivers who were last seen before a stamp [ns], or all drivers, and keep what was learnt of them.

        Raises OutputError if it cannot be saved.
        """
        gone = [v for v, one in self.drivers.items() if before_ns is None or one.seen_ns < before_ns]
        for vehicle in gone:
            driver = self.drivers.pop(vehicle)
            driver.topics.close()
            self._settings.standard.retire(vehicle, f"vehicle_{vehicle:02}/")
            self.counts["retired"] += 1
            # without a stamp, nobody has seen the vehicle since time has jumped
            kept = self._known[vehicle] = Kept(driver.follower.filter.learnt, driver.follower.stamp_ns or 0)
            if self._settings.save_state is not None:
                write_learnt(file_of(self._settings.save_state, vehicle), kept)

    def _meet(self, vehicle: int) -> _InView:
        """Make the filter of a driver, who may have been here before."""
        row = self._row_of(vehicle)
        filter_ = self._settings.adapted.filter_of(self._period_s, self._road, row, self._settings.standard.vehicles)
        kept = self._known.pop(vehicle, None) or self._saved(vehicle)
        self.counts["came" if kept is None else "came again"] += 1
        follower = Follower(vehicle, filter_, kept, self._of_filters, self._window_s)
        own = self._settings.has_vehicle_topics
        space = f"vehicle_{vehicle:02}/" if own else ""
        topics = DriverTopics(self._node, vehicle, self._settings.types, None if own else self, space)
        topics.choose_parameters(self._effects, filter_)
        driver = self.drivers[vehicle] = _InView(follower, topics, -(1 << 62))
        return driver

    def _row_of(self, vehicle: int) -> Array:
        """Row (WIDTH,) from which a driver starts: the model file's, or else the parameters of the node."""
        row = self._effects.copy()
        model = self._settings.model
        if vehicle in model.vehicle:
            row[: len(NAMES)] = model.rows_of(np.array([vehicle]))[0, : len(NAMES)]
        else:
            row[: len(NAMES)] = [self._node.get_parameter(name).value for name in NAMES]
        return row

    def _saved(self, vehicle: int) -> Kept | None:
        """What an earlier run has learnt, None if nothing is known. A damaged file is told, and not used."""
        directory = self._settings.resume
        file = None if directory is None else file_of(directory, vehicle)
        if file is not None and file.exists():
            try:
                return read_learnt(file)
            except InputError as error:
                self._node.get_logger().warning(str(error))
        return None
