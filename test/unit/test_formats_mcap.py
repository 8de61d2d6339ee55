"""MCAP files: written, read, damaged, recovered. Hostile files are refused in bounded memory."""

import io
import struct
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Footer, Header, Message, Schema, Statistics
from mcap.writer import CompressionType, Writer

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.cdr import Encoder
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.convert import write_bag
from sugiyama_ros.formats.definitions import full_text
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.formats.mcap_records import MAGIC, RecordFile, Segment, merged
from sugiyama_ros.formats.mcap_writer import BagWriter
from sugiyama_ros.formats.recover import recover
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.dense import DenseTracks

INNOVATION = "sugiyama_msgs/msg/Innovation"
HEADER = "std_msgs/msg/Header"


def innovation(encode: Encoder, k: int) -> bytes:
    stamp = {"sec": k // 1000, "nanosec": k % 1000 * 1_000_000}
    return encode(
        INNOVATION,
        header={"stamp": stamp, "frame_id": "road"},
        vehicle=7,
        innovation_m=0.1 * k,
        innovation_var=1.0,
        nis=float("nan"),
        log_likelihood=-1.0,
        scored=k % 2 == 0,
    )


def bag_of(path: Path, count: int, **changes: object) -> Path:
    """A bag of ``count`` innovations on two topics, 1 ms apart."""
    encode = Encoder(INNOVATION)
    with BagWriter(path, {"source": "test"}) as bag:
        channels = [bag.topic(f"/vehicle_0{k}/innovation", INNOVATION) for k in (7, 8)]
        for k in range(count):
            bag.write(channels[k % 2], innovation(encode, k), k * 1_000_000, k * 1_000_000 + 1)
    return path


def ring(steps: int = 20) -> DenseTracks:
    position = (np.arange(steps)[:, None] * 2.0 + np.array([0.0, 30.0, 60.0])) % 100.0
    return DenseTracks(position, np.array([3.0, 4.0, 5.0]), np.array([4, 5, 6]), Road(100.0), 0.25, 1.5, "model", "ab")


def refused(path: Path, act: Callable[[Path], object] = read_tracks) -> str:
    with pytest.raises(InputError) as caught:
        act(path)
    text = str(caught.value)
    assert "\n" not in text
    assert str(path) in text
    return text


def read_all(path: Path) -> int:
    """Read everything in a bag."""
    with Bag(path) as bag:
        bag.info()
        return sum(1 for _ in bag.messages())


# --- written


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path = bag_of(tmp_path / "a.mcap", 5001)
    assert list(tmp_path.iterdir()) == [path]
    with Bag(path) as bag:
        info = bag.info()
        messages = list(bag.messages())
        one_topic = list(bag.messages(["/vehicle_08/innovation"]))
        raw = list(bag.raw_messages(["/vehicle_07/innovation"]))
    with path.open("rb") as stream:
        numbers = [m.sequence for _, _, m in make_reader(stream).iter_messages("/vehicle_07/innovation")]
    assert (info.messages, info.start_ns, info.end_ns, info.duration_s) == (5001, 0, 5_000_000_000, 5.0)
    assert (info.profile, info.storage, info.compression) == ("ros2", "mcap", ("zstd",))
    assert info.library.startswith("sugiyama_ros ")
    assert info.size_bytes == path.stat().st_size
    assert [(t.name, t.type, t.count) for t in info.topics] == [
        ("/vehicle_07/innovation", INNOVATION, 2501),
        ("/vehicle_08/innovation", INNOVATION, 2500),
    ]
    assert {(t.serialization, t.reliability, t.durability) for t in info.topics} == {("cdr", "reliable", "volatile")}
    assert info.metadata["sugiyama"]["source"] == "test"
    assert [m.log_time_ns for m in messages] == [k * 1_000_000 for k in range(5001)]
    assert messages[42].message.innovation_m == 0.1 * 42
    assert messages[42].message.header.stamp.nanosec == 42_000_000
    assert {m.topic for m in one_topic} == {"/vehicle_08/innovation"}
    assert len(one_topic) == 2500
    assert numbers == list(range(2501))
    encoder = Encoder(INNOVATION)
    assert [m.message for m in raw] == [innovation(encoder, k) for k in range(0, 5001, 2)]


def test_flush_without_traffic_brings_all_to_the_disk(tmp_path: Path) -> None:
    encode = Encoder(INNOVATION)
    with BagWriter(tmp_path / "a.mcap") as bag:
        channel = bag.topic("/i", INNOVATION)
        bag.write(channel, innovation(encode, 1), 1, 1)
        before = bag.part.stat().st_size
        bag.flush()
        after = bag.part.stat().st_size
        bag.flush()
        assert bag.part.stat().st_size == after > before
        assert recover(bag.part, tmp_path / "b.mcap").messages == 1
        bag.write(channel, innovation(encode, 2), 2, 2)
        time.sleep(1.1)
        bag.write(channel, innovation(encode, 3), 3, 3)
        assert recover(bag.part, tmp_path / "b.mcap").messages == 3


def test_disk_full(tmp_path: Path) -> None:
    # A limit on the size of files stands for the full disk; it needs a process of its own.
    script = """
        import os, resource, signal, sys
        from pathlib import Path
        from sugiyama_ros.errors import OutputError
        from sugiyama_ros.formats.mcap_writer import BagWriter
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))
        try:
            with BagWriter(Path("a.mcap")) as bag:
                channel = bag.topic("/h", "std_msgs/msg/Header")
                for k in range(30):
                    bag.write(channel, os.urandom(100_000), k, k)
                    bag.flush()
        except OutputError as error:
            print(error)
            sys.exit(2)
    """
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", textwrap.dedent(script)],
        cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr == ""
    assert done.stdout.startswith("a.mcap: cannot be written: File too large")
    assert done.stdout.count("\n") == 1
    (part,) = tmp_path.glob("a.mcap.*.part")
    assert part.name in done.stdout
    assert recover(part, tmp_path / "a.mcap").messages == 9


# --- trajectories


def test_trajectories_come_back_from_any_namespace(tmp_path: Path) -> None:
    given = ring()
    write_bag(given, tmp_path / "a.mcap")
    renamed(tmp_path / "a.mcap", tmp_path / "b.mcap", lambda topic: "/experiment" + topic)
    back = read_tracks(tmp_path / "b.mcap", Choices(ring_m=100.0)).dense()
    np.testing.assert_array_equal(back.position_m, given.position_m)
    assert (back.period_s, back.start_s, back.source, back.sha256) == (0.25, 1.5, "model", "ab")
    assert "says a ring of 100 m" in refused(
        tmp_path / "b.mcap", lambda path: read_tracks(path, Choices(ring_m=99.0)).dense()
    )


def renamed(path: Path, out: Path, name: Callable[[str], str], times: int = 1) -> None:
    """Copy of a bag with other topic names and each message repeated ``times`` times."""
    with path.open("rb") as stream, BagWriter(out) as bag:
        for _ in range(times):
            stream.seek(0)
            for schema, channel, message in make_reader(stream).iter_messages(log_time_order=False):
                assert schema is not None
                number = bag.topic(name(channel.topic), schema.name)
                bag.write(number, message.data, message.log_time, message.publish_time)


# --- damaged and hostile files


def mcap(*records: object, tail: bytes | None = None) -> bytes:
    """A file with a header, some records, and a proper end unless ``tail`` replaces it."""
    builder = RecordBuilder()
    for record in (Header("ros2", "test"), *records):
        record.write(builder)  # type: ignore[attr-defined]
    body = MAGIC + builder.end()
    if tail is not None:
        return body + tail
    end = RecordBuilder()
    DataEnd(0).write(end)
    Footer(0, 0, 0).write(end)
    return body + end.end() + MAGIC


def chunk(data: bytes, size: int, compression: str = "zstd") -> Chunk:
    return Chunk(compression, data, 0, 0, 0, size)


def zeros(size: int) -> bytes:
    """Zeros, ``size`` bytes of them, compressed as a stream, so that the frame does not say its size."""
    out = io.BytesIO()
    with zstandard.ZstdCompressor().stream_writer(out, closefd=False) as stream:
        for _ in range(size >> 20):
            stream.write(bytes(1 << 20))
    return out.getvalue()


def test_every_cut_is_reported(tmp_path: Path) -> None:
    whole = bag_of(tmp_path / "a.mcap", 300).read_bytes()
    path = tmp_path / "cut.mcap"
    for length in [*range(8, 200, 7), len(whole) // 2, *range(len(whole) - 60, len(whole))]:
        path.write_bytes(whole[:length])
        assert "cut off" in refused(path, read_all)


def test_every_flipped_byte_is_reported_or_harmless(tmp_path: Path) -> None:
    whole = bag_of(tmp_path / "a.mcap", 50).read_bytes()
    path = tmp_path / "flipped.mcap"
    told = []
    for position in range(0, len(whole), 3):
        path.write_bytes(whole[:position] + bytes([whole[position] ^ 0x55]) + whole[position + 1 :])
        try:
            read_all(path)
        except InputError as error:
            told.append(str(error))
    assert len(told) > len(whole) / 3 * 0.5
    assert not any("\n" in text for text in told)


GIGABYTE = 1 << 30
SCHEMA = Schema(id=1, data=b"int32 x\n", encoding="ros2msg", name="a/msg/A")
CHANNEL = Channel(id=1, topic="/a", message_encoding="cdr", metadata={}, schema_id=1)


def inner(*records: object) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)  # type: ignore[attr-defined]
    return builder.end()


@cache
def hostile() -> dict[str, tuple[bytes, str]]:
    """Contents of files, and a part of what is said of each."""
    bomb = zeros(GIGABYTE)
    return {
        "a chunk of 1 GB, claimed": (mcap(chunk(b"x" * 1000, GIGABYTE)), "claims 1073741824 bytes"),
        "a chunk of 1 GB, declared small": (mcap(chunk(zstandard.compress(bytes(1 << 27)), 100)), "frame claims"),
        "a chunk of 1 GB, not declared": (mcap(chunk(bomb, 1000)), "the file is damaged"),
        "a chunk of 1 GB, declared as 64 MiB": (mcap(chunk(bomb, 64 << 20)), "the file is damaged"),
        "a chunk shorter than declared": (mcap(chunk(zstandard.compress(b"x"), 100)), "the file is damaged"),
        "a chunk that is no zstd": (mcap(chunk(b"abcdefgh", 100)), "cannot be decompressed"),
        "a chunk that is no lz4": (mcap(chunk(b"abcdefgh", 100, "lz4")), "cannot be decompressed"),
        "a chunk of another kind": (mcap(chunk(b"abcdefgh", 100, "rar")), "compression 'rar' is not known"),
        "a chunk with a wrong length": (mcap(chunk(b"abcdefgh", 100, "")), "not as long as it claims"),
        "a record inside that does not end": (
            mcap(chunk(b"\x05" + b"\xff" * 8 + b"ab", 11, "")),
            "does not end within",
        ),
        "a message without a head": (mcap(chunk(b"\x05" + struct.pack("<Q", 2) + b"ab", 11, "")), "without its head"),
        "a message of no channel": (mcap(Message(9, 0, b"", 0, 0)), "channel 9, which is not described"),
        "a record longer than the file": (mcap(tail=b"\x05" + struct.pack("<Q", GIGABYTE) + bytes(100)), "cut off"),
        "a record as long as can be": (mcap(tail=b"\x05" + b"\xff" * 8 + bytes(100) + MAGIC), "offset"),
        "no footer": (mcap(tail=bytes(100) + MAGIC), "sugiyama recover"),
        "a channel with wrong lengths": (
            mcap(tail=b"\x04" + struct.pack("<QHHI", 8, 1, 1, 1 << 31) + mcap()[33:]),
            "not a valid Channel",
        ),
        "a chunk as long as can be": (
            mcap(tail=b"\x06" + struct.pack("<QQQQIIQ", 40, 0, 0, 9, 0, 0, (1 << 64) - 1) + mcap()[33:]),
            "not a valid Chunk",
        ),
        "a message that does not fit": (mcap(SCHEMA, CHANNEL, Message(1, 0, b"\0\1\0\0abc", 0, 0)), "does not fit"),
        "a message of nothing": (mcap(SCHEMA, CHANNEL, Message(1, 0, b"", 0, 0)), "does not fit"),
    }


def test_hostile_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "hostile.mcap"
    for name, (content, said) in hostile().items():
        path.write_bytes(content)
        assert said in refused(path, read_all), name
        refused(path)


def test_hostile_files_take_bounded_memory(tmp_path: Path) -> None:
    for number, (content, _) in enumerate(hostile().values()):
        (tmp_path / f"{number}.mcap").write_bytes(content)
    # A list of a million messages, each a Python object, in a file of 100 bytes or so.
    (tmp_path / "list.mcap").write_bytes(
        mcap(
            Schema(id=1, data=b"B[] b\n" + b"=" * 80 + b"\nMSG: a/B\nuint8 x\n", encoding="ros2msg", name="a/msg/A"),
            CHANNEL,
            chunk(
                zstandard.compress(
                    data := inner(Message(1, 0, b"\0\1\0\0" + struct.pack("<I", 40 << 20) + bytes(40 << 20), 0, 0))
                ),
                len(data),
            ),
        )
    )
    script = """
        import resource, sys
        from pathlib import Path
        from sugiyama_ros.errors import InputError
        from sugiyama_ros.formats import read_tracks
        from sugiyama_ros.formats.mcap_reader import Bag
        from sugiyama_ros.formats.recover import recover
        def everything(path):
            with Bag(path) as bag:
                bag.info()
                for _ in bag.messages(): pass
        before = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (before + (512 << 20),) * 2)
        for path in sorted(Path().glob("*.mcap")):
            for act in (everything, read_tracks, lambda p: recover(p, Path("out"))):
                try:
                    act(path)
                except InputError:
                    pass
        print("all refused")
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)],
        cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.stdout == "all refused\n", done.stderr


def test_a_wrong_index_is_reported_or_harmless(tmp_path: Path) -> None:
    index = ChunkIndex(10, GIGABYTE, "zstd", 10, 0, 0, {1: GIGABYTE}, 0, 10)
    counts = Statistics(0, 1, {1: GIGABYTE}, GIGABYTE, GIGABYTE, 0, 0, 0, 1)
    body = mcap(SCHEMA, CHANNEL, Message(1, 0, b"\0\1\0\0\5\0\0\0", 0, 0), DataEnd(0), tail=b"")
    summary = inner(SCHEMA, CHANNEL, counts, index)
    path = tmp_path / "a.mcap"
    path.write_bytes(body + summary + inner(Footer(len(body), 0, 0)) + MAGIC)
    with Bag(path) as bag:
        assert [m.message.x for m in bag.messages(["/a"])] == [5]
    path.write_bytes(body + summary + inner(Footer(GIGABYTE, 0, 0)) + MAGIC)
    assert "the summary is said to be at" in refused(path, read_all)


def test_other_peoples_bags(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    for options in (
        {"use_chunking": False},
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.NONE, "repeat_channels": False, "repeat_schemas": False},
        {"use_statistics": False},
    ):
        with path.open("wb") as stream:
            writer = Writer(stream, **options)  # type: ignore[arg-type]
            writer.start(profile="ros2")
            schema = writer.register_schema(HEADER, "ros2msg", full_text(HEADER).encode())
            known = writer.register_channel("/known", "cdr", schema)
            other = writer.register_channel("/other", "json", 0)
            for k in range(10):
                writer.add_message(known, k, Encoder(HEADER)(HEADER, stamp={"sec": k, "nanosec": 0}, frame_id="f"), k)
                writer.add_message(other, k, b"{}", k)
            writer.finish()
        with Bag(path) as bag:
            assert [m.message.stamp.sec for m in bag.messages(["/known"])] == list(range(10))
            assert {m.message for m in bag.messages(["/other"])} == {b"{}"}
            info = bag.info()
        assert [(t.name, t.type, t.count) for t in info.topics] == [("/known", HEADER, 10), ("/other", "", 10)]
        assert (info.start_ns, info.end_ns, info.messages) == (0, 9, 20)
    with Bag(path) as bag, pytest.raises(InputError, match="no topic /none"):
        list(bag.messages(["/none"]))


# --- recovered


def test_recover_what_a_cut_leaves(tmp_path: Path) -> None:
    whole = bag_of(tmp_path / "a.mcap", 40_000).read_bytes()
    cut = tmp_path / "cut.mcap.part"
    cut.write_bytes(whole[: int(0.7 * len(whole))])
    done = recover(cut, tmp_path / "cut.mcap")
    # A chunk holds 256 kB, that is about 2,300 of these messages.
    assert 0.7 * 40_000 - 2_600 < done.messages < 0.7 * 40_000 + 2_600
    assert done.topics == 2
    assert 0 < done.lost_bytes < 256 << 10
    with Bag(tmp_path / "cut.mcap") as bag:
        assert [m.log_time_ns for m in bag.messages()] == [k * 1_000_000 for k in range(done.messages)]
        assert bag.info().metadata["sugiyama"]["source"] == "test"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mcap", "cut.mcap", "cut.mcap.part"]


def test_recover_leaves_out_what_is_damaged(tmp_path: Path) -> None:
    whole = bytearray(bag_of(tmp_path / "a.mcap", 20_000).read_bytes())
    with (tmp_path / "a.mcap").open("rb") as stream:
        chunks = [r.offset for r in RecordFile(tmp_path / "a.mcap", stream).records() if r.opcode == Opcode.CHUNK]
    for offset in (chunks[0] + 200, chunks[2] + 1):
        # The first chunk has all descriptions; the third now lies about its length.
        whole[offset] ^= 0xFF
    (tmp_path / "b.mcap").write_bytes(whole)
    done = recover(tmp_path / "b.mcap", tmp_path / "c.mcap")
    kept = (len(chunks) - 2) / len(chunks)
    assert done.messages == pytest.approx(20_000 * kept, abs=2_600)
    assert done.lost_bytes > 0
    assert read_all(tmp_path / "c.mcap") == done.messages


# --- house rules


def test_overlapping_parts_are_merged_in_bounded_memory(tmp_path: Path) -> None:
    """Parts are open only while their messages are due; too many at the same time are refused with a cure."""
    opened: list[int] = []

    def part(number: int, times: list[int], size: int = 100 << 20) -> Segment:
        def load() -> Iterator[tuple[int, int]]:
            opened.append(number)
            yield from ((time, number) for time in times)
            opened.remove(number)

        return Segment(times[0], size, load)

    most = []
    for found in merged([part(k, [10 * k, 10 * k + 12]) for k in (3, 1, 2, 0)], tmp_path):
        most.append((found, len(opened)))
    times = [time for (time, _), _ in most]
    assert times == sorted(times)
    assert len(times) == 8
    assert max(count for _, count in most) == 2
    with pytest.raises(InputError, match="lie in another order than their log times; sort it with `mcap sort"):
        list(merged([part(k, [k, 100]) for k in range(3)], tmp_path))
