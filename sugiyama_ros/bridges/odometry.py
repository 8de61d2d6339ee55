"""One vehicle on each topic, as robots and simulators publish it."""

from sugiyama_ros.bridges.fields import Bridge

BRIDGE = Bridge(
    type="nav_msgs/msg/Odometry",
    x="pose.pose.position.x",
    y="pose.pose.position.y",
    orientation="pose.pose.orientation",
    var="pose.covariance[0]",
)
