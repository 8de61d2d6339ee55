"""The simulator as a node: drivers who differ and change, the truth, and runs that are compared with it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger
from sugiyama_msgs.msg import MeasuredPositions, StyleChange, TrueParameters, Truth
from sugiyama_msgs.srv import SetDriver

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.truth import read_truth
from sugiyama_ros.nodes.base.qos import LATCHED, STREAM, WINDOW
from sugiyama_ros.nodes.drivers import DriversNode
from sugiyama_ros.nodes.plan import FromSimulator
from sugiyama_ros.nodes.run import run
from sugiyama_ros.nodes.simulator import SimulatorNode
from sugiyama_ros.page.truth import against_truth
from sugiyama_ros.simulation.experiment import Experiment

pytestmark = [pytest.mark.ros, pytest.mark.timeout(90)]


def simulator(**parameters: Any) -> SimulatorNode:
    return SimulatorNode(parameter_overrides=[Parameter(name, value=value) for name, value in parameters.items()])


class Listener(Node):
    """Hears one driver's truth, and their changes of style."""

    def __init__(self, vehicle: int) -> None:
        super().__init__("listener")
        self.truth: list[Truth] = []
        self.parameters: list[TrueParameters] = []
        self.samples: list[MeasuredPositions] = []
        self.changes: list[StyleChange] = []
        space = f"vehicle_{vehicle:02}"
        self.create_subscription(Truth, f"{space}/truth", self.truth.append, STREAM)
        self.create_subscription(TrueParameters, f"{space}/true_parameters", self.parameters.append, LATCHED)
        self.create_subscription(MeasuredPositions, "measured", self.samples.append, STREAM)
        self.create_subscription(StyleChange, f"{space}/style_change", self.changes.append, STREAM)

    def of(self, name: str) -> float:
        """Value of a true parameter as told last."""
        last = self.parameters[-1]
        return float(last.value[list(last.name).index(name)])


def test_one_driver_changes_and_all_drivers_change(stage) -> None:
    node, listener = simulator(vehicles=3, ring=60.0, rate=0.0, start_paused=True), Listener(1)
    stage.add(node, listener)
    stage.until(lambda: bool(listener.parameters))
    assert listener.of("v_star") == 10.26
    request = SetDriver.Request(vehicle=1, name=["v_star", "actuation_lag.time_constant"], value=[7.5, 0.4])
    assert stage.call(SetDriver, "/simulator/set_driver", request).success
    stage.until(lambda: listener.of("v_star") == 7.5 and listener.of("actuation_lag.time_constant") == 0.4)
    assert node.samples.simulator.drivers[:, 2].tolist() == [10.26, 7.5, 10.26]
    for vehicle, name, value, why in (
        (3, "v_star", 9.0, "vehicle 3: not on the road; give 0 to 2"),
        (1, "v_star", 900.0, "out of bounds; give 0.5 to 80"),
        (1, "v_star", float("nan"), "out of bounds"),
        (1, "no_such", 1.0, "not known"),
        (1, "no_such.time", 1.0, "no_such"),
    ):
        refused = stage.call(
            SetDriver, "/simulator/set_driver", SetDriver.Request(vehicle=vehicle, name=[name], value=[value])
        )
        assert not refused.success
        assert why in refused.message
    assert node.samples.simulator.drivers[1, 2] == 7.5
    for parameter in (Parameter("v_star", value=12), Parameter("kappa_v", value=0.3)):  # a whole number will do
        assert node.set_parameters([parameter])[0].successful
    stage.until(lambda: listener.of("v_star") == 12.0 and listener.of("kappa_v") == 0.3)
    for parameter in (Parameter("vehicles", value=4), Parameter("seed", value=1), Parameter("v_star", value="fast")):
        (refused,) = node.set_parameters([parameter])
        assert not refused.successful
        assert refused.reason


def test_without_an_end_and_as_fast_as_it_goes_it_still_hears_others(stage) -> None:
    """Nobody who reports progress is there to be waited for: a listener hears samples, and a pause is a pause."""
    node, listener = simulator(vehicles=3, ring=60.0, rate=0.0), Listener(1)
    stage.add(node, listener)
    stage.until(lambda: bool(listener.samples) and node.next_step > 3 * WINDOW)
    assert stage.call(Trigger, "/simulator/pause", Trigger.Request()).success
    paused_at = node.next_step
    stage.for_a_while(0.2)
    assert node.next_step == paused_at


