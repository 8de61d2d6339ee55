"""Objects of derived_object_msgs, as CARLA publishes them."""

from sugiyama_ros.bridges.fields import Bridge

BRIDGE = Bridge(
    type="derived_object_msgs/msg/ObjectArray",
    objects="objects",
    id="id",
    x="pose.position.x",
    y="pose.position.y",
    orientation="pose.orientation",
    length="shape.dimensions[0]",
    vehicle_class="classification",
)
