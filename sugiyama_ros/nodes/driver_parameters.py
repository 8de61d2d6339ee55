"""Parameters of nodes that follow a driver: how they are declared, and the model file from which they start."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES, PARAMETERS, check_for_filter
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.chain import CHAIN, Adaptation
from sugiyama_ros.filters.effect_filter import OF_LAW, STRENGTHS, EffectFilter, check_names
from sugiyama_ros.filters.online import ADAPT, OnlineFilter
from sugiyama_ros.fit.model_file import ModelFile, read_model, typical_driver
from sugiyama_ros.laws.registry import ADAPTIVE_SEEK, PAPERS
from sugiyama_ros.nodes.arrivals import WINDOW_S
from sugiyama_ros.road import Road

Engine = Literal["compiled", "filterpy"]
#: What works out a step of an `OnlineFilter`; the first one, unless another one is asked for.
ENGINES: tuple[Engine, ...] = ("compiled", "filterpy")
#: Prior std of the logarithm of a preference for which none was measured: a factor of two up or down.
OTHER_STD = 0.7


def check_driver(node: Node) -> None:
    """Refuse parameters of a driver with which a filter cannot run, now and whenever they are set.

    Raises InputError.
    """
    check_for_filter(np.array([node.get_parameter(name).value for name in NAMES]))

    def on_set(changed: list[RosParameter]) -> SetParametersResult:
        wanted = {p.name: p.value for p in changed}
        row = [wanted.get(name, node.get_parameter(name).value) for name in NAMES]
        try:
            check_for_filter(np.array(row, dtype=np.float64))
        except (InputError, TypeError, ValueError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(on_set)


def declare_driver(node: Node, default: Array) -> None:
    """Declare the parameters of a driver, with their descriptions and ranges.

    default: (P,), default values, in the order of ``PARAMETERS`` [SI].
    """
    for p, value in zip(PARAMETERS, default[: len(PARAMETERS)].tolist(), strict=True):
        declare_float(
            node,
            p.name,
            value,
            ParameterDescriptor(
                description=f"{p.symbol} [{p.unit}] {p.description}",
                floating_point_range=[FloatingPointRange(from_value=p.lower, to_value=p.upper)],
            ),
        )


def declare_model(node: Node) -> ModelFile:
    """Declare the parameters ``model`` and ``law``: from which drivers a node starts. Raises InputError.

    Without a model file, a typical driver of the law stands for every vehicle.
    """
    file = declare_path(node, "model", "model file (YAML) with drivers and effects")
    about = ParameterDescriptor(description="law by which the drivers drive, without a model file", read_only=True)
    law = str(node.declare_parameter("law", PAPERS, about).value)
    if file is None:
        return typical_driver(law)
    if law != PAPERS:
        raise InputError(f"law: the model file {file} says by which law its drivers drive; leave out law or model")
    return read_model(file)


@dataclass(frozen=True)
class Adapted:
    """What is learnt online of a driver: preferences, in the state of the filter, and parameters of effects.

    adaptation: of preferences; of_effects: names such as ``drag.c0``, ``effects`` for all strengths, or ``law``;
    engine: of ``ENGINES``, what works out a step.
    """

    adaptation: Adaptation
    of_effects: tuple[str, ...]
    engine: Engine = "compiled"

    def filter_of(self, period_s: float, road: Road, row: Array, vehicles: int = CHAIN) -> OnlineFilter:
        """Return the filter of a driver who starts from a row (WIDTH,), with a number of vehicles in its chain.

        A filter that learns values of effects keeps the usual chain: each value costs as much as another filter.
        """
        if self.of_effects:
            return EffectFilter(period_s, road, row, self.of_effects, self.adaptation)
        return OnlineFilter(period_s, road, row, adaptation=self.adaptation, vehicles=vehicles, engine=self.engine)


def declare_adapt(node: Node, rows: Array) -> Adapted:
    """Declare the parameters ``adapt`` and ``engine``: what is learnt online, and how. Raises InputError.

    rows: (N, WIDTH) of the drivers; of drivers of another law than the paper's, the law's parameters are learnt.
    """
    about = ParameterDescriptor(
        description="parameters that are learnt online: preferences, parameters of effects and laws such as drag.c0 and"
        " idm.T, effects for the strengths of all effects in the model, or law for all parameters of the law",
        read_only=True,
    )
    usual = list(ADAPT.names) if (rows[:, ROW.law] == ADAPTIVE_SEEK).all() else [OF_LAW]
    given = node.declare_parameter("adapt", usual, about).value
    names = tuple(dict.fromkeys(name for name in given if name))
    own = tuple(name for name in names if name not in (STRENGTHS, OF_LAW) and "." not in name)
    known = dict(zip(ADAPT.names, ADAPT.prior_std, strict=True))
    stds = tuple(known.get(name, OTHER_STD) for name in own)
    of_effects = tuple(name for name in names if name not in own)
    check_names(of_effects)
    engine = _declare_engine(node)
    if of_effects and engine != ENGINES[0]:
        raise InputError(f"engine: {engine} learns no parameters of effects; take {of_effects[0]} out of adapt")
    return Adapted(Adaptation(own, stds, ADAPT.relaxation_s), of_effects, engine)


def _declare_engine(node: Node) -> Engine:
    """Declare the parameter ``engine``. Raises InputError for an unknown one."""
    about = ParameterDescriptor(
        description="what works out a step of the filter: compiled, or filterpy for the same estimates, slower, by code"
        " that is meant to be read",
        read_only=True,
    )
    return engine_of(str(node.declare_parameter("engine", ENGINES[0], about).value))


def engine_of(name: str) -> Engine:
    """Return the engine of a name. Raises InputError for an unknown one."""
    for engine in ENGINES:
        if name == engine:
            return engine
    raise InputError(f"engine: {name!r} is not known; give {' or '.join(ENGINES)}")


def declare_float(node: Node, name: str, default: float, about: ParameterDescriptor) -> float:
    """Declare a parameter that is a number, within a range. Raises InputError."""
    return float(node.declare_parameter(name, default, about).value)


def declare_window(node: Node) -> float:
    """Declare the parameter ``reorder_window``: time [s] by which a sample may be late and still be sorted in."""
    about = ParameterDescriptor(
        description="time [s] by which a sample may be late and still be sorted in; later ones are dropped",
        floating_point_range=[FloatingPointRange(from_value=0.0, to_value=1.0)],
        read_only=True,
    )
    return declare_float(node, "reorder_window", WINDOW_S, about)


def declare_path(node: Node, name: str, description: str) -> Path | None:
    """Declare a parameter that names a file or a directory; None if it is empty."""
    about = ParameterDescriptor(description=description, read_only=True)
    given = str(node.declare_parameter(name, "", about).value)
    return Path(given) if given else None
