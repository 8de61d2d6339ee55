"""Follow the vehicles that a perception sees, and record everything.

    ros2 launch sugiyama_ros live.launch.py centre_line:=LINE.csv topics:="['/car*/odom']" output:=FILE.mcap
        [frame:=map] [model:=MODEL.yaml] [critic:=true] [namespace:=NAME] [use_sim_time:=true]

The critic follows the vehicles in view. The launch ends with Ctrl-C; the file is finished then.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, GroupAction, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node, PushROSNamespace, SetParameter

from launch import LaunchContext, LaunchDescription
from sugiyama_ros.nodes.base import environment

#: How often a node that was killed starts again.
RETRIES = 5
FLAG = ["true", "false"]


def nodes(context: LaunchContext) -> list[GroupAction]:
    """Tracks, all drivers in view, and a recorder."""
    import yaml

    def given(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    config, package = Path(given("config")), "sugiyama_ros"
    line = {"centre_line": given("centre_line"), "topics": yaml.safe_load(given("topics")), "frame": given("frame")}
    # a parameter of the file holds for all drivers, whatever a model says of them
    model, has_critic = [{"model": given("model")}] if given("model") else [], given("critic") == "true"
    again = {"respawn": True, "respawn_delay": 1.0, "respawn_max_retries": RETRIES}
    everything = [
        PushROSNamespace(given("namespace")),
        SetParameter("use_sim_time", given("use_sim_time") == "true"),
        # the recorder ends last, so it gets more time before it is killed
        Node(
            package=package,
            executable="sugiyama_recorder",
            parameters=[config / "recorder.yaml", {"output": given("output")}],
            sigterm_timeout="20",
            on_exit=Shutdown(reason="the recorder has ended"),
        ),
        Node(package=package, executable="sugiyama_drivers", parameters=model or [config / "drivers.yaml"], **again),
        *(
            [Node(package=package, executable="sugiyama_critic", parameters=[config / "critic.yaml"])]
            if has_critic
            else []
        ),
        Node(package=package, executable="sugiyama_tracks", parameters=[config / "tracks.yaml", line], **again),
    ]
    return [GroupAction(everything)]


def generate_launch_description() -> LaunchDescription:
    """Arguments and nodes."""
    environment.find_packages()
    config = Path(get_package_share_directory("sugiyama_ros")) / "config"
    return LaunchDescription(
        [
            DeclareLaunchArgument("centre_line", description="centre lines of the lanes (CSV)"),
            DeclareLaunchArgument("topics", description="patterns of the topics of vehicles, as a list in YAML"),
            DeclareLaunchArgument("frame", default_value="", description="frame of the centre line"),
            DeclareLaunchArgument("model", default_value="", description="model file from which drivers start"),
            DeclareLaunchArgument(
                "critic", default_value="false", choices=FLAG, description="whether a critic listens"
            ),
            DeclareLaunchArgument("namespace", default_value="", description="namespace of all nodes"),
            DeclareLaunchArgument(
                "use_sim_time", default_value="false", choices=FLAG, description="whether the time is that of /clock"
            ),
            DeclareLaunchArgument("output", description="MCAP file, or directory, to write"),
            DeclareLaunchArgument("config", default_value=str(config), description="directory of parameter files"),
            OpaqueFunction(function=nodes),
        ]
    )
