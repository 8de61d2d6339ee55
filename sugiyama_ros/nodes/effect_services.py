"""What the services ``~/add_effect`` and ``~/remove_effect`` do in nodes that follow drivers, and how to call them."""

import time
from collections.abc import Callable, Iterable

from rclpy.client import Client
from rclpy.node import Node
from sugiyama_msgs.srv import AddEffect, RemoveEffect

from sugiyama_ros.arrays import Array
from sugiyama_ros.effects.registry import ROW, active, switched_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.nodes.base import incoming

# Time [s] in which services that are there answer, all together.
_READY_S, _LOOK_S = 1.0, 0.01


def clients_of(node: Node, kind: type, services: Iterable[str]) -> tuple[list[Client], list[str]]:
    """Make clients of services that nodes of the graph offer; nothing waits for a service that nobody offers.

    Returns clients: clients that are ready; who has called destroys them; missing: services that nobody offers.
    """
    offered = {name for name, _ in node.get_service_names_and_types()}
    wanted = list(services)
    waiting = [node.create_client(kind, name) for name in wanted if name in offered]
    ready: list[Client] = []
    end = time.monotonic() + _READY_S
    while waiting:
        ready += [client for client in waiting if client.service_is_ready()]
        waiting = [client for client in waiting if client not in ready]
        if time.monotonic() > end:
            break
        if waiting:
            time.sleep(_LOOK_S)
    for client in waiting:
        node.destroy_client(client)
    found = {client.srv_name for client in ready}
    return ready, [name for name in wanted if name not in found]


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
