"""What comes from the road to the nodes of a process that follow vehicles, and what a sample is that arrives."""

from collections import defaultdict, deque
from collections.abc import Callable
from enum import Enum, auto
from functools import partial
from typing import Protocol

from sugiyama_msgs.msg import DriverArray, MeasuredPositions
from sugiyama_msgs.msg import Road as RoadMessage

from sugiyama_ros.nodes.base.cdr_messages import NS, ArrayWriter, KnownDriver
from sugiyama_ros.nodes.base.incoming import RefusedError, receiver
from sugiyama_ros.nodes.base.node import AnyPublisher, PacedNode
from sugiyama_ros.nodes.base.qos import DEPTH, LATCHED, STREAM
from sugiyama_ros.nodes.base.samples import Sample

#: Name of the topic on which all drivers are in one message, in the namespace of the road.
DRIVERS_TOPIC = "drivers"

#: Time [s] by which a sample may be late and still be sorted in, unless a parameter of the node says otherwise.
WINDOW_S = 0.2
#: A sample that is late by at most this time [s] is dropped. Two successive samples from further back say that time
#: has jumped.
_LATE_NS = NS
#: Time [s] without samples after which a sample is from another time. In periods of the road, at least.
_LONGEST_S, LONGEST_PERIODS = 10.0, 100
# Times between samples from which rate and spread are worked out.
_MEASURED = 100


class Listener(Protocol):
    """Who follows the vehicles."""

    def on_road(self, road: RoadMessage) -> None:
        """Take in the road."""

    def take_in(self, sample: Sample) -> None:
        """Take in a sample; the road is known."""

    def refuse(self, topic: str, reason: Exception) -> None:
        """Hear of a message that was dropped."""


class RoadFeed:
    """Hands the road and every sample to all nodes of a process that follow vehicles, from one subscription to each.

    Samples wait for the road. What the nodes know of their drivers after a sample is sent in one message, if they say
    it here. The nodes stay as they are otherwise: each reports its own progress, so the source waits for each of them.

    host: the node that subscribes and sends; named: the name of a topic for the node, if not that of the road.
    """

    def __init__(self, host: PacedNode, named: Callable[[str], str] | None = None) -> None:
        self._host, self._named = host, named or host.shared
        self._listeners: list[Listener] = []
        self._waiting: deque[Sample] = deque(maxlen=DEPTH)
        self._is_held, self._has_road = False, False
        self._known: defaultdict[int, list[KnownDriver]] = defaultdict(list)
        self._writer: ArrayWriter | None = None
        kinds = (
            (RoadMessage, "road", self._on_road, LATCHED),
            (MeasuredPositions, "measured", self._on_measured, STREAM),
        )
        self._inputs = [
            AnyPublisher(host, kind, self._named(topic), receiver(kind, take, partial(self._refuse, topic)), qos)
            for kind, topic, take, qos in kinds
        ]

    def hand_to(self, listener: Listener) -> None:
        """Hand everything from now on to a listener, too."""
        self._listeners.append(listener)

    def hold(self) -> None:
        """Let samples wait, as if there were no road."""
        self._is_held = True

    def release(self) -> None:
        """Go on with the samples that wait."""
        self._is_held = False
        self._go_on()

    def offer_drivers(self) -> None:
        """Publish the topic of all drivers, so that a recorder hears it from the first message on."""
        self._host.stream(DriverArray, self._named(DRIVERS_TOPIC))

    def collect(self, stamp_ns: int, driver: KnownDriver) -> None:
        """Note what is known of a driver after the sample at a stamp [ns]."""
        self._known[stamp_ns].append(driver)

    def close(self) -> None:
        """Hear nothing more."""
        for one in self._inputs:
            one.close()

    def _refuse(self, topic: str, reason: RefusedError) -> None:
        for listener in self._listeners:
            listener.refuse(self._named(topic), reason)

    def _on_road(self, road: RoadMessage) -> None:
        self._has_road = True
        for listener in self._listeners:
            listener.on_road(road)
        self._go_on()

    def _on_measured(self, sample: Sample) -> None:
        self._waiting.append(sample)
        self._go_on()

    def _go_on(self) -> None:
        while self._waiting and self._has_road and not self._is_held:
            sample = self._waiting.popleft()
            for listener in self._listeners:
                listener.take_in(sample)
            self._send_drivers()

    def _send_drivers(self) -> None:
        """Send what is known; a layout of the message is kept while drivers and parameters stay the same."""
        for stamp_ns, drivers in self._known.items():
            if self._writer is None or not self._writer.fits(drivers):
                self._writer = ArrayWriter(drivers)
            publisher = self._host.stream(DriverArray, self._named(DRIVERS_TOPIC))
            self._host.send(publisher, self._writer.message(stamp_ns, drivers))
        self._known.clear()


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
        self._longest_ns = round(max(_LONGEST_S, LONGEST_PERIODS * period_s) * NS)
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
