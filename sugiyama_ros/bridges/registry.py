"""All bridges, by the type of their message: one entry each."""

from sugiyama_ros.bridges.fields import Bridge

_BRIDGES = (
    # One vehicle on each topic, as robots and simulators publish it.
    Bridge(
        type="nav_msgs/msg/Odometry",
        x="pose.pose.position.x",
        y="pose.pose.position.y",
        orientation="pose.pose.orientation",
        var="pose.covariance[0]",
    ),
    # Boxes of a detector that also tracks: the ids stay with their objects.
    Bridge(
        type="vision_msgs/msg/Detection3DArray",
        objects="detections",
        id="id",
        x="bbox.center.position.x",
        y="bbox.center.position.y",
        orientation="bbox.center.orientation",
        length="bbox.size.x",
    ),
    # Objects that Autoware tracks. Their direction does not count where its sign is unknown.
    Bridge(
        type="autoware_perception_msgs/msg/TrackedObjects",
        objects="objects",
        id="object_id",
        x="kinematics.pose_with_covariance.pose.position.x",
        y="kinematics.pose_with_covariance.pose.position.y",
        orientation="kinematics.pose_with_covariance.pose.orientation",
        heading_known="kinematics.orientation_availability=2",
        var="kinematics.pose_with_covariance.covariance[0]",
        length="shape.dimensions.x",
    ),
    # Objects of derived_object_msgs, as CARLA publishes them.
    Bridge(
        type="derived_object_msgs/msg/ObjectArray",
        objects="objects",
        id="id",
        x="pose.position.x",
        y="pose.position.y",
        orientation="pose.orientation",
        length="shape.dimensions[0]",
        vehicle_class="classification",
    ),
)
BRIDGES = {bridge.type: bridge for bridge in _BRIDGES}
