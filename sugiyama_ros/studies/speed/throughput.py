"""How much a simulation and a bag take in."""

import tempfile
from pathlib import Path

import numpy as np

from sugiyama_ros.formats.mcap_writer import BagWriter
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon
from sugiyama_ros.studies.rings import CARS, JAM_GAP_M, LENGTH_M, RING_M, alike
from sugiyama_ros.studies.speed.figure import SpeedFigure, cpu_of_functions

_STEPS, _MESSAGES, _MESSAGE_BYTES = 200, 10_000, 100
#: Wanted time [µs] for one message of a bag: 150,000 messages in a second.
MESSAGE_AT_MOST_US = 6.7


def measure() -> tuple[SpeedFigure, ...]:
    """Measure the steps of a simulation and the messages of a bag."""
    length = np.full(CARS, LENGTH_M)
    start = platoon(length, JAM_GAP_M)
    simulator = Simulator(alike(), length, start, Road(RING_M), np.random.default_rng(0))

    def simulate() -> None:
        for _ in range(_STEPS):
            simulator.step()

    with tempfile.TemporaryDirectory() as folder, BagWriter(Path(folder) / "a.mcap") as bag:
        channel, data = bag.topic("/header", "std_msgs/msg/Header"), bytes(_MESSAGE_BYTES)

        def write() -> None:
            for k in range(_MESSAGES):
                bag.write(channel, data, k, k)

        spent = cpu_of_functions({"simulate": simulate, "write": write}, rounds=5)
    return (
        SpeedFigure(
            "simulation_us", "simulation, for each driver and step", 1e6 * spent["simulate"] / (CARS * _STEPS), "µs"
        ),
        SpeedFigure(
            "bag_message_us",
            f"one message of {_MESSAGE_BYTES} bytes in a bag",
            1e6 * spent["write"] / _MESSAGES,
            "µs",
            MESSAGE_AT_MOST_US,
        ),
    )
