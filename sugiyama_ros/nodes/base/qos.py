"""Quality of service of every topic, and the window of the pacing that it rests on.

The source sends at most WINDOW steps beyond the slowest subscriber (pacing.py). For a topic with one message a step,
every publisher and every subscription keeps two windows, because a seek may double what is under way. So no message is
overwritten before its subscribers have taken it.
"""

from collections.abc import Iterable
from typing import Any

from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy

#: Steps that the source may be ahead of the slowest subscriber.
WINDOW = 64
DEPTH = 2 * WINDOW


def reliable(depth: int, durability: QoSDurabilityPolicy = QoSDurabilityPolicy.TRANSIENT_LOCAL) -> QoSProfile:
    """A reliable profile that keeps the last ``depth`` messages."""
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=QoSReliabilityPolicy.RELIABLE,
        durability=durability,
    )


#: For every topic with more than one message: who subscribes hears what comes from then on, and nothing old.
STREAM = reliable(DEPTH, QoSDurabilityPolicy.VOLATILE)
#: As STREAM, but who subscribes late and asks for it (transient local) gets the last messages too, in their order.
KEPT_STREAM = reliable(DEPTH)
#: Latched: the last message only.
LATCHED = reliable(1)
#: Progress counts from the start, so only the last message of a sender matters; a receiver hears many senders.
PROGRESS_OUT = reliable(1)
PROGRESS_IN = reliable(1000)


def offered(publishers: Iterable[Any]) -> QoSProfile:
    """The best profile that connects to all of a topic's publishers (TopicEndpointInfo), also to those of a sensor."""
    profiles = [publisher.qos_profile for publisher in publishers]
    is_latched = bool(profiles) and all(q.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for q in profiles)
    profile = reliable(DEPTH, QoSDurabilityPolicy.TRANSIENT_LOCAL if is_latched else QoSDurabilityPolicy.VOLATILE)
    if not all(q.reliability == QoSReliabilityPolicy.RELIABLE for q in profiles):
        profile.reliability = QoSReliabilityPolicy.BEST_EFFORT
    return profile
