"""Parameters of nodes: names that no node has, and values with which a node cannot work, are refused in one line."""

import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from sugiyama_ros.errors import SugiyamaError
from sugiyama_ros.nodes.base.names import PARAMETERS_OF
from sugiyama_ros.nodes.executables import NODES

pytestmark = [pytest.mark.ros, pytest.mark.timeout(90)]
Make = Callable[..., Any]


@pytest.fixture
def make(stage, ring_csv: Path, tmp_path: Path) -> Make:
    """What makes a node with arguments of the command line, beside those without which it does not start."""
    (tmp_path / "line.csv").write_text("x,y\n0,0\n100,0\n")
    needed = {
        "recorder": {"output": str(tmp_path / "out.mcap")},
        "replay": {"source": str(ring_csv), "ring": "100.0"},
        "tracks": {"centre_line": str(tmp_path / "line.csv"), "topics": "['/a']"},
    }

    def make(name: str, *arguments: str, **given: str) -> Any:
        pairs = [f"{key}:={value}" for key, value in (needed.get(name, {}) | given).items()]
        options = [word for pair in pairs for word in ("-p", pair)]
        node = getattr(import_module(f"sugiyama_ros.nodes.{name}"), NODES[name])(
            cli_args=["--ros-args", *options, *arguments]
        )
        stage.add(node)
        return node

    return make


@pytest.mark.parametrize("name", NODES)
def test_the_names_of_a_nodes_parameters_are_those_that_it_declares(make: Make, name: str) -> None:
    node = make(name)
    of_ros = {"use_sim_time", "start_type_description_service"}
    assert set(node.get_parameters_by_prefix("")) - of_ros == set(PARAMETERS_OF[name])
    node.close()


@pytest.mark.parametrize("name", NODES)
def test_every_node_refuses_a_parameter_that_no_node_has(make: Make, name: str) -> None:
    with pytest.raises(SugiyamaError, match=f"^parameter robot_name: {name} has none of this name"):
        make(name, robot_name="x")


@pytest.mark.parametrize(
    ("name", "given", "nearest"),
    [
        ("drivers", "vehicle_topic", "vehicle_topics"),
        ("drivers", "vehicle", "vehicles"),
        ("recorder", "paced_topic", "paced_topics"),
        ("replay", "sorce", "source"),
        ("simulator", "vehicle", "vehicles"),
        ("tracks", "center_line", "centre_line"),
    ],
)
def test_the_nearest_name_is_told(make: Make, name: str, given: str, nearest: str) -> None:
    wanted = f"^parameter {given}: seven has none of this name, the nearest is {nearest};"
    with pytest.raises(SugiyamaError, match=wanted):
        make(name, "-r", "__node:=seven", **{given: "[7]"})


def test_a_misspelt_parameter_ends_a_node_with_one_line() -> None:
    command = [sys.executable, "-m", "sugiyama_ros.nodes.executables", "drivers", "--ros-args", "-p", "vehicle:=[7]"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=80)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.splitlines() == [
        "parameter vehicle: drivers has none of this name, the nearest is vehicles; correct it, or give what is for"
        " another node under its name, not under /**"
    ]


def test_a_file_for_several_nodes(make: Make, tmp_path: Path) -> None:
    """Every node gets the section ``/**``: it takes its own parameters and those of ROS, and leaves those of others."""
    file = tmp_path / "all.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n    use_sim_time: true\n    rate: 0.5\n    sigma_nu: 0.3\n"
        "    start_type_description_service: true\n    qos_overrides:\n      /measured:\n        publisher:\n"
        "          depth: 9\n"
        "drivers:\n  ros__parameters:\n    vehicles: [7]\n"
        "some_other_node:\n  ros__parameters:\n    robot_name: x\n"
    )
    wanted = {"use_sim_time": True, "rate": 0.5, "sigma_nu": 0.3, "vehicles": [7]}
    for name in ("drivers", "critic", "recorder", "keeper"):
        node = make(name, "--params-file", str(file))
        own = {key: value for key, value in wanted.items() if key in (*PARAMETERS_OF[name], "use_sim_time")}
        assert {key: node.get_parameter(key).value for key in own} == own
        assert not node.has_parameter("rate")
        node.close()
    file.write_text(file.read_text().replace("sigma_nu", "sigma_mu"))
    with pytest.raises(
        SugiyamaError, match=r"^parameter sigma_mu: critic has none of this name, the nearest is sigma_"
    ):
        make("critic", "--params-file", str(file))


