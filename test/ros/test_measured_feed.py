"""One subscription for several nodes of a process."""

import pytest
from rclpy.node import Node
from sugiyama_msgs.msg import MeasuredPositions
from sugiyama_msgs.msg import Road as RoadMessage

from sugiyama_ros.nodes.base import cdr_messages
from sugiyama_ros.nodes.base.qos import LATCHED, STREAM
from sugiyama_ros.nodes.estimator import Estimator
from sugiyama_ros.trajectories.placing import Positions

pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]


def test_estimators_of_a_process_share_one_subscription(stage) -> None:
    hand, first = Node("hand"), Estimator(namespace="/vehicle_00")
    shared = [first, *(Estimator(first.feed, namespace=f"/vehicle_0{v}") for v in (1, 2))]
    alone = Estimator(namespace="/vehicle_03")
    to_road = hand.create_publisher(RoadMessage, "road", LATCHED)
    to_measured = hand.create_publisher(MeasuredPositions, "measured", STREAM)
    stage.add(hand, *shared, alone)
    stage.until(lambda: hand.count_subscribers("measured") == 2)
    # samples that come before the road wait for it
    for k in range(10):
        positions = Positions([0, 1, 2, 3], [1, 2, 3, 0], [(25.0 * v + 3.0 * k) % 100.0 for v in range(4)], [4.5] * 4)
        to_measured.publish(cdr_messages.measured_positions(k * cdr_messages.NS // 2, k, positions))
    to_road.publish(RoadMessage(circumference_m=100.0, period_s=0.5))
    stage.until(lambda: all(node.steps == 10 for node in [*shared, alone]))
    assert [dict(node.health().values)["samples"] for node in [*shared, alone]] == [10] * 4
