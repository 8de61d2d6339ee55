"""Messages in the order of their log times, whatever their order in a file."""

from array import array
from collections.abc import Callable, Collection, Iterable, Iterator
from heapq import heappop, heappush, heapreplace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.opcode import Opcode

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.mcap_records import Message, content_records, message_at

#: Most bytes of chunks that are open at the same time, because their times overlap.
MOST_OPEN = 256 << 20


class Segment(NamedTuple):
    """A part of a recording whose messages are in order.

    start_ns: log time [ns] of the first message, or an earlier one; size: bytes that it takes while it is open; load:
    gives the messages.
    """

    start_ns: int
    size: int
    load: Callable[[], Iterable[Any]]


def merged(parts: Collection[Segment], time_of: Callable[[Any], int], path: Path) -> Iterator[Any]:
    """Yield the messages of all parts in the order of their log times, and in that of the parts at the same time.

    A part is loaded when its first message is due, and forgotten after its last one.

    Raises InputError.
    """
    waiting = sorted(enumerate(parts), key=lambda one: (one[1].start_ns, one[0]), reverse=True)
    # (log time, number of the part, message, messages that follow, bytes); no two have the same number
    due: list[tuple[int, int, Any, Iterator[Any], int]] = []
    open_bytes = 0
    while due or waiting:
        while waiting and (not due or waiting[-1][1].start_ns <= due[0][0]):
            number, part = waiting.pop()
            open_bytes += part.size
            if due and open_bytes > MOST_OPEN:
                raise InputError(
                    f"{path}: more than {MOST_OPEN >> 20} MiB of it lie in another order than their log times;"
                    f" sort it with `mcap sort {path} -o sorted.mcap`"
                )
            messages = iter(part.load())
            first = next(messages, None)
            if first is None:
                open_bytes -= part.size
                continue
            if time_of(first) < part.start_ns:
                raise InputError(
                    f"{path}: a chunk holds messages of before its start time; the file is damaged;"
                    f" run `sugiyama recover {path}`"
                )
            heappush(due, (time_of(first), number, first, messages, part.size))
        if due:
            _, number, message, messages, size = due[0]
            yield message
            following = next(messages, None)
            if following is None:
                heappop(due)
                open_bytes -= size
            else:
                heapreplace(due, (time_of(following), number, following, messages, size))


def in_order(
    content: bytes, where: str, describe: Callable[[int, bytes], None], unwanted: Callable[[int], bool]
) -> Iterator[Message]:
    """Messages of a chunk, in the order of their log times. Raises InputError."""
    times, starts, ends = array("Q"), array("Q"), array("Q")
    left_out: dict[int, bool] = {}
    for opcode, found in content_records(content, where):
        if opcode != Opcode.MESSAGE:
            describe(opcode, found)
            continue
        channel = found.channel
        if channel not in left_out:
            left_out[channel] = unwanted(channel)
        if not left_out[channel]:
            times.append(found.log_time)
            starts.append(found.start)
            ends.append(found.end)
    order = np.argsort(np.frombuffer(times, dtype=np.uint64), kind="stable") if times else np.zeros(0, dtype=np.int64)
    for k in order.tolist():
        yield message_at(content, starts[k], ends[k])
