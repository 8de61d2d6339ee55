"""What a physical effect is: a name, a stage at which it acts, parameters, and compiled functions.

A driver's row holds the parameters of every effect in the registry. The parameters of an effect that does not act are
0. If no effect acts, every number equals the number of the base model to the last bit.
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from sugiyama_ros.driver.parameters import Parameter, check_declared
from sugiyama_ros.errors import InputError
from sugiyama_ros.jit import kernel

PERCEPTION, ATTENTION, PREFERENCE, UTILITY, ACTUATION, ENVIRONMENT, MEASUREMENT = (
    "perception",
    "attention",
    "preference",
    "utility",
    "actuation",
    "environment",
    "measurement",
)
STAGES = (PERCEPTION, ATTENTION, PREFERENCE, UTILITY, ACTUATION, ENVIRONMENT, MEASUREMENT)
#: What a road may have that some effects need: a ring, places where drivers let others pass, signals, curves.
RING, YIELDS, SIGNALS, CURVES = NEEDS = ("ring", "yields", "signals", "curves")


class Seen(NamedTuple):
    """What a driver can see at one moment, and what effects can depend on.

    Parameters
    ----------
    gap, speed, leader_speed : float
        Gap [m], infinite without a leader, speed [m/s] and leader's speed [m/s].
    position, time, circumference : float
        Position [m] on the road, time [s] of the recording, and circumference [m] of the ring; 0 for an open road.
    acceleration, leader_acceleration : float
        Accelerations [m/s^2] of the car and of its leader in the last period.
    second_gap, second_speed : float
        Gap [m] between the leader and the second vehicle ahead, infinite without a second vehicle, and speed [m/s] of
        the second vehicle.
    rear_gap, rear_speed : float
        Gap [m] between the follower and the car, infinite without a follower, and speed [m/s] of the follower.
    past_gap, past_speed, past_leader_speed : float
        Gap [m], speed [m/s] and leader's speed [m/s] one reaction time ago. Without an effect that looks back, these
        are the gap and the speeds of now.
    line_gap : float
        Gap [m] between the front bumper and the next line before which the rule may ask the driver to wait: where lanes
        meet, or at a signal. Infinite without a line, and below 0 behind the line.
    arrive_s, clear_s : float
        Times [s] until whoever goes first reaches the place behind the line, and until they have left it. The first is
        at most 0 while the place is taken or the signal is red; the second is infinite at a red signal, and below 0
        after the signal has turned green.
    curvature : float
        Largest curvature [1/m] of the road just ahead; 0 on a straight road.
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
    past_gap: float
    past_speed: float
    past_leader_speed: float
    line_gap: float
    arrive_s: float
    clear_s: float
    curvature: float


@kernel
def with_motion(
    seen: Seen,
    view: tuple[float, float, float],
    accelerations: tuple[float, float],
    past: tuple[float, float, float],
    line_gap: float,
) -> Seen:
    """Replace gaps, speeds, accelerations and the view of the past; the other fields stay."""
    return Seen(
        gap=view[0],
        speed=view[1],
        leader_speed=view[2],
        position=seen.position,
        time=seen.time,
        circumference=seen.circumference,
        acceleration=accelerations[0],
        leader_acceleration=accelerations[1],
        second_gap=seen.second_gap,
        second_speed=seen.second_speed,
        rear_gap=seen.rear_gap,
        rear_speed=seen.rear_speed,
        past_gap=past[0],
        past_speed=past[1],
        past_leader_speed=past[2],
        line_gap=line_gap,
        arrive_s=seen.arrive_s,
        clear_s=seen.clear_s,
        curvature=seen.curvature,
    )


@kernel
def with_view(seen: Seen, gap: float, speed: float, leader_speed: float) -> Seen:
    """Replace the gap [m], the speed [m/s] and the leader's speed [m/s]; the other fields stay."""
    accelerations = seen.acceleration, seen.leader_acceleration
    past = seen.past_gap, seen.past_speed, seen.past_leader_speed
    return with_motion(seen, (gap, speed, leader_speed), accelerations, past, seen.line_gap)


class Extent(NamedTuple):
    """What a search for an effect may know about a recording.

    Parameters
    ----------
    start_s, end_s : float
        Times [s] of the first and the last sample.
    circumference_m : float
        Circumference [m] of the ring; 0 for an open road.
    first_m, last_m : float
        Smallest and largest position [m].
    has_lines, has_curves : bool
        Whether drivers come to lines before which they let others pass, and to curves.
    """

    start_s: float
    end_s: float
    circumference_m: float
    first_m: float
    last_m: float
    has_lines: bool = False
    has_curves: bool = False


