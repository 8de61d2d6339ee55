"""One step of a vehicle in time: Euler's rule, as in the paper's state-space model (Eq. ssm_form)."""

from typing import Any

from sugiyama_ros.jit import kernel


@kernel
def advance(position: Any, speed: Any, acceleration: Any, period: float) -> tuple[Any, Any]:
    """Advance vehicles by one period.

    position, speed, acceleration: position [m], speed [m/s] and acceleration [m/s^2] at the beginning of the period;
    all of one shape; period: length of the period [s]. Returns position [m] and speed [m/s] at the end of the period.
    """
    return position + period * speed, speed + period * acceleration
