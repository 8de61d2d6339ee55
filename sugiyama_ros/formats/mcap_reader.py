"""Reader of bags: MCAP files, and directories of rosbag2 with one or more of them."""

import re
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Header, Metadata, MetadataIndex, Statistics

from sugiyama_ros.errors import InputError
from sugiyama_ros.files import read_yaml
from sugiyama_ros.formats.cdr import Decoder, decoder_of
from sugiyama_ros.formats.mcap_records import (
    HEAD,
    MAGIC,
    MAX_RECORD,
    METADATA,
    ZSTD,
    Descriptions,
    Message,
    Record,
    RecordFile,
    Segment,
    content_records,
    in_order,
    merged,
    open_packed,
    unpacked,
)

_FOOTER_SIZE = HEAD.size + 20
_BLOCK = 1 << 20
# How rosbag2 and others call files that zstd has compressed.
_PACKED = (".zstd", ".zst")


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
    refused before memory is allocated for them. Raises InputError.
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
        for record in self._noting(self._file.records(self._summary or len(MAGIC))):
            if record.opcode == Opcode.STATISTICS:
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
            counts, start, end = self._counted()
        else:
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
            messages=sum(counts.values()) if statistics is None else statistics.message_count,
            compression=tuple(sorted(compression - {""})),
            topics=tuple(sorted(topics, key=attrgetter("name"))),
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

    def close(self) -> None:
        """Close the file."""
        self._opened.close()

    def __enter__(self) -> "Bag":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _noting(self, records: Iterable[Record]) -> Iterator[Record]:
        """Records; their descriptions of types and channels are kept."""
        for record in records:
            if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._described.add(record.opcode, self._file.body(record))
            yield record

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

        def wanted(channel: int) -> bool:
            if channel not in self._described.channels:
                raise InputError(
                    f"{self.path}: a message of channel {channel}, which is not described; the file is damaged"
                )
            return topics is None or self._described.channels[channel].topic in topics

        skipped = self._without(topics)
        parts = [
            Segment(start, size, partial(self._part, where, content, wanted))
            for start, size, where, content in self._parts(skipped)
        ]
        if not self._described.channels:
            self._describe_chunks()
        yield from merged(parts, attrgetter("log_time"), self.path)
        missing = set(topics or ()) - {channel.topic for channel in self._described.channels.values()}
        if missing:
            raise InputError(f"{self.path}: no topic {', '.join(sorted(missing))}; see `sugiyama info {self.path}`")

    def _part(self, where: str, content: Callable[[], bytes], wanted: Callable[[int], bool]) -> Iterator[Message]:
        return in_order(content(), where, self._described.add, wanted)

    def _parts(self, skipped: Collection[int]) -> Iterator[tuple[int, int, str, Callable[[], bytes]]]:
        """The chunks, and the blocks of messages between them: first log time [ns], bytes, name, and what reads it.

        Chunks at the offsets ``skipped`` are passed over.
        """
        file, block, first_ns = self._file, (0, 0), 0
        for record in self._noting(file.records()):
            is_message = record.opcode == Opcode.MESSAGE
            begin, end = block
            if begin < end and (not is_message or end != record.offset or record.end - begin > _BLOCK):
                yield first_ns, end - begin, f"{self.path}: offset {begin}", partial(file.read, begin, end - begin)
                block = (0, 0)
            if is_message:
                log_time = file.log_time(record)
                first_ns = log_time if block == (0, 0) else min(first_ns, log_time)
                block = (record.offset if block == (0, 0) else block[0], record.end)
            elif record.opcode == Opcode.CHUNK and record.offset not in skipped:
                start_ns, size = file.chunk_head(record)
                yield start_ns, min(size, MAX_RECORD), file.where(record), partial(file.chunk, record)

    def _without(self, topics: Collection[str] | None) -> Collection[int]:
        """Offsets of chunks that hold no message of ``topics``, as far as the summary says so."""
        records = self._noting(self._file.records(self._summary)) if self._summary else ()
        indexes = [record for record in records if record.opcode == Opcode.CHUNK_INDEX]
        wanted = {channel.id for channel in self._described.channels.values() if channel.topic in (topics or ())}
        if topics is None or len(wanted) < len(topics):
            return frozenset()
        found = [self._file.parse(ChunkIndex, record) for record in indexes]
        return {
            index.chunk_start_offset
            for index in found
            if index.message_index_offsets and wanted.isdisjoint(index.message_index_offsets)
        }

    def _describe_chunks(self) -> None:
        """Take in the descriptions in all chunks, where they are nowhere else: one may come after its messages."""
        for record in self._file.records():
            if record.opcode == Opcode.CHUNK:
                content = self._file.chunk(record)
                for opcode, start, end in content_records(content, self._file.where(record)):
                    if opcode != Opcode.MESSAGE:
                        self._described.add(opcode, content[start:end])

    def _decoder(self, number: int) -> Decoder | None:
        """Decoder for the messages of a channel; None if they cannot be decoded, and `undecoded` says why."""
        channel, schema = self._described.channels[number], self._described.schema(number)
        said = (schema.name, schema.data.decode(errors="replace"), schema.encoding) if schema else ("", "", "")
        found = decoder_of(*said, channel.message_encoding)
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

    def _counted(self) -> tuple[dict[int, int], int, int]:
        """Messages of each channel, and the first and last log time [ns], of a file that does not say them."""
        counts: dict[int, int] = {}
        start, end = (1 << 64) - 1, 0
        for message in self._selected(None):
            counts[message.channel] = counts.get(message.channel, 0) + 1
            start, end = min(start, message.log_time), max(end, message.log_time)
        return counts, min(start, end), end

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


