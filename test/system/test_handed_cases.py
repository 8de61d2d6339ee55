"""What people typed who tried the package works, or else what the message says to do. Skipped without their files."""

import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from sugiyama_ros import cli

CASES = Path(__file__).parents[2].parent / "shared/cases"
pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(not CASES.exists(), reason="needs recordings that are not in the repository"),
]
CARS, LINE = "--odometry /car*/odom --centerline line.csv", "--centerline line.csv"
#: What people typed, behind the name of the case.
COMMANDS = (
    *(f"bag_definition_not_ros2msg convert {name}.mcap o.parquet {CARS}" for name in ("idl", "emptydef", "ros1")),
    f"bag_pedestrian_is_leader convert derived o.parquet --odometry /carla/objects {LINE}",
    f"bag_pedestrian_is_leader convert autoware o.parquet --odometry /perception/* {LINE}",
    f"bag_px4_microseconds convert px4.mcap o.parquet --odometry /px4_*/fmu/*/vehicle_* {LINE} --bridge px4.yaml",
    *(f"bag_rates_differ convert {name}.mcap o.parquet {CARS}" for name in ("r5", "rmix")),
    f"bag_reindexed_storage_empty convert rec o.parquet {CARS}",
    f"bag_rosbag2_compression convert msgmode_0.mcap o.parquet --odometry /* {LINE}",
    "bag_rosbag2_compression info mcap_zstd",
    f"bag_stamp_zero convert stamp0.mcap o.parquet {CARS}",
    *(
        f"bag_tf_not_interpolated convert {one}.mcap o.parquet --odometry /det {LINE} --frame map"
        for one in ("tf10", "tflate")
    ),
    f"bag_topic_after_topic convert bytopic.mcap o.parquet {CARS}",
    *(f"commonroad_bicycle_beside_car convert {name}.xml o.parquet" for name in ("overtaken", "beside")),
    "commonroad_goal_lanelet info cr_goal.xml",
    *(
        f"commonroad_pedestrian_and_parked convert {name}.xml o.parquet"
        for name in ("ped", "ped_ahead", "parked", "parked_between", "parked_between_2018b")
    ),
    "commonroad_uncertain_position info cr_rect.xml",
    *(f"csv_decimal_comma info {name}.csv" for name in ("cr", "de_dot", "de_first_whole")),
    *(
        f"ind_parked_and_bicycle convert {name}00_tracks.csv o.parquet --road-file map.osm{more}"
        for name, more in (("", ""), ("", " --without 2,3"), ("", " --class car"), ("parked/", ""), ("bicycle/", ""))
    ),
    "ind_without_recordingMeta convert 00_tracks.csv o.parquet --road-file map.osm",
    "lanelet2_empty_latlon convert vehicle_tracks_000.csv o.parquet --road-file map.osm",
    "lanelet2_zero_length_bound convert vehicle_tracks_000.csv o.parquet --road-file map.osm",
    "lanes_and_classes_as_text info tracks.csv",
    "map_with_missing_lanelet convert vehicle_tracks_000.csv o.parquet --road-file map.osm",
    "plane_leader_leaves_view convert queue.csv queue.parquet --road-file queue.osm",
    "plane_missing_length convert vehicle_tracks_000.csv o.parquet --road-file map.osm",
    "reference_asked_again convert tracks.csv o.parquet --columns map.yaml --reference front",
    "reference_asked_again convert tracks.csv o.parquet --columns centres.yaml",
    "sumo_bike_and_bus_lane convert bus_same_speed_fcd.xml o.parquet --road-file bus.net.xml",
    "sumo_human_readable_time info human.xml",
    "sumo_human_readable_time info human.csv",
    "sumo_lengths_lost_with_road convert fcd.xml o.parquet --road-file n.net.xml",
    "sumo_meso_no_lane info meso.xml",
    "sumo_net_point_lane convert fcd.xml o.parquet --road-file n.net.xml",
    "sumo_opposite_overtaking convert fcd.xml o.parquet",
    "sumo_opposite_overtaking convert fcd.xml o.parquet --road-file n.net.xml",
    "sumo_output_not_closed info fcd_no_end.xml",
    "sumo_output_not_closed info fcd_cut.xml",
    "sumo_plain_header convert h_plain.csv o.parquet",
    "sumo_plain_header convert h_plain.csv o.parquet --columns map.yaml",
    "tgsim_i395_axis info I395_two.csv",
    "tgsim_i395_axis info I395_short.csv",
    *(f"ztd_clock_as_digits convert L001.csv o.parquet --columns {name}.yaml" for name in ("map", "map_plain")),
)
#: Commands that cannot work with the file at hand, and what the message asks for.
OTHER_DATA = {
    f"bag_detections_without_id convert noid.mcap o.parquet --odometry /det {LINE}": "give the messages of a tracker",
    "interaction_v12_cases convert DR_OWN_Merging_train.csv o.parquet --road-file map.osm": "",
    "interaction_v12_cases calibrate o.parquet": "for 5 s; give longer recordings",
    "speed_and_gap_only info drive.csv": "leader_s_m is s_m + gap + the leader's length",
}


@pytest.fixture
def run(tmp_path: Path, monkeypatch, capfd) -> Callable[[str], tuple[int, str]]:
    """Run a command on a copy of its case; returns the exit code, and what was written on errors."""

    def call(command: str) -> tuple[int, str]:
        case, *words = command.split()
        if not (tmp_path / case).exists():
            shutil.copytree(CASES / case, tmp_path / case)
        monkeypatch.chdir(tmp_path / case)
        monkeypatch.setattr(sys, "argv", ["sugiyama", *words])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return end.value.code or 0, capfd.readouterr().err.strip()

    return call


def cured(command: str, said: str) -> str:
    """The command as the message says, in the folder of the case; what it says of files is done to them."""
    words = command.split()
    if found := re.search(r"; give (--reference \w+)|with (--without \S+)", said):
        return f"{command} {found[1] or found[2]}"
    if found := re.search(r"leave out (--columns)", said):
        place = words.index(found[1])
        return " ".join(words[:place] + words[place + 2 :])
    if found := re.search(r"give `(stamp_unit: \w+)` in the bridge", said):
        bridge = Path(words[words.index("--bridge") + 1])
        bridge.write_text(f"{bridge.read_text()}\n{found[1]}\n")
        return command
    if found := re.search(r"cut it behind its last (\S+) and add (\S+)$", said):
        text = Path(words[2]).read_text()
        Path(words[2]).write_text(text[: text.rindex(found[1]) + len(found[1])] + found[2])
        return command
    if found := re.search(r"(\w*_recordingMeta\.csv)", said):
        shutil.copy(Path("with") / found[1], found[1])
        return command
    raise AssertionError(f"no cure that can be followed: {said}")


@pytest.mark.parametrize("command", COMMANDS)
def test_what_people_typed_works_or_what_the_message_says_does(command, run, tmp_path):
    if "centres.yaml" in command:
        shutil.copytree(CASES / "reference_asked_again", tmp_path / "reference_asked_again")
        mapped = (tmp_path / "reference_asked_again/map.yaml").read_text()
        (tmp_path / "reference_asked_again/centres.yaml").write_text(re.sub("reference:.*", "", mapped))
    code, said = run(command)
    if code:
        assert (code, said.count("error: "), "\n" in said) == (2, 1, False), said
        code, said = run(cured(command, said))
    assert code == 0, said


def test_what_needs_other_data_says_which(run):
    for command, wanted in OTHER_DATA.items():
        code, said = run(command)
        assert (code, wanted in said) == (2 if wanted else 0, True), said
