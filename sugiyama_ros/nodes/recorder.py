"""Records the serialized bytes of all topics, as they come, in one MCAP file."""

import math
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.topic_or_service_is_hidden import topic_or_service_is_hidden

from sugiyama_ros.errors import InputError, SugiyamaError
from sugiyama_ros.files import Output
from sugiyama_ros.formats.definitions import full_text
from sugiyama_ros.formats.mcap_writer import BagWriter, FolderWriter, Qos
from sugiyama_ros.nodes.base import cdr_messages, incoming
from sugiyama_ros.nodes.base.cdr_messages import NS
from sugiyama_ros.nodes.base.node import ERROR, OK, RECORDER, UNRECORDED, WARN, Health, PacedNode, message_type
from sugiyama_ros.nodes.base.qos import DEPTH, offered

_POLL_S = 0.2
# New topics that are subscribed to at one poll.
_AT_A_TIME = 50
# Messages that may wait on a topic to which all nodes write without pacing.
_FROM_ALL = 5000
_FLUSH_S = 1.0
#: Silence [s] after which a topic is no longer waited for.
PATIENCE_S = 10.0
#: What all nodes log. It is recorded, but no node counts what it logs.
LOG = "/rosout"
_MB = 1_000_000
#: A stamp that is farther than this [ns] from all samples so far is of another clock.
_NEAR_NS = 10 * NS
_STAMPED = ("std_msgs/Header", "builtin_interfaces/Time", "Header")


