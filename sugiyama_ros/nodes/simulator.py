"""Simulated vehicles as a source of measured positions."""

from typing import Any

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from sugiyama_ros.driver.parameters import NAMES, defaults
from sugiyama_ros.nodes.base.node import ERROR, Health
from sugiyama_ros.nodes.base.samples import Positions
from sugiyama_ros.nodes.base.spin import run_node
from sugiyama_ros.nodes.driver_parameters import declare_driver
from sugiyama_ros.nodes.source import Source
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Clock, Simulator, platoon
from sugiyama_ros.trajectories.trajectories import DEFAULT_LENGTH_M


class Simulated:
    """A running simulation as samples. It only goes forward."""

    start_s = 0.0
    steps = 0
    source = "adaptiveSeek"
    sha256 = ""

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        self.road, self.period_s = simulator.road, simulator.period_s
        self.collisions = 0

    def at(self, step: int) -> Positions:
        """Sample number ``step``, which is the current sample or the next."""
        s = self._simulator
        if step > s.step_number:
            self.collisions += len(s.step())
        return Positions(list(range(len(s.length_m))), s.leader.tolist(), s.measure().tolist(), s.length_m.tolist())


class SimulatorNode(Source):
    """Simulates drivers, and sends the positions that a camera would measure.

    The drivers are identical and start from rest, in a jam. Parameters of the node: ``vehicles``, ``ring``,
    ``start_gap``, ``period``, ``seed``, the parameters of a driver, and the parameters of `Source`.
    """

    samples: Simulated

    def __init__(self, **options: Any) -> None:
        super().__init__("simulator", **options)

    def open(self) -> Simulated:
        """A simulation with the node's parameters."""
        declare_driver(self, defaults())
        whole = self._integer
        vehicles = whole("vehicles", 22, 1, 1000, "number of vehicles")
        ring_m = self._real("ring", 230.0, 0.0, 1e5, "circumference [m]; 0: an open road")
        gap_m = self._real("start_gap", 2.0, 0.1, 1e3, "gap [m] between vehicles at the start")
        period_s = self._real("period", 1.0 / 3.0, 0.05, 1.0, "time [s] between samples")
        seed = whole("seed", 0, 0, 2**31 - 1, "seed of the noise")
        length_m = np.full(vehicles, DEFAULT_LENGTH_M)
        driver = np.array([self.get_parameter(name).value for name in NAMES])
        return Simulated(
            Simulator(
                np.tile(driver, (vehicles, 1)),
                length_m,
                platoon(length_m, gap_m),
                Road(ring_m),
                np.random.default_rng(seed),
                clock=Clock(period_s),
            )
        )

    def health(self) -> Health:
        """ERROR once vehicles have collided, because the model is not valid after that; else as `Source`."""
        collisions = self.samples.collisions
        if collisions:
            return Health(ERROR, f"{collisions} collisions", {"step": self.next_step, "collisions": collisions})
        return super().health()

    def _integer(self, name: str, default: int, lower: int, upper: int, description: str) -> int:
        bounds = IntegerRange(from_value=lower, to_value=upper)
        about = ParameterDescriptor(description=description, integer_range=[bounds], read_only=True)
        return int(self.declare_parameter(name, default, about).value)

    def _real(self, name: str, default: float, lower: float, upper: float, description: str) -> float:
        bounds = FloatingPointRange(from_value=lower, to_value=upper)
        about = ParameterDescriptor(description=description, floating_point_range=[bounds], read_only=True)
        return float(self.declare_parameter(name, default, about).value)


def main() -> None:
    """Run the simulator."""
    run_node(SimulatorNode)


if __name__ == "__main__":
    main()
