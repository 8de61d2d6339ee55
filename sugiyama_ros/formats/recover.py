"""Recovery of the intact messages of a cut or damaged MCAP file."""

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Header, Metadata
from mcap.writer import CompressionType, Writer

from sugiyama_ros.errors import InputError, OutputError
from sugiyama_ros.files import Target, output_of, writing
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.formats.mcap_records import (
    HEAD,
    MAGIC,
    MAX_RECORD,
    MESSAGE,
    Descriptions,
    Record,
    RecordFile,
    content_records,
    open_packed,
)

# Blocks in which the next chunk is looked for: they grow from the first size to the second.
_FIRST_BLOCK, _BLOCK = 1 << 12, 1 << 20
# Bytes that are read and decompressed for a file, at most: so many, and so many for each byte of the file. A recording
# needs less than a tenth of it; a crafted file could otherwise take hours.
_WORK, _WORK_OF_A_BYTE = 1 << 28, 200
# The name of the compression, behind its length, and where it stands in a chunk record.
_CHUNK_NAME = re.compile(rb"\x04\0\0\0zstd|\x03\0\0\0lz4")
_NAME_AT = HEAD.size + 28
_OPCODES = {int(opcode) for opcode in Opcode}


@dataclass(frozen=True)
class Recovered:
    """Result of a recovery: numbers of messages and topics, and bytes of the file that could not be used."""

    path: Path
    messages: int
    topics: int
    lost_bytes: int
    start_ns: int
    end_ns: int


def recover(path: Path, target: Target) -> Recovered:
    """Write every intact message of a file into a new file, and verify the new file by reading it.

    Chunks with a wrong checksum are left out.

    Raises InputError, OutputError.
    """
    path, output = Path(path), output_of(target)
    with open_packed(path) as stream:
        output.check()
        out = output.path
        if out.exists() and out.samefile(path):
            raise OutputError(f"{out}: is also read by this command; give another name for the output")
        salvage = _Salvage(RecordFile(path, stream))
        with writing(output) as recovered:
            writer = Writer(recovered, chunk_size=256 << 10, compression=CompressionType.ZSTD)
            salvage.write(writer)
            if salvage.messages == 0:
                raise InputError(f"{path}: holds no whole message; nothing can be recovered")
    with Bag(out) as bag:
        read = sum(1 for _ in bag.raw_messages())
        info = bag.info()
    if not read == info.messages == salvage.messages:
        raise OutputError(f"{out}: {read} of {salvage.messages} messages read back; check the disk and try again")
    return Recovered(out, read, len(info.topics), salvage.lost_bytes, info.start_ns, info.end_ns)


class _Salvage:
    """Reads a damaged file and copies what is intact."""

    def __init__(self, file: RecordFile) -> None:
        self._file = file
        self._described = Descriptions(file.path)
        self._new_schema: dict[int, int] = {}
        self._new_channel: dict[int, int] = {}
        self._left = _WORK + _WORK_OF_A_BYTE * file.size
        self.messages = 0
        self.lost_bytes = 0

    def write(self, writer: Writer) -> None:
        """Copy metadata and messages. Descriptions that a damaged chunk has lost come from the summary."""
        profile, library = "ros2", ""
        for record in self._records():
            with suppress(InputError):
                if record.opcode == Opcode.HEADER:
                    header = self._file.parse(Header, record)
                    profile, library = header.profile, header.library
                elif record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._described.add(record.opcode, self._file.body(record))
        writer.start(profile=profile, library=library)
        self.lost_bytes = 0
        for record in self._records():
            try:
                self._copy(record, writer)
            except InputError:
                self.lost_bytes += record.length
        writer.finish()  # type: ignore[no-untyped-call]

    def _copy(self, record: Record, writer: Writer) -> None:
        """Copy the content of a record. Raises InputError if it is damaged."""
        if record.opcode == Opcode.METADATA:
            metadata = self._file.parse(Metadata, record)
            writer.add_metadata(metadata.name, metadata.metadata)
        elif record.opcode == Opcode.MESSAGE:
            self._file.log_time(record)  # refuses a message without its head
            body = self._file.body(record, MAX_RECORD)
            self._copy_message(body, writer)
        elif record.opcode == Opcode.CHUNK:
            content = self._chunk(record)
            for opcode, start, end in content_records(content, self._file.where(record)):
                if opcode == Opcode.MESSAGE:
                    self._copy_message(content[start:end], writer)
                else:
                    self._described.add(opcode, content[start:end])

    def _copy_message(self, body: bytes, writer: Writer) -> None:
        """Copy one message; a message without a description of its channel is lost."""
        number, sequence, log_ns, publish_ns = MESSAGE.unpack_from(body)
        channel = self._described.channels.get(number)
        schema = self._described.schema(number) if channel else None
        if channel is None or (schema is None and channel.schema_id != 0):
            self.lost_bytes += len(body) - MESSAGE.size
            return
        if schema is not None and schema.id not in self._new_schema:
            self._new_schema[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if channel.id not in self._new_channel:
            type_id = self._new_schema[schema.id] if schema else 0
            self._new_channel[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, type_id, channel.metadata
            )
        writer.add_message(self._new_channel[channel.id], log_ns, body[MESSAGE.size :], publish_ns, sequence)
        self.messages += 1

    def _records(self) -> Iterator[Record]:
        """Records of the file. Behind a damaged record, go on from the next intact chunk."""
        offset, before = len(MAGIC), len(MAGIC)
        while offset < self._file.size - len(MAGIC):
            try:
                record = self._file.record(offset)
                if record.opcode not in _OPCODES:
                    raise self._file.damaged(offset, "no record")
            except InputError:
                # The length of the record before may be wrong: search from its start.
                found = self._next_chunk(before + 1)
                self.lost_bytes += max(0, found - offset)
                offset = before = found
                continue
            yield record
            if record.opcode == Opcode.FOOTER:
                return
            offset, before = record.end, offset

    def _chunk(self, record: Record) -> bytes:
        """Content of a chunk. Raises InputError if it is damaged, or if too much has been read already."""
        size = record.length + self._file.chunk_head(record)[1]
        if size > self._left:
            raise InputError(f"{self._file.path}: takes too much work to recover; the rest is left out")
        self._left -= size
        return self._file.chunk(record)

    def _next_chunk(self, offset: int) -> int:
        """Offset of the next intact compressed chunk; the end of the file if there is none."""
        size = _FIRST_BLOCK
        while offset < self._file.size and self._left > size:
            self._left -= size
            block = self._file.read(offset, min(size + _NAME_AT + 8, self._file.size - offset))
            for name in _CHUNK_NAME.finditer(block, _NAME_AT):
                start = offset + name.start() - _NAME_AT
                with suppress(InputError):
                    record = self._file.record(start)
                    if record.opcode == Opcode.CHUNK:
                        self._chunk(record)
                        return start
            offset += size
            size = min(2 * size, _BLOCK)
        return self._file.size
