"""Reader of MCAP files: summary and messages."""

import re
import zlib
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Header, Metadata, MetadataIndex, Statistics

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.cdr import Decoder, decoder_of
from sugiyama_ros.formats.mcap_order import Segment, in_order, merged
from sugiyama_ros.formats.mcap_records import (
    HEAD,
    MAGIC,
    MAX_DESCRIPTION,
    Descriptions,
    Message,
    RecordFile,
    content_records,
)
from sugiyama_ros.formats.zstd_packed import ZSTD, open_packed, unpacked

_FOOTER_SIZE = HEAD.size + 20
_BLOCK = 1 << 20
_log_time = attrgetter("log_time")


@dataclass(frozen=True)
class TopicInfo:
    """One topic of a bag; ``reliability`` and ``durability`` are empty if the file does not say them."""

    name: str
    type: str
    count: int
    serialization: str
    reliability: str
    durability: str


@dataclass(frozen=True)
class BagInfo:
    """What ``ros2 bag info`` says about a bag, and the metadata in it."""

    file: str
    size_bytes: int
    storage: str
    profile: str
    library: str
    duration_s: float
    start_ns: int
    end_ns: int
    messages: int
    compression: tuple[str, ...]
    topics: tuple[TopicInfo, ...]
    metadata: dict[str, dict[str, str]]


class BagMessage(NamedTuple):
    """One message of a bag; ``message`` is a dataclass, or bytes if they cannot be decoded."""

    topic: str
    type: str
    log_time_ns: int
    message: Any


