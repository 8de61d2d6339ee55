"""One step in time of a vehicle: Euler's rule, as in the paper's state-space model (Eq. ssm_form)."""

from typing import Any

from sugiyama_ros.jit import kernel


@kernel
def advance(position: Any, speed: Any, acceleration: Any, period: float) -> tuple[Any, Any]:
    """Advance vehicles by one period.

    Parameters
    ----------
    position, speed, acceleration
        Numbers, or arrays of one shape, in m, m/s and m/s^2 at the beginning of the period.
    period
        Length of the period [s].

    Returns
    -------
    Position [m] and speed [m/s] at the end of the period.
    """
    return position + period * speed, speed + period * acceleration
