"""The node behind the live page, and the server that shows the page."""

import contextlib
import logging
import math
import socket
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bokeh.server.server import Server
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from std_srvs.srv import Trigger
from sugiyama_msgs.msg import Innovation, MeasuredPositions, VehicleState, Verdict
from sugiyama_msgs.msg import Road as RoadMessage
from sugiyama_msgs.srv import AddEffect, RemoveEffect
from tornado.ioloop import IOLoop, PeriodicCallback

from sugiyama_ros.effects.effect import RecordingExtent
from sugiyama_ros.effects.registry import EFFECTS, effect
from sugiyama_ros.errors import SugiyamaError
from sugiyama_ros.formats.truth import namespaces
from sugiyama_ros.nodes.base import cdr_messages, environment, incoming
from sugiyama_ros.nodes.base.qos import LATCHED, STREAM
from sugiyama_ros.nodes.base.spin import Spinner, ros
from sugiyama_ros.nodes.plan import REPLAY, Plan, RunSettings, estimators
from sugiyama_ros.nodes.runners import OneProcess
from sugiyama_ros.page.guard import Guard, log_quietly
from sugiyama_ros.page.live import KEPT, Log, page
from sugiyama_ros.page.panels.base import MOVING_S
from sugiyama_ros.road import Road

#: Address that only this machine reaches.
LOCAL = "127.0.0.1"
# Bytes that a browser may send at a time, and in the head of a request.
_LARGEST_MESSAGE, _LARGEST_HEADER = 1 << 20, 1 << 14
# Time [s] for which the nodes run at a stretch, and from one stretch to the next.
_STRETCH_S, _EVERY_S = 0.01, 0.015


class View(Node):
    """Subscribes to everything that the page shows, and calls the services behind its buttons."""

    def __init__(self, rate: float) -> None:
        super().__init__("view", start_parameter_services=False)
        self.rate = rate
        self.road = Road()
        self.space, self.error = Log(0), Log(KEPT)
        self.driver: Mapping[int, Log] = {}
        self.vehicles: Sequence[int] = ()
        self.weights: Mapping[str, float] = {}
        self._now: dict[int, tuple[float, float]] = {}
        self.now: Mapping[int, tuple[float, float]] = self._now
        self.added: Sequence[str] = ()
        self.said = ""
        self._duration_s = 1.0
        self.effects: Sequence[str] = [
            name for name, e in EFFECTS.items() if e.function is not None and e.starts(self._recording())
        ]
        self._strength: dict[str, float] = {}
        self._speed: dict[int, float] = {}
        self._std: dict[int, float] = {}
        self._squares: deque[tuple[float, float, int]] = deque(maxlen=10_000)
        self._sum, self._scored = 0.0, 0
        self._latest_s = -math.inf
        self._listen(RoadMessage, "/road", incoming.road, self._on_road, LATCHED)
        self._listen(MeasuredPositions, "/measured", incoming.sample, self._on_measured)
        self._listen(Verdict, "/verdict", incoming.verdict, self._on_verdict)

    def _listen(
        self, kind: type, topic: str, decode: Callable[[bytes], Any], take: Callable[[Any], None], qos: Any = STREAM
    ) -> None:
        """Subscribe to a topic. A message that is not valid is left out; the nodes of the road tell of it."""
        self.create_subscription(kind, topic, incoming.receiver(decode, take, lambda reason: None), qos, raw=True)

    def pause(self, paused: bool) -> None:
        """Call the replay's ~/pause or ~/resume."""
        self._call(Trigger, f"{REPLAY}/{'pause' if paused else 'resume'}", Trigger.Request())

    def set_rate(self, rate: float) -> None:
        """Set the replay's parameter ``rate``."""
        value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=rate)
        request = SetParameters.Request(parameters=[Parameter(name="rate", value=value)])
        self._call(SetParameters, f"{REPLAY}/set_parameters", request)
        self.rate = rate

    def add(self, name: str) -> None:
        """Call every estimator's ~/add_effect, with the critic's strength or else the value where a search begins."""
        if not self.vehicles:
            return
        values = dict(effect(name).starts(self._recording())[0])
        first = effect(name).parameters[0].name
        if first in values and self._strength.get(name):
            values[first] = self._strength[name]
        request = AddEffect.Request(effect=name, name=list(values), value=[float(v) for v in values.values()])
        for estimator in estimators(namespaces(self.vehicles)):
            self._call(AddEffect, f"{estimator}/add_effect", request)
        self.added = tuple(dict.fromkeys([*self.added, name]))

    def remove(self, name: str) -> None:
        """Call every estimator's ~/remove_effect."""
        for estimator in estimators(namespaces(self.vehicles)):
            self._call(RemoveEffect, f"{estimator}/remove_effect", RemoveEffect.Request(effect=name))
        self.added = tuple(one for one in self.added if one != name)

    def _recording(self) -> RecordingExtent:
        return RecordingExtent(0.0, self._duration_s, self.road.circumference_m, 0.0, self.road.circumference_m)

    def _call(self, kind: type, service: str, request: Any) -> None:
        client = self.create_client(kind, service)
        if not client.service_is_ready() and not client.wait_for_service(0.5):
            self.said = f"{service} does not answer"
            self.destroy_client(client)
            return

        def done(future: Any) -> None:
            answer = future.result() if future.exception() is None else None
            self.said = getattr(answer, "message", "") if answer is not None else f"{service} has failed"
            self.destroy_client(client)

        client.call_async(request).add_done_callback(done)

    def _on_road(self, road: RoadMessage) -> None:
        self.road, self._duration_s = Road(float(road.circumference_m)), float(road.period_s * road.steps)

    def _on_measured(self, sample: cdr_messages.Sample) -> None:
        if self.vehicles:
            return
        vehicles = sorted(sample.place)
        for v, space in zip(vehicles, namespaces(vehicles), strict=True):
            self._speed[v] = self._std[v] = math.nan
            self._listen(VehicleState, f"{space}/state", incoming.state, self._on_state)
            self._listen(Innovation, f"{space}/innovation", incoming.innovation, self._on_innovation)
        self.space, self.driver = Log(KEPT * len(vehicles)), {v: Log(KEPT) for v in vehicles}
        self.vehicles = vehicles

    def _on_state(self, state: tuple[float, int, float, float, float]) -> None:
        time_s, v, position, speed, variance = state
        if v not in self.driver:
            return
        self._speed[v], self._std[v] = speed, math.sqrt(max(variance, 0.0))
        self._now[v] = (position, speed)
        self.space.add(time_s, position, speed)

    def _on_innovation(self, found: cdr_messages.ReadInnovation) -> None:
        time_s, v, innovation, variance, _, scored = found
        if v not in self.driver:
            return
        if time_s != self._latest_s:
            if time_s < self._latest_s - 1.0:
                self._squares.clear()
            else:
                self._sum_up()
            self._latest_s, self._sum, self._scored = time_s, 0.0, 0
        if scored:
            self._sum += innovation**2
            self._scored += 1
        self.driver[v].add(time_s, self._speed[v], self._std[v], innovation, math.sqrt(max(variance, 0.0)))

    def _sum_up(self) -> None:
        """Log the error up to the last sample, which is complete when a newer sample comes."""
        self._squares.append((self._latest_s, self._sum, self._scored))
        while self._squares[0][0] < self._latest_s - MOVING_S:
            self._squares.popleft()
        if scored := sum(n for _, _, n in self._squares):
            self.error.add(self._latest_s, math.sqrt(sum(total for _, total, _ in self._squares) / scored))

    def _on_verdict(self, message: Verdict) -> None:
        self.weights = dict(zip(message.model, message.weight, strict=True))
        self._strength = dict(zip(message.model, message.strength, strict=True))


