"""The times under which messages are recorded: when they come, or the times of the data."""

import time

from sugiyama_ros.formats.definitions import full_text
from sugiyama_ros.nodes.base.cdr_messages import NS

#: A stamp that is farther than this [ns] from all samples so far is of another clock.
_NEAR_NS = 10 * NS
_STAMPED = ("std_msgs/Header", "builtin_interfaces/Time", "Header")


class LogTime:
    """Gives each message its time [ns] in the record.

    With the time of the data, a message has its own stamp if that is within the time of the samples of the road so far,
    or near it, and else the stamp of the last sample. At a fast rate, many samples come before what follows from them.
    So a bag of a fast replay plays as long as the recording was.

    of_data: whether the time is that of the data; else it is the time at which the message comes.
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


def begins_with_stamp(type_name: str) -> bool:
    """Whether messages of a type begin with a header or a stamp. Raises InputError where the type is not installed."""
    lines = (line.split("#")[0].split() for line in full_text(type_name).splitlines())
    first = next((words for words in lines if words and "=" not in "".join(words)), [""])
    return first[0] in _STAMPED
