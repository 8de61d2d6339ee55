"""adaptiveSeek, the driver model of the paper: the law that all others are compared with."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import PARAMETERS, REFERENCE_HORIZON, REFERENCE_PERIOD_S
from sugiyama_ros.driver.utility import ACTIONS, mean_action
from sugiyama_ros.jit import kernel
from sugiyama_ros.laws.law import Law


@kernel
def adaptive_seek(gap: float, speed: float, leader_speed: float, p: Array) -> float:
    """Mean action [m/s^2] of a driver with the parameters p (P,) of ``driver.parameters``, at the reference period."""
    return mean_action(gap, speed, leader_speed, p, ACTIONS, REFERENCE_PERIOD_S, REFERENCE_HORIZON)


LAW = Law(
    name="adaptive_seek",
    title="adaptiveSeek",
    summary="the Boltzmann mean of the actions, by a utility of speed and risk that the driver anticipates",
    source="Dai, Shen, Wang, Huang and Filev, Calibration of Human Driving Behavior and Preference (the paper)",
    parameters=PARAMETERS,
    function=adaptive_seek,
)
