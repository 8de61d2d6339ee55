"""Quality of service of every topic, and the window of the pacing that it rests on.

The source sends at most WINDOW steps beyond the slowest subscriber (pacing.py). Every publisher and every subscription
keeps two windows of a topic that carries one message a step (a seek may double what is under way), so that nothing that
somebody still waits for is ever overwritten.
"""

from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy

#: Steps that the source may be ahead of the slowest subscriber.
WINDOW = 64
DEPTH = 2 * WINDOW


def reliable(depth: int, durability: QoSDurabilityPolicy = QoSDurabilityPolicy.TRANSIENT_LOCAL) -> QoSProfile:
    """Reliable, the last ``depth`` messages kept."""
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=QoSReliabilityPolicy.RELIABLE,
        durability=durability,
    )


#: Everything that is recorded. Transient local: what is sent before a subscriber is found reaches him all the same.
STREAM = reliable(DEPTH)
#: Latched: the last message only.
LATCHED = reliable(1)
#: Progress is cumulative: a sender's last message makes his earlier ones useless, a receiver hears many senders.
PROGRESS_OUT = reliable(1)
PROGRESS_IN = reliable(1000)
