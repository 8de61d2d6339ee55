"""The line before which a driver lets others pass: how much attention the driver pays to it.

A line stands where lanes meet, and at a signal. It is a virtual leader: a vehicle of no length that stands there. A
driver pays attention to it while somebody who goes first would be in the way: the attention, from 0 to 1, is the weight
of the line's collision penalty beside the penalty of the leader (paper, sections 3.2 and 7).

The times of arrival are compared as in the theory of gap acceptance. Who goes first is in the way if they reach the
place behind the line earlier than ``TIME_GAP_S`` after the driver would be through, at a usual acceleration, and if
they leave it after the driver can be at the line, at the largest acceleration. A driver who can no longer stop goes on.

References
----------
Transportation Research Board, Highway Capacity Manual, 6th edition (2016), chapters 20 and 22 (critical headways).
"""

import math

from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.jit import kernel

#: Time [s] that a driver wants between being through and somebody who goes first. At a line, attention is then one half
#: at a gap of 4.6 s. A typical driver starts at gaps of 5.9 s and more, since little attention is enough to hold them.
#: Critical headways of single-lane roundabouts and of minor roads are 4 to 5 s.
TIME_GAP_S = 1.5
#: Way [m] from a line until a vehicle is through: the width of a lane, and the room that a car on it takes.
_THROUGH_M = 6.0
#: Usual acceleration [m/s^2] of drivers who start.
USUAL = 1.5
#: Time [s] within which attention comes and goes.
SOFT_S = 0.3
# Share of the hardest braking within which attention goes from a line that comes too late.
_SOFT_BRAKING = 0.1
# Largest acceleration and hardest braking [m/s^2] of the driver model.
_FASTEST: float = float(ACTIONS[-1])
_HARDEST: float = -float(ACTIONS[0])


@kernel
def smooth_step(x: float) -> float:
    """Go smoothly from 0, below x = 0, to 1, above it."""
    if x < -30.0:
        return 0.0
    return 1.0 if x > 30.0 else 1.0 / (1.0 + math.exp(-x))


@kernel
def time_over(way: float, speed: float, acceleration: float) -> float:
    """Compute the time [s] in which a vehicle covers a way [m] at an even acceleration [m/s^2]; 0 for none."""
    if way <= 0.0:
        return 0.0
    return 2.0 * way / (max(speed, 0.0) + math.sqrt(speed * speed + 2.0 * acceleration * way))


@kernel
def time_to_line(gap: float, speed: float) -> float:
    """Compute the time [s] after which a driver can be at a line, at the largest acceleration."""
    return time_over(gap, speed, _FASTEST)


@kernel
def time_through(gap: float, speed: float) -> float:
    """Compute the time [s] after which a driver is through the place behind a line, at a usual acceleration."""
    return time_over(gap + _THROUGH_M, speed, USUAL)


@kernel
def attention(gap: float, speed: float, arrive_s: float, clear_s: float, time_gap_s: float) -> float:
    """Compute the attention, from 0 to 1, that a driver pays to a line.

    gap: to the line [m]; speed: own [m/s]; arrive_s, clear_s: times [s] until who goes first reaches the place behind
    the line, and until they have left it; time_gap_s: time [s] that the driver wants after being through.
    """
    if not 0.0 < gap < math.inf:
        return 0.0
    in_the_way = smooth_step((time_through(gap, speed) + time_gap_s - arrive_s) / SOFT_S)
    in_the_way *= smooth_step((clear_s - time_to_line(gap, speed)) / SOFT_S)
    braking = max(speed, 0.0) ** 2 / (2.0 * gap * _HARDEST)
    return in_the_way * smooth_step((1.0 - braking) / _SOFT_BRAKING)
