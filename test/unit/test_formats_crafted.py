"""Files that were made to do harm: they are refused with one line, in bounded time."""

import struct
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Header

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.cdr import Encoder
from sugiyama_ros.formats.convert import convert
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.formats.mcap_records import MAGIC
from sugiyama_ros.formats.mcap_writer import BagWriter
from sugiyama_ros.formats.measured import MEASURED_TYPE, ROAD_TYPE
from sugiyama_ros.formats.recover import recover
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.page.recording import read_recording

SIZE = 4 << 20


def head() -> bytes:
    builder = RecordBuilder()
    Header("ros2", "").write(builder)
    return MAGIC + bytes(builder.end())  # type: ignore[no-untyped-call]


def chunk(data: bytes, claimed: int, length: int | None = None) -> bytes:
    """A chunk record; ``length`` is what it says of its data, if that is not true."""
    said = len(data) if length is None else length
    body = struct.pack("<QQQI", 0, 1, claimed, 0) + struct.pack("<I4sQ", 4, b"zstd", said)
    return b"\6" + struct.pack("<Q", len(body) + said) + body + data


def overlapping() -> bytes:
    """Heads of chunks, each of which claims all that follows."""
    count = SIZE // len(chunk(b"", 0))
    return b"\xff" * 20 + b"".join(chunk(b"", 1 << 20, SIZE - (k + 1) * (SIZE // count)) for k in range(count))


def scattered() -> bytes:
    """Small whole chunks with a damaged byte between them."""
    one = chunk(zstandard.compress(b""), 0) + b"\xff" * 9
    return one * (SIZE // len(one))


def bomb(content: bytes) -> bytes:
    one = chunk(zstandard.ZstdCompressor(level=19).compress(content), len(content))
    return one * max(1, 199_000 // len(one))


CRAFTED: dict[str, Callable[[], bytes]] = {
    "overlapping": overlapping,
    "scattered": scattered,
    "zeros": lambda: bomb(b"\0" * (32 << 20)),
    "empty messages": lambda: bomb((b"\5" + struct.pack("<Q", 22) + b"\0" * 22) * (1 << 19)),
}


@pytest.mark.parametrize("what", CRAFTED)
def test_recovery_of_a_crafted_file_ends(tmp_path: Path, what: str) -> None:
    """With work that grows with the square of the size, each takes more than two minutes of the processor."""
    (tmp_path / "a.mcap").write_bytes(head() + CRAFTED[what]() + MAGIC)
    began = time.process_time()
    with pytest.raises(InputError, match="no whole message"):
        recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert time.process_time() - began < 60.0
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def bag_with(path: Path, vehicles: list[int]) -> Path:
    encode = Encoder(ROAD_TYPE, MEASURED_TYPE)
    with BagWriter(path) as bag:
        road, measured = bag.topic("/road", ROAD_TYPE), bag.topic("/measured", MEASURED_TYPE)
        about = {"circumference_m": 100.0, "period_s": 0.5, "steps": 3, "source": "", "sha256": ""}
        header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "road"}
        bag.write(road, encode(ROAD_TYPE, header=header, **about), 0, 0)
        for step in range(3):
            stamp = {"sec": step // 2, "nanosec": 500_000_000 * (step % 2)}
            data = encode(
                MEASURED_TYPE,
                header={"stamp": stamp, "frame_id": "road"},
                step=step,
                vehicle=np.array(vehicles, dtype=np.int32),
                leader=np.full(len(vehicles), -1, dtype=np.int32),
                position_m=np.arange(len(vehicles)) * 20.0 + step,
                length_m=np.full(len(vehicles), 4.5),
            )
            bag.write(measured, data, step * 500_000_000, step * 500_000_000)
    return path


def test_a_vehicle_below_0_is_refused_and_nothing_is_left(tmp_path: Path) -> None:
    path = bag_with(tmp_path / "a.mcap", [3, -3])
    with pytest.raises(InputError, match="not within 0 to 2147483647"):
        convert(path, tmp_path / "b.mcap")
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]
    assert read_tracks(bag_with(tmp_path / "c.mcap", [3, 4])).dense().vehicle.tolist() == [3, 4]


@pytest.mark.parametrize("type_name", ["std_msgs/msg/Header", "sugiyama_msgs/msg/VehicleState"])
def test_topics_of_others_that_end_alike_are_left_out_of_a_report(tmp_path: Path, type_name: str) -> None:
    """Messages of another type, and bytes that are no message of the right type."""
    plain = bag_with(tmp_path / "a.mcap", [0, 1])
    with BagWriter(tmp_path / "b.mcap") as bag:
        for name, data in (("/lifecycle/state", b"\0\1\0\0" + bytes(4)), ("/x/innovation", b""), ("/verdict", b"{}")):
            bag.write(bag.topic(name, type_name), data, 0, 0)
        with Bag(plain) as given:
            for message in given.raw_messages():
                bag.write(bag.topic(message.topic, message.type), message.message, message.log_time_ns, 0)
    recording = read_recording(tmp_path / "b.mcap")
    assert not recording.has_estimates
    assert recording.trajectories.vehicle.tolist() == [0, 1]
