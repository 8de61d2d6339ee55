"""Objects that Autoware tracks."""

from sugiyama_ros.bridges.fields import Bridge

BRIDGE = Bridge(
    type="autoware_perception_msgs/msg/TrackedObjects",
    objects="objects",
    id="object_id",
    x="kinematics.pose_with_covariance.pose.position.x",
    y="kinematics.pose_with_covariance.pose.position.y",
    orientation="kinematics.pose_with_covariance.pose.orientation",
    heading_known="kinematics.orientation_availability=2",  # not for a direction whose sign is unknown
    var="kinematics.pose_with_covariance.covariance[0]",
    length="shape.dimensions.x",
)
