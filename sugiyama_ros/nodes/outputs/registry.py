"""All outputs, by name, and the parameter that chooses among them."""

from importlib import import_module
from math import isnan

from rcl_interfaces.msg import ParameterDescriptor

from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.chain import CHAIN
from sugiyama_ros.filters.online import Estimate
from sugiyama_ros.formats.centre_line import read_lanes
from sugiyama_ros.nodes.base.cdr_messages import NS
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.driver_parameters import declare_path
from sugiyama_ros.nodes.follower import Follower
from sugiyama_ros.nodes.outputs.output import DriverOutput, Known, Places
from sugiyama_ros.nodes.prediction import VEHICLES
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.centre_line import CentreLine

_MODULES = ("odometry", "predicted_path", "predicted_odometry")


class StandardTopics:
    """Publishes what the parameter ``publish`` asks for, of each driver, on topics such as ``vehicle_07/odometry``.

    node: the node that publishes. Raises InputError.
    """

    def __init__(self, node: PacedNode) -> None:
        self._node = node
        about = ParameterDescriptor(
            description=f"standard messages of each driver to publish: {', '.join(_MODULES)}", read_only=True
        )
        names = [name for name in node.declare_parameter("publish", [""], about).value if name]
        for name in names:
            if name not in _MODULES:
                raise InputError(f"publish: {name!r} is not known; give {', '.join(_MODULES)}")
        self.outputs: list[DriverOutput] = []
        try:
            # their messages need not be installed where nobody asks for them
            self.outputs = [import_module(f"sugiyama_ros.nodes.outputs.{name}").OUTPUT for name in names]
        except ImportError as error:
            raise InputError(f"publish: {error}; install this package of messages") from None
        file = declare_path(node, "centre_line", "centre lines of the lanes (CSV), for published poses")
        self._line: CentreLine | None = None if file is None else read_lanes(file).lines[0]
        frame = ParameterDescriptor(description="frame of published poses", read_only=True)
        self._frame = str(node.declare_parameter("frame", "road", frame).value)
        self._told_ns: dict[tuple[int, str], int] = {}

    @property
    def vehicles(self) -> int:
        """Vehicles that a driver's filter needs in its chain: more where a path is predicted."""
        return VEHICLES if any(one.ahead_s > 0.0 for one in self.outputs) else CHAIN

    def publish(self, road: Road, follower: Follower, estimate: Estimate, stamp_ns: int, space: str) -> None:
        """Publish what is due of a driver after a sample; ``space`` such as ``vehicle_07/``."""
        vehicle = follower.vehicle
        due = [one for one in self.outputs if self._is_due(vehicle, one, stamp_ns)]
        if not due or isnan(estimate.speed):
            return
        path = follower.predict(estimate, stamp_ns, max(one.ahead_s for one in due))
        known = Known(stamp_ns, vehicle, path, Places(road, self._line, self._frame))
        for one in due:
            self._told_ns[vehicle, one.name] = stamp_ns
            publisher = self._node.stream(one.kind, space + one.name)
            for message in one.messages(known):
                self._node.send(publisher, message)

    def _is_due(self, vehicle: int, output: DriverOutput, stamp_ns: int) -> bool:
        told_ns = self._told_ns.get((vehicle, output.name))
        return told_ns is None or not 0 <= stamp_ns - told_ns < output.every_s * NS

    def retire(self, vehicle: int, space: str) -> None:
        """Take down the topics of a driver who has gone."""
        for one in self.outputs:
            self._told_ns.pop((vehicle, one.name), None)
            self._node.end_stream(space + one.name)
