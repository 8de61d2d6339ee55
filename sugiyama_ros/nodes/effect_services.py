"""What the services ``~/add_effect`` and ``~/remove_effect`` do, in each node that follows drivers."""

from collections.abc import Callable

from sugiyama_msgs.srv import AddEffect, RemoveEffect

from sugiyama_ros.arrays import Array
from sugiyama_ros.effects.registry import ROW, active, switched_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.nodes.base import incoming


def add_effect(
    request: AddEffect.Request, response: AddEffect.Response, effects: Array, take: Callable[[Array], None]
) -> AddEffect.Response:
    """Hand effects (WIDTH,) with the requested one to ``take``, or say why not."""
    try:
        values = incoming.effect_values(request.effect, request.name, request.value)
        take(switched_on(effects, request.effect, values))
        response.success = True
    except (InputError, ValueError) as error:
        response.message = str(error)
    return response


def remove_effect(
    request: RemoveEffect.Request, response: RemoveEffect.Response, effects: Array, take: Callable[[Array], None]
) -> RemoveEffect.Response:
    """Hand effects (WIDTH,) without the requested one to ``take``, or say that the model does not have it."""
    if request.effect in active(effects):
        without = effects.copy()
        without[ROW.places[request.effect]] = 0.0
        take(without)
        response.success = True
    else:
        response.message = str(incoming.RefusedError(f"effect {request.effect!r}: is not in the model"))
    return response
