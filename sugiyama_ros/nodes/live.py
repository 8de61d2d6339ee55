"""The server of the live page, and the nodes that run beside it."""

import contextlib
import logging
import socket
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from bokeh.server.server import Server
from tornado.ioloop import IOLoop, PeriodicCallback
from tornado.web import ErrorHandler

from sugiyama_ros.errors import SugiyamaError
from sugiyama_ros.nodes.base import environment
from sugiyama_ros.nodes.base.spin import Spinner, ros
from sugiyama_ros.nodes.plan import Plan, RunSettings, UseOfModel, plan_of
from sugiyama_ros.nodes.replay import TrackSamples
from sugiyama_ros.nodes.run import RunNodes
from sugiyama_ros.nodes.view import View
from sugiyama_ros.page.guard import Guard, log_quietly
from sugiyama_ros.page.live import page

# Address that only this machine reaches.
_LOCAL = "127.0.0.1"
# Bytes that a browser may send at a time, and in the head of a request.
_LARGEST_MESSAGE, _LARGEST_HEADER = 1 << 20, 1 << 14
# Samples of drivers, in a second of a recording with vehicles that come and go, that a critic beside the page can take.
_CRITIC_AT_MOST = 200.0
# Samples that may be under way: few, so that neither pictures nor buttons have to wait for many.
_WINDOW = 4
# Time [s] for which the nodes run at a stretch, and from one stretch to the next.
_STRETCH_S, _EVERY_S = 0.01, 0.015


def serve(
    source: Path | None,
    output: Path,
    settings: RunSettings,
    *,
    host: str = _LOCAL,
    port: int = 5006,
    on_ready: Callable[[str, UseOfModel | None], None] = lambda url, use_of_model: None,
) -> None:
    """Show the live page until a signal comes.

    on_ready: is called with the address of the page, and with how the drivers start from a model file.

    Raises InputError, OutputError, SugiyamaError.
    """
    if source is not None:
        environment.isolate()
    plan = _plan(source, output, settings) if source is not None else None
    with ros() as asked_to_stop, contextlib.ExitStack() as stack:
        view = View(settings.rate) if plan is None else View(settings.rate, str(output), plan.vehicles_with_topics)
        stack.callback(view.destroy_node)
        server, url = _server(view, host, port)
        runner = RunNodes(plan, _WINDOW) if plan is not None else None
        if runner is not None:
            stack.callback(runner.close)
        spinner = Spinner([*(runner.all if runner is not None else ()), view])
        stack.callback(spinner.close)
        if runner is not None:
            stack.callback(runner.stop, spinner)
        failures: list[Exception] = []
        turns = _turns(spinner, runner, asked_to_stop, failures)
        server.start()
        stack.callback(server.stop)
        turns.start()
        stack.callback(turns.stop)
        on_ready(url, None if plan is None else plan.use_of_model)
        IOLoop.current().start()
        for failure in failures:
            raise failure


def _plan(source: Path, output: Path, settings: RunSettings) -> Plan:
    """What runs beside the page; without a critic where too many vehicles are in view."""
    plan = plan_of(source, output, settings)
    if isinstance(plan.source, TrackSamples) and plan.source.drivers_per_s > _CRITIC_AT_MOST:
        return replace(plan, settings=replace(settings, critic=False))
    return plan


def _turns(
    spinner: Spinner, runner: RunNodes | None, asked_to_stop: Callable[[], bool], failures: list[Exception]
) -> PeriodicCallback:
    """Callback that lets the nodes run between the turns of the server, and stops it after a signal or a failure."""
    loop = IOLoop.current()

    def stretch() -> None:
        try:
            spinner.until(lambda: False, _STRETCH_S)
            if runner is not None:
                runner.check()
        except Exception as failure:  # the loop would log it, and go on for ever
            failures.append(failure)
        if failures or asked_to_stop():
            loop.stop()

    return PeriodicCallback(stretch, 1000 * _EVERY_S)


def _server(view: View, host: str, port: int) -> tuple[Server, str]:
    """The server, which is already listening, and the address of the page."""
    names = {host, "localhost"} if host == _LOCAL else {host, "localhost", socket.gethostname(), socket.getfqdn()}
    guard = Guard(names, port, open_to_others=host != _LOCAL)
    shown = {_LOCAL: "localhost", "0.0.0.0": socket.gethostname()}.get(host, host)
    url = f"http://{shown}:{port}" + (f"/?token={guard.token}" if guard.token else "")
    log_quietly()
    # Bokeh would check the origin of a web socket by a list of names; the guard compares it with the host.
    # A browser that closes the page is nothing to warn of.
    for name in ("bokeh.server.util", "bokeh.server.views.ws"):
        logging.getLogger(name).setLevel(logging.ERROR)
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
    # Bokeh would look for a file of such a name, which Python refuses
    server._tornado.add_handlers(".*", [(".*%00.*", ErrorHandler, {"status_code": 404})])
    return server, url
