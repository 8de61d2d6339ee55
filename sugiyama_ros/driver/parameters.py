"""The parameters of a driver, declared once.

The optimiser, the ROS parameter descriptors, the YAML files, the command line and the reports read this declaration.
The parameters of one driver are a float64 vector of shape (P,), in the declared order. The parameters of N drivers are
an array of shape (N, P).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError


@dataclass(frozen=True)
class Parameter:
    """The declaration of one parameter.

    Parameters
    ----------
    name : str
        Name in code, files and messages.
    symbol : str
        Symbol in the source.
    unit : str
        SI unit; ``"1"`` for a number without a unit.
    default, lower, upper : float
        Default value and bounds, in this unit.
    description : str
        Meaning, and source where the source is not obvious.
    axis : {"", "time", "place"}
        ``"time"`` if the value is a time of the recording, ``"place"`` if it is a position on the road.
    is_whole : bool
        Whether only whole numbers make sense.
    """

    name: str
    symbol: str
    unit: str
    default: float
    lower: float
    upper: float
    description: str
    axis: Literal["", "time", "place"] = ""
    is_whole: bool = False

    @property
    def of_unit(self) -> str:
        """The unit after a number in a message; empty for a number without a unit."""
        return "" if self.unit == "1" else f" {self.unit}"

    @property
    def bounds(self) -> str:
        """The bounds in a message; which times and places are possible, a recording says."""
        of_axis = {"time": "a time [s] at which somebody drives", "place": "a position [m] that vehicles come to"}
        return of_axis.get(self.axis, f"{self.lower:g} to {self.upper:g}{self.of_unit}")

    @property
    def bounds_of_effect(self) -> str:
        """The bounds in a message about an effect, which 0 switches off."""
        least_is_off = self.lower == 0.0 and not self.axis
        return f"more than 0, and {self.upper:g}{self.of_unit} at most" if least_is_off else self.bounds


def check_declared(owner: str, parameters: Sequence[Parameter]) -> None:
    """Check the name and the parameters of an effect or a law of another package. Raises InputError."""
    if not isinstance(owner, str) or not owner.isidentifier():
        raise InputError(f"{owner!r}: is no name; use letters, digits and underscores")
    if not isinstance(parameters, tuple) or not all(isinstance(p, Parameter) for p in parameters):
        raise InputError(f"{owner}: parameters must be a tuple of Parameter")
    names = [p.name for p in parameters]
    if len(set(names)) != len(names):
        raise InputError(f"{owner}: a parameter is declared twice: {', '.join(map(str, names))}")
    for p in parameters:
        if not -math.inf < p.lower <= p.upper < math.inf:
            raise InputError(f"{owner}: {p.name}: its bounds must be finite, the lower one first")


_MEAN = "Eq. SimulatedModelParameters"
_FIXED = "section 5, fixed for all drivers"

#: Declared parameters. The names follow the paper's symbols. The model makes sense within the bounds.
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

# Indices in the vector. Compiled code uses them, because it cannot look up a name.
SIGMA_NU, SIGMA_A, V_STAR, KAPPA_V, KAPPA_1, KAPPA_C, KAPPA_D, OMEGA_2, RATIONALITY, RHO, SIGMA_X, SIGMA_V = range(
    COUNT
)

#: Indices of the utility's parameters. The mean action depends on these parameters alone.
UTILITY: tuple[int, ...] = (V_STAR, KAPPA_V, KAPPA_1, KAPPA_C, KAPPA_D, OMEGA_2, RATIONALITY)

#: Least std of a noise with which a filter can run, in the unit of the noise.
LEAST_NOISE = 1e-6

#: Time [s] between two samples for which the defaults hold (Sugiyama experiment).
REFERENCE_PERIOD_S = 1.0 / 3.0
#: Periods that a driver looks ahead, at the reference period; section 3.1.
REFERENCE_HORIZON = 4


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


def defaults(drivers: int | None = None) -> Array:
    """Return the paper's parameters (P,), or (drivers, P) of identical drivers."""
    row = np.array([p.default for p in PARAMETERS])
    return row if drivers is None else np.tile(row, (drivers, 1))


def population() -> Array:
    """Return the parameters (P,) of a driver about whom nothing is known yet.

    These are the paper's parameters except for the acceleration noise, which the paper reduces for its simulations
    (section 4.1): here it is the mean over the 22 drivers of the measured experiment, fitted with the paper's
    likelihood.
    """
    known = defaults()
    known[SIGMA_A] = 0.68
    return known


