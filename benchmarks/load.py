"""What one node for all drivers can take: many drivers, measured in real time, followed by a process of its own.

    python -m benchmarks.load [--drivers 500] [--rate 10] [--duration 60] [--json]

The positions are those of platoons on an open road, 10 cars each, with noise. They are sent by the clock, without
pacing, as perception sends them. Printed is what the node counts, what came back, and what its process took.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rclpy.node import Node
from sugiyama_msgs.msg import DriverArray, MeasuredPositions
from sugiyama_msgs.msg import Road as RoadMessage

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import SugiyamaError
from sugiyama_ros.nodes.base import cdr_messages, environment
from sugiyama_ros.nodes.base.qos import LATCHED, STREAM
from sugiyama_ros.nodes.base.spin import Spinner, ros
from sugiyama_ros.trajectories.placing import Positions

_PLATOON, _HEADWAY_M, _SPEED, _NOISE_M, _LENGTH_M = 10, 25.0, 12.0, 0.2, 4.5
_START_S, _LAST_S = 120.0, 3.0


@dataclass(frozen=True)
class Load:
    """What was measured.

    drivers, samples, answers: drivers in every sample, samples sent, and messages about all drivers that came back;
    lost: samples without an answer, or with an answer that lacks a driver; cpu_s, wall_s: time of the processor [s] of
    the node's process while the samples came, and the time that they took; delay_ms: median, 99th percentile and
    largest time [ms] from a sample to its answer; memory_mb: largest memory of the node's process [MB].
    """

    drivers: int
    samples: int
    answers: int
    lost: int
    cpu_s: float
    wall_s: float
    delay_ms: tuple[float, float, float]
    memory_mb: float


class _Perception(Node):
    """Sends samples by the clock, and notes when an answer comes."""

    def __init__(self, drivers: int, period_s: float) -> None:
        super().__init__("perception")
        self.sent_s: dict[int, float] = {}
        self.answered_s: dict[int, float] = {}
        self.complete = 0
        self._drivers = drivers
        self._to_road = self.create_publisher(RoadMessage, "road", LATCHED)
        self._to_measured = self.create_publisher(MeasuredPositions, "measured", STREAM)
        self.create_subscription(DriverArray, "drivers", self._on_answer, STREAM, raw=True)
        self._to_road.publish(RoadMessage(circumference_m=0.0, period_s=period_s))

    @property
    def is_heard(self) -> bool:
        """Whether somebody listens to the samples, and answers."""
        return self._to_measured.get_subscription_count() > 0 and self.count_publishers("drivers") > 0

    def send(self, stamp_ns: int, step: int, positions: Positions) -> None:
        """Send one sample."""
        self.sent_s[stamp_ns] = time.monotonic()
        self._to_measured.publish(cdr_messages.measured_positions(stamp_ns, step, positions))

    def _on_answer(self, raw: bytes) -> None:
        # stamp, name of the frame, and then the number of drivers
        sec, nanosec, frame = np.frombuffer(raw, "<i4", 3, 4).tolist()
        at = 16 + -(-frame // 4) * 4
        self.complete += int(np.frombuffer(raw, "<i4", 1, at)[0]) == self._drivers
        self.answered_s[sec * cdr_messages.NS + nanosec] = time.monotonic()


def measure(drivers: int, rate_hz: float, duration_s: float) -> Load:
    """Follow many drivers for some time.

    rate_hz, duration_s: samples a second [Hz], and how long they come [s]. Raises SugiyamaError.
    """
    environment.isolate()
    command = [sys.executable, "-m", "sugiyama_ros.nodes.executables", "drivers"]
    child = subprocess.Popen(command)
    try:
        with ros():
            perception = _Perception(drivers, 1.0 / rate_hz)
            spinner = Spinner([perception])
            spinner.until(lambda: perception.is_heard or child.poll() is not None, _START_S)
            spinner.until(lambda: False, 1.0)
            if child.poll() is not None or not perception.is_heard:
                raise SugiyamaError("the node of all drivers has not started")
            load = _drive(perception, spinner, child.pid, drivers, rate_hz, duration_s)
            spinner.close()
            perception.destroy_node()
        return load
    finally:
        child.terminate()
        child.wait()


def _drive(
    perception: _Perception, spinner: Spinner, pid: int, drivers: int, rate_hz: float, duration_s: float
) -> Load:
    """Send the samples, and wait for the last answers."""
    rng = np.random.default_rng(0)
    place = np.arange(drivers)
    start_m: Array = -_HEADWAY_M * (place % _PLATOON) + 10.0 * _HEADWAY_M * (place // _PLATOON)
    leader = np.where(place % _PLATOON == 0, -1, place - 1).tolist()
    samples = round(duration_s * rate_hz)
    before_s, began_s = _cpu_s(pid), time.monotonic()
    for step in range(samples):
        due_s = began_s + step / rate_hz
        spinner.until(lambda due_s=due_s: time.monotonic() >= due_s, 1.0 / rate_hz)  # type: ignore[misc]
        position = start_m + _SPEED * step / rate_hz + rng.normal(0.0, _NOISE_M, drivers)
        positions = Positions(place.tolist(), leader, position.tolist(), [_LENGTH_M] * drivers)
        perception.send(round(step / rate_hz * cdr_messages.NS), step, positions)
    spinner.until(lambda: len(perception.answered_s) == samples, _LAST_S)
    delays = [1e3 * (at - perception.sent_s[stamp]) for stamp, at in perception.answered_s.items()]
    median, most, worst = np.percentile(delays, (50, 99, 100)).tolist() if delays else (np.nan,) * 3
    return Load(
        drivers=drivers,
        samples=samples,
        answers=len(delays),
        lost=samples - perception.complete,
        cpu_s=_cpu_s(pid) - before_s,
        wall_s=time.monotonic() - began_s,
        delay_ms=(median, most, worst),
        memory_mb=_memory_mb(pid),
    )


def _cpu_s(pid: int) -> float:
    """Time of the processor [s] that a process has taken so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _memory_mb(pid: int) -> float:
    """Largest memory [MB] that a process has used so far."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1024.0


def main() -> None:
    """Measure what the arguments ask for, and print it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drivers", type=int, default=500)
    parser.add_argument("--rate", type=float, default=10.0)
    parser.add_argument("--duration", type=float, default=60.0)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    load = measure(given.drivers, given.rate, given.duration)
    if given.json:
        print(json.dumps(asdict(load)))
        return
    median, most, worst = load.delay_ms
    print(
        f"{load.drivers} drivers, {load.samples} samples in {load.wall_s:.0f} s: {load.lost} lost;"
        f" {load.cpu_s:.1f} s of the processor, {load.memory_mb:.0f} MB;"
        f" answers after {median:.0f} ms, 99 % within {most:.0f} ms, all within {worst:.0f} ms"
    )


if __name__ == "__main__":
    main()
