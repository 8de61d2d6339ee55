"""Pacing: a source waits for its slowest subscriber, so that no message is lost at any rate."""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass
class _Subscriber:
    steps: int
    heard_s: float


class Pace:
    """How far a source may go: at most ``window`` steps beyond the slowest subscriber.

    A subscriber reports how many steps of the recording it has taken, at least once a second. A subscriber that is
    silent for ``patience_s`` is dropped, and joins again with its next report. Nothing is sent before all nodes in
    ``wait_for`` have reported.
    """

    def __init__(self, window: int, patience_s: float, wait_for: Iterable[str] = ()) -> None:
        self.missing = set(wait_for)
        self.dropped: set[str] = set()
        self.window = window
        self._patience_s = patience_s
        self._subscribers: dict[str, _Subscriber] = {}
        self._first = 0
        self._next = 0
        self.acknowledged = 0

    @property
    def drained(self) -> bool:
        """Whether everything sent has been acknowledged."""
        return self.acknowledged == self._next

    @property
    def may_send(self) -> bool:
        """Whether one more step fits into the window."""
        return not self.missing and self._next < self.acknowledged + self.window

    def sent(self) -> None:
        """One more step was sent."""
        self._next += 1
        self._update()

    def heard(self, name: str, steps: int, now_s: float) -> None:
        """Subscriber ``name`` has taken all steps before number ``steps``."""
        self.missing.discard(name)
        self.dropped.discard(name)
        known = self._subscribers.setdefault(name, _Subscriber(self._first, now_s))
        known.heard_s = now_s
        # Any other number is from before the last restart. An old number that happens to fit lets the source run at
        # most one window too far, because all steps had been taken at the restart.
        if known.steps < steps <= self._next:
            known.steps = steps
        self._update()

    def restart(self, step: int) -> None:
        """Go on with step number ``step``. Everything sent before must have been acknowledged."""
        self._first = self._next = step
        for subscriber in self._subscribers.values():
            subscriber.steps = step
        self._update()

    def drop_silent(self, now_s: float) -> list[str]:
        """Drop the subscribers that have been silent for too long; returns their names."""
        silent = [n for n, s in self._subscribers.items() if now_s - s.heard_s > self._patience_s]
        for name in silent:
            del self._subscribers[name]
        if silent:
            self.dropped.update(silent)
            self._update()
        return silent

    def _update(self) -> None:
        self.acknowledged = min((s.steps for s in self._subscribers.values()), default=self._next)


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