def _policy(qos: str, name: str, numbers: dict[str, str]) -> str:
    """One policy of the first profile in the YAML text of rosbag2; older bags write numbers."""
    found = re.search(rf"\b{name}: *(\w+)", qos)
    return numbers.get(found[1], found[1]) if found else ""


class BagSource:
    """One or more files that were recorded together, read as one: an MCAP file, or a directory of rosbag2.

    Raises InputError.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.files = path, bag_files(path)
        #: Why the messages of a topic are given as bytes.
        self.undecoded: dict[str, str] = {}

    def info(self) -> BagInfo:
        """Content of all files together."""
        each = []
        for file in self.files:
            with Bag(file) as bag:
                each.append(bag.info())
        if len(each) == 1:
            return replace(each[0], file=str(self.path))
        filled = [one for one in each if one.messages]
        start_ns = min((one.start_ns for one in filled), default=0)
        end_ns = max((one.end_ns for one in filled), default=0)
        topics: dict[str, TopicInfo] = {}
        for topic in (topic for one in each for topic in one.topics):
            known = topics.get(topic.name)
            topics[topic.name] = topic if known is None else replace(known, count=known.count + topic.count)
        return replace(
            each[0],
            file=str(self.path),
            size_bytes=sum(one.size_bytes for one in each),
            duration_s=1e-9 * (end_ns - start_ns),
            start_ns=start_ns,
            end_ns=end_ns,
            messages=sum(one.messages for one in each),
            compression=tuple(sorted({name for one in each for name in one.compression})),
            topics=tuple(topics[name] for name in sorted(topics)),
            metadata={name: values for one in each for name, values in one.metadata.items()},
        )

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Messages of some topics in the order of their log times, as those of `Bag`."""
        parts, missing = [], set(topics)
        for file in self.files:
            with Bag(file) as bag:
                about = bag.info()
            here = {topic.name for topic in about.topics} & set(topics)
            missing -= here
            if here and about.messages:
                parts.append(Segment(about.start_ns, 0, partial(self._of_file, file, here)))
        if missing:
            raise InputError(f"{self.path}: no topic {', '.join(sorted(missing))}; see `sugiyama info {self.path}`")
        yield from merged(parts, attrgetter("log_time_ns"), self.path)

    def _of_file(self, file: Path, topics: Collection[str]) -> Iterator[BagMessage]:
        with Bag(file) as bag:
            for message in bag.messages(topics):
                if isinstance(message.message, bytes):
                    self.undecoded.update(bag.undecoded)
                yield message


def bag_files(path: Path) -> list[Path]:
    """Files of a bag, in the order in which they were recorded. Raises InputError."""
    if not path.is_dir():
        if path.suffix.lower() in (".bag", ".db3"):
            kind = "a bag of ROS 1" if path.suffix.lower() == ".bag" else "in a database of rosbag2"
            source = path if path.suffix.lower() == ".bag" else path.parent
            target = path.with_suffix("")
            cure = f"run `rosbags-convert --src {source} --dst {target}_mcap --dst-storage mcap`"
            raise InputError(f"{path}: {kind}, not an MCAP file; {cure}, and give {target}_mcap")
        return [path]
    if not (path / METADATA).is_file():
        raise InputError(f"{path}: has no {METADATA}; give one of its .mcap files, or run `ros2 bag reindex {path}`")
    document = read_yaml(path / METADATA)
    try:
        about = document["rosbag2_bagfile_information"]
        storage, names = str(about["storage_identifier"]), [str(name) for name in about["relative_file_paths"]]
    except (KeyError, TypeError):
        raise InputError(f"{path / METADATA}: is not of a bag; give a directory that rosbag2 recorded") from None
    if storage != "mcap":
        cure = f"run `rosbags-convert --src {path} --dst {path}_mcap --dst-storage mcap`"
        raise InputError(f"{path}: its storage is {storage}, not mcap; {cure}, and give {path}_mcap")
    files = [_unpacked(path / Path(name).name) for name in names]
    if not files:
        raise InputError(f"{path}: has no files; record something")
    return files


def _unpacked(file: Path) -> Path:
    """The file that was unpacked beside a compressed one, if there is one."""
    beside = file.with_suffix("")
    return beside if file.suffix in _PACKED and beside.suffix == ".mcap" and beside.is_file() else file
