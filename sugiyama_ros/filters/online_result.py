"""What the compiled online filter tells after a step."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.filters.online_state import (
    ACCELERATION,
    APPROACH_RATE,
    GAP_M,
    INNOVATION_M,
    INNOVATION_VAR,
    NIS,
    POSITION_M,
    RESULTS,
    SPEED,
)
from sugiyama_ros.filters.state import MOVING, STATE, Linearised, Scene, State
from sugiyama_ros.jit import kernel


@kernel(allocates=False)
def fill_in(result: Array, state: State, linearised: Linearised, length: Array, scene: Scene) -> None:
    """Fill in what follows from the state.

    result: of ``Online``; its innovation is there already; length: lengths [m] of the vehicles, (M,).
    """
    mean, period, lap = state.mean, scene.period_s, scene.circumference_m
    result[POSITION_M] = mean[0] % lap if lap > 0.0 else mean[0]
    result[SPEED] = mean[1]
    result[ACCELERATION] = (linearised.next_mean[1] - mean[1]) / period
    result[GAP_M], result[APPROACH_RATE] = math.inf, 0.0
    if len(state.known) > 1 and state.known[1] == MOVING:
        result[GAP_M] = mean[STATE] - mean[0] - 0.5 * (length[0] + length[1])
        result[APPROACH_RATE] = mean[1] - mean[STATE + 1]
    result[NIS] = result[INNOVATION_M] ** 2 / result[INNOVATION_VAR]
    _fill_in_covariance(result[RESULTS:].reshape((3, 3)), state.covariance, linearised.jacobian[1], period)


@kernel(allocates=False)
def _fill_in_covariance(out: Array, covariance: Array, next_speed: Array, period: float) -> None:
    """Fill in the covariance of own position, speed and acceleration.

    The next speed is v + dt a. So the acceleration is (v' - v) / dt, and so is its row of derivatives.
    """
    size = len(next_speed)
    for i in range(2):
        for j in range(2):
            out[i, j] = covariance[i, j]
        out[i, 2] = 0.0
    out[2, 2] = 0.0
    for k in range(size):
        slope = (next_speed[k] - 1.0) / period if k == 1 else next_speed[k] / period
        if slope == 0.0:
            continue
        for i in range(2):
            out[i, 2] += slope * covariance[i, k]
        for j in range(size):
            other = (next_speed[j] - 1.0) / period if j == 1 else next_speed[j] / period
            out[2, 2] += slope * covariance[k, j] * other
    out[2, 0], out[2, 1] = out[0, 2], out[1, 2]