def index(name: str) -> int:
    """Return the index of a parameter in the vector. Raises InputError."""
    if name not in NAMES:
        raise InputError(f"parameter {name!r}: not known; the parameters are {', '.join(NAMES)}")
    return NAMES.index(name)


def check(parameters: NDArray[np.float64]) -> None:
    """Check that the first P entries of parameters (..., P) lie within their bounds. Raises InputError."""
    for k, p in enumerate(PARAMETERS):
        values = np.ravel(parameters[..., k])
        outside = values[~((values >= p.lower) & (values <= p.upper))]
        if len(outside):
            raise InputError(f"parameter {p.name}: {outside[0]:g}{p.of_unit} is out of bounds; give {p.bounds}")


def check_for_filter(parameters: NDArray[np.float64]) -> None:
    """Check parameters (..., P) as ``check``, and that a filter can run with their noises. Raises InputError."""
    check(parameters)
    # a filter divides by these and takes their logarithms
    for k in (SIGMA_NU, SIGMA_A):
        if not (parameters[..., k] >= LEAST_NOISE).all():
            needed = replace(PARAMETERS[k], lower=LEAST_NOISE)
            raise InputError(f"parameter {needed.name}: a filter needs noise; give {needed.bounds}")


def read_pairs(text: str, where: str) -> dict[str, str]:
    """Texts of the values in ``KEY=VALUE[,KEY=VALUE]``, by key. Raises InputError, also for a key that comes twice."""
    found: dict[str, str] = {}
    for pair in filter(None, (part.strip() for part in text.split(","))):
        key, equals, value = (part.strip() for part in pair.partition("="))
        if not key or not equals:
            raise InputError(f"{where}: {pair} is not NAME=VALUE; give each value as NAME=VALUE, with commas between")
        if key in found:
            raise InputError(f"{where}: {key} is given twice; give it once")
        found[key] = value
    return found


def read_numbers(
    texts: Mapping[str, str], parameters: Sequence[Parameter], where: str, may_be_zero: bool = False
) -> dict[str, float]:
    """Values of parameters from their texts, each within its bounds. Raises InputError.

    may_be_zero: whether 0 is allowed beyond the bounds too, because it switches something off.
    """
    declared, found = {p.name: p for p in parameters}, {}
    for name, text in texts.items():
        if name not in declared:
            raise InputError(f"{where}: {name[:40]!r} is not known; the parameters are {', '.join(declared)}")
        p = declared[name]
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not p.lower <= value <= p.upper and not (may_be_zero and value == 0.0):
            raise InputError(
                f"{where}: {name} is {text or 'empty'}; give {p.bounds_of_effect if may_be_zero else p.bounds}"
            )
        found[name] = value
    return found


def read_parameters(texts: Iterable[str], where: str) -> dict[str, float]:
    """Values of a driver's parameters by name, from texts ``NAME=VALUE``. Raises InputError."""
    return read_numbers(read_pairs(",".join(texts), where), PARAMETERS, where)


def horizon_at(period_s: float) -> int:
    """Return the number of periods that a driver looks ahead.

    The look-ahead time is the same at every period, rounded down to whole periods (paper, section 5.4: 6 at 0.2 s).
    """
    return max(1, int(REFERENCE_HORIZON * REFERENCE_PERIOD_S / period_s + 1e-6))


def at_period(parameters: Array, period_s: float) -> Array:
    """Rescale parameters (..., P), or rows with effects, from the reference period to another period [s].

    With h periods of look-ahead, rho becomes rho^(4 / h): the correlation of the noise over the look-ahead stays the
    same (paper, section 5.4: rho^(2/3) at 0.2 s). The paper does not say how to rescale the noises. Here the
    acceleration noise keeps its stationary variance. The position noise and the speed noise keep their variances per
    second.
    """
    scaled = parameters.copy()
    rho = parameters[..., RHO]
    rho_scaled = rho ** (REFERENCE_HORIZON / horizon_at(period_s))
    scaled[..., RHO] = rho_scaled
    scaled[..., SIGMA_A] *= np.sqrt((1.0 - rho_scaled * rho_scaled) / (1.0 - rho * rho))
    for k in (SIGMA_X, SIGMA_V):
        scaled[..., k] *= math.sqrt(period_s / REFERENCE_PERIOD_S)
    return scaled


def jacobian_at_reference(parameters: Array, scaled: Array, period_s: float) -> Array:
    """Return the derivatives (P, P) of ``at_period``: of the scaled parameter of the column by the one of the row."""
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
