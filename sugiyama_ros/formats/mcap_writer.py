"""Writers of bags that rosbag2, Foxglove, Lichtblick and PlotJuggler read: MCAP files, and directories of rosbag2."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType
from typing import Any

import yaml
from mcap.writer import CompressionType, Writer

from sugiyama_ros.errors import InputError, OutputError
from sugiyama_ros.files import Draft, Target, make_directory, not_written, writing
from sugiyama_ros.formats.definitions import full_text, type_hash
from sugiyama_ros.formats.mcap_records import METADATA

#: Chunks are closed at this size [bytes]; small chunks limit what a crash can lose.
_CHUNK_SIZE = 256 << 10
#: Longest wall time [s] for which written messages may stay in memory.
_FLUSH_S = 1.0
_NEVER_NS = 2**63 - 1
_INFINITE = "{sec: 9223372036, nsec: 854775807}"


@dataclass(frozen=True)
class Qos:
    """Quality of service that the publishers of a topic offer."""

    reliability: str = "reliable"
    durability: str = "volatile"
    depth: int = 10

    @property
    def yaml(self) -> str:
        """The YAML text that rosbag2 (Jazzy and newer) keeps with each topic."""
        return (
            "- history: keep_last\n"
            f"  depth: {self.depth}\n"
            f"  reliability: {self.reliability}\n"
            f"  durability: {self.durability}\n"
            f"  deadline: {_INFINITE}\n"
            f"  lifespan: {_INFINITE}\n"
            "  liveliness: automatic\n"
            f"  liveliness_lease_duration: {_INFINITE}\n"
            "  avoid_ros_namespace_conventions: false\n"
        )


#: Quality of service of a topic whose last message must reach late subscribers.
LATCHED_TOPIC = Qos(durability="transient_local", depth=1)


class BagWriter:
    """Writes serialized messages to an MCAP file; use it in a ``with`` block.

    The file appears under its name when the block ends without an error. Until then the messages are in ``part``, such
    as ``FILE.3f9a1c07.part``; after a crash, ``sugiyama recover`` makes a complete file from it. An error in the block
    removes this file. If the disk fails, the messages that were flushed before stay.

    target: the file; metadata: parameters, data source and checksum of the run, kept in a record named ``sugiyama``.
    Raises OutputError, InputError.
    """

    def __init__(self, target: Target, metadata: Mapping[str, str] | None = None) -> None:
        self._draft = Draft(target)
        self.path, self.part = self._draft.path, self._draft.part
        self._counts: list[int] = []
        self._topics: dict[str, tuple[int, str]] = {}
        self._schemas: dict[str, int] = {}
        self._dirty = False
        self._kept = False
        self._flushed_s = time.monotonic()
        release = _version()
        about = {"version": release, **(metadata or {})}
        try:
            self._writer = Writer(self._draft.stream, chunk_size=_CHUNK_SIZE, compression=CompressionType.ZSTD)
            self._writer.start(profile="ros2", library=f"sugiyama_ros {release}")
            self._writer.add_metadata("sugiyama", about)
        except OSError as error:
            self._discard()
            raise self._failed(error) from None

    @property
    def counts(self) -> dict[str, int]:
        """Messages written so far on each topic."""
        return {name: self._counts[channel] for name, (channel, _) in self._topics.items()}

    @property
    def size(self) -> int:
        """Bytes in the file so far, without the last chunk."""
        return self._draft.stream.tell()

    def topic(self, name: str, type_name: str, qos: Qos = Qos()) -> int:
        """Announce a topic, such as ``/vehicle_07/innovation``; returns its number for ``write``.

        A topic that is announced twice keeps its number.
        """
        if name in self._topics:
            channel, announced = self._topics[name]
            if announced != type_name:
                raise InputError(f"{name}: announced as {announced} before, now as {type_name}; use two names")
            return channel
        if type_name not in self._schemas:
            self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", full_text(type_name).encode())
        about = {"offered_qos_profiles": qos.yaml, "topic_type_hash": type_hash(type_name)}
        number = self._writer.register_channel(name, "cdr", self._schemas[type_name], about)
        self._counts += [0] * (number + 1 - len(self._counts))
        self._topics[name] = (number, type_name)
        return number

    def write(self, channel: int, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Write one message in CDR; times in [ns]."""
        if log_time_ns < 0 or publish_time_ns < 0:
            raise InputError(f"{self.path}: MCAP has no times before 0; shift the times of the source")
        try:
            self._writer.add_message(channel, log_time_ns, data, publish_time_ns, self._counts[channel])
        except OSError as error:
            raise self._failed(error) from None
        self._counts[channel] += 1
        self._dirty = True
        if time.monotonic() - self._flushed_s > _FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Write all messages to the disk. Call it once a second if there may be no messages for a while."""
        self._flushed_s = time.monotonic()
        if not self._dirty:
            return
        try:
            self._writer.flush()  # type: ignore[no-untyped-call]
            self._draft.sync()
        except OSError as error:
            raise self._failed(error) from None
        self._dirty = False
        self._kept = True

    def close(self) -> None:
        """Finish the file and give it its name."""
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._draft.finish()
        except OSError as error:
            failed = self._failed(error)
            self._discard()
            raise failed from None

    def _discard(self) -> None:
        """Remove the unfinished file, but keep what was flushed before a disk failed."""
        if self._kept:
            self._draft.close()
        else:
            self._draft.discard()

    def _failed(self, error: OSError) -> OutputError:
        """Error to raise where the disk refuses to write."""
        kept = f"; what was flushed before is in {self.part} (`sugiyama recover`)" if self._kept else ""
        return OutputError(f"{not_written(self.path, error)}{kept}")

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
            return
        self._kept = self._kept and issubclass(kind, OutputError)
        self._discard()


def _version() -> str:
    """Version of the installed package."""
    try:
        return version("sugiyama_ros")
    except PackageNotFoundError:
        return "0"


class FolderWriter:
    """Writes serialized messages to a directory of rosbag2: files of a bounded size, and ``metadata.yaml`` at the end.

    It is used as `BagWriter` is. What is latched stands in the first file alone, as with rosbag2.

    folder: the directory, which must not be there yet; split_bytes: size at which the next file begins; 0: one file;
    metadata: what is kept in each file. Raises OutputError.
    """

    def __init__(self, folder: Path, split_bytes: int = 0, metadata: Mapping[str, str] | None = None) -> None:
        if folder.exists():
            raise OutputError(f"{folder}: is there already; give another name")
        make_directory(folder)
        self._folder, self._split_bytes, self._metadata = folder, split_bytes, metadata
        self._topics: list[tuple[str, str, Qos]] = []
        #: Messages written so far on each topic.
        self.counts: dict[str, int] = {}
        self._files: list[dict[str, Any]] = []
        self._open()

    def topic(self, name: str, type_name: str, qos: Qos) -> int:
        """Announce a topic; returns its number for ``write``."""
        channel = self._writer.topic(name, type_name, qos)
        if name not in self.counts:
            self._topics.append((name, type_name, qos))
            self.counts[name] = 0
            self._channels.append(channel)
        return list(self.counts).index(name)

    def write(self, number: int, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Write one message in CDR; times in [ns]."""
        if self._split_bytes and self._writer.size >= self._split_bytes:
            self._writer.close()
            self._open()
        self._writer.write(self._channels[number], data, log_time_ns, publish_time_ns)
        self.counts[self._topics[number][0]] += 1
        about = self._files[-1]
        about["first"] = min(about["first"], log_time_ns)
        about["last"] = max(about["last"], log_time_ns)
        about["count"] += 1

    def flush(self) -> None:
        """Write all messages to the disk."""
        self._writer.flush()

    def close(self) -> None:
        """Finish the last file, and write ``metadata.yaml``."""
        self.__exit__(None, None, None)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.__exit__(kind, error, trace)
        if kind is None:
            self._describe()

    def __enter__(self) -> "FolderWriter":
        return self

    def _open(self) -> None:
        name = f"{self._folder.name}_{len(self._files)}.mcap"
        self._writer = BagWriter(self._folder / name, self._metadata)
        self._channels = [self._writer.topic(*topic) for topic in self._topics]
        self._files.append({"path": name, "first": _NEVER_NS, "last": 0, "count": 0})

    def _describe(self) -> None:
        """Write what rosbag2 (Jazzy and newer) wants to know of a bag."""
        first = min(about["first"] for about in self._files)
        last = max(about["last"] for about in self._files)
        start = min(first, last)  # without messages, there is no first
        document = {
            "version": 9,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": last - start},
            "starting_time": {"nanoseconds_since_epoch": start},
            "message_count": sum(self.counts.values()),
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": name,
                        "type": kind,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": yaml.safe_load(qos.yaml),
                        "type_description_hash": type_hash(kind),
                    },
                    "message_count": self.counts[name],
                }
                for name, kind, qos in self._topics
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [about["path"] for about in self._files],
            "files": [
                {
                    "path": about["path"],
                    "starting_time": {"nanoseconds_since_epoch": min(about["first"], about["last"])},
                    "duration": {"nanoseconds": max(about["last"] - about["first"], 0)},
                    "message_count": about["count"],
                }
                for about in self._files
            ],
            "custom_data": None,
            "ros_distro": "jazzy",
        }
        with writing(self._folder / METADATA) as stream:
            stream.write(yaml.safe_dump({"rosbag2_bagfile_information": document}, sort_keys=False).encode())
