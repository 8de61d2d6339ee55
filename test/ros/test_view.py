"""The node behind the live page."""

from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sugiyama_msgs.msg import MeasuredPositions, Road, VehicleState

from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.nodes.view import View


def test_a_page_hears_publishers_that_offer_less_than_a_replay(stage) -> None:
    """Best effort and volatile: a perception, and the topics of each vehicle of a node for all drivers."""
    view, world = View(1.0), Node("world")
    to_road = world.create_publisher(Road, "/road", qos_profile_sensor_data)
    to_measured = world.create_publisher(MeasuredPositions, "/measured", qos_profile_sensor_data)
    to_state = world.create_publisher(VehicleState, "/vehicle_01/state", qos_profile_sensor_data)
    stage.add(view, world)
    steps = iter(range(100_000))

    def told() -> bool:
        k = next(steps)
        to_road.publish(Road(circumference_m=0.0, period_s=0.1))
        message = MeasuredPositions(vehicle=[1], leader=[-1], position_m=[1.0 * k], length_m=[4.5], step=k)
        state = VehicleState(vehicle=1, position_m=1.0 * k, speed=10.0)
        for one in (message, state):
            one.header.frame_id = FRAME
            one.header.stamp.sec, one.header.stamp.nanosec = divmod(k * 100_000_000, 1_000_000_000)
        to_measured.publish(message)
        to_state.publish(state)
        return 1 in view.now

    stage.until(told)
    assert view.now[1][1] == 10.0
