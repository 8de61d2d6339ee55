"""A node that keeps what each estimator last published about its driver, for an estimator that starts again.

A latched (transient-local) message is gone when its publisher is gone, so another node has to hold it.
"""

import re
from functools import partial
from typing import Any

from rclpy.publisher import Publisher
from sugiyama_msgs.msg import DriverParameters

from sugiyama_ros.nodes.base.node import OK, Health, PacedNode
from sugiyama_ros.nodes.base.qos import LATCHED, STREAM
from sugiyama_ros.nodes.base.spin import run_node

_LOOK_S = 0.5
_PARAMETERS = re.compile(r"(.*/vehicle_\d+)/parameters")


class Keeper(PacedNode):
    """Latches the last message of each topic ``.../vehicle_07/parameters`` on ``.../vehicle_07/_kept_parameters``."""

    def __init__(self, **options: Any) -> None:
        super().__init__("keeper", **options)
        self._kept: dict[str, Publisher] = {}
        self.create_timer(_LOOK_S, self._look, clock=self.steady)

    def health(self) -> Health:
        """Always OK, with the number of drivers heard."""
        return Health(OK, "keeping", {"drivers": len(self._kept)})

    def _look(self) -> None:
        """Subscribe to estimators that are new in the graph."""
        for topic, _ in self.get_topic_names_and_types():
            found = _PARAMETERS.fullmatch(topic)
            if found is not None and topic not in self._kept:
                self._kept[topic] = self.create_publisher(DriverParameters, f"{found[1]}/_kept_parameters", LATCHED)
                keep = partial(self.send, self._kept[topic])
                self.create_subscription(DriverParameters, topic, keep, STREAM, raw=True)


def main() -> None:
    """Run the keeper."""
    run_node(Keeper)


if __name__ == "__main__":
    main()