class Recorder(PacedNode):
    """Records every topic of the graph that is not hidden, with the quality of service that its publishers offer.

    A step counts as taken when a message has come on all paced topics. Parameters of the node: ``output``, the file;
    ``overwrite``, whether to replace a file of this name; ``paced_topics``, full names of the topics with one message a
    step (only ``measured``, if left out); ``metadata``, lines ``key=value`` for the file; ``time_source``, wall or
    data; ``split_mb``. An output without the ending .mcap is a directory, as rosbag2 writes it.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(RECORDER, **options)
        measured = self.resolve_topic_name("measured")
        output = self.option("output", "", "MCAP file to write, or directory for rosbag2")
        overwrite = self.option("overwrite", False, "replace a file of this name")
        paced = self.full_names("paced_topics", [measured], "full names of the topics with one message a step")
        metadata = self.texts("metadata", "lines key=value to keep in the file")
        times = self.option("time_source", "wall", "times in the file: wall, or data for the stamps of the samples")
        split = "size [MB] at which the next file of a directory begins; 0: one file"
        split_mb = self.option("split_mb", 0.0, split, (0.0, 1e9))
        if not output:
            raise InputError("recorder: no file given; start it with -p output:=FILE.mcap")
        if times not in ("wall", "data"):
            raise InputError(f"recorder: time_source {times!r} is not known; give wall or data")
        for line in metadata:
            if "=" not in line:
                raise InputError(f"recorder: metadata {line!r} is no line key=value")
        about = dict(line.split("=", 1) for line in metadata)
        self._output = output
        self._bag = _writer(Path(output), overwrite, split_mb, about)
        self._time = _LogTime(times == "data")
        self._held: list[tuple[int, bytes, bool]] = []
        self._measured = measured
        self._levels = Levels({measured, *paced})
        self._step: dict[bytes, int] = {}
        self._unheard = set(self._levels.topics)
        self._known: set[str] = set()
        self._late: list[str] = []
        self._waiting_s = 0.0
        self._is_closed = False
        self.create_timer(_POLL_S, self._on_poll, clock=self.steady)
        self.create_timer(_FLUSH_S, lambda: self._guarded(self._flush), clock=self.steady)
        self._on_poll()

    def health(self) -> Health:
        """ERROR after a failure or if a topic has fallen silent, WARN while a topic has not appeared."""
        values = {"messages": self.received, "topics": len(self._known)}
        if self.failure:
            return Health(ERROR, str(self.failure), values)
        if self._late:
            return Health(ERROR, f"gave up waiting for {', '.join(self._late)}", values)
        if self._unheard:
            return Health(WARN, f"{len(self._unheard)} topics have not appeared: {min(self._unheard)} ...", values)
        return Health(OK, "recording", values)

    @property
    def doing(self) -> str:
        """Where everything is recorded."""
        return f"records all topics in {self._output}"

    @property
    def counts(self) -> dict[str, int]:
        """Messages recorded so far on each topic."""
        return self._bag.counts

    def close(self) -> None:
        """Finish the file. A publisher may go on, but nothing more is recorded.

        In the time of the data, a recording without a sample has no times: it is dropped, and an older file of its name
        stays.
        """
        self._is_closed = True
        if not self._time.is_known:
            self.get_logger().info(f"no sample came: {self._output} is not written")
            self._bag.__exit__(SugiyamaError, None, None)
            return
        for held in self._held:
            self._write(*held)
        if self.failure is not None:
            self._bag.__exit__(type(self.failure), self.failure, None)
        else:
            self._guarded(self._bag.close)

    def _flush(self) -> None:
        """Write what is buffered, until the file is finished."""
        if not self._is_closed:
            self._bag.flush()

    def _on_poll(self) -> None:
        new = [
            (topic, types[0])
            for topic, types in self.get_topic_names_and_types()
            if topic not in self._known and not topic.endswith(UNRECORDED) and not topic_or_service_is_hidden(topic)
        ]
        # a subscription takes some milliseconds; a queue may not hold the messages that wait meanwhile
        for topic, type_name in new[:_AT_A_TIME]:
            self._subscribe(topic, type_name)
        if not self._unheard:
            self.announce()
        self._waiting_s = self._waiting_s + _POLL_S if self._levels.waiting else 0.0
        if self._waiting_s > PATIENCE_S:
            self._drop_late()
        self.report_if_worse()

    def _subscribe(self, topic: str, type_name: str) -> None:
        """Record a topic from now on, if it has a publisher."""
        publishers = self.get_publishers_info_by_topic(topic)
        if not publishers:
            return
        self._known.add(topic)
        qos = offered(publishers)
        qos.depth = DEPTH if topic in self._levels.topics else _FROM_ALL
        try:
            message = message_type(type_name)
            told = Qos(qos.reliability.name.lower(), qos.durability.name.lower(), DEPTH)
            channel = self._bag.topic(topic, type_name, told)
            stamped = _begins_with_stamp(type_name)
        except (ImportError, AttributeError, ValueError, SugiyamaError) as error:
            self.get_logger().warning(f"{topic}: not recorded: {error}")
            return
        on_message = self._on_paced if topic in self._levels.topics else self._on_message
        self.create_subscription(message, topic, partial(on_message, topic, (channel, stamped)), qos, raw=True)
        self._unheard.discard(topic)

    def _on_message(self, topic: str, channel: tuple[int, bool], raw: bytes) -> None:
        if self._is_closed:
            return
        number, stamped = channel
        if self._time.is_known:
            self._write(number, raw, stamped)
        else:
            self._held.append((number, raw, stamped))
        self.received += topic != LOG

    def _write(self, number: int, raw: bytes, stamped: bool) -> None:
        now = self._time.of(raw, stamped)
        self._guarded(self._bag.write, number, raw, now, now)

    def _on_paced(self, topic: str, channel: tuple[int, bool], raw: bytes) -> None:
        step = None
        if topic == self._measured:
            try:
                sample = incoming.sample(raw)
            except incoming.RefusedError as reason:
                self.refuse(topic, reason)
            else:
                step = sample.step
                self._time.heard(sample.stamp_ns)
                if self._held and not self._is_closed:
                    held, self._held = self._held, []
                    for one in held:
                        self._write(*one)
        self._on_message(topic, channel, raw)
        if topic not in self._levels.topics or (topic == self._measured and step is None):
            return
        stamp = cdr_messages.stamp_key(raw)
        if step is not None:
            self._step[stamp] = step
        if self._levels.reached(topic, stamp):
            self._complete(stamp)

    def _complete(self, stamp: bytes) -> None:
        """Note that all topics have come up to ``stamp``."""
        self._waiting_s = 0.0
        if stamp not in self._step:
            return
        steps = self._step[stamp] + 1
        for older in list(self._step):
            del self._step[older]
            if older == stamp:
                break
        self.taken(steps, last=not self._levels.waiting)

    def _drop_late(self) -> None:
        """Wait no longer for topics that have fallen silent, so that they do not hold up the others."""
        late, stamp = self._levels.drop_late()
        self._waiting_s = 0.0
        if late:
            self._late += late
            self.get_logger().warning(f"nothing for {PATIENCE_S:.0f} s on {', '.join(late)}: no longer waiting for it")
        if stamp is not None:
            self._complete(stamp)

    def _guarded(self, action: Callable[..., None], *arguments: Any) -> None:
        """Write to the file. An error ends this node in good order, not the process in the middle of a callback."""
        if self.failure is None:
            try:
                action(*arguments)
            except SugiyamaError as error:
                self.failure = error


class Levels:
    """How far a recorder of many topics has come: up to the last stamp for which every topic has brought a message.

    ``reached`` takes constant time, whatever the number of topics.
    """

    def __init__(self, topics: Iterable[str]) -> None:
        self.topics = set(topics)
        self._pending: dict[bytes, int] = {}
        self._last: dict[str, bytes] = {}

    @property
    def waiting(self) -> bool:
        """Whether one topic has a stamp that another topic still lacks."""
        return bool(self._pending)

    def reached(self, topic: str, stamp: bytes) -> bool:
        """Note a message with ``stamp`` on ``topic``; returns whether all topics now have this stamp."""
        self._last[topic] = stamp
        count = self._pending.get(stamp, 0) + 1
        self._pending[stamp] = count
        if count < len(self.topics):
            return False
        self._forget(stamp)
        return True

    def drop_late(self) -> tuple[list[str], bytes | None]:
        """Wait no longer for topics that are behind; returns their names, and the last stamp that is now complete."""
        late = sorted(t for t in self.topics if self._last.get(t) not in self._pending) if self._pending else []
        self.topics.difference_update(late)
        complete = [stamp for stamp, count in self._pending.items() if count >= len(self.topics)]
        if not complete:
            return late, None
        self._forget(complete[-1])
        return late, complete[-1]

    def _forget(self, stamp: bytes) -> None:
        # Stamps come in order on every topic, so older stamps that lack a message will never be complete.
        for older in list(self._pending):
            del self._pending[older]
            if older == stamp:
                break


class _LogTime:
    """Gives each message its time [ns] in the record.

    With the time of the data, a message has its own stamp if that is within the time of the samples of the road so far,
    or near it, and else the stamp of the last sample. At a fast rate, many samples come before what follows from them.
    So a bag of a fast replay plays as long as the recording was. Without, it is the time at which the message comes.
    """

    def __init__(self, of_data: bool) -> None:
        self.of_data = of_data
        self._last_ns: int | None = None
        self._within = (0, 0)  # stamps of the earliest and of the latest sample

    @property
    def is_known(self) -> bool:
        """Whether messages can be given a time: with the time of the data, once a sample has come."""
        return not self.of_data or self._last_ns is not None

    def heard(self, stamp_ns: int) -> None:
        """Note the stamp [ns] of a sample of the road."""
        earliest, latest = (stamp_ns, stamp_ns) if self._last_ns is None else self._within
        self._within = min(earliest, stamp_ns), max(latest, stamp_ns)
        self._last_ns = stamp_ns

    def of(self, raw: bytes, stamped: bool) -> int:
        """Time [ns] of a message; ``stamped`` if it begins with its stamp."""
        if not self.of_data or self._last_ns is None:
            return time.time_ns()
        if stamped and raw[:2] == b"\0\1" and len(raw) >= 12:
            own = int.from_bytes(raw[4:8], "little", signed=True) * NS + int.from_bytes(raw[8:12], "little")
            earliest, latest = self._within
            if own >= 0 and earliest - _NEAR_NS <= own <= latest + _NEAR_NS:
                return own
        return max(self._last_ns, 0)


def _begins_with_stamp(type_name: str) -> bool:
    """Whether messages of a type begin with a header or a stamp. Raises InputError where the type is not installed."""
    lines = (line.split("#")[0].split() for line in full_text(type_name).splitlines())
    first = next((words for words in lines if words and "=" not in "".join(words)), [""])
    return first[0] in _STAMPED


def _writer(path: Path, overwrite: bool, split_mb: float, about: dict[str, str]) -> BagWriter | FolderWriter:
    """A writer of one file, or of a directory. Raises InputError or OutputError."""
    if path.suffix == ".mcap":
        if split_mb > 0.0:
            raise InputError(f"{path}: is one file; give a directory, or leave out split_mb")
        return BagWriter(Output(path, overwrite), about)
    if path.suffix:
        raise InputError(f"{path}: cannot be written as {path.suffix}; give a name that ends in .mcap, or a directory")
    return FolderWriter(path, math.ceil(split_mb * _MB), about)
