"""What the live page shows, and what its buttons do; the node behind the page offers it."""

from collections import deque
from itertools import islice
from typing import NamedTuple, Protocol

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.road import Road

#: Samples that are kept of each vehicle.
KEPT = 750


class Log:
    """The latest rows of numbers, for many readers. Each reader remembers how many rows it has seen."""

    def __init__(self, kept: int) -> None:
        self._rows: deque[tuple[float, ...]] = deque(maxlen=kept)
        self.heard = 0

    def add(self, *row: float) -> None:
        """Keep a row, and forget the oldest one if there are too many."""
        self._rows.append(row)
        self.heard += 1

    def since(self, seen: int) -> Array:
        """Rows after the first ``seen`` rows, as far as they are kept; array of shape (rows, columns)."""
        new = min(self.heard - seen, len(self._rows))
        return np.array(list(islice(self._rows, len(self._rows) - new, None)))


class Status(NamedTuple):
    """Where the recording is."""

    #: File or model that the positions come from; empty before the road is known.
    source: str
    #: Time [s] of the last sample since the first one, and duration of the recording; 0 without a known end.
    time_s: float
    total_s: float
    #: Rate at which samples arrive, in times real time, and time [s] since the last one; NaN where not known.
    real_rate: float
    silent_s: float
    #: Whether the last sample of the recording has arrived.
    ended: bool
    #: Number of the ROS domain, and file to which the topics are written; empty where nothing is written.
    domain: str
    recording: str


class Feed(Protocol):
    """What the page shows, and what its buttons do."""

    road: Road
    #: Rate of the replay that was asked for, in times real time; 0 is as fast as the nodes take it.
    rate: float
    #: Numbers of the vehicles that have been seen; empty before the first sample.
    vehicles: list[int]
    #: Model that the critic finds most probable, and gain of each of its models over the base model [nats].
    best: str
    gains: dict[str, float]
    #: Position [m] and speed [m/s] of each vehicle on the road, and the lane of each whose lane is known.
    now: dict[int, tuple[float, float]]
    lanes: dict[int, int]
    #: Vehicles whose drivers pay attention to a line now, before which they let others pass.
    yielding: set[int]
    #: Vehicles in the latest sample, those that have had a leader, and those of whose drivers something is learnt.
    here: set[int]
    led: set[int]
    followers: set[int]
    #: v*, its std [m/s], kappa_v and its std [s] of each driver, as last published.
    adapted: dict[int, tuple[float, float, float, float]]
    #: Effects that can be added, each with its explanation; names for people of all effects; those that were added.
    effects: dict[str, str]
    titles: dict[str, str]
    added: list[str]
    #: Times [s] at which an effect was added or removed; latest events, the newest first; last answer of a node.
    changed_s: list[float]
    events: deque[str]
    said: str
    #: Time [s], position [m] and speed [m/s] of every vehicle at every sample.
    space: Log
    #: Time [s], one-step error [m] of all drivers over the last ``MOVING_S`` seconds, and that of the base model.
    error: Log
    #: Whether the critic's probabilities have been stable for a while; time [s] and gain [nats] of each of its models.
    is_settled: bool
    critic: dict[str, Log]
    #: Time [s], speed and its std [m/s], innovation and its std [m], and measured position [m] of each vehicle.
    driver: dict[int, Log]
    #: Time [s], v* and its std [m/s], kappa_v and its std [s] of each vehicle.
    learnt: dict[int, Log]

    def status(self) -> Status:
        """Where the recording is."""

    def values(self, effect: str) -> str:
        """Values with which an effect would be added, as ``name=value`` with commas."""

    def pause(self, paused: bool) -> None:
        """Pause the replay, or resume it."""

    def set_rate(self, rate: float) -> None:
        """Set the rate of the replay, in times real time; 0 is as fast as the nodes take it."""

    def add(self, effect: str, values: str) -> None:
        """Add an effect to all estimators, with values as ``values`` gives them."""

    def remove(self, effect: str) -> None:
        """Remove an effect from all estimators."""