def serve(
    source: Path | None,
    output: Path,
    settings: RunSettings,
    *,
    host: str = LOCAL,
    port: int = 5006,
    on_ready: Callable[[str], None] = lambda url: None,
) -> None:
    """Show the live page until a signal comes.

    Parameters
    ----------
    source : Path or None
        File of trajectories to replay; None shows the graph that runs already.
    output : Path
        MCAP file to write during a replay.
    settings : RunSettings
        How the replay goes.
    host, port : str, int
        Address and port on which to listen. Beyond this machine, the page asks for a token.
    on_ready : callable
        Called with the address of the page, which contains the token.

    Raises
    ------
    InputError, OutputError
        For files that cannot be read or written.
    SugiyamaError
        Where the port is taken.
    """
    if source is not None:
        environment.isolate()
    plan = Plan.read(source, output, settings) if source is not None else None
    with ros() as asked_to_stop, contextlib.ExitStack() as stack:
        view = View(settings.rate)
        stack.callback(view.destroy_node)
        server, url = _server(view, host, port)
        runner = OneProcess(plan) if plan is not None else None
        if runner is not None:
            stack.callback(runner.close)
        spinner = Spinner([*(runner.nodes if runner is not None else ()), view])
        stack.callback(spinner.close)
        if runner is not None:
            stack.callback(runner.stop, spinner)
        turns = _turns(spinner, runner, asked_to_stop)
        server.start()
        stack.callback(server.stop)
        turns.start()
        stack.callback(turns.stop)
        on_ready(url)
        IOLoop.current().start()


def _turns(spinner: Spinner, runner: OneProcess | None, asked_to_stop: Callable[[], bool]) -> PeriodicCallback:
    """Callback that lets the nodes run between the turns of the server, and stops the server after a signal."""
    loop = IOLoop.current()

    def stretch() -> None:
        spinner.until(lambda: False, _STRETCH_S)
        if runner is not None:
            runner.check()
        if asked_to_stop():
            loop.stop()

    return PeriodicCallback(stretch, 1000 * _EVERY_S)


def _server(view: View, host: str, port: int) -> tuple[Server, str]:
    """The server, which is already listening, and the address of the page."""
    names = {host, "localhost"} if host == LOCAL else {host, "localhost", socket.gethostname(), socket.getfqdn()}
    guard = Guard(names, port, open_to_others=host != LOCAL)
    shown = {LOCAL: "localhost", "0.0.0.0": socket.gethostname()}.get(host, host)
    url = f"http://{shown}:{port}" + (f"/?token={guard.token}" if guard.token else "")
    log_quietly()
    # Bokeh would check the origin of a web socket by a list of names; the guard compares it with the host.
    logging.getLogger("bokeh.server.util").setLevel(logging.ERROR)
    try:
        server = Server(
            {"/": page(view)},
            address=host,
            port=port,
            auth_provider=guard,
            allow_websocket_origin=["*"],
            websocket_max_message_size=_LARGEST_MESSAGE,
            http_server_kwargs={"max_body_size": _LARGEST_MESSAGE, "max_header_size": _LARGEST_HEADER},
        )
    except OSError as error:
        raise SugiyamaError(f"{host}, port {port}: {error.strerror}; choose others with --host and --port") from None
    return server, url