@pytest.mark.parametrize(
    ("name", "given", "why"),
    [
        ("drivers", "vehicles:=[]", "vehicles: what was given is not a list of whole numbers; give one such as [-1]"),
        ("drivers", "vehicles:=7", "vehicles: what was given is not a list of whole numbers; give one such as [-1]"),
        ("drivers", "vehicles:=[-7]", "vehicles: -7 is no vehicle, or was named before; give numbers from 0 on"),
        ("drivers", "vehicles:=[7, 7]", "vehicles: 7 is no vehicle, or was named before"),
        ("drivers", "vehicles:=[-1, 7]", "each once, or -1 alone for every vehicle in view"),
        ("drivers", "vehicles:=[3000000000]", "vehicles: 3000000000 is no vehicle"),
        ("drivers", "resume:=/no/such/folder", "resume: /no/such/folder is no directory; give one that save_state"),
        ("drivers", "save_state:=/dev/null/state", "/dev/null/state: cannot be written"),
        ("drivers", "v_star:=.nan", "v_star: out of bounds; give 0.5 to 80"),
        ("drivers", "v_star:=[]", "v_star: what was given is not a number"),
        ("drivers", "most_drivers:=0", "most_drivers: out of bounds; give 1 to 100000"),
        ("drivers", "use_sim_time:=[]", "use_sim_time: what was given is not true or false"),
        ("recorder", "split_mb:=-1", "split_mb: out of bounds; give 0 to"),
        ("recorder", "split_mb:=.nan", "split_mb: out of bounds"),
        ("recorder", "paced_topics:=[measured]", "paced_topics: measured is no full name; give /measured"),
        ("recorder", "time_source:=''", "time_source '' is not known; give wall or data"),
        ("replay", "ring:=-230.0", "ring: out of bounds; give 0 to 10000000"),
        ("replay", "ring:=.inf", "ring: out of bounds"),
        ("replay", "wait_for:=[recorder]", "wait_for: recorder is no full name; give /recorder"),
        ("simulator", "controlled:=[-7]", "controlled: -7 is no vehicle, or was named before"),
        ("simulator", "lengths:=[]", "lengths: what was given is not a list of numbers; give one such as [0.0]"),
        ("simulator", "lengths:=[.nan]", "give one each, or one for all, 0.01 to 100 m"),
        ("tracks", "topics:=[]", "no centre line or no topics given"),
    ],
)
def test_a_value_with_which_a_node_cannot_work(make: Make, name: str, given: str, why: str) -> None:
    key, _, value = given.partition(":=")
    with pytest.raises(SugiyamaError) as raised:
        make(name, **{key: value})
    assert why in str(raised.value)


def test_an_empty_list_of_texts_is_a_list_without_texts(make: Make) -> None:
    assert "once" not in make("simulator", wait_for="[]", effects="[]", start_paused="true").doing
    assert make("drivers", adapt="[]", publish="[]").health().message.startswith("waiting for a road")
    recorder = make("recorder", paced_topics="[]", metadata="[]")
    recorder.close()


def test_a_directory_is_made_that_save_state_names_and_may_be_resumed(make: Make, tmp_path: Path) -> None:
    folder = str(tmp_path / "new" / "state")
    make("drivers", save_state=folder, resume=folder)
    assert Path(folder).is_dir()
