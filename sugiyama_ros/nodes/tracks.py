"""From what a perception has seen to positions on the road: topics of vehicles in, ``road`` and ``measured`` out."""

from collections.abc import Callable
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any

from sugiyama_msgs.msg import MeasuredPositions
from sugiyama_msgs.msg import Road as RoadMessage

from sugiyama_ros.bridges.bridge import BRIDGES, Bridge, read_bridge
from sugiyama_ros.bridges.frames import TF_TOPICS, TF_TYPE
from sugiyama_ros.bridges.perception import Perception, PerceptionSettings, RoadSample
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.centre_line import read_lanes
from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.nodes.base import cdr_messages
from sugiyama_ros.nodes.base.node import OK, WARN, Health, PacedNode, message_type
from sugiyama_ros.nodes.base.qos import LATCHED, STREAM, offered
from sugiyama_ros.nodes.plane import PlaneTopics
from sugiyama_ros.trajectories.about import DEFAULT_LENGTH_M

_POLL_S = 0.2


class TracksNode(PacedNode):
    """Puts vehicles that were seen in the plane on the lanes of a road, says who follows whom, and sends it all.

    Parameters of the node: ``centre_line`` (CSV file), ``topics`` (patterns of names), ``bridge`` (YAML file for a type
    of message that is not known), ``frame`` of the centre line, ``period``, ``length`` and ``ahead``.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("tracks", **options)
        line = self.path("centre_line", "centre lines of the lanes (CSV): x, y[, lane, width]")
        bridge = self.path("bridge", "what a message of a type that is not known says (YAML)")
        self._patterns = self.texts("topics", "patterns of the topics of vehicles, as /car*/odom")
        frame = str(self.option("frame", "", "frame of the centre line; empty: that of the messages"))
        period_s = self.option("period", 0.1, "time [s] between two samples of the road", (0.01, 10.0))
        length = "length [m] of a vehicle that does not say it"
        length_m = self.option("length", DEFAULT_LENGTH_M, length, (0.5, 100.0))
        if line is None or not self._patterns:
            raise InputError(
                "tracks: no centre line or no topics given; start it with -p centre_line:=FILE.csv -p"
                ' topics:=["/car*/odom"]'
            )
        own = [read_bridge(bridge)] if bridge is not None else []
        self._bridges = BRIDGES | {one.type: one for one in own}
        self._perception = Perception(read_lanes(Path(line)), PerceptionSettings(period_s, frame, length_m))
        ahead = "how far ahead [s] the way of each vehicle is predicted and published, with its heading; 0: not at all"
        ahead_s = self.option("ahead", 0.0, ahead, (0.0, 10.0))
        self._plane = PlaneTopics(self, self._perception.lanes, period_s, ahead_s) if ahead_s > 0.0 else None
        self._known: set[str] = set()
        self._sources = 0
        self._to_road = self.create_publisher(RoadMessage, "road", LATCHED)
        self._to_measured = self.create_publisher(MeasuredPositions, "measured", STREAM)
        self._send_road(period_s)
        self.create_timer(_POLL_S, self._on_poll, clock=self.steady)
        self._on_poll()

    def health(self) -> Health:
        """WARN without a topic, without a vehicle on the road, or where much of what is seen is lost."""
        counts = self._perception.counts
        periods = self._perception.periods_s
        values = {"topics": self._sources, "samples": self.steps, **vars(counts)}
        if periods:
            values["periods of vehicles [s]"] = f"{periods[0]:.3g} to {periods[-1]:.3g}"
        problem = self._perception.problem()
        if not self._sources:
            return Health(WARN, f"no topic {', '.join(self._patterns)} of a known type", values)
        if problem or not counts.taken:
            return Health(WARN, problem or "no vehicle on the road yet", values)
        return Health(OK, "sending", values)

    def _on_poll(self) -> None:
        """Subscribe to topics that are new."""
        for topic, (kind, *_) in self.get_topic_names_and_types():
            if topic in self._known or not self.get_publishers_info_by_topic(topic):
                continue
            if kind == TF_TYPE and topic in TF_TOPICS:
                self._subscribe(topic, kind, partial(self._on_transforms, static=TF_TOPICS[topic]))
            elif any(fnmatchcase(topic, pattern) for pattern in self._patterns):
                bridge = self._bridges.get(kind)
                if bridge is None:
                    self._leave_out(topic, f"{kind} is not known; give a bridge for it")
                elif self._subscribe(topic, kind, partial(self._on_seen, bridge=bridge, topic=topic)):
                    self._sources += 1

    def _subscribe(self, topic: str, kind: str, take: Callable[[Any], None]) -> bool:
        """Take what comes on a topic; False where its type is not installed."""
        try:
            message = message_type(kind)
        except (ImportError, AttributeError):
            self._leave_out(topic, f"{kind} is not installed; install {kind.partition('/')[0]}")
            return False
        self._known.add(topic)
        self.listen(message, topic, take, offered(self.get_publishers_info_by_topic(topic)))
        return True

    def _leave_out(self, topic: str, why: str) -> None:
        self._known.add(topic)
        self.get_logger().warning(f"{topic}: left out: {why}")

    def _on_transforms(self, message: Any, static: bool) -> None:
        for sample in self._perception.hear(message, static):
            self._send(sample)

    def _on_seen(self, message: Any, bridge: Bridge, topic: str) -> None:
        self.received += 1
        try:
            for sample in self._perception.take(message, bridge, topic, self.get_clock().now().nanoseconds):
                self._send(sample)
        except (InputError, ValueError) as error:
            self.refuse(topic, error)

    def _send(self, sample: RoadSample) -> None:
        message = cdr_messages.measured_positions(sample.stamp_ns, sample.step, sample.positions)
        self.send(self._to_measured, message)
        if self._plane is not None:
            self._plane.publish(sample)
        self.taken(sample.step + 1)

    def _send_road(self, period_s: float) -> None:
        message = RoadMessage(
            circumference_m=self._perception.lanes.road.circumference_m, period_s=period_s, source="tracks"
        )
        message.header.frame_id = FRAME
        self.send(self._to_road, message)