class Bag:
    """An MCAP file opened for reading; use it in a ``with`` block.

    Memory stays below 512 MiB, whatever the file claims. Larger records, and larger chunks after decompression, are
    refused before memory is allocated for them.

    Raises InputError.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._described = Descriptions(self.path)
        #: Why the messages of a topic are given as bytes.
        self.undecoded: dict[str, str] = {}
        with ExitStack() as opened:
            self._file = RecordFile(self.path, opened.enter_context(open_packed(self.path)))
            first = self._file.record(len(MAGIC))
            if first.opcode != Opcode.HEADER:
                raise self._file.damaged(first.offset, "no header record")
            self._header = self._file.parse(Header, first)
            self._summary = self._summary_start()
            self._opened = opened.pop_all()

    def info(self) -> BagInfo:
        """Content of the bag: from its summary, or from all its messages if it has no summary."""
        statistics: Statistics | None = None
        metadata: dict[str, dict[str, str]] = {}
        compression: set[str] = set()
        for record in self._file.records(self._summary or len(MAGIC)):
            if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._described.add(record.opcode, self._file.body(record, MAX_DESCRIPTION))
            elif record.opcode == Opcode.STATISTICS:
                statistics = self._file.parse(Statistics, record)
            elif record.opcode == Opcode.CHUNK_INDEX:
                compression.add(self._file.parse(ChunkIndex, record).compression)
            elif record.opcode == Opcode.METADATA_INDEX:
                record = self._file.record(self._file.parse(MetadataIndex, record).offset)
            if record.opcode == Opcode.METADATA:
                found = self._file.parse(Metadata, record)
                self._described.count(record.length)
                metadata[found.name] = found.metadata
        if statistics is None:
            statistics = self._counted()
        counts = statistics.channel_message_counts
        start, end = statistics.message_start_time, statistics.message_end_time
        topics = [self._topic(channel, counts.get(channel.id, 0)) for channel in self._described.channels.values()]
        return BagInfo(
            file=str(self.path),
            size_bytes=self._file.size,
            storage="mcap",
            profile=self._header.profile,
            library=self._header.library,
            duration_s=1e-9 * (end - start),
            start_ns=start,
            end_ns=end,
            messages=statistics.message_count,
            compression=tuple(sorted(compression - {""})),
            topics=tuple(sorted(topics, key=lambda topic: topic.name)),
            metadata=metadata,
        )

    def messages(self, topics: Collection[str] | None = None, *, skip_misfits: bool = False) -> Iterator[BagMessage]:
        """Messages of some topics, or of all topics, in the order of their log times.

        A topic whose messages cannot be decoded has bytes, and `undecoded` says why. Raises InputError for a topic that
        is not in the bag, and for a message that does not fit its definition, unless such messages are skipped.
        """
        decoders: dict[int, Decoder | None] = {}
        for number, message in enumerate(self._selected(topics)):
            if message.channel not in decoders:
                decoders[message.channel] = self._decoder(message.channel)
            decode = decoders[message.channel]
            found = self._named(message)
            if decode is not None:
                try:
                    found = found._replace(message=decode(found.message))
                except ValueError as error:
                    if skip_misfits:
                        continue
                    raise InputError(
                        f"{self.path}: message {number} ({found.topic!r}): does not fit its definition: {error}"
                    ) from None
            yield found

    def raw_messages(self, topics: Collection[str] | None = None) -> Iterator[BagMessage]:
        """Messages with their content as bytes; otherwise the same as ``messages``."""
        return map(self._named, self._selected(topics))

    def _named(self, message: Message) -> BagMessage:
        """A message with the topic and type of its channel; unpacked if it was compressed on its own."""
        schema = self._described.schema(message.channel)
        channel = self._described.channels[message.channel]
        data = message.data
        if data[: len(ZSTD)] == ZSTD and channel.message_encoding == "cdr":
            data = unpacked(data, f"{self.path}: a message of {channel.topic!r}")
        return BagMessage(channel.topic, schema.name if schema else "", message.log_time, data)

    def _selected(self, topics: Collection[str] | None) -> Iterator[Message]:
        """Messages of some topics, or of all topics."""
        skipped = self._chunks_without(topics) if topics is not None else frozenset()
        self._describe_all()

        def unwanted(channel: int) -> bool:
            if channel not in self._described.channels:
                raise InputError(
                    f"{self.path}: a message of channel {channel}, which is not described; the file is damaged"
                )
            return topics is not None and self._described.channels[channel].topic not in topics

        def part(start_ns: int, size: int, where: str, content: Callable[[], bytes]) -> Segment:
            return Segment(start_ns, size, lambda: in_order(content(), where, self._described.add, unwanted))

        yield from merged([part(*found) for found in self._parts(skipped)], _log_time, self.path)
        missing = set(topics or ()) - {channel.topic for channel in self._described.channels.values()}
        if missing:
            raise InputError(f"{self.path}: no topic {', '.join(sorted(missing))}; see `sugiyama info {self.path}`")

    def _parts(self, skipped: Collection[int]) -> Iterator[tuple[int, int, str, Callable[[], bytes]]]:
        """The chunks, and the blocks of messages between them: first log time [ns], bytes, name, and what reads it.

        Chunks at the offsets ``skipped`` are passed over.
        """
        file, block, first_ns = self._file, (0, 0), 0
        for record in file.records():
            is_message = record.opcode == Opcode.MESSAGE
            begin, end = block
            if begin < end and (not is_message or end != record.offset or record.end - begin > _BLOCK):
                yield first_ns, end - begin, f"{self.path}: offset {begin}", partial(file.read, begin, end - begin)
                block = (0, 0)
            if is_message:
                log_time = file.message_head(record).log_time
                first_ns = log_time if block == (0, 0) else min(first_ns, log_time)
                block = (record.offset if block == (0, 0) else block[0], record.end)
            elif record.opcode == Opcode.CHUNK and record.offset not in skipped:
                start_ns, size = file.chunk_head(record)
                yield start_ns, size, f"{self.path}: chunk at offset {record.offset}", partial(file.chunk, record)

    def _describe_all(self) -> None:
        """Take in the descriptions of types and channels: from the summary, and from between the chunks.

        Only if that leaves some out, from the chunks as well: a channel may be described in a chunk that comes later.
        """
        for offset in (self._summary, len(MAGIC)):
            for record in self._file.records(offset) if offset else ():
                if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._described.add(record.opcode, self._file.body(record, MAX_DESCRIPTION))
        if self._described.channels:
            return
        for record in self._file.records():
            if record.opcode == Opcode.CHUNK:
                where = f"{self.path}: chunk at offset {record.offset}"
                for opcode, found in content_records(self._file.chunk(record), where):
                    if opcode != Opcode.MESSAGE:
                        self._described.add(opcode, found)

    def _chunks_without(self, topics: Collection[str]) -> Collection[int]:
        """Offsets of chunks that hold no message of ``topics``, as far as the summary says so."""
        if not self._summary:
            return frozenset()
        indexes = []
        for record in self._file.records(self._summary):
            if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._described.add(record.opcode, self._file.body(record, MAX_DESCRIPTION))
            elif record.opcode == Opcode.CHUNK_INDEX:
                indexes.append(record)
        wanted = {channel.id for channel in self._described.channels.values() if channel.topic in topics}
        if len(wanted) < len(topics):
            return frozenset()
        skipped = set()
        for record in indexes:
            index = self._file.parse(ChunkIndex, record)
            if index.message_index_offsets and wanted.isdisjoint(index.message_index_offsets):
                skipped.add(index.chunk_start_offset)
        return skipped

    def _decoder(self, number: int) -> Decoder | None:
        """Decoder for the messages of a channel; None if they cannot be decoded, and `undecoded` says why."""
        channel, schema = self._described.channels[number], self._described.schema(number)
        name = schema.name if schema is not None else ""
        text = schema.data.decode(errors="replace") if schema is not None else ""
        found = decoder_of(name, text, schema.encoding if schema is not None else "", channel.message_encoding)
        if isinstance(found, str):
            self.undecoded[channel.topic] = found
            return None
        return found

    def _topic(self, channel: Channel, count: int) -> TopicInfo:
        schema = self._described.schema(channel.id)
        qos = channel.metadata.get("offered_qos_profiles", "")[:10_000]
        return TopicInfo(
            name=channel.topic,
            type=schema.name if schema else "",
            count=count,
            serialization=channel.message_encoding,
            reliability=_policy(qos, "reliability", {"1": "reliable", "2": "best_effort"}),
            durability=_policy(qos, "durability", {"1": "transient_local", "2": "volatile"}),
        )

    def _counted(self) -> Statistics:
        """Statistics of a file without a statistics record, by counting."""
        counts: dict[int, int] = {}
        start, end = (1 << 64) - 1, 0
        for message in self._selected(None):
            counts[message.channel] = counts.get(message.channel, 0) + 1
            start, end = min(start, message.log_time), max(end, message.log_time)
        return Statistics(
            attachment_count=0,
            channel_count=len(self._described.channels),
            channel_message_counts=counts,
            chunk_count=0,
            message_count=sum(counts.values()),
            message_end_time=end,
            message_start_time=min(start, end),
            metadata_count=0,
            schema_count=len(self._described.schemas),
        )

    def _summary_start(self) -> int:
        """Offset of the summary section, with a verified checksum; 0 if there is no summary."""
        file = self._file
        footer_offset = file.size - len(MAGIC) - _FOOTER_SIZE
        if footer_offset < len(MAGIC) or file.read(file.size - len(MAGIC), len(MAGIC)) != MAGIC:
            raise file.cut_off(file.size)
        record = file.record(footer_offset)
        if record.opcode != Opcode.FOOTER or record.length != _FOOTER_SIZE - HEAD.size:
            raise file.damaged(footer_offset, "no footer record")
        footer = file.parse(Footer, record)
        start = footer.summary_start
        if start == 0:
            return 0
        if not len(MAGIC) <= start <= footer_offset:
            raise file.damaged(footer_offset, f"the summary is said to be at {start}")
        if footer.summary_crc:
            crc, end = 0, file.size - len(MAGIC) - 4
            for offset in range(start, end, _BLOCK):
                crc = zlib.crc32(file.read(offset, min(_BLOCK, end - offset)), crc)
            if crc != footer.summary_crc:
                raise file.damaged(start, "checksum of the summary does not hold")
        return start

    def close(self) -> None:
        """Close the file."""
        self._opened.close()

    def __enter__(self) -> "Bag":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _policy(qos: str, name: str, numbers: dict[str, str]) -> str:
    """One policy of the first profile in the YAML text of rosbag2; older bags write numbers."""
    found = re.search(rf"\b{name}: *(\w+)", qos)
    return numbers.get(found[1], found[1]) if found else ""
