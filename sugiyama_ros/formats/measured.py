"""One road in a bag: messages on the topics ``road`` and ``measured``, written and read."""

import math
from array import array
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices, agreed_ring
from sugiyama_ros.formats.format import Format
from sugiyama_ros.formats.mcap_records import MAGIC
from sugiyama_ros.formats.reading import checksum_of, shown_name
from sugiyama_ros.trajectories.about import About, source_in
from sugiyama_ros.trajectories.assemble import Column, assemble
from sugiyama_ros.trajectories.dense import LAST_VEHICLE, MAX_SAMPLES, DenseTracks
from sugiyama_ros.trajectories.labels import Labels, labels, numbered
from sugiyama_ros.trajectories.tracks import LINE, NOBODY, Tracks

if TYPE_CHECKING:
    from sugiyama_ros.formats.mcap_reader import Bag
    from sugiyama_ros.formats.mcap_writer import BagWriter

ROAD_TYPE = "sugiyama_msgs/msg/Road"
MEASURED_TYPE = "sugiyama_msgs/msg/MeasuredPositions"
#: Type and name of the topic that says which vehicles a controller drives, by their numbers.
CONTROLLED_TYPE, CONTROLLED = "std_msgs/msg/Int32MultiArray", "controlled"
# Lists that not every source of positions knows and that tracks keep. Older bags lack some of them.
_MORE = ("lane", "d_m", *LINE, "leader_shift_m")
_NONE = np.zeros(0)
# What a message says of a leader: there is none, or nobody knows whether there is one.
_FREE, _UNKNOWN = -1, -2
#: Frame in the headers of all messages: positions along the road.
FRAME = "road"


def stamp_ns(time_s: float) -> int:
    """A time [s] as the nanoseconds of a message stamp."""
    return round(time_s * 1e9)


def messages(trajectories: DenseTracks) -> Iterator[tuple[str, int, bytes]]:
    """One road as messages: one Road, the controlled vehicles if there are any, one MeasuredPositions for each time.

    A vehicle is in a message while it is on the road.

    Yields type, stamp [ns] and CDR bytes. Raises InputError.
    """
    # Imported here, and the reader below too: a file of text needs no messages, whose code takes long to load.
    from sugiyama_ros.formats.cdr import Encoder

    encode = Encoder(ROAD_TYPE, MEASURED_TYPE)
    times = [stamp_ns(time) for time in trajectories.time_s.tolist()]
    yield (
        ROAD_TYPE,
        times[0],
        encode(
            ROAD_TYPE,
            header=_header(times[0]),
            circumference_m=trajectories.road.circumference_m,
            period_s=trajectories.period_s,
            steps=len(times),
            source=trajectories.source,
            sha256=trajectories.sha256,
        ),
    )
    if trajectories.controlled:
        layout = {"dim": [], "data_offset": 0}
        data = np.array(trajectories.controlled, dtype=np.int32)
        yield CONTROLLED_TYPE, times[0], Encoder(CONTROLLED_TYPE)(CONTROLLED_TYPE, layout=layout, data=data)
    vehicle = trajectories.vehicle.astype(np.int32)
    for step, (time, leader) in enumerate(zip(times, trajectories.leader, strict=True)):
        here = np.flatnonzero(trajectories.present[step])
        ahead = leader[here]
        yield (
            MEASURED_TYPE,
            time,
            encode(
                MEASURED_TYPE,
                header=_header(time),
                step=step,
                vehicle=vehicle[here],
                leader=np.where(ahead >= 0, vehicle[ahead], np.int32(-1)),
                position_m=trajectories.position_m[step, here],
                length_m=trajectories.length_m[here],
            ),
        )


def channels_of(bag: "BagWriter", trajectories: DenseTracks) -> dict[str, int]:
    """Announce the topics of ``messages`` in a bag; returns the number of each for ``BagWriter.write``, by its type."""
    from sugiyama_ros.formats.mcap_writer import LATCHED_TOPIC, Qos

    channels = {
        ROAD_TYPE: bag.topic("/road", ROAD_TYPE, LATCHED_TOPIC),
        MEASURED_TYPE: bag.topic("/measured", MEASURED_TYPE, Qos()),
    }
    if trajectories.controlled:
        channels[CONTROLLED_TYPE] = bag.topic(f"/{CONTROLLED}", CONTROLLED_TYPE, LATCHED_TOPIC)
    return channels


