"""Boxes of a detector that also tracks: the ids stay with their objects."""

from sugiyama_ros.bridges.fields import Bridge

BRIDGE = Bridge(
    type="vision_msgs/msg/Detection3DArray",
    objects="detections",
    id="id",
    x="bbox.center.position.x",
    y="bbox.center.position.y",
    orientation="bbox.center.orientation",
    length="bbox.size.x",
)
