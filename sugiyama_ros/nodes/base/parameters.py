"""Parameters of a driver as parameters of nodes, and the model file from which a driver starts."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter as RosParameter

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES, PARAMETERS, check_for_filter
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.chain import CHAIN, Adaptation
from sugiyama_ros.filters.effect_filter import OF_LAW, STRENGTHS, EffectFilter, check_names
from sugiyama_ros.filters.goals import GoalFilter
from sugiyama_ros.filters.online import ADAPT, OnlineFilter
from sugiyama_ros.fit.driver_types import LEAST_STD
from sugiyama_ros.fit.goals import KnownGoals
from sugiyama_ros.fit.model_file import ModelFile, decisions_between, drivers_of
from sugiyama_ros.laws.registry import ADAPTIVE_SEEK, PAPERS
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.road import Road

Engine = Literal["compiled", "filterpy"]
#: What works out a step of an `OnlineFilter`; the first one, unless another one is asked for.
ENGINES: tuple[Engine, ...] = ("compiled", "filterpy")
# Prior std of the logarithm of a preference for which none was measured: a factor of two up or down.
_OTHER_STD = 0.7


def declare_driver(node: PacedNode, default: Array) -> None:
    """Declare the parameters of a driver, with their ranges, and default values in the order of ``PARAMETERS``."""
    for p, value in zip(PARAMETERS, default[: len(PARAMETERS)].tolist(), strict=True):
        bounds = FloatingPointRange(from_value=p.lower, to_value=p.upper)
        text = f"{p.symbol} [{p.unit}] {p.description}"
        node.declare_parameter(p.name, value, ParameterDescriptor(description=text, floating_point_range=[bounds]))


def check_driver(node: PacedNode) -> None:
    """Refuse parameters of a driver with which a filter cannot run, now (InputError) and whenever they are set."""
    check_for_filter(driver_of(node))

    def on_set(changed: list[RosParameter]) -> SetParametersResult:
        wanted = {p.name: p.value for p in changed}
        row = [wanted.get(name, node.get_parameter(name).value) for name in NAMES]
        try:
            check_for_filter(np.array(row, dtype=np.float64))
        except (InputError, TypeError, ValueError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(on_set)


def driver_of(node: PacedNode) -> Array:
    """The driver (P,) whom the parameters of a node describe now."""
    return np.array([node.get_parameter(name).value for name in NAMES])


def declare_model(node: PacedNode) -> ModelFile:
    """Declare the parameters ``model`` and ``law``: from which drivers a node starts. Raises InputError.

    Without a model file, a typical driver of the law stands for every vehicle.
    """
    file = node.path("model", "model file (YAML) with drivers and effects")
    law = str(node.option("law", PAPERS, "law by which the drivers drive, without a model file"))
    return drivers_of(file, law)


@dataclass(frozen=True)
class OnlineSettings:
    """What is learnt online of a driver: preferences, in the state of the filter, and parameters of effects.

    of_effects: names such as ``drag.c0``, ``effects`` for all strengths, or ``law``; engine: of ``ENGINES``; goals:
    what drivers may intend, if the model knows it; decision_period_s: time [s] from one decision of a driver to the
    next, if the model knows it.
    """

    adaptation: Adaptation
    of_effects: tuple[str, ...]
    engine: Engine
    goals: KnownGoals | None = None
    decision_period_s: float | None = None

    def filter_of(self, period_s: float, road: Road, row: Array, vehicles: int = CHAIN) -> OnlineFilter:
        """Return the filter of a driver who starts from a row (WIDTH,), with a number of vehicles in its chain.

        period_s: time between two samples [s]; drivers who decide more often have filters with a shorter period.
        A filter that learns values of effects keeps the usual chain: each value costs as much as another filter.
        """
        period_s /= decisions_between(period_s, self.decision_period_s)
        if self.goals is not None:
            return GoalFilter(period_s, road, row, self.goals.rows, self.goals.prior, self.adaptation, vehicles)
        if self.of_effects:
            return EffectFilter(period_s, road, row, self.of_effects, self.adaptation)
        return OnlineFilter(period_s, road, row, adaptation=self.adaptation, vehicles=vehicles, engine=self.engine)


def declare_adapt(node: PacedNode, rows: Array, model: ModelFile) -> OnlineSettings:
    """Declare the parameters ``adapt`` and ``engine``: what is learnt online, and how. Raises InputError.

    rows: (N, WIDTH) of the drivers; of drivers of another law than the paper's, the law's parameters are learnt; model:
    where they come from, with the population and the goals of the drivers, if it knows them.
    """
    usual = list(ADAPT.names) if (rows[:, ROW.law] == ADAPTIVE_SEEK).all() else [OF_LAW]
    given = node.option(
        "adapt",
        usual,
        "parameters that are learnt online: preferences, parameters of effects and laws such as drag.c0 and idm.T,"
        " effects for the strengths of all effects in the model, or law for all parameters of the law",
    )
    names = tuple(dict.fromkeys(name for name in given if name))
    own = tuple(name for name in names if name not in (STRENGTHS, OF_LAW) and "." not in name)
    known = dict(zip(ADAPT.names, ADAPT.prior_std, strict=True))
    if model.population is not None:
        known |= {name: max(std, LEAST_STD) for name, (_, std) in model.population.parameters.items()}
    stds = tuple(known.get(name, _OTHER_STD) for name in own)
    of_effects = tuple(name for name in names if name not in own)
    check_names(of_effects)
    text = (
        "what works out a step of the filter: compiled, or filterpy for the same estimates, slower, by code that is"
        " meant to be read"
    )
    engine = engine_of(str(node.option("engine", ENGINES[0], text)))
    if of_effects and engine != ENGINES[0]:
        raise InputError(f"engine: {engine} learns no parameters of effects; take {of_effects[0]} out of adapt")
    if model.goals is not None and (of_effects or engine != ENGINES[0]):
        wrong = "adapt: takes no parameters of effects" if of_effects else f"engine: takes {ENGINES[0]} only"
        raise InputError(f"{wrong} beside goals; take the goals out of the model file")
    return OnlineSettings(
        Adaptation(own, stds, ADAPT.relaxation_s), of_effects, engine, model.goals, model.conditions.decision_period_s
    )


def engine_of(name: str) -> Engine:
    """Return the engine of a name. Raises InputError for an unknown one."""
    for engine in ENGINES:
        if name == engine:
            return engine
    raise InputError(f"engine: {name!r} is not known; give {' or '.join(ENGINES)}")
