"""Directories of rosbag2: one or more files, and ``metadata.yaml``."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from types import TracebackType
from typing import Any

import yaml

from sugiyama_ros.documents import read_yaml
from sugiyama_ros.errors import InputError, OutputError
from sugiyama_ros.formats.definitions import type_hash
from sugiyama_ros.formats.mcap_order import Segment, merged
from sugiyama_ros.formats.mcap_reader import Bag, BagInfo, BagMessage, TopicInfo
from sugiyama_ros.formats.mcap_writer import BagWriter, Qos
from sugiyama_ros.outputs import make_directory, writing

METADATA = "metadata.yaml"
_NEVER_NS = 2**63 - 1
# How rosbag2 and others call files that zstd has compressed.
_PACKED = (".zstd", ".zst")


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


@dataclass(frozen=True)
class BagSource:
    """One or more files that were recorded together, read as one.

    path: MCAP file, or directory of rosbag2; files: the files.
    """

    path: Path
    files: list[Path]
    #: Why the messages of a topic are given as bytes.
    undecoded: dict[str, str] = field(default_factory=dict)

    def info(self) -> BagInfo:
        """Content of all files together. Raises InputError where a file cannot be read."""
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
        return BagInfo(
            file=str(self.path),
            size_bytes=sum(one.size_bytes for one in each),
            storage=each[0].storage,
            profile=each[0].profile,
            library=each[0].library,
            duration_s=1e-9 * (end_ns - start_ns),
            start_ns=start_ns,
            end_ns=end_ns,
            messages=sum(one.messages for one in each),
            compression=tuple(sorted({name for one in each for name in one.compression})),
            topics=tuple(topics[name] for name in sorted(topics)),
            metadata={name: values for one in each for name, values in one.metadata.items()},
        )

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Messages of some topics in the order of their log times, as those of `Bag`.

        Raises InputError for a topic that no file has.
        """
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


def recorded(path: Path) -> BagSource:
    """A bag: an MCAP file, or a directory of rosbag2. Raises InputError as `bag_files` does."""
    return BagSource(path, bag_files(path))


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
        self._numbers: dict[str, int] = {}
        self._counts: list[int] = []
        self._files: list[dict[str, Any]] = []
        self._open()

    @property
    def counts(self) -> dict[str, int]:
        """Messages written so far on each topic."""
        return {name: self._counts[number] for name, number in self._numbers.items()}

    def topic(self, name: str, type_name: str, qos: Qos) -> int:
        """Announce a topic; returns its number for ``write``."""
        channel = self._writer.topic(name, type_name, qos)
        if name not in self._numbers:
            self._numbers[name] = len(self._topics)
            self._topics.append((name, type_name, qos))
            self._counts.append(0)
            self._channels.append(channel)
        return self._numbers[name]

    def write(self, number: int, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Write one message in CDR; times in [ns]."""
        if self._split_bytes and self._writer.size >= self._split_bytes:
            self._writer.close()
            self._open()
        self._writer.write(self._channels[number], data, log_time_ns, publish_time_ns)
        self._counts[number] += 1
        about = self._files[-1]
        about["first"] = min(about["first"], log_time_ns)
        about["last"] = max(about["last"], log_time_ns)
        about["count"] += 1

    def flush(self) -> None:
        """Write all messages to the disk."""
        self._writer.flush()

    def close(self) -> None:
        """Finish the last file, and write ``metadata.yaml``."""
        self._writer.close()
        self._describe()

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
            "message_count": sum(self._counts),
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": name,
                        "type": kind,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": yaml.safe_load(qos.yaml),
                        "type_description_hash": type_hash(kind),
                    },
                    "message_count": count,
                }
                for (name, kind, qos), count in zip(self._topics, self._counts, strict=True)
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
