"""The writer of MCAP records against the writer of the package mcap."""

import io

import numpy as np
from mcap.writer import CompressionType, Writer

from sugiyama_ros.formats.mcap_record_writer import RecordWriter

ABOUT = {"version": "1", "source": "test"}
CHUNK = 5000


def test_the_bytes_are_those_of_the_package_mcap() -> None:
    rng = np.random.default_rng(1)
    ours, theirs = io.BytesIO(), io.BytesIO()
    writer = RecordWriter(ours, CHUNK, "library", ABOUT)
    expected = Writer(theirs, chunk_size=CHUNK, compression=CompressionType.ZSTD)
    expected.start(profile="ros2", library="library")
    expected.add_metadata("sugiyama", ABOUT)
    sequence = [0] * 5
    for k in range(400):
        if k % 100 == 0:
            name = f"package/msg/Type{k}"
            assert writer.schema(name, "int32 a\n") == expected.register_schema(name, "ros2msg", b"int32 a\n")
            channel = writer.channel(f"/topic{k}", 1 + k // 100, {"qos": "x"})
            assert channel == expected.register_channel(f"/topic{k}", "cdr", 1 + k // 100, {"qos": "x"})
        number = int(rng.integers(1, channel + 1))
        data, time_ns = rng.bytes(int(rng.integers(0, 200))), int(rng.integers(1, 1 << 62))
        writer.message(number, sequence[number], (time_ns, time_ns + 1), data)
        expected.add_message(number, time_ns, data, time_ns + 1, sequence[number])
        sequence[number] += 1
        if k in (7, 8, 300):
            writer.flush()
            expected.flush()
    writer.finish()
    expected.finish()
    assert ours.getvalue() == theirs.getvalue()


def test_an_empty_file_is_that_of_the_package_mcap() -> None:
    ours, theirs = io.BytesIO(), io.BytesIO()
    RecordWriter(ours, CHUNK, "library", ABOUT).finish()
    expected = Writer(theirs, chunk_size=CHUNK, compression=CompressionType.ZSTD)
    expected.start(profile="ros2", library="library")
    expected.add_metadata("sugiyama", ABOUT)
    expected.finish()
    assert ours.getvalue() == theirs.getvalue()
