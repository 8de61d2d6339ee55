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
    """Where the recording is.

    source: file or model that the positions come from; empty before the road is known; time_s, total_s: time of the
    last sample since the first one, and duration of the recording [s]; 0 without a known end; real_rate: rate at which
    samples arrive, in times real time; naN before it is known; silent_s: time [s] since the last sample; naN before the
    first one; ended: whether the last sample of the recording has arrived; domain: number of the ROS domain; recording:
    file to which the topics are written; empty where nothing is written.
    """

    source: str
    time_s: float
    total_s: float
    real_rate: float
    silent_s: float
    ended: bool
    domain: str
    recording: str


class Feed(Protocol):
    """What the page shows, and what its buttons do.

    road: the road; rate: rate of the replay that was asked for, in times real time; 0 is as fast as the nodes take it;
    vehicles: numbers of the vehicles that have been seen; empty before the first sample; best: model that the critic
    finds most probable; empty without a critic; gains: gain of each model of the critic over the base model [nats], by
    name; empty without a critic; now: position [m] and speed [m/s] of each vehicle that is on the road; lanes: number
    of the lane of each vehicle whose lane is known; here, led: vehicles in the latest sample, and vehicles that have
    had a leader; followers: vehicles of whose drivers something is learnt; who follows nobody is not among them;
    adapted: v*, its std [m/s], kappa_v and its std [s] of each driver, as last published; effects: effects that can be
    added, each with its explanation; titles: names for people of all effects; added: effects that were added;
    changed_s: times [s] at which an effect was added or removed; events: latest events, the newest one first; said:
    last answer of a node; space: time [s], position [m] and speed [m/s] of every vehicle at every sample; error: time
    [s], one-step error [m] of all drivers over the last ``MOVING_S`` seconds, and of the base model; is_settled:
    whether the critic's probabilities have been stable for a while; critic: for each model that the critic has had, a
    Log of time [s] and gain [nats]; driver: for each vehicle a Log of time [s], speed and its std [m/s], innovation and
    its std [m], and the measured position [m]; learnt: for each vehicle a Log of time [s], v* and its std [m/s],
    kappa_v and its std [s].
    """

    road: Road
    rate: float
    vehicles: list[int]
    best: str
    gains: dict[str, float]
    now: dict[int, tuple[float, float]]
    lanes: dict[int, int]
    here: set[int]
    led: set[int]
    followers: set[int]
    adapted: dict[int, tuple[float, float, float, float]]
    effects: dict[str, str]
    titles: dict[str, str]
    added: list[str]
    changed_s: list[float]
    events: deque[str]
    said: str
    space: Log
    error: Log
    is_settled: bool
    critic: dict[str, Log]
    driver: dict[int, Log]
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