def _read_measured(path: Path, choices: Choices) -> Tracks:
    """Read tracks from a bag with one ``road`` and one ``measured`` topic, in any namespace. Raises InputError."""
    from sugiyama_ros.formats.mcap_reader import Bag

    with Bag(path) as bag:
        topics = _topics(bag)
        try:
            return _collected(bag, topics, choices)
        except (AttributeError, TypeError, ValueError):
            # A bag brings its own definitions, which may have other fields.
            raise InputError(
                f"{path}: `road` or `measured`: not the fields that this version knows; convert the source again"
            ) from None


def _topics(bag: "Bag") -> dict[str, str]:
    """The types of the topics, by name. Raises InputError unless there is one ``road`` and one ``measured``."""
    about, topics = bag.info().topics, {}
    for name, kind in (("road", ROAD_TYPE), ("measured", MEASURED_TYPE)):
        found = [t.name for t in about if t.name.split("/")[-1] == name and t.type == kind and t.count]
        if len(found) != 1:
            have = f"{len(found)} topics ({', '.join(map(repr, found))})" if found else "no topic"
            seen = "" if found else "; vehicles on other topics are read by `sugiyama convert` with --odometry"
            raise InputError(f"{bag.path}: {have} `{name}` with messages of {kind}; give a bag with exactly one{seen}")
        topics[found[0]] = kind
    space = found[0].removesuffix("measured")
    return topics | {t.name: t.type for t in about if (t.name, t.type) == (space + CONTROLLED, CONTROLLED_TYPE)}


def _collected(bag: "Bag", topics: dict[str, str], choices: Choices) -> Tracks:
    """Tracks from the messages on topics, given by name with their types."""
    path = bag.path
    road: Any = None
    columns = _Columns(path)
    for message in bag.messages(topics):
        content = message.message
        if topics[message.topic] == MEASURED_TYPE:
            columns.add(content)
        elif topics[message.topic] == CONTROLLED_TYPE:
            columns.controlled.update(content.data.tolist())
        elif road is None:
            road = _checked(content)
        elif (road.circumference_m, road.period_s) != (content.circumference_m, content.period_s):
            raise InputError(f"{path}: {message.topic!r}: the road changes; record one road in one bag")
    if road is None:
        raise InputError(f"{path}: no message on `road`; the bag is damaged")
    about = About(
        view="whole",
        ring_m=agreed_ring(path, road.circumference_m, choices),
        period_s=road.period_s,
        source=source_in(shown_name(path), road.source) or shown_name(path),
        sha256=road.sha256 or checksum_of(bag.files[0]),
    )
    return columns.tracks(about)


def _checked(road: Any) -> Any:
    """A message on ``road``. Raises TypeError where a field is of another type than in this package's definition."""
    if not isinstance(road.source, str) or not isinstance(road.sha256, str):
        raise TypeError
    return road


def _header(time_ns: int) -> dict[str, Any]:
    """Header of a message."""
    seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": FRAME}


