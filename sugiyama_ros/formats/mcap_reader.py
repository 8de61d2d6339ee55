"""Reader of bags: MCAP files, and directories of rosbag2 with one or more of them."""

import re
import zlib
from array import array
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Header, Metadata, MetadataIndex, Statistics

from sugiyama_ros.errors import InputError
from sugiyama_ros.files import read_yaml
from sugiyama_ros.formats.cdr import Decoder, decoder_of
from sugiyama_ros.formats.mcap_records import (
    HEAD,
    MAGIC,
    MAX_RECORD,
    MESSAGE,
    METADATA,
    ZSTD,
    Descriptions,
    Record,
    RecordFile,
    Segment,
    content_records,
    merged,
    open_packed,
    unpacked,
)

_FOOTER_SIZE = HEAD.size + 20
_BLOCK = 1 << 20
# How rosbag2 and others call files that zstd has compressed.
_PACKED = (".zstd", ".zst")
# The name of a file of a bag in several files.
_NUMBERED = re.compile(r"(.*)_(\d+)")


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
    """A bag opened for reading: an MCAP file, or a directory of rosbag2, whose files are read as one.

    Use it in a ``with`` block. Memory stays below 512 MiB, whatever the files claim. Larger records, and larger chunks
    after decompression, are refused before memory is allocated for them. Raises InputError.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self.files = bag_files(self.path)
        #: Why the messages of a topic are given as bytes.
        self.undecoded: dict[str, str] = {}
        with ExitStack() as opened:
            self._each = [_BagFile(file, opened.enter_context(open_packed(file))) for file in self.files]
            self._opened = opened.pop_all()

    def info(self) -> BagInfo:
        """Content of the bag: from its summary, or from all its messages if it has no summary."""
        each = [file.content() for file in self._each]
        counts, topics = Counter[str](), {}
        for file, content in zip(self._each, each, strict=True):
            for number, channel in file.described.channels.items():
                counts[channel.topic] += content.counts.get(number, 0)
                topics[channel.topic] = file, channel
        filled = [content for content in each if content.messages]
        start_ns = min((content.start_ns for content in filled), default=0)
        end_ns = max((content.end_ns for content in filled), default=0)
        return BagInfo(
            file=str(self.path),
            size_bytes=sum(file.records.size for file in self._each),
            storage="mcap",
            profile=self._each[0].header.profile,
            library=self._each[0].header.library,
            duration_s=1e-9 * (end_ns - start_ns),
            start_ns=start_ns,
            end_ns=end_ns,
            messages=sum(content.messages for content in each),
            compression=tuple(sorted({name for content in each for name in content.compression} - {""})),
            topics=tuple(_topic(*topics[name], counts[name]) for name in sorted(topics)),
            metadata={name: values for content in each for name, values in content.metadata.items()},
        )

    def messages(self, topics: Collection[str] | None = None, *, skip_misfits: bool = False) -> Iterator[BagMessage]:
        """Messages of some topics, or of all topics, in the order of their log times.

        A topic whose messages cannot be decoded has bytes, and `undecoded` says why. Raises InputError for a topic that
        is not in the bag, and for a message that does not fit its definition, unless such messages are skipped.
        """
        decoders: dict[tuple[_BagFile, int], Decoder | None] = {}
        for number, (log_ns, file, channel, data) in enumerate(self._selected(topics)):
            if (file, channel) not in decoders:
                decoders[file, channel] = self._decoder(file, channel)
            decode, found = decoders[file, channel], file.named(channel, log_ns, data)
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
        return (file.named(channel, log_ns, data) for log_ns, file, channel, data in self._selected(topics))

    def close(self) -> None:
        """Close the files."""
        self._opened.close()

    def __enter__(self) -> "Bag":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _selected(self, topics: Collection[str] | None) -> "Iterator[_Found]":
        """Messages of some topics, or of all topics, in the order of their log times."""
        yield from merged([part for file in self._each for part in file.parts(topics)], self.path)
        known = {channel.topic for file in self._each for channel in file.described.channels.values()}
        if missing := set(topics or ()) - known:
            raise InputError(f"{self.path}: no topic {', '.join(sorted(missing))}; see `sugiyama info {self.path}`")

    def _decoder(self, file: "_BagFile", number: int) -> Decoder | None:
        """Decoder for the messages of a channel; None if they cannot be decoded, and `undecoded` says why."""
        channel, schema = file.described.channels[number], file.described.schema(number)
        said = (schema.name, schema.data.decode(errors="replace"), schema.encoding) if schema else ("", "", "")
        found = decoder_of(*said, channel.message_encoding)
        if isinstance(found, str):
            self.undecoded[channel.topic] = found
            return None
        return found


class _Found(NamedTuple):
    """One message as in a file: log time [ns], file, number of the channel, and bytes."""

    log_ns: int
    file: "_BagFile"
    channel: int
    data: bytes


@dataclass
class _Content:
    """What a file says of itself: messages of each channel and in all, first and last log time [ns], and metadata."""

    counts: dict[int, int] = field(default_factory=dict)
    messages: int = 0
    start_ns: int = 0
    end_ns: int = 0
    compression: set[str] = field(default_factory=set)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)


class _BagFile:
    """One MCAP file of a bag. Raises InputError."""

    def __init__(self, path: Path, stream: BinaryIO) -> None:
        self.path, self.records, self.described = path, RecordFile(path, stream), Descriptions(path)
        first = self.records.record(len(MAGIC))
        if first.opcode != Opcode.HEADER:
            raise self.records.damaged(first.offset, "no header record")
        self.header = self.records.parse(Header, first)
        self._summary = self._summary_start()

    def content(self) -> _Content:
        """Content of the file: from its summary, or from all its messages if it has no summary."""
        file, found, is_counted = self.records, _Content(), False
        for record in self._noting(file.records(self._summary or len(MAGIC))):
            if record.opcode == Opcode.STATISTICS:
                said = file.parse(Statistics, record)
                is_counted, found.counts, found.messages = True, said.channel_message_counts, said.message_count
                found.start_ns, found.end_ns = said.message_start_time, said.message_end_time
            elif record.opcode == Opcode.CHUNK_INDEX:
                found.compression.add(file.parse(ChunkIndex, record).compression)
            elif record.opcode == Opcode.METADATA_INDEX:
                record = file.record(file.parse(MetadataIndex, record).offset)
            if record.opcode == Opcode.METADATA:
                metadata = file.parse(Metadata, record)
                self.described.count(record.length)
                found.metadata[metadata.name] = metadata.metadata
        for one in () if is_counted else merged(self.parts(None), self.path):
            found.start_ns = min(found.start_ns, one.log_ns) if found.messages else one.log_ns
            found.end_ns, found.messages = max(found.end_ns, one.log_ns), found.messages + 1
            found.counts[one.channel] = found.counts.get(one.channel, 0) + 1
        return found

    def named(self, number: int, log_ns: int, data: bytes) -> BagMessage:
        """A message with the topic and type of its channel; unpacked if it was compressed on its own."""
        schema, channel = self.described.schema(number), self.described.channels[number]
        if data[: len(ZSTD)] == ZSTD and channel.message_encoding == "cdr":
            data = unpacked(data, f"{self.path}: a message of {channel.topic!r}")
        return BagMessage(channel.topic, schema.name if schema else "", log_ns, data)

    def parts(self, topics: Collection[str] | None) -> list[Segment]:
        """The chunks, and the blocks of messages between them."""
        skipped = self._without(topics)
        parts = [
            Segment(start_ns, size, partial(self._in_order, read, where, topics))
            for start_ns, size, where, read in self._blocks(skipped)
        ]
        if not self.described.channels:
            # the descriptions are in the chunks alone, and one may come after its messages
            for record in self.records.records():
                if record.opcode == Opcode.CHUNK:
                    content = self.records.chunk(record)
                    for opcode, start, end in content_records(content, self.records.where(record)):
                        if opcode != Opcode.MESSAGE:
                            self.described.add(opcode, content[start:end])
        return parts

    def _noting(self, records: Iterable[Record]) -> Iterator[Record]:
        """Records; their descriptions of types and channels are kept."""
        for record in records:
            if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.described.add(record.opcode, self.records.body(record))
            yield record

    def _without(self, topics: Collection[str] | None) -> set[int]:
        """Offsets of chunks that hold no message of ``topics``, as far as the summary says so."""
        records = self._noting(self.records.records(self._summary)) if self._summary else ()
        indexes = [record for record in records if record.opcode == Opcode.CHUNK_INDEX]
        skipped: set[int] = set()
        if topics is None:
            return skipped
        others = {number for number, channel in self.described.channels.items() if channel.topic not in topics}
        for record in indexes:
            index = self.records.parse(ChunkIndex, record)
            if index.message_index_offsets and others.issuperset(index.message_index_offsets):
                skipped.add(index.chunk_start_offset)
        return skipped

    def _blocks(self, skipped: Collection[int]) -> Iterator[tuple[int, int, str, Callable[[], bytes]]]:
        """The chunks, and the blocks of messages between them: first log time [ns], bytes, name, and what reads it.

        Chunks at the offsets ``skipped`` are passed over.
        """
        file, block, first_ns = self.records, (0, 0), 0
        for record in self._noting(file.records()):
            is_message = record.opcode == Opcode.MESSAGE
            begin, end = block
            if begin < end and (not is_message or end != record.offset or record.end - begin > _BLOCK):
                yield first_ns, end - begin, f"{self.path}: offset {begin}", partial(file.read, begin, end - begin)
                block = (0, 0)
            if is_message:
                log_ns = file.log_time(record)
                first_ns = log_ns if block == (0, 0) else min(first_ns, log_ns)
                block = (record.offset if block == (0, 0) else block[0], record.end)
            elif record.opcode == Opcode.CHUNK and record.offset not in skipped:
                start_ns, size = file.chunk_head(record)
                yield start_ns, min(size, MAX_RECORD), file.where(record), partial(file.chunk, record)

    def _in_order(self, read: Callable[[], bytes], where: str, topics: Collection[str] | None) -> Iterator[_Found]:
        """Messages in a block or chunk on some topics, in the order of their log times."""
        times, starts, ends = array("Q"), array("Q"), array("Q")
        content, is_wanted = read(), dict[int, bool]()
        for opcode, start, end in content_records(content, where):
            if opcode != Opcode.MESSAGE:
                self.described.add(opcode, content[start:end])
                continue
            channel, _, log_ns, _ = MESSAGE.unpack_from(content, start)
            if channel not in is_wanted:
                topic = self._topic_of(channel)
                is_wanted[channel] = topics is None or topic in topics
            if is_wanted[channel]:
                times.append(log_ns)
                starts.append(start)
                ends.append(end)
        order: list[int] = np.argsort(np.array(times, dtype=np.uint64), kind="stable").tolist()
        for k in order:
            channel, *_ = MESSAGE.unpack_from(content, starts[k])
            yield _Found(times[k], self, channel, content[starts[k] + MESSAGE.size : ends[k]])

    def _topic_of(self, channel: int) -> str:
        if channel not in self.described.channels:
            raise InputError(
                f"{self.path}: a message of channel {channel}, which is not described; the file is damaged"
            )
        return self.described.channels[channel].topic

    def _summary_start(self) -> int:
        """Offset of the summary section, with a verified checksum; 0 if there is no summary."""
        file = self.records
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


def _topic(file: _BagFile, channel: Channel, count: int) -> TopicInfo:
    schema = file.described.schema(channel.id)
    qos = channel.metadata.get("offered_qos_profiles", "")[:10_000]
    return TopicInfo(
        name=channel.topic,
        type=schema.name if schema else "",
        count=count,
        serialization=channel.message_encoding,
        reliability=_policy(qos, "reliability", {"1": "reliable", "2": "best_effort"}),
        durability=_policy(qos, "durability", {"1": "transient_local", "2": "volatile"}),
    )


def _policy(qos: str, name: str, numbers: dict[str, str]) -> str:
    """One policy of the first profile in the YAML text of rosbag2; older bags write numbers."""
    found = re.search(rf"\b{name}: *(\w+)", qos)
    return numbers.get(found[1], found[1]) if found else ""


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
        return _split_files(path)
    document = read_yaml(path / METADATA)
    try:
        about = document["rosbag2_bagfile_information"]
        storage, names = str(about["storage_identifier"]), [str(name) for name in about["relative_file_paths"]]
    except (KeyError, TypeError):
        raise InputError(f"{path / METADATA}: is not of a bag; give a directory that rosbag2 recorded") from None
    if not names:
        raise InputError(f"{path}: has no files; record something")
    # a directory that was indexed again may not say its storage, but its files do
    storage = storage or ("mcap" if all(".mcap" in Path(name).suffixes for name in names) else "sqlite3")
    if storage != "mcap":
        unsaid = "" if about["storage_identifier"] else f"write `storage_identifier: {storage}` into {METADATA}, "
        cure = f"{unsaid}run `rosbags-convert --src {path} --dst {path}_mcap --dst-storage mcap`"
        raise InputError(f"{path}: its storage is {storage}, not mcap; {cure}, and give {path}_mcap")
    return [_unpacked(path / Path(name).name) for name in names]


def split_files(path: Path) -> list[Path]:
    """Files of a directory whose names say that they are one bag, in the order of their numbers; none if they do not.

    A bag that was killed has no metadata; its files are called as ``part_0.mcap`` and ``part_1.mcap``.
    """
    files = [file for file in path.iterdir() if ".mcap" in file.suffixes and file.is_file()]
    parts = [_NUMBERED.fullmatch(file.name.partition(".mcap")[0]) for file in files]
    if len(files) < 2:
        return [_unpacked(file) for file in files]
    if None in parts or len({part[1] for part in parts if part}) > 1:
        return []
    # a file that was unpacked stands beside the compressed one
    whole = {int(part[2]): _unpacked(file) for file, part in zip(files, parts, strict=True) if part}
    return [whole[number] for number in sorted(whole)]


def _split_files(path: Path) -> list[Path]:
    if files := split_files(path):
        return files
    raise InputError(f"{path}: has no {METADATA}, and its names do not say that its files are one bag; give one file")


def _unpacked(file: Path) -> Path:
    """The file that was unpacked beside a compressed one, if there is one."""
    beside = file.with_suffix("")
    return beside if file.suffix in _PACKED and beside.suffix == ".mcap" and beside.is_file() else file
