"""Position and speed in 1 to 5 seconds, each with its covariance and with the stamp of its time."""

import numpy as np
from nav_msgs.msg import Odometry

from sugiyama_ros.nodes.driver import AHEAD_S
from sugiyama_ros.nodes.outputs.odometry import odometry
from sugiyama_ros.nodes.outputs.output import DriverOutput, Known


def predicted(known: Known) -> list[Odometry]:
    """Return one message for each second ahead."""
    times = known.path.time_s
    return [odometry(known, int(np.abs(times - second).argmin())) for second in range(1, round(times[-1]) + 1)]


OUTPUT = DriverOutput("predicted_odometry", Odometry, predicted, every_s=1.0, ahead_s=AHEAD_S)
