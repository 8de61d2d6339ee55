"""Constants of the paper's driver that may be fitted, in groups that act together."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Constants:
    """Constants that become free together.

    name: Name of the group; parameters: Names of the constants; title: Name for people; summary: Explanation in one
    line; individual: Whether every driver has individual values; is_noise: Whether the constants change only noises
    and not the mean motion.
    """

    name: str
    parameters: tuple[str, ...]
    title: str
    summary: str
    individual: bool = False
    is_noise: bool = False


#: Constants that the paper fixes, in groups that act together.
CONSTANTS = (
    Constants(
        "response_constants",
        ("kappa_c", "kappa_d", "kappa_1"),
        "softer or harder response",
        "gap scales and the width of the desired-speed reward are fitted instead of the paper's constants",
    ),
    Constants(
        "noise_constants",
        ("rho", "sigma_x", "sigma_v"),
        "other noise of the motion",
        "noises of position, speed and acceleration are fitted instead of the paper's constants",
        is_noise=True,
    ),
    Constants(
        "rationality",
        ("rationality",),
        "sharper or looser choices",
        "how sharply a driver prefers the best action is fitted for each driver",
        individual=True,
    ),
    Constants(
        "risk_constants",
        ("kappa_c", "kappa_d"),
        "own gap scales of each driver",
        "gap scales at standstill and per closing speed are fitted for each driver",
        individual=True,
    ),
)
