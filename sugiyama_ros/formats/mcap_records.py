"""Bounded reading of the records of an MCAP file. Everything that a file claims is checked before it is used."""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema

from sugiyama_ros.errors import InputError

MAGIC = b"\x89MCAP0\r\n"
#: Largest record, and largest chunk after decompression [bytes].
MAX_RECORD = 64 << 20
#: Largest description (schema, channel, metadata), and largest sum of all descriptions of a file [bytes].
MAX_DESCRIPTION = 1 << 20
_MAX_DESCRIPTIONS = 64 << 20

HEAD = struct.Struct("<BQ")
#: Head of a message: channel, sequence, time of recording and of publishing [ns].
MESSAGE = struct.Struct("<HIQQ")
# Head of a chunk: log times [ns] of its first and last message, and length of its content [bytes].
_CHUNK_HEAD = struct.Struct("<QQQ")

Parsed = TypeVar("Parsed")


class Message(NamedTuple):
    """One message as in the file; times in [ns]."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


class Place(NamedTuple):
    """Where a message lies in the content of a chunk: its channel, log time [ns], and first and last byte."""

    channel: int
    log_time: int
    start: int
    end: int


@dataclass(frozen=True)
class Record:
    """One record at the top level of a file: its kind, where it starts, and the length of its body [bytes]."""

    opcode: int
    offset: int
    length: int

    @property
    def end(self) -> int:
        """Offset behind the record."""
        return self.offset + HEAD.size + self.length


class RecordFile:
    """An open MCAP file, read record by record. Raises InputError."""

    def __init__(self, path: Path, stream: BinaryIO) -> None:
        self.path = path
        self.stream = stream
        self.size = stream.seek(0, 2)
        self._cure = f"run `sugiyama recover {path}`"
        if self.size == 0:
            raise InputError(f"{path}: empty file; give an MCAP file")
        if self.read(0, min(len(MAGIC), self.size)) != MAGIC[: self.size]:
            raise InputError(f"{path}: not an MCAP file (its first bytes differ); give an MCAP file")

    def read(self, offset: int, length: int) -> bytes:
        """Exactly ``length`` bytes from ``offset``."""
        if offset + length > self.size:
            raise self.cut_off(offset)
        self.stream.seek(offset)
        data = self.stream.read(length)
        if len(data) != length:
            raise self.cut_off(offset)
        return data

    def records(self, offset: int = len(MAGIC)) -> Iterator[Record]:
        """Records from ``offset`` on, without their bodies, up to the record that ends the data."""
        while True:
            record = self.record(offset)
            yield record
            if record.opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return
            offset = record.end

    def record(self, offset: int) -> Record:
        """The record at ``offset``, without its body."""
        opcode, length = HEAD.unpack(self.read(offset, HEAD.size))
        record = Record(opcode, offset, length)
        if record.end > self.size:
            raise self.cut_off(offset)
        return record

    def body(self, record: Record, largest: int = MAX_RECORD) -> bytes:
        """Body of a record of at most ``largest`` bytes."""
        if record.length > largest:
            raise self.damaged(record.offset, f"a record claims {record.length} bytes, more than {largest}")
        return self.read(record.offset + HEAD.size, record.length)

    def parse(self, kind: type[Parsed], record: Record, largest: int = MAX_DESCRIPTION) -> Parsed:
        """A record's body as a record class of the package ``mcap``."""
        return parse(kind, self.body(record, largest), f"{self.path}: offset {record.offset}")

    def chunk(self, record: Record) -> bytes:
        """Decompressed and verified content of a chunk."""
        return decompress(self.parse(Chunk, record, MAX_RECORD), f"{self.path}: chunk at offset {record.offset}")

    def chunk_head(self, record: Record) -> tuple[int, int]:
        """Log time [ns] of the first message of a chunk, and bytes of its content, as it claims them."""
        if record.length < _CHUNK_HEAD.size:
            raise self.damaged(record.offset, "not a valid Chunk record")
        start_ns, _, size = _CHUNK_HEAD.unpack(self.read(record.offset + HEAD.size, _CHUNK_HEAD.size))
        return start_ns, min(size, MAX_RECORD)

    def message_head(self, record: Record) -> Place:
        """Where a message outside of any chunk lies in the file, and its log time [ns]."""
        if record.length < MESSAGE.size:
            raise self.damaged(record.offset, "a message without its head")
        start = record.offset + HEAD.size
        channel, _, log_time, _ = MESSAGE.unpack(self.read(start, MESSAGE.size))
        return Place(channel, log_time, start, record.end)

    def message(self, record: Record) -> Message:
        """A message outside of any chunk."""
        body = self.body(record)
        if len(body) < MESSAGE.size:
            raise self.damaged(record.offset, "a message without its head")
        return Message._make((*MESSAGE.unpack_from(body), body[MESSAGE.size :]))

    def cut_off(self, offset: int) -> InputError:
        """Error to raise where the file ends too early."""
        return InputError(f"{self.path}: cut off (the record at offset {offset} is incomplete); {self._cure}")

    def damaged(self, offset: int, what: str) -> InputError:
        """Error to raise where the file contradicts itself."""
        return InputError(f"{self.path}: offset {offset}: {what}; {self._cure}")


