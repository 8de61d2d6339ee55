"""What several controllers share: the speed that is safe, and the mean speed of the last seconds."""

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.controllers.controller import STRONGEST
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.laws.gipps import safe_speed

#: The speed [m/s] that somebody chooses for a controlled vehicle.
TARGET = Parameter("target", "U", "m/s", 7.5, 0.5, 80.0, "speed that the vehicle holds where it can")
#: The time [s] over which a controlled vehicle averages its own speed.
WINDOW = Parameter("window", "T", "s", 38.0, 1.0, 600.0, "time over which the vehicle averages its own speed")
#: What a controlled vehicle adds to its mean speed where the gap is long.
CATCH_UP = Parameter(
    "catch_up", "v_catch", "m/s", 1.0, 0.0, 10.0, "largest speed added to the mean where the gap is long"
)
# Gaps [m] at which a vehicle begins to catch up, and does so fully.
_SHORT_M, _LONG_M = 7.0, 30.0
# Gap [m] at standstill.
_STANDSTILL_M = 2.0


def safely(wanted: float, gap: float, speed: float, leader_speed: float, period: float) -> float:
    """Limit a wanted speed [m/s] to the speed from which the vehicle can still stop behind the leader.

    The limit is the safe speed of Gipps' law for a vehicle and a leader who brake as gently as the vehicle accelerates.
    Behind a leader who brakes harder, the limit falls faster, and the vehicle brakes harder, too.
    """
    room = gap - _STANDSTILL_M
    return min(wanted, safe_speed(room, max(speed, 0.0), leader_speed, period, STRONGEST, STRONGEST))


def catching_up(gap: float, catch_up: float) -> float:
    """Speed [m/s] that a vehicle adds to its mean speed to close a long gap; Stern et al. (2018)."""
    return catch_up * min(max((gap - _SHORT_M) / (_LONG_M - _SHORT_M), 0.0), 1.0)


def samples_in(window: float, period: float) -> int:
    """Number of samples in a window [s]."""
    return max(1, round(window / period))


def mean_of_last(memory: Array, speed: float) -> float:
    """Put a speed [m/s] into memory, and return the mean of what it holds.

    memory: (1 + W,), number of speeds so far, and the last W of them; changed in place.
    """
    number, last = int(memory[0]), memory[1:]
    last[number % len(last)] = speed
    memory[0] = number + 1
    return float(np.mean(last[: number + 1]))
