"""Simulate drivers on a ring, follow each of them in a process of its own, and record everything.

    ros2 launch sugiyama_ros simulate.launch.py output:=FILE.mcap [vehicles:=22] [duration:=0.0] [rate:=1.0]
        [model:=MODEL.yaml] [critic:=true] [namespace:=NAME] [use_sim_time:=true] [config:=DIRECTORY]

The launch ends after ``duration`` [s], if it is not 0, or with Ctrl-C; the file is finished then.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, GroupAction, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node, PushROSNamespace, SetParameter

from launch import LaunchContext, LaunchDescription
from sugiyama_ros.nodes.base import environment
from sugiyama_ros.nodes.plan import one_for_each, paced_topics, within

#: How often a node that was killed starts again.
RETRIES = 5
FLAG = ["true", "false"]


def nodes(context: LaunchContext) -> list[GroupAction]:
    """One simulator, one recorder, and one node for each driver."""

    def given(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    config = Path(given("config"))
    vehicles = range(int(given("vehicles")))
    package = "sugiyama_ros"
    around, model, has_critic = given("namespace"), given("model"), given("critic") == "true"
    drivers = one_for_each(vehicles, {"ask_keeper": True, **({"model": model} if model else {})})
    names = ["recorder", *drivers, *(["critic"] if has_critic else [])]
    paced = within(around, paced_topics(vehicles, vehicles))
    recorder = {"output": given("output"), "paced_topics": paced, "time_source": "data"}
    simulator = {
        "vehicles": len(vehicles),
        "duration": float(given("duration")),
        "exit_at_end": True,
        "rate": float(given("rate")),
        "wait_for": within(around, [f"/{name}" for name in names]),
    }
    critic = [Node(package=package, executable="sugiyama_critic", parameters=[config / "critic.yaml"])]
    everything = [
        PushROSNamespace(around),
        SetParameter("use_sim_time", given("use_sim_time") == "true"),
        # the recorder ends last, so it gets more time before it is killed
        Node(
            package=package,
            executable="sugiyama_recorder",
            parameters=[config / "recorder.yaml", recorder],
            sigterm_timeout="20",
            on_exit=Shutdown(reason="the recorder has ended"),
        ),
        Node(package=package, executable="sugiyama_keeper"),
        *(critic if has_critic else []),
        *(
            Node(
                package=package,
                executable="sugiyama_drivers",
                name=name,
                parameters=[*([] if model else [config / "drivers.yaml"]), parameters],
                respawn=True,
                respawn_delay=1.0,
                respawn_max_retries=RETRIES,
            )
            for name, parameters in drivers.items()
        ),
        Node(
            package=package,
            executable="sugiyama_simulator",
            parameters=[config / "simulator.yaml", simulator],
            on_exit=Shutdown(reason="the simulator has ended"),
        ),
    ]
    return [GroupAction(everything)]


def generate_launch_description() -> LaunchDescription:
    """Arguments and nodes."""
    environment.find_packages()
    config = Path(get_package_share_directory("sugiyama_ros")) / "config"
    return LaunchDescription(
        [
            DeclareLaunchArgument("output", description="MCAP file to write"),
            DeclareLaunchArgument("vehicles", default_value="22", description="number of vehicles"),
            DeclareLaunchArgument(
                "duration", default_value="0.0", description="time [s] of the simulation; 0: endless"
            ),
            DeclareLaunchArgument("rate", default_value="1.0", description="times real time; 0: as fast as possible"),
            DeclareLaunchArgument("model", default_value="", description="model file from which drivers start"),
            DeclareLaunchArgument(
                "critic", default_value="false", choices=FLAG, description="whether a critic listens"
            ),
            DeclareLaunchArgument("namespace", default_value="", description="namespace of all nodes"),
            DeclareLaunchArgument(
                "use_sim_time", default_value="false", choices=FLAG, description="whether the time is that of /clock"
            ),
            DeclareLaunchArgument("config", default_value=str(config), description="directory of parameter files"),
            OpaqueFunction(function=nodes),
        ]
    )
