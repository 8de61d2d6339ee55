"""What a physical effect is: a name, a stage at which it acts, parameters, and one compiled function.

A driver's row of parameters continues, behind those of ``driver.parameters``, with the parameters of every effect in
the catalogue. All of them are 0 for an effect that is not there, and the model then is the base model bit for bit.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from sugiyama_ros.driver.parameters import Parameter

PERCEPTION, PREFERENCE, ACTUATION, ENVIRONMENT, MEASUREMENT = (
    "perception",
    "preference",
    "actuation",
    "environment",
    "measurement",
)
STAGES = (PERCEPTION, PREFERENCE, ACTUATION, ENVIRONMENT, MEASUREMENT)


class Seen(NamedTuple):
    """What there is for a driver to see, and for effects to depend on, at one moment; SI units.

    gap is infinite without a leader; second_gap is that from the leader to his own leader; rear_gap that of the
    follower. Accelerations are those applied in the last period.
    """

    gap: float
    speed: float
    leader_speed: float
    position: float
    time: float
    circumference: float
    acceleration: float
    leader_acceleration: float
    second_gap: float
    second_speed: float
    rear_gap: float
    rear_speed: float


class Recording(NamedTuple):
    """What a search for an effect may know of a recording: times [s], ring [m] (0: open road), extent of the road."""

    start_s: float
    end_s: float
    circumference_m: float
    first_m: float
    last_m: float


#: Values of parameters, by name.
Values = Mapping[str, float]


def _no_starts(_: Recording) -> tuple[Values, ...]:
    return ()


@dataclass(frozen=True, eq=False)
class Effect:
    """A named physical mechanism.

    name; stage, one of STAGES; summary and source: what it is, in one line, and where that is known from.
    parameters: declared as those of drivers are, with 0 as default; the effect acts where any of its ``strengths`` (the
    first parameter if none is named) is not 0.
    function: compiled with ``numba.njit``. By stage, with ``seen`` a Seen and ``p`` the effect's own parameters:

    - perception: (seen, p) -> gap, speed, leader_speed as the driver perceives them;
    - preference: (v_star, kappa_v, seen, p) -> v_star, kappa_v;
    - actuation: (acceleration, seen, p) -> acceleration [m/s^2] that comes of the one that was meant;
    - environment: (seen, p) -> acceleration [m/s^2] that is added to the driver's own.

    Effects with a memory or of the measurement have no such function: the simulator and the filters know them.
    starts: where a search for its parameters begins; individual: whether each driver has values of his own.
    """

    name: str
    stage: str
    summary: str
    source: str
    parameters: tuple[Parameter, ...]
    starts: Callable[[Recording], tuple[Values, ...]] = _no_starts
    function: Callable[..., Any] | None = None
    strengths: tuple[str, ...] = ()
    individual: bool = False

    @property
    def switches(self) -> tuple[str, ...]:
        """Names of the parameters that switch it on by not being 0."""
        return self.strengths or (self.parameters[0].name,)


def at(*values: Values) -> Callable[[Recording], tuple[Values, ...]]:
    """Starts of a search that do not depend on the recording."""
    return lambda _: values
