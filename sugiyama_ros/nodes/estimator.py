"""One driver's estimator: measured positions in; state, innovation and parameters out."""

import re
from typing import Any

from sugiyama_msgs.msg import DriverParameters

from sugiyama_ros.errors import InputError
from sugiyama_ros.nodes.base.cdr_messages import NS
from sugiyama_ros.nodes.base.feed import RoadFeed
from sugiyama_ros.nodes.base.node import ERROR, OK, WARN, Health
from sugiyama_ros.nodes.base.qos import LATCHED
from sugiyama_ros.nodes.base.samples import Sample
from sugiyama_ros.nodes.base.spin import run_node
from sugiyama_ros.nodes.driver import DriverTopics, Follower
from sugiyama_ros.nodes.drivers import FollowingNode
from sugiyama_ros.nodes.keeper import Kept, file_of, kept_in, read_learnt

# Time [s] in which a keeper may answer.
_PATIENCE_S = 5.0
_SAVED_EVERY_NS = 10 * NS


class Estimator(FollowingNode):
    """Follows the vehicle of its namespace, ``.../vehicle_07``, whether it is in view or not.

    More parameters of the node: ``ask_keeper`` and ``array_topic``.

    feed: where the samples come from, if several nodes of the process share one.
    """

    def __init__(self, feed: RoadFeed | None = None, **options: Any) -> None:
        super().__init__("estimator", **options)
        assert self.vehicle is not None
        self.feed = feed or RoadFeed(self)
        self._is_asking = self.option("ask_keeper", False, "whether to go on from what the keeper has last heard")
        array = "whether to publish on `drivers`, in one message with other drivers"
        in_array = self.option("array_topic", False, array)
        if in_array:
            self.feed.offer_drivers()
        self._topics = DriverTopics(self, self.vehicle, self._model.types, self.feed if in_array else None)
        self._saved_ns: int | None = None
        saved = file_of(self._resume, self.vehicle) if self._resume is not None else None
        if saved is not None and saved.exists():  # nothing is known of a vehicle that was not there before
            self.known[self.vehicle] = read_learnt(saved)
        if self._is_asking:
            self.feed.hold()
            self.listen(DriverParameters, "_kept_parameters", self._on_kept, LATCHED)
            self._patience = self.create_timer(_PATIENCE_S, lambda: self._on_kept(), clock=self.steady)
        self.add_post_set_parameters_callback(lambda _: self.begin_anew())
        self.feed.hand_to(self)

    def only_vehicle(self) -> int:
        """Number of the vehicle. Raises InputError where the namespace has none."""
        found = re.search(r"/vehicle_(\d+)$", self.get_namespace())
        if found is None:
            raise InputError(
                f"estimator: the namespace {self.get_namespace()} names no vehicle; start it with -r __ns:=/vehicle_07"
            )
        return int(found[1])

    @property
    def follower(self) -> Follower | None:
        """What follows the driver; None before the road is known."""
        return self.drivers[self.vehicle].follower if self.vehicle in self.drivers else None

    def health(self) -> Health:
        """ERROR after a failure of the filter, WARN without a road or a position."""
        if self._failure:
            return Health(ERROR, self._failure, self._counts)
        if self._arrivals is None or self.follower is None:
            return Health(WARN, f"waiting for a road on {self.shared('road')}", self._counts)
        if self._arrivals.stamp_ns is None:
            return Health(OK, f"ready; nothing heard on {self.shared('measured')} yet", self._counts)
        values = {**self._counts, **self._arrivals.rhythm}
        if self.follower.missing_in_a_row:
            return Health(WARN, f"{self.follower.missing_in_a_row} samples missing in a row", values)
        unknown = self._topics.not_identified
        return Health(OK, f"following; not yet identified: {', '.join(unknown)}" if unknown else "following", values)

    def finish(self) -> None:
        """Keep what was learnt, and send nothing more."""
        self._save()
        super().finish()

    def restart(self) -> None:
        """Start a new filter from the node's parameters and from what an earlier run has learnt."""
        super().restart()
        if self._road is not None and self.vehicle is not None:
            self.meet(self.vehicle, self.known.get(self.vehicle))
            self._topics.restart()
            self._saved_ns = None

    def topics_of(self, vehicle: int) -> DriverTopics:
        """Publish the driver on the topics of the node."""
        return self._topics

    def follow_all(self, sample: Sample, late: bool) -> None:
        """Take in a sample, and save now and then what was learnt."""
        assert self.vehicle is not None
        driver = self.drivers[self.vehicle]
        self.follow(driver, sample, late)
        if self._saved_ns is None:
            self._saved_ns = sample.stamp_ns
        elif not late and not 0 <= sample.stamp_ns - self._saved_ns < _SAVED_EVERY_NS:
            self._saved_ns = sample.stamp_ns
            self._save()
        if self._failure or driver.follower.missing_in_a_row:
            self.report_if_worse()

    def _on_kept(self, message: DriverParameters | None = None) -> None:
        """Go on from the keeper's answer; without a message, the keeper has not answered in time."""
        if not self._is_asking or self.vehicle is None:
            return
        self._is_asking = False
        self._patience.cancel()
        if message is not None:
            try:
                self.known[self.vehicle] = kept_in(message)
            except ValueError as error:
                self.refuse("_kept_parameters", error)
            self.restart()
        self.feed.release()

    def _save(self) -> None:
        if self.vehicle is not None and self.follower is not None and self.follower.stamp_ns is not None:
            self.keep(self.vehicle, Kept(self.follower.filter.learnt, self.follower.stamp_ns))


if __name__ == "__main__":
    run_node(Estimator)