# Number of arguments of a component of the utility that takes the driver's preferences.
_WITH_PREFERENCES = 6
#: Values of parameters, by name.
Values = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Memory:
    """How much of a wanted change of the acceleration is carried out from one period to the next.

    Parameters
    ----------
    change : callable
        Compiled, (wanted [m/s^2], period [s], p) -> change [m/s^2] that is carried out.
    expected_change : callable
        Compiled, (wanted, variance, period, p) -> (mean, slope, variance_left). The wanted change has a normal
        distribution with mean ``wanted``. The results are the mean of the change that is carried out, its regression on
        the wanted change, and the variance that the regression leaves.
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
        is bad, the variance [m^2] of the innovation of a bad sample, and the log-likelihood of the sample.
    sample : callable
        (noise, values, rng) -> noise. Draws which measurements are bad, and returns the noise (N,) [m] with them.
        ``values`` holds the effect's parameters, shape (N, K).
    """

    weigh: Callable[..., tuple[float, float, float]]
    sample: Callable[..., Any]


def _no_starts(_: Extent) -> tuple[Values, ...]:
    """Search for nothing."""
    return ()


@dataclass(frozen=True, eq=False)
class Effect:
    """A named physical mechanism, with everything that the rest of the package needs to know about it.

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
    term : str
        The effect as part of the equation of the model, in the names of its parameters, such as "- c0 - c2 v|v|". A
        term that begins with a sign is added to the acceleration. Empty if there is none.
    source : str
        Publication that describes the effect.
    parameters : tuple of Parameter
        Declared parameters, each with 0 as default.
    function : callable, optional
        Compiled with ``numba.njit``. ``seen`` is a `Seen`, and ``p`` holds the effect's parameters. By stage:

        - attention: (attention, seen, p) -> attention, from 0 to 1, that the driver pays to the line ahead;
        - perception, measurement: (seen, p) -> gap, speed, leader_speed as the driver perceives them;
        - preference: (v_star, kappa_v, seen, p) -> v_star, kappa_v;
        - utility: (seen, action, period, horizon, p) -> term that is added to the utility of holding the action; a
          function with a sixth argument gets the driver's ``Preferences``;
        - actuation: (acceleration, seen, p) -> acceleration [m/s^2] in place of the intended acceleration;
        - environment: (seen, p) -> acceleration [m/s^2] that is added to the acceleration by the driver.
    memory : Memory, optional
        How much of a wanted change of the acceleration is carried out.
    noise_factor : callable, optional
        Compiled, (speed, p) -> factor of the std of the acceleration noise.
    displacement : callable, optional
        Compiled, (position, circumference, p) -> (offset, slope): measured minus true position [m], and the derivative
        of this difference.
    measurement_noise_factor : callable, optional
        Compiled, (position, circumference, p) -> factor of the std of the measurement noise.
    contamination : Contamination, optional
        How some measurements are worse than others. At most one effect with a contamination acts at a time.
    wanders : tuple of str
        Names of the driver's parameters whose logarithms wander at random (Ornstein-Uhlenbeck). The first two
        parameters of the effect are then the std of the logarithm and the correlation time [s].
    needs : tuple of str
        What the road must have for the effect to act, of ``NEEDS``: one of these; nothing if left out.
    starts : callable
        Extent -> sets of values at which a search for the parameters begins. Without sets there is no search.
    strengths : tuple of str
        Names of the parameters that switch the effect on if they are not 0; if left out, the first parameter.
    individual : bool
        Whether each driver has their own values.
    is_constant : bool
        Whether the effect frees a constant of the paper's driver: it says what these drivers are like, and explains
        nothing.
    is_limit : bool
        Whether a smaller first parameter makes the effect stronger.
    reach : int
        Number of vehicles ahead that the driver looks at.
    sees_rear : bool
        Whether the driver looks at the vehicle behind.
    sees_accelerations : bool
        Whether the function depends on accelerations, so that a filter must know their distribution.
    looks_back : bool
        Whether the function depends on the past (``past_gap`` and the like of `Seen`). The first parameter of the
        effect is then the time [s] that the driver looks back.
    bank : mapping of str to float, optional
        Values at which the live diagnosis begins with the effect, whose strength it then fits; left out if the effect
        takes no part. A place that is left out is tried all along the road.
    benchmark : tuple of mapping
        Strong and weak values with which the benchmark of the diagnosis hides the effect. If a place or a time is left
        out, the benchmark draws it at random.
    ascending : tuple of (str, str)
        Pairs of names of parameters of which the second must be larger than the first while the effect acts.
    least : mapping of str to float
        Values of parameters below which the effect makes no physical sense. A search may go below, but the effect is
        then not named.
    advice : mapping of str to str
        What to record to tell the effect from another effect, by the name of the other effect.
    fixed : tuple of str
        Names of parameters that a search leaves as they are at its start.
    forms : tuple of Effect
        Further forms of the same mechanism, with names of their own. A search tries them too, and a verdict then names
        the mechanism, and says which form fits best.
    """

    name: str
    stage: str
    summary: str
    source: str
    parameters: tuple[Parameter, ...]
    title: str = ""
    term: str = ""
    function: Callable[..., Any] | None = None
    memory: Memory | None = None
    noise_factor: Callable[..., float] | None = None
    displacement: Callable[..., tuple[float, float]] | None = None
    measurement_noise_factor: Callable[..., float] | None = None
    contamination: Contamination | None = None
    wanders: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    starts: Callable[[Extent], tuple[Values, ...]] = _no_starts
    strengths: tuple[str, ...] = ()
    individual: bool = False
    is_constant: bool = False
    is_limit: bool = False
    reach: int = 1
    sees_rear: bool = False
    sees_accelerations: bool = False
    looks_back: bool = False
    bank: Values | None = None
    benchmark: tuple[Values, ...] = ()
    ascending: tuple[tuple[str, str], ...] = ()
    least: Values = field(default_factory=dict)
    advice: Mapping[str, str] = field(default_factory=dict)
    fixed: tuple[str, ...] = ()
    forms: tuple["Effect", ...] = ()

    def __post_init__(self) -> None:
        check_declared(self.name, self.parameters)
        known = {p.name for p in self.parameters}
        if not known or not {*self.switches, *(name for pair in self.ascending for name in pair)} <= known:
            raise InputError(f"effect {self.name}: its strengths must be among its parameters")
        if not set(self.needs) <= set(NEEDS):
            raise InputError(f"effect {self.name}: needs {', '.join(self.needs)}; give some of {', '.join(NEEDS)}")
        if any(form.forms for form in self.forms):
            raise InputError(f"effect {self.name}: a form has no forms of its own")

    @property
    def is_searched(self) -> bool:
        """Whether a search can find the effect in some recording."""
        return bool(self.starts(Extent(0.0, 100.0, 100.0, 0.0, 100.0, has_lines=True, has_curves=True)))

    @property
    def switches(self) -> tuple[str, ...]:
        """Names of the parameters that switch the effect on if they are not 0."""
        return self.strengths or (self.parameters[0].name,)

    @property
    def acts_on_preferences(self) -> bool:
        """Whether the effect acts on preferences of the paper's drivers alone, which other laws do not have."""
        return self.stage in (PREFERENCE, UTILITY) or bool(self.wanders)

    @property
    def is_noise(self) -> bool:
        """Whether the effect changes noises alone. It hardly changes the mean of free runs, which cannot judge it."""
        of_noise = self.noise_factor or self.measurement_noise_factor or self.contamination
        return of_noise is not None and self.function is None


def takes_preferences(component: Callable[..., Any]) -> bool:
    """Whether a component of the utility takes the driver's ``Preferences``, as its sixth argument."""
    return len(inspect.signature(getattr(component, "py_func", component)).parameters) == _WITH_PREFERENCES


def at(*values: Values) -> Callable[[Extent], tuple[Values, ...]]:
    """Make starts of a search that do not depend on the recording.

    Parameters
    ----------
    *values : mapping of str to float
        Sets of values of the parameters, by name.

    Returns
    -------
    callable
        Extent -> starts, for ``Effect.starts``.
    """
    return lambda _: values


def at_lines(*values: Values) -> Callable[[Extent], tuple[Values, ...]]:
    """Make starts of a search in recordings in which drivers come to lines; arguments and result as of `at`."""
    return lambda recording: values if recording.has_lines else ()
