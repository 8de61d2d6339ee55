"""Parameters of nodes that follow a driver: how they are declared, and the model file from which they start."""

from pathlib import Path

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES, PARAMETERS, check_for_filter, population
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.driver_types import DriverTypes
from sugiyama_ros.fit.model_file import read_model
from sugiyama_ros.nodes.arrivals import WINDOW_S


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
        declare_float(
            node,
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


def declare_float(node: Node, name: str, default: float, about: ParameterDescriptor) -> float:
    """Declare a parameter that is a number, within a range.

    Raises
    ------
    InputError
        If the node was started with something else, or with a number out of range.
    """
    try:
        return float(node.declare_parameter(name, default, about).value)
    except InvalidParameterTypeException:
        raise InputError(f"parameter {name}: what was given is not a number; give one such as {default:g}") from None
    except InvalidParameterValueException:
        bounds = about.floating_point_range[0]
        raise InputError(
            f"parameter {name}: out of bounds; give {bounds.from_value:g} to {bounds.to_value:g}"
        ) from None


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
