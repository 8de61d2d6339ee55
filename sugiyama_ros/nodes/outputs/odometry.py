"""Position and speed of now, with their covariance."""

import numpy as np
from geometry_msgs.msg import TwistWithCovariance
from nav_msgs.msg import Odometry

from sugiyama_ros.arrays import Array
from sugiyama_ros.nodes.base.cdr_messages import NS, time_message
from sugiyama_ros.nodes.outputs.output import UNKNOWN_VAR, DriverOutput, Known


def odometry(known: Known, k: int = 0) -> Odometry:
    """Return state number k of the path, with the stamp of its time."""
    path = known.path
    message = Odometry(
        child_frame_id=f"vehicle_{known.vehicle:02}",
        pose=known.places.pose(float(path.position_m[k]), float(path.covariance[k, 0, 0])),
        twist=TwistWithCovariance(),
    )
    message.header.stamp = time_message(known.stamp_ns + round(float(path.time_s[k]) * NS))
    message.header.frame_id = known.places.frame
    message.twist.twist.linear.x = float(path.speed[k])
    # of the speeds, the filter knows the one along the road
    covariance: Array = np.diag([float(path.covariance[k, 1, 1]), *[UNKNOWN_VAR] * 5])
    message.twist.covariance = covariance.ravel()
    return message


OUTPUT = DriverOutput("odometry", Odometry, lambda known: [odometry(known)])
