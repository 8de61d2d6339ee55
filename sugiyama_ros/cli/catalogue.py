"""``sugiyama effects``, ``sugiyama laws`` and ``sugiyama controllers``: what there is, from the declarations."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sugiyama_ros.cli.options import Json
from sugiyama_ros.cli.output import print_json, print_line

if TYPE_CHECKING:
    from sugiyama_ros.driver.parameters import Parameter


def effects(
    name: Annotated[str, typer.Argument(help="Name of an effect. Without a name, all effects are listed.")] = "",
    as_json: Json = False,
) -> None:
    """List the physical effects that can be added to the model.

    Each effect has its meaning, and its parameters with their units.
    """
    from sugiyama_ros.effects.registry import EFFECTS, effect

    _show({name: effect(name)} if name else EFFECTS, bool(name), as_json)


def laws(
    name: Annotated[str, typer.Argument(help="Name of a law. Without a name, all laws are listed.")] = "",
    as_json: Json = False,
) -> None:
    """List the car-following laws that the model is compared with.

    Each law has its meaning, and its parameters with their units.
    """
    from sugiyama_ros.laws.registry import LAWS, law

    _show({name: law(name)} if name else LAWS, bool(name), as_json)


def controllers(
    name: Annotated[str, typer.Argument(help="Name of a controller. Without a name, all controllers are listed.")] = "",
    as_json: Json = False,
) -> None:
    """List the controllers that can drive simulated vehicles.

    Each controller has its meaning, and its parameters with their units.
    """
    from sugiyama_ros.controllers.registry import CONTROLLERS, controller

    _show({name: controller(name)} if name else CONTROLLERS, bool(name), as_json)


def _show(found: Mapping[str, Any], in_detail: bool, as_json: bool) -> None:
    if as_json:
        print_json([{"name": name, **_document(one)} for name, one in found.items()])
        return
    for name, one in found.items():
        print_line(one.title if one.title == name else f"{one.title} ({name})")
        print_line(f"    {one.summary}")
        for p in one.parameters:
            unit = f" [{_unit(p)}]" if _unit(p) else ""
            print_line(f"    {p.name}{unit}: {p.description}; {p.lower:g} to {p.upper:g}")
        if in_detail:
            print_line(f"    source: {one.source}")


def _document(one: Any) -> dict[str, Any]:
    return {
        "title": one.title,
        "summary": one.summary,
        "source": one.source,
        "parameters": [
            {"name": p.name, "unit": _unit(p), "meaning": p.description, "lower": p.lower, "upper": p.upper}
            for p in one.parameters
        ],
    }


def _unit(parameter: "Parameter") -> str:
    return "" if parameter.unit == "1" else parameter.unit