class Descriptions:
    """Types and channels that a file describes; the first description of each counts. Bounded in memory."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._size = 0
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}

    def add(self, opcode: int, body: bytes) -> None:
        """Keep the description of a type or of a channel."""
        if opcode == Opcode.SCHEMA:
            schema = parse(Schema, body, str(self._path))
            if schema.id not in self.schemas:
                self.count(len(body))
                self.schemas[schema.id] = schema
        else:
            channel = parse(Channel, body, str(self._path))
            if channel.id not in self.channels:
                self.count(len(body))
                self.channels[channel.id] = channel

    def count(self, size: int) -> None:
        """Note that ``size`` bytes are kept. Raises InputError for too many bytes."""
        self._size += size
        if self._size > _MAX_DESCRIPTIONS:
            raise InputError(f"{self._path}: more than {_MAX_DESCRIPTIONS} bytes of descriptions; not read")

    def schema(self, channel: int) -> Schema | None:
        """Type of a channel's messages, if it has one."""
        return self.schemas.get(self.channels[channel].schema_id)


def parse(kind: type[Parsed], body: bytes, where: str) -> Parsed:
    """Bytes of a record as a record class of the package ``mcap``. Raises InputError if they do not fit."""
    try:
        record: Parsed = kind.read(ReadDataStream(BytesIO(body)))  # type: ignore[attr-defined]
    except (McapError, struct.error, UnicodeDecodeError, OverflowError):
        raise InputError(f"{where}: not a valid {kind.__name__} record; the file is damaged") from None
    return record


def decompress(chunk: Chunk, where: str) -> bytes:
    """Content of a chunk, with verified length and checksum. Raises InputError if they are wrong."""
    if chunk.uncompressed_size > MAX_RECORD:
        raise InputError(f"{where}: claims {chunk.uncompressed_size} bytes, more than {MAX_RECORD}; not read")
    try:
        content = _decompressed(chunk)
    except (zstandard.ZstdError, RuntimeError, EOFError) as error:
        raise InputError(f"{where}: cannot be decompressed ({error}); the file is damaged") from None
    if content is None:
        raise InputError(f"{where}: compression {chunk.compression[:20]!r} is not known; use zstd, lz4 or none")
    if len(content) != chunk.uncompressed_size:
        raise InputError(f"{where}: is not as long as it claims ({chunk.uncompressed_size} bytes); the file is damaged")
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise InputError(f"{where}: checksum does not hold; the file is damaged")
    return content


def _decompressed(chunk: Chunk) -> bytes | None:
    """At most as many bytes as the chunk claims, or one more; None if the compression is not known."""
    most = chunk.uncompressed_size
    if chunk.compression == "":
        return chunk.data
    if chunk.compression == "zstd":
        # The decompressor allocates what the frame claims, whatever its limit.
        claimed = zstandard.frame_content_size(chunk.data)
        if claimed > most:
            raise zstandard.ZstdError(f"frame claims {claimed} bytes")
        return zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=most)
    if chunk.compression == "lz4":
        content: bytes = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=most + 1)
        return content
    return None


def content_records(content: bytes, where: str) -> Iterator[tuple[int, Any]]:
    """Schemas, channels (as opcode and body) and messages (as Place) inside a chunk.

    Raises InputError where a record does not end within the chunk.
    """
    position = 0
    while position < len(content):
        start = position + HEAD.size
        opcode, length = HEAD.unpack_from(content, position) if start <= len(content) else (0, len(content))
        position = start + length
        if position > len(content) or opcode == 0:
            raise InputError(f"{where}: a record inside is none, or does not end within the chunk; the file is damaged")
        if opcode == Opcode.MESSAGE:
            if length < MESSAGE.size:
                raise InputError(f"{where}: a message without its head; the file is damaged")
            channel, _, log_time, _ = MESSAGE.unpack_from(content, start)
            yield opcode, Place(channel, log_time, start, position)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            if length > MAX_DESCRIPTION:
                raise InputError(f"{where}: a description of {length} bytes, more than {MAX_DESCRIPTION}; not read")
            yield opcode, content[start:position]


def message_at(content: bytes, start: int, end: int) -> Message:
    """The message whose head begins at ``start`` of the content of a chunk."""
    return Message._make((*MESSAGE.unpack_from(content, start), content[start + MESSAGE.size : end]))
