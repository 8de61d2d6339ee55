"""`run` on tracks: vehicles that come and go on two lanes, followed by one node."""

from pathlib import Path

import numpy as np
import pytest
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from sugiyama_msgs.msg import DriverArray, MeasuredPositions, Verdict
from sugiyama_msgs.srv import AddEffect, Seek

from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.nodes import live
from sugiyama_ros.nodes.base.samples import UNKNOWN_LEADER
from sugiyama_ros.nodes.base.spin import Spinner
from sugiyama_ros.nodes.critic import Critic
from sugiyama_ros.nodes.drivers import DriversNode
from sugiyama_ros.nodes.plan import RunSettings
from sugiyama_ros.nodes.replay import Replay, TrackSamples
from sugiyama_ros.nodes.run import run
from sugiyama_ros.trajectories.dense import numbers_of

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]


@pytest.fixture
def tracks_csv(tmp_path: Path) -> Path:
    """Four vehicles at 10 m/s. 11 follows 12 on lane 1 until 12 leaves at 5 s; 13 is alone on lane 2 from 3 s on.

    Vehicle 14 is another recording's, and follows nobody.
    """
    rng, lines = np.random.default_rng(2), ["recording,vehicle,time_s,s_m,lane,length_m"]
    drives = (
        ("a", 11, 0, 100, 0.0, 1),
        ("a", 12, 0, 50, 30.0, 1),
        ("a", 13, 30, 100, 0.0, 2),
        ("b", 14, 0, 40, 0.0, 1),
    )
    for recording, vehicle, first, last, start_m, lane in drives:
        for k in range(first, last):
            position = start_m + 1.0 * k + rng.normal(0.0, 0.1)
            lines.append(f"{recording},{vehicle},{0.1 * k:.1f},{position:.3f},{lane},4.5")
    path = tmp_path / "tracks.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def messages(bag: Path, topic: str, kind: type) -> list[object]:
    with Bag(bag) as opened:
        return [deserialize_message(raw, kind) for _, _, _, raw in opened.raw_messages({topic})]


def test_one_node_follows_who_is_in_view(tracks_csv: Path, tmp_path: Path) -> None:
    output = tmp_path / "out.mcap"
    result = run(tracks_csv, output)
    assert (result.steps, result.vehicles, result.messages_lost) == (140, 4, 0)
    sent = messages(output, "/measured", MeasuredPositions)
    known = messages(output, "/drivers", DriverArray)
    assert len(sent) == len(known) == 140
    assert [list(s.vehicle) for s in sent] == [list(k.vehicle) for k in known]
    assert list(sent[0].leader) == [12, UNKNOWN_LEADER]
    assert list(sent[60].leader) == [UNKNOWN_LEADER, UNKNOWN_LEADER]
    assert sent[60].lane.tolist() == [1, 2]
    assert list(sent[120].vehicle) == [14]
    assert known[99].speed.tolist() == pytest.approx([10.0, 10.0], abs=0.5)
    assert known[49].gap_m[0] == pytest.approx(25.5, abs=0.5)
    assert {d.vehicle for d in result.drivers} == {11, 12, 13, 14}


def test_vehicles_with_the_same_name_have_numbers_of_their_own(tracks_csv: Path) -> None:
    tracks_csv.write_text(tracks_csv.read_text().replace("b,14", "b,11"))
    samples = TrackSamples(read_tracks(tracks_csv))
    assert samples.vehicle == [0, 1, 2, 3]
    assert samples.names[3] == "11 of recording b"


def test_a_replay_numbers_vehicles_as_a_model_file_does(tracks_csv: Path) -> None:
    tracks_csv.write_text(tracks_csv.read_text().replace("b,14", "b,car 2147483640"))
    tracks = read_tracks(tracks_csv)
    assert TrackSamples(tracks).vehicle == numbers_of(tracks).tolist() == [11, 12, 13, 2147483640]


def test_a_critic_follows_who_is_in_view_and_whose_leader_is_known(tracks_csv: Path, tmp_path: Path) -> None:
    result = run(tracks_csv, tmp_path / "out.mcap", critic=True)
    assert result.messages_lost == 0
    verdicts = messages(tmp_path / "out.mcap", "/verdict", Verdict)
    assert len(verdicts) >= 2
    # driver 11 has a known leader in 50 samples, of which the first few only start the filters; nobody else has one
    assert 40 <= verdicts[-1].samples < 50
    assert sum(verdicts[-1].weight) == pytest.approx(1.0)


def test_the_critic_adds_an_effect_to_the_models_of_all_who_come_and_go(stage, tracks_csv: Path) -> None:
    about = {"source": str(tracks_csv), "rate": 0.0, "wait_for": ["/drivers", "/critic"]}
    replay = Replay(parameter_overrides=[Parameter(k, value=v) for k, v in about.items()])
    drivers, critic = DriversNode(), Critic()
    stage.add(replay, drivers, critic)
    stage.until(lambda: critic.steps == drivers.steps == 140)
    request = AddEffect.Request(effect="drag", name=["c0"], value=[0.1])
    assert stage.call(AddEffect, "/critic/add_effect", request).success
    assert stage.call(Seek, "/replay/seek", Seek.Request(time_s=0.0)).success
    stage.until(lambda: critic.health().values.get("added") == "drag")


def test_a_live_page_leaves_the_critic_out_where_many_are_in_view(
    tracks_csv: Path, tmp_path: Path, monkeypatch
) -> None:
    settings = RunSettings(critic=True)
    assert live._plan(tracks_csv, tmp_path / "out.mcap", settings).settings.critic
    # two drivers at 10 Hz
    monkeypatch.setattr(live, "_CRITIC_AT_MOST", 19.0)
    assert not live._plan(tracks_csv, tmp_path / "out.mcap", settings).settings.critic


def test_a_second_source_in_the_same_domain_is_refused(stage, tracks_csv: Path) -> None:
    """The first one goes on."""
    about = [Parameter("source", value=str(tracks_csv)), Parameter("start_paused", value=True)]
    first = Replay(parameter_overrides=about)
    stage.add(first)
    stage.for_a_while(3.3)
    second = Replay(parameter_overrides=about)
    other = Spinner([second])
    other.until(lambda: second.failure is not None, 10.0)
    stage.for_a_while(0.3)
    assert "another node publishes it already in ROS domain" in str(second.failure)
    assert first.failure is None
    other.close()
    second.destroy_node()
