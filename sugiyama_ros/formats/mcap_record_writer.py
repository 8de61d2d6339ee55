"""Writes the records of an MCAP file: messages in compressed chunks, their indexes, and a summary.

The package ``mcap`` has a writer, but it makes several objects and ten small writes for each message. The writer here
packs a message in one step and writes the same bytes; a test compares the two.
"""

import struct
import zlib
from collections.abc import Iterable, Mapping
from typing import Any, BinaryIO

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from sugiyama_ros.formats.mcap_records import HEAD, MAGIC, MESSAGE

# Kind and length of the record, then the head of the message.
_MESSAGE = struct.Struct(HEAD.format + MESSAGE.format.lstrip("<"))
_MESSAGE_OPCODE = int(Opcode.MESSAGE)
_FOOTER = struct.Struct("<BQQQ")
_FOOTER_SIZE = 20


class RecordWriter:
    """Writes records to an open file. The caller opens and closes the file, and handles OSError.

    stream: the open file, which is empty; chunk_size: size [bytes] at which a chunk is closed; library: name of the
    writing program; metadata: texts to keep in a record named ``sugiyama``.
    """

    def __init__(self, stream: BinaryIO, chunk_size: int, library: str, metadata: Mapping[str, str]) -> None:
        self._stream = stream
        self._chunk_size = chunk_size
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._counts: dict[int, int] = {}
        self._chunk = bytearray()
        # of the messages of each channel in this chunk: time [ns] and offset in the chunk, in turn
        self._index: dict[int, list[int]] = {}
        stream.write(MAGIC + _bytes([Header("ros2", library)]))
        about = _bytes([Metadata("sugiyama", dict(metadata))])
        self._metadata = MetadataIndex(stream.tell(), len(about), "sugiyama")
        stream.write(about)

    def schema(self, name: str, text: str) -> int:
        """Describe a message type by its definition (``ros2msg``); returns its number."""
        self._schemas.append(Schema(id=len(self._schemas) + 1, data=text.encode(), encoding="ros2msg", name=name))
        self._describe(self._schemas[-1])
        return self._schemas[-1].id

    def channel(self, topic: str, schema: int, about: Mapping[str, str]) -> int:
        """Describe a topic whose messages are in CDR; returns its number."""
        number = len(self._channels) + 1
        self._channels.append(Channel(number, topic, "cdr", dict(about), schema))
        self._describe(self._channels[-1])
        return number

    def message(self, channel: int, sequence: int, times_ns: tuple[int, int], data: bytes) -> None:
        """Add a message, with the times [ns] at which it was recorded and published."""
        chunk, index = self._chunk, self._index.get(channel)
        if index is None:
            index = self._index[channel] = []
        index += (times_ns[0], len(chunk))
        chunk += _MESSAGE.pack(_MESSAGE_OPCODE, MESSAGE.size + len(data), channel, sequence, *times_ns)
        chunk += data
        if len(chunk) > self._chunk_size:
            self._end_chunk()

    def flush(self) -> None:
        """Close the chunk and hand everything to the operating system."""
        self._end_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """Write the summary, which ends the file."""
        self._end_chunk()
        self._stream.write(_bytes([DataEnd(0)]))
        start = self._stream.tell()
        summary, offsets = b"", []
        for kind, records in self._summary():
            group = _bytes(records)
            offsets.append(SummaryOffset(kind, start + len(summary), len(group)))
            summary += group
        offset_start = start + len(summary)
        summary += _bytes(offsets)
        crc = zlib.crc32(_FOOTER.pack(Opcode.FOOTER, _FOOTER_SIZE, start, offset_start), zlib.crc32(summary))
        self._stream.write(summary + _bytes([Footer(start, offset_start, crc)]) + MAGIC)

    def _describe(self, record: Any) -> None:
        self._chunk += _bytes([record])
        if len(self._chunk) > self._chunk_size:
            self._end_chunk()

    def _end_chunk(self) -> None:
        """Write the chunk, if it has messages, and where the messages of each channel are in it."""
        if not self._index:
            return
        content = bytes(self._chunk)
        times = [time for index in self._index.values() for time in index[::2]]
        chunk = Chunk(
            compression="zstd",
            data=zstandard.compress(content),
            message_start_time=min(times),
            message_end_time=max(times),
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )
        start, packed = self._stream.tell(), _bytes([chunk])
        indexes = {number: _message_index(number, index) for number, index in self._index.items()}
        offsets, at = {}, start + len(packed)
        for number, record in indexes.items():
            offsets[number] = at
            at += len(record)
        self._stream.write(packed + b"".join(indexes.values()))
        self._chunks.append(
            ChunkIndex(
                chunk_length=len(packed),
                chunk_start_offset=start,
                compression="zstd",
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=at - start - len(packed),
                message_index_offsets=offsets,
                message_start_time=chunk.message_start_time,
                uncompressed_size=len(content),
            )
        )
        for number, index in self._index.items():
            self._counts[number] = self._counts.get(number, 0) + len(index) // 2
        self._chunk, self._index = bytearray(), {}

    def _summary(self) -> list[tuple[Opcode, list[Any]]]:
        """Records of the summary by kind, in the order of the file."""
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=max((c.message_end_time for c in self._chunks), default=0),
            message_start_time=min((c.message_start_time for c in self._chunks), default=0),
            metadata_count=1,
            schema_count=len(self._schemas),
        )
        return [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, []),
            (Opcode.METADATA_INDEX, [self._metadata]),
        ]


def _bytes(records: Iterable[Any]) -> bytes:
    """Bytes of records of the package ``mcap``."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _message_index(channel: int, index: list[int]) -> bytes:
    """Bytes of the record that says where the messages of a channel are in their chunk."""
    size = 8 * len(index)
    return struct.pack(f"<BQHI{len(index)}Q", Opcode.MESSAGE_INDEX, 6 + size, channel, size, *index)
