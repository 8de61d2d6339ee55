"""adaptiveSeek, the driver model of the paper. All other laws are compared with it."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import PARAMETERS, REFERENCE_HORIZON, REFERENCE_PERIOD_S
from sugiyama_ros.driver.utility import ACTIONS, mean_action
from sugiyama_ros.jit import kernel
from sugiyama_ros.laws.law import Law


@kernel
def _adaptive_seek(gap: float, speed: float, leader_speed: float, p: Array) -> float:
    """Compute the mean action [m/s^2] at the reference period, p = the parameters (P,) of ``driver.parameters``."""
    return mean_action(gap, speed, leader_speed, p, ACTIONS, REFERENCE_PERIOD_S, REFERENCE_HORIZON)


LAW = Law(
    name="adaptive_seek",
    title="adaptiveSeek",
    summary="the Boltzmann mean of the actions, for an anticipated utility of speed and risk",
    source="Dai, Shen, Wang, Huang and Filev, Calibration of Human Driving Behavior and Preference (the paper)",
    parameters=PARAMETERS,
    function=_adaptive_seek,
)
