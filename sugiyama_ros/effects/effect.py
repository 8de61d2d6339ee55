"""What a physical effect is: a name, a stage at which it acts, parameters, and compiled functions.

A driver's row of parameters continues, behind those of ``driver.parameters``, with the parameters of every effect in
the registry. All of them are 0 for an effect that is not there, and the model then is the base model bit for bit.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.jit import kernel

PERCEPTION, PREFERENCE, UTILITY, ACTUATION, ENVIRONMENT, MEASUREMENT = (
    "perception",
    "preference",
    "utility",
    "actuation",
    "environment",
    "measurement",
)
STAGES = (PERCEPTION, PREFERENCE, UTILITY, ACTUATION, ENVIRONMENT, MEASUREMENT)


class Seen(NamedTuple):
    """What there is for a driver to see, and for effects to depend on, at one moment; SI units.

    The gap is infinite without a leader; second_gap is the gap between the leader and the leader's leader; rear_gap is
    the gap between the follower and the driver. Accelerations are those of the last period.
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


@kernel
def with_view(seen: Seen, gap: float, speed: float, leader_speed: float) -> Seen:
    """Replace the gap [m], the speed and the leader's speed [m/s] of what is seen; the rest stays."""
    return Seen(
        gap=gap,
        speed=speed,
        leader_speed=leader_speed,
        position=seen.position,
        time=seen.time,
        circumference=seen.circumference,
        acceleration=seen.acceleration,
        leader_acceleration=seen.leader_acceleration,
        second_gap=seen.second_gap,
        second_speed=seen.second_speed,
        rear_gap=seen.rear_gap,
        rear_speed=seen.rear_speed,
    )


class Recording(NamedTuple):
    """What a search for an effect may know of a recording: times [s], ring [m] (0: open road), extent of the road."""

    start_s: float
    end_s: float
    circumference_m: float
    first_m: float
    last_m: float


#: Values of parameters, by name.
Values = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Memory:
    """How an effect carries out a wanted change of the acceleration, from one period to the next.

    Parameters
    ----------
    change : callable
        Compiled, (wanted, period, p) -> change [m/s^2] that is carried out.
    expected_change : callable
        Compiled, (wanted, variance, period, p) -> (mean, slope, variance_left): of a wanted change that is known as a
        normal distribution, the mean of the change that is carried out, its regression on the wanted change, and the
        variance that the regression leaves.
    """

    change: Callable[..., float]
    expected_change: Callable[..., tuple[float, float, float]]


@dataclass(frozen=True, eq=False)
class Contamination:
    """How an effect makes some measurements worse than others.

    Parameters
    ----------
    weigh : callable
        Compiled, (innovation, variance, noise_var, p) -> (probability, wide, density): the probability that the sample
        is one of the bad ones, the variance of its innovation then, and the log-likelihood of the mixture.
    sample : callable
        (noise, values, rng) -> noise (N,) [m]; draws which measurements are bad. ``values`` has shape (N, K).
    """

    weigh: Callable[..., tuple[float, float, float]]
    sample: Callable[..., Any]


def _no_starts(_: Recording) -> tuple[Values, ...]:
    return ()


@dataclass(frozen=True, eq=False)
class Effect:
    """A named physical mechanism; everything that others need to know about it is declared here.

    Parameters
    ----------
    name : str
        Name in commands, files and messages.
    stage : str
        One of ``STAGES``.
    title : str
        Name for people, such as "slower stretch of road".
    summary : str
        What the effect is, in one line.
    source : str
        Where the effect is known from.
    parameters : tuple of Parameter
        Declared as those of drivers are, with 0 as default.
    function : callable, optional
        Compiled with ``numba.njit``. By stage, with ``seen`` a `Seen` and ``p`` the effect's own parameters:

        - perception, measurement: (seen, p) -> gap, speed, leader_speed as the driver perceives them;
        - preference: (v_star, kappa_v, seen, p) -> v_star, kappa_v;
        - utility: (seen, action, period, horizon, p) -> what is added to the utility of holding the action [m/s^2];
        - actuation: (acceleration, seen, p) -> acceleration [m/s^2] that comes of the one that was meant;
        - environment: (seen, p) -> acceleration [m/s^2] that is added to the driver's own.
    memory : Memory, optional
        How a wanted change of the acceleration is carried out.
    noise_factor : callable, optional
        Compiled, (speed, p) -> factor of the std of the acceleration noise.
    displacement : callable, optional
        Compiled, (position, circumference, p) -> (offset, slope): measured minus true position [m], and its derivative.
    measurement_noise_factor : callable, optional
        Compiled, (position, circumference, p) -> factor of the std of the measurement noise.
    contamination : Contamination, optional
        Which measurements are worse than others. At most one effect of this kind acts at a time.
    wanders : tuple of str
        Names of the driver's parameters whose logarithms wander at random (Ornstein-Uhlenbeck); the first two
        parameters of the effect are the std of the logarithm and the correlation time [s].
    starts : callable
        Recording -> values from which a search for the parameters begins; nothing is searched for without any.
    strengths : tuple of str
        Names of the parameters that switch the effect on by not being 0; the first parameter if left out.
    individual : bool
        Whether each driver has values of their own.
    is_noise : bool
        Whether the effect changes no mean motion, so that a free run, which has no noise, cannot speak against it.
    is_limit : bool
        Whether the effect is the stronger, the smaller its first parameter is.
    reach : int
        How many vehicles ahead the driver looks.
    sees_accelerations : bool
        Whether the function needs the accelerations as they are distributed, not only their means.
    bank : mapping of str to float, optional
        Values with which the live critic follows the drivers.
    benchmark : tuple of mapping
        Strong and weak values with which the benchmark of the diagnosis hides the effect. A place or a time that is
        left out is drawn at random.
    advice : mapping of str to str
        What to record to tell the effect from another one, by the name of the other effect.
    """

    name: str
    stage: str
    summary: str
    source: str
    parameters: tuple[Parameter, ...]
    title: str = ""
    function: Callable[..., Any] | None = None
    memory: Memory | None = None
    noise_factor: Callable[..., float] | None = None
    displacement: Callable[..., tuple[float, float]] | None = None
    measurement_noise_factor: Callable[..., float] | None = None
    contamination: Contamination | None = None
    wanders: tuple[str, ...] = ()
    starts: Callable[[Recording], tuple[Values, ...]] = _no_starts
    strengths: tuple[str, ...] = ()
    individual: bool = False
    is_noise: bool = False
    is_limit: bool = False
    reach: int = 1
    sees_accelerations: bool = False
    bank: Values | None = None
    benchmark: tuple[Values, ...] = ()
    advice: Mapping[str, str] = field(default_factory=dict)

    @property
    def switches(self) -> tuple[str, ...]:
        """Names of the parameters that switch the effect on by not being 0."""
        return self.strengths or (self.parameters[0].name,)


def at(*values: Values) -> Callable[[Recording], tuple[Values, ...]]:
    """Starts of a search that do not depend on the recording."""
    return lambda _: values
