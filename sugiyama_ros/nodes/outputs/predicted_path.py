"""The path of the next 5 seconds, one pose for each period."""

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path

from sugiyama_ros.nodes.base.cdr_messages import NS, time_message
from sugiyama_ros.nodes.driver import AHEAD_S
from sugiyama_ros.nodes.outputs.output import DriverOutput, Known


def path(known: Known) -> list[Path]:
    """Return the path, whose poses have the stamps of their times."""
    message = Path()
    message.header.stamp, message.header.frame_id = time_message(known.stamp_ns), known.places.frame
    for time_s, position_m in zip(known.path.time_s.tolist(), known.path.position_m.tolist(), strict=True):
        pose = PoseStamped(pose=known.places.pose(position_m, 0.0).pose)
        pose.header.stamp, pose.header.frame_id = time_message(known.stamp_ns + round(time_s * NS)), known.places.frame
        message.poses.append(pose)
    return [message]


OUTPUT = DriverOutput("predicted_path", Path, path, every_s=1.0, ahead_s=AHEAD_S)
