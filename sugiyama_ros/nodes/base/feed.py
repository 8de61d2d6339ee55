"""What comes from the road to a node that follows vehicles, and what a sample is that arrives."""

from collections import deque
from collections.abc import Callable
from enum import Enum, auto

from std_msgs.msg import Int32MultiArray
from sugiyama_msgs.msg import MeasuredPositions
from sugiyama_msgs.msg import Road as RoadMessage

from sugiyama_ros.formats.measured import CONTROLLED
from sugiyama_ros.nodes.base.cdr_messages import NS
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.base.qos import DEPTH, LATCHED, STREAM
from sugiyama_ros.nodes.base.samples import Sample

#: Time [s] by which a sample may be late and still be sorted in, unless a parameter of the node says otherwise.
WINDOW_S = 0.2
#: A sample that is late by at most this time [s] is dropped. Two successive samples from further back say that time
#: has jumped.
_LATE_NS = NS
#: Time [s] without samples after which a sample is from another time. In periods of the road, at least.
_LONGEST_S, _LONGEST_PERIODS = 10.0, 100
# Times between samples from which rate and spread are worked out.
_MEASURED = 100


class RoadFeed:
    """Hands the road and every sample to a node that follows vehicles. Samples wait for the road.

    On ``controlled``, anybody may say which vehicles a controller drives.
    """

    def __init__(
        self, node: PacedNode, on_road: Callable[[RoadMessage], None], take_in: Callable[[Sample], None]
    ) -> None:
        self._hand_road, self._take_in = on_road, take_in
        self._waiting: deque[Sample] = deque(maxlen=DEPTH)
        self._is_held, self._has_road = False, False
        #: Numbers of the vehicles that a controller drives: nobody follows them as drivers.
        self.controlled: frozenset[int] = frozenset()
        self._inputs = [
            node.listen(Int32MultiArray, CONTROLLED, self._on_controlled, LATCHED),
            node.listen(RoadMessage, "road", self._on_road, LATCHED),
            node.listen(MeasuredPositions, "measured", self._on_measured, STREAM),
        ]

    def hold(self) -> None:
        """Let samples wait, as if there were no road."""
        self._is_held = True

    def release(self) -> None:
        """Go on with the samples that wait."""
        self._is_held = False
        self._go_on()

    def close(self) -> None:
        """Hear nothing more."""
        for one in self._inputs:
            one.close()

    def _on_controlled(self, message: Int32MultiArray) -> None:
        self.controlled = frozenset(message.data)

    def _on_road(self, road: RoadMessage) -> None:
        self._has_road = True
        self._hand_road(road)
        self._go_on()

    def _on_measured(self, sample: Sample) -> None:
        self._waiting.append(sample)
        self._go_on()

    def _go_on(self) -> None:
        while self._waiting and self._has_road and not self._is_held:
            self._take_in(self._waiting.popleft())


class Arrival(Enum):
    """What a sample is to those who follow the vehicles."""

    NEXT = auto()
    #: To be sorted in: it is late, but not too late.
    LATE = auto()
    #: Nothing may be done with it: it came before, or too late.
    LEFT_OUT = auto()
    #: Too far from the last sample; the next sample will say whether time has jumped.
    PUT_ASIDE = auto()
    #: Time has jumped; the sample that was put aside, if there is one, comes first.
    JUMPED = auto()


#: What is taken in.
FOLLOWED = (Arrival.NEXT, Arrival.LATE, Arrival.JUMPED)


def new_counts() -> dict[str, int]:
    """Return what is counted of the samples, all 0."""
    names = ("samples", "missing", "duplicates", "sorted in", "late", "resets", "skipped", "changes of style")
    return dict.fromkeys(names, 0)


class Arrivals:
    """Judges every sample by its stamp, and counts what becomes of them.

    window_s: time [s] by which a sample may be late and still be sorted in.
    """

    def __init__(self, period_s: float, window_s: float, counts: dict[str, int]) -> None:
        self._window_ns = round(window_s * NS)
        self._longest_ns = round(max(_LONGEST_S, _LONGEST_PERIODS * period_s) * NS)
        self._counts = counts
        #: Stamp [ns] of the latest sample.
        self.stamp_ns: int | None = None
        #: The sample that was put aside.
        self.aside: Sample | None = None
        self._clock_jumped = False
        self._recent: deque[int] = deque()
        self._between_ns: deque[int] = deque(maxlen=_MEASURED)

    def clock_has_jumped(self) -> None:
        """Take the next sample for one after a jump, wherever its stamp is."""
        self._clock_jumped = self.stamp_ns is not None

    def judge(self, sample: Sample) -> Arrival:
        """Return what the next sample that arrives is.

        A sample put aside before it is dropped unless time has jumped.
        """
        stamp_ns, latest_ns, aside = sample.stamp_ns, self.stamp_ns, self.aside
        if latest_ns is None:
            return self._next(stamp_ns)
        ahead_ns = stamp_ns - latest_ns
        is_far = not -_LATE_NS <= ahead_ns <= self._longest_ns
        confirms = is_far and aside is not None and 0 < stamp_ns - aside.stamp_ns <= self._longest_ns
        if self._clock_jumped or confirms:
            return self._jump(stamp_ns, aside)
        if 0 < ahead_ns <= self._longest_ns:
            self._drop_aside()
            return self._next(stamp_ns)
        if ahead_ns == 0 or stamp_ns in self._recent:
            return self._left_out("duplicates")
        if -self._window_ns <= ahead_ns < 0:
            self._counts["sorted in"] += 1
            self._counts["samples"] += 1
            self._recent.append(stamp_ns)
            return Arrival.LATE
        if -_LATE_NS <= ahead_ns < 0:
            return self._left_out("late")
        self._drop_aside()
        self.aside = sample
        return Arrival.PUT_ASIDE

    def taken_aside(self) -> Sample | None:
        """Return the sample that was put aside before a jump, and no longer keep it."""
        aside, self.aside = self.aside, None
        return aside

    @property
    def rhythm(self) -> dict[str, float]:
        """Mean rate [Hz] of the last samples, and standard deviation [s] of the times between them."""
        count = len(self._between_ns)
        if not count:
            return {}
        mean = sum(self._between_ns) / count
        spread = float((sum((t - mean) ** 2 for t in self._between_ns) / count) ** 0.5)
        return {"rate [Hz]": round(NS / mean, 3), "spread [s]": round(spread / NS, 6)}

    def _next(self, stamp_ns: int) -> Arrival:
        if self.stamp_ns is not None:
            self._between_ns.append(stamp_ns - self.stamp_ns)
        self.stamp_ns = stamp_ns
        self._counts["samples"] += 1
        self._recent.append(stamp_ns)
        while self._recent[0] < stamp_ns - self._window_ns:
            self._recent.popleft()
        return Arrival.NEXT

    def _jump(self, stamp_ns: int, aside: Sample | None) -> Arrival:
        self._counts["resets"] += 1
        self._counts["samples"] += 1 if aside is None else 2
        self._recent.clear()
        self._recent.append(stamp_ns)
        self._between_ns.clear()
        self.stamp_ns, self._clock_jumped = stamp_ns, False
        return Arrival.JUMPED

    def _left_out(self, why: str) -> Arrival:
        self._counts[why] += 1
        return Arrival.LEFT_OUT

    def _drop_aside(self) -> None:
        if self.aside is not None:
            self._counts["late"] += 1
            self.aside = None
