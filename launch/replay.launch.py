"""Replay a recording, follow each driver in a process of its own, and record everything.

    ros2 launch sugiyama_ros replay.launch.py source:=FILE output:=FILE.mcap [rate:=1.0] [ring:=230.0]
        [model:=MODEL.yaml] [critic:=true] [namespace:=NAME] [use_sim_time:=true]

``rate:=0.0`` is as fast as the nodes take it; ``ring`` is needed only where the file does not say it. The launch ends
with the replay, or with Ctrl-C; the file is finished then.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, GroupAction, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node, PushROSNamespace, SetParameter

from launch import LaunchContext, LaunchDescription
from sugiyama_ros.formats.registry import known_suffixes
from sugiyama_ros.nodes.base import environment
from sugiyama_ros.nodes.plan import RunSettings, one_for_each, plan_of, within

#: How often a node that was killed starts again.
RETRIES = 5
FLAG = ["true", "false"]


def nodes(context: LaunchContext) -> list[GroupAction]:
    """One replay, one recorder, and one node for each driver of the file; on tracks, one node for all in view."""

    def given(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    config = Path(given("config"))
    settings = RunSettings(
        rate=float(given("rate")),
        ring_m=float(given("ring")) or None,
        model=Path(given("model")) if given("model") else None,
        critic=given("critic") == "true",
    )
    plan = plan_of(Path(given("source")), Path(given("output")), settings)
    package = "sugiyama_ros"
    space = given("namespace")
    own = plan.vehicles_with_topics
    drivers = one_for_each(own, plan.drivers | {"ask_keeper": True}) if own else {"drivers": plan.drivers}
    recorder = {**plan.recorder, "paced_topics": within(space, plan.paced_topics)}
    sending = plan.sending(drivers)
    sending |= {"wait_for": within(space, sending["wait_for"]), "exit_at_end": True}
    critic = [Node(package=package, executable="sugiyama_critic", parameters=[config / "critic.yaml"])]
    everything = [
        PushROSNamespace(space),
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
        *(critic if settings.critic else []),
        *(
            Node(
                package=package,
                executable="sugiyama_drivers",
                name=name,
                parameters=[*([] if settings.model else [config / "drivers.yaml"]), parameters],
                respawn=True,
                respawn_delay=1.0,
                respawn_max_retries=RETRIES,
            )
            for name, parameters in drivers.items()
        ),
        Node(
            package=package,
            executable="sugiyama_replay",
            parameters=[config / "replay.yaml", sending],
            on_exit=Shutdown(reason="the replay has ended"),
        ),
    ]
    return [GroupAction(everything)]


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
