"""Holds what every estimator last said of its driver, for one that is started anew.

What a node has latched (transient-local) is gone with the node, so another one has to hold it.
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
    """Latches on .../vehicle_07/_kept_parameters what was last published on .../vehicle_07/parameters."""

    def __init__(self, **options: Any) -> None:
        super().__init__("keeper", **options)
        self._kept: dict[str, Publisher] = {}
        self.create_timer(_LOOK_S, self._look, clock=self.steady)

    def health(self) -> Health:
        """Always well; tells of how many drivers it has heard."""
        return Health(OK, "keeping", {"drivers": len(self._kept)})

    def _look(self) -> None:
        """Listen to the estimators that have come."""
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
