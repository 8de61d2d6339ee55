"""Simulate drivers on a ring, follow each of them with an estimator, and record everything.

    ros2 launch sugiyama_ros simulate.launch.py output:=FILE.mcap [vehicles:=22] [rate:=1.0] [config:=DIRECTORY]

Stop it with Ctrl-C; the file is finished then.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from sugiyama_ros.formats.truth import namespaces
from sugiyama_ros.nodes.base import environment
from sugiyama_ros.nodes.plan import estimators, step_topics


def nodes(context: LaunchContext) -> list[Node]:
    """One simulator, one recorder, and one estimator for each vehicle."""

    def given(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    config = Path(given("config"))
    vehicles = int(given("vehicles"))
    spaces = namespaces(range(vehicles))
    package = "sugiyama_ros"
    recorder = {"output": given("output"), "paced_topics": step_topics(spaces)}
    simulator = {
        "vehicles": vehicles,
        "rate": float(given("rate")),
        "wait_for": ["/recorder", *estimators(spaces)],
    }
    return [
        Node(package=package, executable="recorder", parameters=[config / "recorder.yaml", recorder]),
        Node(package=package, executable="keeper"),
        *(
            Node(
                package=package,
                executable="estimator",
                namespace=space,
                parameters=[config / "estimator.yaml", {"ask_keeper": True}],
                respawn=True,
            )
            for space in spaces
        ),
        Node(package=package, executable="simulator", parameters=[config / "simulator.yaml", simulator]),
    ]


def generate_launch_description() -> LaunchDescription:
    """Arguments and nodes."""
    environment.find_packages()
    config = Path(get_package_share_directory("sugiyama_ros")) / "config"
    return LaunchDescription(
        [
            DeclareLaunchArgument("output", description="MCAP file to write"),
            DeclareLaunchArgument("vehicles", default_value="22", description="number of vehicles"),
            DeclareLaunchArgument("rate", default_value="1.0", description="times real time; 0: as fast as possible"),
            DeclareLaunchArgument("config", default_value=str(config), description="directory of parameter files"),
            OpaqueFunction(function=nodes),
        ]
    )
