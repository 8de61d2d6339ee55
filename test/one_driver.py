"""A node that follows one driver, who has topics of their own."""

from typing import Any

from rclpy.parameter import Parameter

from sugiyama_ros.nodes.drivers import DriversNode
from sugiyama_ros.nodes.follower import Follower


def parameters(given: dict[str, Any]) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in given.items()]


class OneDriver(DriversNode):
    """Follows the driver of one vehicle, from the road on."""

    def __init__(self, vehicle: int, cli_args: list[str] | None = None, **given: Any) -> None:
        self.vehicle = vehicle
        own = {"vehicles": [vehicle], "vehicle_topics": True, **given}
        super().__init__(parameter_overrides=parameters(own), cli_args=cli_args)

    @property
    def follower(self) -> Follower | None:
        """What follows the driver; None before the road is known."""
        return self.drivers[self.vehicle].follower if self.vehicle in self.drivers else None
