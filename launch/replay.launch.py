"""Replay a recording through one estimator for each driver and record everything.

    ros2 launch sugiyama_ros replay.launch.py source:=FILE output:=FILE.mcap [rate:=1.0] [ring:=230.0]

``rate:=0.0`` is as fast as the nodes take it; ``ring`` is needed only where the file does not say it.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from sugiyama_ros.formats.registry import known_suffixes
from sugiyama_ros.nodes.base import environment
from sugiyama_ros.nodes.plan import Plan, RunSettings


def nodes(context: LaunchContext) -> list[Node]:
    """One replay, one recorder, and one estimator for each vehicle of the file."""

    def given(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    config = Path(given("config"))
    settings = RunSettings(rate=float(given("rate")), ring_m=float(given("ring")) or None)
    plan = Plan.read(Path(given("source")), Path(given("output")), settings)
    package = "sugiyama_ros"
    return [
        Node(package=package, executable="recorder", parameters=[config / "recorder.yaml", plan.recorder]),
        Node(package=package, executable="keeper"),
        *(
            Node(
                package=package,
                executable="estimator",
                namespace=namespace,
                parameters=[config / "estimator.yaml", {"ask_keeper": True}],
                respawn=True,
            )
            for namespace in plan.namespaces
        ),
        Node(package=package, executable="replay", parameters=[config / "replay.yaml", plan.sending]),
    ]


def generate_launch_description() -> LaunchDescription:
    """Arguments and nodes."""
    environment.find_packages()
    config = Path(get_package_share_directory("sugiyama_ros")) / "config"
    return LaunchDescription(
        [
            DeclareLaunchArgument("source", description=f"file of trajectories: {known_suffixes()}"),
            DeclareLaunchArgument("output", description="MCAP file to write"),
            DeclareLaunchArgument("rate", default_value="1.0", description="times real time; 0: as fast as possible"),
            DeclareLaunchArgument("ring", default_value="0.0", description="circumference [m]; 0: as the file says"),
            DeclareLaunchArgument("config", default_value=str(config), description="directory of parameter files"),
            OpaqueFunction(function=nodes),
        ]
    )
