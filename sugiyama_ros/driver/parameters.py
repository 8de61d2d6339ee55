"""The parameters of one driver, declared once.

The optimiser, the ROS parameter descriptors, the YAML files, the command line and the reports read this declaration.
A driver's parameters are a float64 vector of shape (P,), many drivers' an array of shape (N, P), in this order.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError


@dataclass(frozen=True)
class Parameter:
    """One parameter: its name in code and messages, symbol in the paper, unit, default, bounds, meaning and source.

    ``axis`` says that the value is a time of the recording ("time") or a position on the road ("place").
    """

    name: str
    symbol: str
    unit: str
    default: float
    lower: float
    upper: float
    description: str
    axis: Literal["", "time", "place"] = ""


_MEAN = "Eq. SimulatedModelParameters"
_FIXED = "section 5, fixed for all drivers"

#: Names follow the paper's symbols; bounds are those within which the model makes sense.
PARAMETERS: tuple[Parameter, ...] = (
    Parameter("sigma_nu", "σ_ν", "m", 0.263, 0.0, 10.0, f"std of the measurement noise; {_MEAN}"),
    Parameter("sigma_a", "σ_a", "m/s^2", 0.273, 0.0, 10.0, f"std of the acceleration noise in one period; {_MEAN}"),
    Parameter("v_star", "v*", "m/s", 10.26, 0.5, 80.0, f"desired speed; {_MEAN}"),
    Parameter("kappa_v", "κ_v", "s", 0.215, 1e-3, 10.0, f"risk premium, gap scale per speed; {_MEAN}"),
    Parameter("kappa_1", "κ^(1)", "1", 0.7, 0.05, 10.0, f"width of the desired-speed reward over v*; {_FIXED}"),
    Parameter("kappa_c", "κ_c", "m", 0.4, 1e-2, 20.0, f"gap scale at standstill; {_FIXED}"),
    Parameter("kappa_d", "κ_d", "s", 1.0, 0.0, 20.0, f"gap scale per closing speed; {_FIXED}"),
    Parameter("omega_2", "ω^(2)", "1", -10.0, -1e3, 0.0, f"weight of the collision penalty; {_FIXED}"),
    Parameter("rationality", "λ", "1", 200.0, 1.0, 1e5, "sharpness of the action distribution; Eq. MaximumEntropy"),
    Parameter("rho", "ρ", "1", 0.7, 0.0, 0.999, f"correlation of the acceleration noise over a period; {_FIXED}"),
    Parameter("sigma_x", "σ_x", "m", 0.05, 0.0, 5.0, f"std of the position noise in one period; {_FIXED}"),
    Parameter("sigma_v", "σ_v", "m/s", 0.1, 0.0, 5.0, f"std of the speed noise in one period; {_FIXED}"),
)
NAMES: tuple[str, ...] = tuple(p.name for p in PARAMETERS)
COUNT = len(PARAMETERS)

# Places in the vector, for compiled code, which cannot look a name up.
SIGMA_NU, SIGMA_A, V_STAR, KAPPA_V, KAPPA_1, KAPPA_C, KAPPA_D, OMEGA_2, RATIONALITY, RHO, SIGMA_X, SIGMA_V = range(
    COUNT
)

#: The utility's parameters; the mean action depends on these alone.
UTILITY: tuple[int, ...] = (V_STAR, KAPPA_V, KAPPA_1, KAPPA_C, KAPPA_D, OMEGA_2, RATIONALITY)

#: Time [s] between samples for which the defaults hold (Sugiyama experiment).
REFERENCE_PERIOD_S = 1.0 / 3.0
#: Periods that a driver looks ahead, at the reference period; section 3.1.
REFERENCE_HORIZON = 4


def defaults(drivers: int | None = None) -> Array:
    """The paper's parameters, of shape (P,), or (drivers, P) for several identical drivers."""
    row = np.array([p.default for p in PARAMETERS])
    return row if drivers is None else np.tile(row, (drivers, 1))


def population() -> Array:
    """Parameters (P,) of a driver of whom nothing is known yet.

    The paper's, but with the acceleration noise that its likelihood finds on the measured experiment (the mean over the
    22 drivers, fitted here); the paper's own value is reduced for its simulations (section 4.1).
    """
    known = defaults()
    known[SIGMA_A] = 0.68
    return known


def index(name: str) -> int:
    """Place of a parameter in the vector. Raises InputError, which lists the names, for an unknown one."""
    if name not in NAMES:
        raise InputError(f"parameter {name!r}: not known; the parameters are {', '.join(NAMES)}")
    return NAMES.index(name)


def check(parameters: NDArray[np.float64]) -> None:
    """Raises InputError if any entry of ``parameters`` (..., P) lies outside its declared bounds."""
    for k, p in enumerate(PARAMETERS):
        values = np.ravel(parameters[..., k])
        outside = values[~((values >= p.lower) & (values <= p.upper))]
        if len(outside):
            raise InputError(
                f"parameter {p.name}: {outside[0]:g} {p.unit} is out of bounds; give {p.lower:g} to {p.upper:g}"
            )


def horizon_at(period_s: float) -> int:
    """Periods that a driver looks ahead when a period lasts ``period_s`` [s].

    The look-ahead time stays what it is at the reference period, rounded down (paper, section 5.4: 6 at 0.2 s).
    """
    return max(1, int(REFERENCE_HORIZON * REFERENCE_PERIOD_S / period_s + 1e-6))


def at_period(parameters: Array, period_s: float) -> Array:
    """Parameters (..., P) declared for the reference period, rescaled to ``period_s`` [s].

    rho goes to rho^(4 / h), so that the noise's correlation over the look-ahead stays (paper, section 5.4: rho^(2/3)
    at 0.2 s). The paper is silent on the noises: here the acceleration noise keeps its stationary variance, and the
    position and speed noises their variance per second.
    """
    scaled = parameters.copy()
    rho = parameters[..., RHO]
    rho_scaled = rho ** (REFERENCE_HORIZON / horizon_at(period_s))
    scaled[..., RHO] = rho_scaled
    scaled[..., SIGMA_A] *= np.sqrt((1.0 - rho_scaled * rho_scaled) / (1.0 - rho * rho))
    scaled[..., [SIGMA_X, SIGMA_V]] *= math.sqrt(period_s / REFERENCE_PERIOD_S)
    return scaled


def jacobian_at_reference(parameters: Array, scaled: Array, period_s: float) -> Array:
    """Derivatives (P, P) of ``scaled``, which is ``at_period(parameters, period_s)``, by ``parameters`` (P,).

    Column by row.
    """
    rho, sigma_a, there = float(parameters[RHO]), float(parameters[SIGMA_A]), float(scaled[RHO])
    ratio = REFERENCE_HORIZON / horizon_at(period_s)
    rho_slope = ratio * rho ** (ratio - 1.0)
    shrink = float(scaled[SIGMA_A]) / sigma_a
    jacobian = np.eye(COUNT)
    jacobian[RHO, RHO] = rho_slope
    jacobian[RHO, SIGMA_A] = sigma_a * shrink * (rho / (1.0 - rho * rho) - there * rho_slope / (1.0 - there * there))
    jacobian[SIGMA_A, SIGMA_A] = shrink
    jacobian[SIGMA_X, SIGMA_X] = jacobian[SIGMA_V, SIGMA_V] = math.sqrt(period_s / REFERENCE_PERIOD_S)
    return jacobian
