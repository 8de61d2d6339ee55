"""Other readers read every message of this package's bags, and the bytes equal the bytes of ROS 2."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import SeekingReader, make_reader

from sugiyama_ros.formats.cdr import Encoder, decoder, plain
from sugiyama_ros.formats.convert import write_bag
from sugiyama_ros.formats.definitions import full_text
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.formats.mcap_writer import BagWriter, Qos
from sugiyama_ros.formats.measured import MEASURED_TYPE, ROAD_TYPE, messages
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.dense import DenseTracks

TYPES = [
    *(f"sugiyama_msgs/msg/{name}" for name in ("DriverParameters", "Innovation", "MeasuredPositions", "Progress")),
    *(f"sugiyama_msgs/msg/{name}" for name in ("Road", "VehicleState")),
    "diagnostic_msgs/msg/DiagnosticArray",
    "rosgraph_msgs/msg/Clock",
    "visualization_msgs/msg/MarkerArray",
]


def trajectories() -> DenseTracks:
    """Three vehicles on an open road, with a missing sample. One vehicle appears late."""
    position = np.arange(600.0)[:, None] * 2.0 + np.array([0.0, 30.0, 60.0])
    position[:100, 1] = np.nan
    position[200, 2] = np.nan
    return DenseTracks(position, np.array([3.0, 4.0, 5.0]), np.array([4, 5, 6]), Road(), 0.1, 0.0, "a.csv", "00")


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    path = tmp_path / "a.mcap"
    write_bag(trajectories(), path)
    return path


@pytest.fixture
def encoded() -> list[tuple[str, int, bytes]]:
    return list(messages(trajectories()))


def test_mcap_reads_it_by_its_index(bag: Path, encoded: list[tuple[str, int, bytes]]) -> None:
    with bag.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert isinstance(reader, SeekingReader)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(encoded)
        assert summary.chunk_indexes
        found = list(reader.iter_messages())
        header = reader.get_header()
    assert header.profile == "ros2"
    assert [message.data for _, _, message in found] == [data for _, _, data in encoded]
    for schema, channel, message in found:
        assert schema is not None
        assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
        assert message.log_time == message.publish_time
        assert schema.data.decode() == full_text(schema.name)


def test_rosbags_reads_it(bag: Path, encoded: list[tuple[str, int, bytes]]) -> None:
    from rosbags.highlevel import AnyReader

    given = trajectories()
    with AnyReader([bag]) as reader:
        found = list(reader.messages())
        assert [bytes(data) for _, _, data in found] == [data for _, _, data in encoded]
        qos = {c.topic: c.ext.offered_qos_profiles[0].durability.name for c in reader.connections}  # type: ignore[union-attr]
        assert qos == {"/road": "TRANSIENT_LOCAL", "/measured": "VOLATILE"}
        measured: list[Any] = [reader.deserialize(data, c.msgtype) for c, _, data in found if c.topic == "/measured"]
    assert [m.step for m in measured] == list(range(600))
    assert measured[0].vehicle.tolist() == [4, 6]
    assert measured[0].leader.tolist() == [6, -1]
    assert measured[300].leader.tolist() == [5, 6, -1]
    np.testing.assert_array_equal(measured[300].position_m, given.position_m[300])


def test_all_our_types_can_be_recorded(tmp_path: Path) -> None:
    from rosbags.highlevel import AnyReader

    with BagWriter(tmp_path / "a.mcap") as writer:
        for name in TYPES:
            writer.topic(f"/{name.split('/')[-1]}", name, Qos(depth=1000))
            writer.write(writer.topic(f"/{name.split('/')[-1]}", name), b"", 0, 0)
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        assert {connection.msgtype for connection in reader.connections} == set(TYPES)
        assert all(reader.typestore.get_msgdef(name) for name in TYPES)
    with Bag(tmp_path / "a.mcap") as bag:
        assert {topic.type for topic in bag.info().topics} == set(TYPES)


def test_our_bytes_are_those_of_ros(encoded: list[tuple[str, int, bytes]]) -> None:
    serialization = pytest.importorskip("rclpy.serialization")
    from sugiyama_msgs.msg import MeasuredPositions
    from sugiyama_msgs.msg import Road as RoadMessage

    types = {ROAD_TYPE: RoadMessage, MEASURED_TYPE: MeasuredPositions}
    encode = Encoder(*types)
    empty = encode(
        MEASURED_TYPE,
        header={"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        step=0,
        vehicle=np.zeros(0, np.int32),
        leader=np.zeros(0, np.int32),
        position_m=np.zeros(0),
        length_m=np.zeros(0),
    )
    for name, _, ours in [*encoded[:3], encoded[300], (MEASURED_TYPE, 0, empty)]:
        theirs = bytes(serialization.serialize_message(serialization.deserialize_message(ours, types[name])))
        # ROS leaves arbitrary bytes in the padding and behind empty lists; writing the message again removes them.
        assert len(theirs) == len(ours) + (36 if ours == empty else 28 if name == MEASURED_TYPE else 0)
        decode = decoder(name, full_text(name))
        assert decode is not None
        fields = {key: np.array(v) if isinstance(v, list) else v for key, v in plain(decode(theirs)).items()}
        if name == MEASURED_TYPE:
            fields |= {key: fields[key].astype(np.int32) for key in ("vehicle", "leader", "lane")}
            whole = ("header", "step", "vehicle", "leader", "lane")
            fields |= {key: value.astype(float) for key, value in fields.items() if key not in whole}
        assert encode(name, **fields) == ours
