"""``sugiyama run`` and ``sugiyama live``."""

import dataclasses
import gc
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sugiyama_ros.cli.options import Json, ModelFile, Rate, Recording, Ring, Source, rate_of, takes
from sugiyama_ros.cli.output import print_json, print_line, print_note, print_table, progress
from sugiyama_ros.errors import InputError
from sugiyama_ros.tables import TextTable

if TYPE_CHECKING:
    from sugiyama_ros.nodes.run import RunResult


@dataclass(frozen=True)
class RunOptions:
    """Arguments and options of ``sugiyama run``."""

    source: Source
    output: Recording
    rate: Rate = "max"
    processes: Annotated[bool, typer.Option("--processes", help="Run each node in a process of its own.")] = False
    ring: Ring = None
    model: ModelFile = None
    critic: Annotated[bool, typer.Option("--critic", help="Start a critic, which publishes /verdict.")] = False
    save_state: Annotated[
        Path | None, typer.Option("--save-state", help="Directory to save what the estimators learn of each driver.")
    ] = None
    resume: Annotated[
        Path | None,
        typer.Option("--resume", help="Directory of an earlier --save-state; the estimators continue from it."),
    ] = None
    array: Annotated[
        bool,
        typer.Option("--array", help="Publish all drivers in one message, /drivers, instead of on topics of each."),
    ] = False
    as_json: Json = False


@takes(RunOptions)
def run(options: RunOptions) -> None:
    """Replay trajectories as ROS topics, and estimate the drivers.

    Each driver has an estimator of their own. All topics are recorded.
    """
    print_run(replay(options), options.as_json)


def replay(options: RunOptions) -> "RunResult":
    """Replay and record, with a progress bar."""
    rate = rate_of(options.rate)
    gc.disable()  # no module is garbage, and to look for garbage among them takes a tenth of a second
    try:
        from sugiyama_ros.nodes.run import run as run_nodes
    except ModuleNotFoundError as error:
        if error.name not in ("rclpy", "sugiyama_msgs"):
            raise
        raise InputError(f"{error.name}: not installed; run `make demo` once, or source a ROS 2 workspace") from None
    finally:
        gc.freeze()
        gc.enable()
    with progress("replaying") as advance:
        return run_nodes(
            options.source,
            options.output,
            rate=rate,
            processes=options.processes,
            ring_m=options.ring,
            model=options.model,
            critic=options.critic,
            save_state=options.save_state,
            resume=options.resume,
            array=options.array,
            on_progress=advance,
        )


def print_run(result: "RunResult", as_json: bool) -> None:
    """Print what the estimators know at the end of a run."""
    if as_json:
        print_json(dataclasses.asdict(result))
        return
    headings = ("vehicle", "v* [m/s]", "kappa_v [s]", "one-step RMSE [m]", "mean NIS")
    rows = tuple(
        (str(d.vehicle), f"{d.v_star:.2f}", f"{d.kappa_v:.3f}", f"{d.one_step_rmse_m:.3f}", f"{d.nis_mean:.2f}")
        for d in result.drivers
    )
    print_table(TextTable("What the estimators know at the end", headings, rows))
    print_line(
        f"{result.steps} steps of {result.vehicles} vehicles at {result.real_time_factor:.0f} times real time;"
        f" {result.messages_recorded} messages recorded, {result.messages_lost} lost."
    )
    print_line(f"All topics are in {result.output} (sugiyama info {result.output}).")
    if result.interrupted:
        print_note("The run was interrupted: the recording ends early, but it can be read.")


def live(
    source: Annotated[
        Path | None,
        typer.Argument(help="Trajectories to replay. Without them, the page shows the nodes that are running."),
    ] = None,
    output: Recording = Path("sugiyama-live.mcap"),
    rate: Rate = "1",
    ring: Ring = None,
    model: ModelFile = None,
    host: Annotated[
        str,
        typer.Option("--host", help="Address to listen on. If other machines can reach it, the page asks for a token."),
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", min=1024, max=65535, help="Port to listen on.")] = 5006,
    show: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
) -> None:
    """Serve a web page that shows the topics as they arrive.

    Ctrl-C ends it.
    """
    from sugiyama_ros.nodes.live import serve

    def ready(url: str) -> None:
        print_note(f"live page: {url} (Ctrl-C ends it)")
        if show:
            typer.launch(url)

    print_note("starting the nodes")
    serve(source, output, rate=rate_of(rate), ring_m=ring, model=model, host=host, port=port, on_ready=ready)
