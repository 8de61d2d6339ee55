"""Writer of MCAP files that rosbag2, Foxglove, Lichtblick and PlotJuggler read."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from types import TracebackType

from sugiyama_ros.errors import InputError, OutputError
from sugiyama_ros.formats.definitions import full_text, type_hash
from sugiyama_ros.formats.mcap_record_writer import RecordWriter
from sugiyama_ros.outputs import Draft, Target, not_written

#: Chunks are closed at this size [bytes]; small chunks limit what a crash can lose.
_CHUNK_SIZE = 256 << 10
#: Longest wall time [s] for which written messages may stay in memory.
_FLUSH_S = 1.0
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
            self._writer = RecordWriter(self._draft.stream, _CHUNK_SIZE, f"sugiyama_ros {release}", about)
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
            self._schemas[type_name] = self._writer.schema(type_name, full_text(type_name))
        about = {"offered_qos_profiles": qos.yaml, "topic_type_hash": type_hash(type_name)}
        number = self._writer.channel(name, self._schemas[type_name], about)
        self._counts += [0] * (number + 1 - len(self._counts))
        self._topics[name] = (number, type_name)
        return number

    def write(self, channel: int, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Write one message in CDR; times in [ns]."""
        if log_time_ns < 0 or publish_time_ns < 0:
            raise InputError(f"{self.path}: MCAP has no times before 0; shift the times of the source")
        try:
            self._writer.message(channel, self._counts[channel], (log_time_ns, publish_time_ns), data)
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
            self._writer.flush()
            self._draft.sync()
        except OSError as error:
            raise self._failed(error) from None
        self._dirty = False
        self._kept = True

    def close(self) -> None:
        """Finish the file and give it its name."""
        try:
            self._writer.finish()
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