def test_the_truth_is_what_the_drivers_do(stage) -> None:
    settings = {"vehicles": 4, "ring": 80.0, "start": "equal", "lengths": [4, 5, 6, 7], "sigma_nu": 0.01, "rate": 0.0}
    node, listener = simulator(duration=10.0, **settings), Listener(1)
    assert node.get_parameter("sigma_nu").value == 0.01
    stage.add(node, listener)
    stage.until(lambda: len(listener.samples) == 31 and len(listener.truth) == 31)
    assert list(listener.samples[0].length_m) == [4.0, 5.0, 6.0, 7.0]
    assert listener.truth[0].gap_m == pytest.approx((80.0 - 22.0) / 4)
    measured = np.array([m.position_m[1] for m in listener.samples])
    assert np.abs(measured - [m.position_m for m in listener.truth]).max() < 6 * 0.01
    assert [m.header.stamp for m in listener.truth] == [m.header.stamp for m in listener.samples]


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ({"start": "anyhow"}, "give jam, or on a ring equal"),
        ({"start": "equal", "ring": 0.0}, "give jam, or on a ring equal"),
        ({"lengths": [4.0, 5.0]}, "2 lengths of 22 vehicles"),
        ({"ring": 100.0}, "give a ring of "),
        ({"effects": ["drag"]}, "is not NAME:PARAMETER=VALUE"),
        ({"model": "/nowhere/model.yaml"}, "/nowhere/model.yaml"),
    ],
)
def test_a_start_that_is_not_possible(stage, wrong: dict[str, Any], why: str) -> None:
    with pytest.raises(InputError, match=why):
        simulator(**wrong)


class AskOnce:
    """Asks the simulator of a run, through its service, to let a driver drive otherwise from some step on."""

    def __init__(self, step: int, request: SetDriver.Request) -> None:
        self._step, self._request = step, request
        self._node: Node | None = None

    def __call__(self, steps: int, total: int) -> None:
        if self._node is None and steps >= self._step:
            self._node = Node("asks", start_parameter_services=False)
            client = self._node.create_client(SetDriver, "/simulator/set_driver")
            assert client.wait_for_service(10.0)
            client.call_async(self._request)

    def close(self) -> None:
        assert self._node is not None
        self._node.destroy_node()


def test_a_driver_who_is_changed_during_a_run_is_told_of(tmp_path: Path) -> None:
    """The report says when the estimator told of the change, and of nothing else."""
    request = SetDriver.Request(vehicle=1, name=["v_star"], value=[6.8])
    ask = AskOnce(300, request)
    drivers = FromSimulator(3, Experiment(ring_m=600.0, duration_s=400.0, start="equal", seed=1))
    result = run(drivers, tmp_path / "sim.mcap", on_progress=ask)
    assert (result.steps, result.messages_lost) == (1201, 0)
    found = against_truth(result.output)
    assert found is not None
    (change,) = found.changes
    assert (change.vehicle, change.name, change.before, change.after) == (1, "v_star", 10.26, 6.8)
    assert 100.0 <= change.time_s < 370.0
    assert 0.0 < change.told_s - change.time_s < 25.0
    assert found.false_alarms == 0
    ask.close()


def test_a_simulated_run_is_compared_with_the_truth(tmp_path: Path) -> None:
    """In one command: simulator, estimators, file; all is recorded, and the report finds the truth in it."""
    from sugiyama_ros.page.recording import read_recording

    drivers = FromSimulator(4, Experiment(ring_m=60.0, duration_s=60.0, spread=0.1, seed=3), changes={"kappa_v": 0.25})
    result = run(drivers, tmp_path / "sim.mcap")
    assert (result.steps, result.vehicles, result.messages_lost) == (181, 4, 0)
    truth = read_truth(result.output)
    assert truth is not None
    assert truth.position_m.shape == (181, 4)
    assert len(truth.drivers) == 4
    assert len({drive.parameters["v_star"] for drive in truth.drivers}) == 4
    found = against_truth(result.output, read_recording(result.output))
    assert found is not None
    assert {one.name for one in found.parameters} >= {"v_star", "kappa_v", "sigma_nu", "sigma_a"}
    true = {(drive.vehicle, name): value for drive in truth.drivers for name, value in drive.parameters.items()}
    for one in found.parameters:
        assert one.truth == true[one.vehicle, one.name]
        assert one.lower < one.estimate < one.upper
    # 8 intervals of 95 %: fewer than 5 hold the truth with a probability of 4e-4
    held = [one.covered for one in found.parameters if one.name in ("v_star", "kappa_v")]
    assert len(held) == 8
    assert sum(held) >= 5
    assert 0.0 < found.errors["speed_rmse"] < 1.0
    assert (found.changes, found.collisions) == ((), 0)
    assert len(found.table().rows) == 4


def test_a_controlled_vehicle_has_no_driver(stage) -> None:
    node = simulator(vehicles=3, ring=60.0, rate=20.0, controlled=[1], controller="constant_speed:target=3")
    listener, drivers = Listener(1), DriversNode()
    stage.add(node, listener, drivers)
    stage.until(lambda: bool(listener.truth) and abs(listener.truth[-1].speed - 3.0) < 1e-9)
    stage.until(lambda: set(drivers.drivers) == {0, 2})
    assert listener.parameters == []
    answer = stage.call(SetDriver, "/simulator/set_driver", SetDriver.Request(vehicle=1, name=["v_star"], value=[9.0]))
    assert answer.message == "vehicle 1: a controller drives it; give the number of a driver"
