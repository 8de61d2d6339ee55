"""Parameter files and launch files fit the code."""

import ast
import socket
from importlib.metadata import entry_points
from pathlib import Path

import pytest
import yaml
from rclpy.parameter import Parameter

from sugiyama_ros.driver.parameters import NAMES
from sugiyama_ros.nodes.base.environment import is_free
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.critic import Critic
from sugiyama_ros.nodes.drivers import DriversNode
from sugiyama_ros.nodes.recorder import Recorder
from sugiyama_ros.nodes.replay import Replay
from sugiyama_ros.nodes.simulator import SimulatorNode
from sugiyama_ros.nodes.tracks import TracksNode

ROOT = Path(__file__).parents[2]
WITHOUT_PARAMETERS = "keeper"
EXECUTABLES = ("critic", "drivers", "recorder", "replay", "simulator", "tracks")


def make(executable: str, road_csv: Path, tmp_path: Path) -> PacedNode:
    """A node with only the parameters that it requires."""
    if executable == "critic":
        return Critic()
    if executable == "drivers":
        return DriversNode()
    if executable == "recorder":
        return Recorder(parameter_overrides=[Parameter("output", value=str(tmp_path / "out.mcap"))])
    if executable == "replay":
        return Replay(parameter_overrides=[Parameter("source", value=str(road_csv))])
    if executable == "tracks":
        (tmp_path / "line.csv").write_text("x,y\n0,0\n9,0\n")
        given = {"centre_line": str(tmp_path / "line.csv"), "topics": ["/car*/odom"]}
        return TracksNode(parameter_overrides=[Parameter(name, value=value) for name, value in given.items()])
    return SimulatorNode()


@pytest.mark.ros
@pytest.mark.timeout(60)
@pytest.mark.parametrize("executable", EXECUTABLES)
def test_parameter_files_say_what_the_code_does(stage, road_csv: Path, tmp_path: Path, executable: str) -> None:
    given = yaml.safe_load((ROOT / "config" / f"{executable}.yaml").read_text())["/**"]["ros__parameters"]
    node = make(executable, road_csv, tmp_path)
    stage.add(node)
    for name, value in given.items():
        assert node.has_parameter(name), name
        assert node.get_parameter(name).value == value, name
        assert node.describe_parameter(name).description, name
    if executable == "drivers":
        assert set(NAMES) <= set(given)
    node.close()


def test_there_is_a_file_for_each_executable_with_parameters() -> None:
    assert sorted(p.stem for p in (ROOT / "config").iterdir()) == list(EXECUTABLES)


def launched(path: Path) -> list[dict[str, str]]:
    """Constant arguments of each Node(...) in a launch file."""
    calls = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Call)]
    nodes = [c for c in calls if isinstance(c.func, ast.Name) and c.func.id == "Node"]
    return [{k.arg: k.value.value for k in n.keywords if k.arg and isinstance(k.value, ast.Constant)} for n in nodes]


@pytest.mark.parametrize("path", sorted((ROOT / "launch").glob("*.launch.py")), ids=lambda p: p.name)
def test_launch_files_start_what_is_there(path: Path) -> None:
    compile(path.read_text(), str(path), "exec")
    assert "def generate_launch_description()" in path.read_text()
    executables = {node["executable"] for node in launched(path)}
    assert {"sugiyama_recorder"} < executables <= {f"sugiyama_{node}" for node in (*EXECUTABLES, WITHOUT_PARAMETERS)}
    installed = {e.name for e in entry_points(group="console_scripts") if e.value.startswith("sugiyama_ros.nodes.")}
    if installed:  # a checkout that is not installed has no executables
        assert executables <= installed


def test_a_domain_is_not_free_while_any_of_its_participants_lives() -> None:
    domain = next(filter(is_free, range(1, 102)))  # any domain may be in use: by another test, or beside the tests
    for port in (7410 + 250 * domain, 7410 + 250 * domain + 46):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as held:
            held.bind(("", port))
            assert not is_free(domain)
    assert is_free(domain)