class _Columns:
    """Samples from the messages on ``measured``."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._row = array("q")
        self._column = array("q")
        self._position = array("d")
        self._leader = array("i")
        # by name: the first row of each message that has the list, and the list
        self._more: dict[str, list[tuple[int, Array]]] = {}
        self._length: dict[int, float] = {}
        self._number: dict[int, int] = {}
        self._first: tuple[int, float] | None = None
        self._last_step = -1
        self._last_s = 0.0
        #: Numbers of the vehicles that a controller drives.
        self.controlled: set[int] = set()

    def add(self, message: Any) -> None:
        """Take in one message."""
        where = f"{self._path}: measured, step {message.step}"
        time_s = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        if self._first is None:
            self._first = message.step, time_s
        elif message.step <= self._last_step or time_s <= self._last_s:
            raise InputError(f"{where}: time goes backward, as in a replay that loops; record one pass")
        self._last_step, self._last_s = message.step, time_s
        if message.step - self._first[0] >= MAX_SAMPLES:
            raise InputError(f"{where}: more than {MAX_SAMPLES} steps; split the bag")
        vehicles = message.vehicle.tolist()
        if not all(type(vehicle) is int and 0 <= vehicle <= LAST_VEHICLE for vehicle in vehicles):
            raise InputError(f"{where}: a vehicle's number is not within 0 to {LAST_VEHICLE}; number the vehicles")
        more: dict[str, Array] = {name: given for name in _MORE if len(given := getattr(message, name, _NONE))}
        each = (message.position_m, message.length_m, message.leader, *more.values())
        if any(len(one) != len(vehicles) for one in each):
            raise InputError(f"{where}: its arrays differ in length; the publisher is faulty")
        if len(set(vehicles)) != len(vehicles):
            raise InputError(f"{where}: a vehicle's number occurs twice; the publisher is faulty")
        if len(self._row) + len(vehicles) > MAX_SAMPLES:
            raise InputError(f"{where}: more than {MAX_SAMPLES} samples; split the bag")
        if np.isinf(message.position_m).any():
            raise InputError(f"{where}: a position is infinite; the publisher is faulty")
        for vehicle, length in zip(vehicles, message.length_m.tolist(), strict=True):
            if self._length.setdefault(vehicle, length) != length:
                raise InputError(f"{where}: vehicle {vehicle} changes its length; the publisher is faulty")
            self._column.append(self._number.setdefault(vehicle, len(self._number)))
        for name, given in more.items():
            self._more.setdefault(name, []).append((len(self._row), given))
        self._row.extend([message.step - self._first[0]] * len(vehicles))
        self._position.extend(message.position_m.tolist())
        self._leader.extend(message.leader.tolist())

    def tracks(self, about: About) -> Tracks:
        """All samples, on the time base that the road states."""
        if self._first is None or not self._row:
            raise InputError(f"{self._path}: measured: no positions; record some")
        first_step, first_s = self._first
        off_s = self._last_s - first_s - (self._last_step - first_step) * about.period_s
        if not (0.0 < about.period_s < math.inf and abs(off_s) < 0.1 * about.period_s):
            raise InputError(
                f"{self._path}: measured: the stamps do not follow the period of {about.period_s:g} s on `road`;"
                " the publisher is faulty"
            )
        column = np.frombuffer(self._column, dtype=np.int64)
        vehicle = np.array(list(self._number))[column]
        columns: dict[str, Column] = {
            "vehicle": numbered(vehicle),
            "time_s": first_s + about.period_s * np.frombuffer(self._row, dtype=np.int64),
            "s_m": np.frombuffer(self._position),
            "length_m": np.array(list(self._length.values()))[column],
        }
        if self.controlled:
            columns["controlled"] = np.isin(vehicle, list(self.controlled))
        for name, parts in self._more.items():
            column = np.full(len(vehicle), np.nan)
            for first, given in parts:
                column[first : first + len(given)] = given
            columns[name] = _named(np.nan_to_num(column, nan=-1.0), {}) if name == "lane" else column
        leader = np.frombuffer(self._leader, dtype=np.int32)
        if self._more or (leader == _UNKNOWN).any():
            # positions alone do not say who leads whom
            columns["leader"], about = _named(leader, {_FREE: NOBODY}), replace(about, view="end", leaders="given")
        return assemble(columns, about, checked=False)


def _named(number: NDArray[Any], names: dict[int, str]) -> Labels:
    """Names of things that have numbers (R,): those of ``names``, or the number; none below 0."""
    known, code = np.unique(number.astype(np.int64), return_inverse=True)
    is_named = np.array([one >= 0 or one in names for one in known.tolist()])
    return labels(np.where(is_named[code], code, -1).astype(np.int32), [names.get(n, str(n)) for n in known.tolist()])


def _is_bag(head: bytes, path: Path) -> bool:
    """Whether a path is a bag by its content, or is called one; also a directory of rosbag2."""
    if path.is_dir():
        # Imported here: a file of text needs no messages, whose code takes long to load.
        from sugiyama_ros.formats.mcap_reader import split_files

        # tables beside a bag are a folder of tables, as they are without it
        alone = all(".mcap" in file.suffixes for file in path.iterdir() if file.is_file())
        return (path / "metadata.yaml").is_file() or (alone and bool(split_files(path)))
    return head.startswith(MAGIC) or path.suffix.lower() == ".mcap" or path.name.endswith((".mcap.zstd", ".mcap.zst"))


FORMAT = Format(
    name="mcap",
    suffixes=(".mcap",),
    recognise=_is_bag,
    read=_read_measured,
    summary="a bag with the topics road and measured",
    takes_reference=False,
)
