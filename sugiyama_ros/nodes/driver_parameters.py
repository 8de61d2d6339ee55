"""Parameters of nodes that follow a driver: how they are declared, and the model file from which they start."""

from pathlib import Path

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES, PARAMETERS, check_for_filter, population
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.driver_types import DriverTypes
from sugiyama_ros.fit.model_file import read_model


def check_driver(node: Node) -> None:
    """Refuse parameters of a driver with which a filter cannot run, now and whenever they are set.

    Raises
    ------
    InputError
        For a value that the node was started with.
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

    Parameters
    ----------
    node : Node
        The node that gets the parameters.
    default : array (P,) or longer
        Default values, in the order of ``PARAMETERS`` [SI].
    """
    for p, value in zip(PARAMETERS, default[: len(PARAMETERS)].tolist(), strict=True):
        node.declare_parameter(
            p.name,
            value,
            ParameterDescriptor(
                description=f"{p.symbol} [{p.unit}] {p.description}",
                floating_point_range=[FloatingPointRange(from_value=p.lower, to_value=p.upper)],
            ),
        )


def declare_model(node: Node, vehicle: int) -> tuple[Array, DriverTypes | None]:
    """Declare the parameter ``model``, and read the model file if one is given.

    Returns
    -------
    row : array (WIDTH,)
        The driver's row; without a model file, the population's values.
    types : DriverTypes or None
        Types of drivers, if the model file has any.
    """
    file = declare_path(node, "model", "model file (YAML) with drivers and effects")
    if file is None:
        return ROW.with_effects(population()), None
    model = read_model(file)
    return model.rows_of(np.array([vehicle]))[0], model.types


def declare_path(node: Node, name: str, description: str) -> Path | None:
    """Declare a parameter that names a file or a directory; None if it is empty."""
    about = ParameterDescriptor(description=description, read_only=True)
    given = str(node.declare_parameter(name, "", about).value)
    return Path(given) if given else None
