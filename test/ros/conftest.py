"""Nodes under test: each test has a ROS domain of its own, a deadline, and no way to reach another machine."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.node import Node

from sugiyama_ros.nodes.base import environment
from sugiyama_ros.nodes.base.spin import Spinner, ros
from sugiyama_ros.nodes.run import RunResult, run


def isolate(monkeypatch: pytest.MonkeyPatch) -> None:
    """Choose a free domain; the environment variables are restored afterwards."""
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_DOMAIN_ID"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    environment.isolate()


@pytest.fixture(autouse=True)
def own_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each test has a domain of its own."""
    isolate(monkeypatch)


class Stage:
    """Nodes that are executed together."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._spinner: Spinner | None = None

    def add(self, *nodes: Node) -> None:
        """Add nodes to be executed. Call it before the first ``until``."""
        assert self._spinner is None
        self.nodes += nodes

    def kill(self, node: Node) -> None:
        """Take a node down without an orderly end. Other nodes may be added then."""
        self.suspend()
        self.nodes.remove(node)
        node.destroy_node()

    def suspend(self) -> None:
        """Carry out nothing until the next ``until``. Other nodes may be added then."""
        assert self._spinner is not None
        self._spinner.close()
        self._spinner = None

    def until(self, done: Callable[[], bool], timeout_s: float = 20.0) -> None:
        """Carry out callbacks until ``done()``; fails after ``timeout_s``."""
        self._spinner = self._spinner or Spinner(self.nodes)
        self._spinner.until(done, timeout_s)
        assert done(), f"not done after {timeout_s} s"

    def for_a_while(self, time_s: float) -> None:
        """Carry out callbacks for ``time_s``."""
        end = time.monotonic() + time_s
        self.until(lambda: time.monotonic() > end, 2.0 * time_s)

    def call(self, kind: type, service: str, request: object) -> Any:
        """Call a service of one of the nodes."""
        client = self.nodes[0].create_client(kind, service)
        self.until(client.service_is_ready)
        future = client.call_async(request)
        self.until(future.done)
        return future.result()

    def close(self) -> None:
        """Take everything down."""
        if self._spinner is not None:
            self._spinner.close()
        for node in self.nodes:
            node.destroy_node()


@pytest.fixture
def stage() -> Iterator[Stage]:
    """An empty stage, with rclpy up."""
    with ros():
        stage = Stage()
        yield stage
        stage.close()


def write_vehicles(path: Path, lap_m: float) -> Path:
    """Write 4 vehicles with 200 samples of 0.5 s; ``lap_m``: where positions begin anew [m]."""
    rng = np.random.default_rng(1)
    lines = ["time_s,vehicle,position_m,length_m"]
    for step in range(200):
        for vehicle in range(4):
            position = (25.0 * vehicle + 3.0 * step + rng.normal(0.0, 0.2)) % lap_m
            lines.append(f"{0.5 * step:.3f},{vehicle},{position:.4f},4.5")
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def ring_csv(tmp_path: Path) -> Path:
    """A file of 4 vehicles on a ring of 100 m, with 200 samples of 0.5 s. It does not give the ring's length."""
    return write_vehicles(tmp_path / "ring.csv", 100.0)


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, RunResult]:
    """A file of 4 vehicles on a ring of 100 m, and a run of it at full speed in one process."""
    folder = tmp_path_factory.mktemp("recorded")
    source = write_vehicles(folder / "ring.csv", 100.0)
    with pytest.MonkeyPatch.context() as monkeypatch:
        isolate(monkeypatch)
        return source, run(source, folder / "out.mcap", ring_m=100.0)


@pytest.fixture
def road_csv(tmp_path: Path) -> Path:
    """A file of 4 vehicles on an open road, with 200 samples of 0.5 s."""
    return write_vehicles(tmp_path / "road.csv", 1e6)
