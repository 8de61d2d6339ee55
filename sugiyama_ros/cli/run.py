"""``sugiyama run`` and ``sugiyama live``."""

import dataclasses
import gc
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sugiyama_ros.cli.options import (
    AddEffect,
    Json,
    Law,
    ModelFile,
    Overwrite,
    Rate,
    Ring,
    SetParameter,
    command_line,
    own_output,
    rate_of,
    takes,
)
from sugiyama_ros.cli.output import (
    print_against,
    print_cautions,
    print_json,
    print_line,
    print_note,
    print_table,
    show_page,
)
from sugiyama_ros.cli.report import report
from sugiyama_ros.errors import InputError
from sugiyama_ros.laws import PAPERS
from sugiyama_ros.nodes.executables import ros_needed
from sugiyama_ros.progress import stage
from sugiyama_ros.results import TextTable

if TYPE_CHECKING:
    from sugiyama_ros.nodes.plan import FromSimulator, UseOfModel
    from sugiyama_ros.nodes.run import RunResult

#: Exit code of a program that Ctrl-C has ended.
INTERRUPTED = 130
_VAGUE = "not identified"
_LIVE = "sugiyama-live.mcap"


@dataclass(frozen=True)
class RunOptions:
    """Arguments and options of ``sugiyama run``."""

    output: Annotated[Path, typer.Option("--output", "-o", help="MCAP file to write.")]
    source: Annotated[
        Path | None, typer.Argument(help="Trajectories: a file in any known format. With --simulate, none.")
    ] = None
    overwrite: Overwrite = False
    rate: Rate = "max"
    simulate: Annotated[
        bool, typer.Option("--simulate", help="Simulate drivers, and compare the estimates with the truth.")
    ] = False
    vehicles: Annotated[int | None, typer.Option(min=1, max=1000, help="With --simulate: number of vehicles.")] = None
    duration: Annotated[float | None, typer.Option(min=1.0, help="With --simulate: duration [s].")] = None
    spread: Annotated[
        float | None,
        typer.Option(min=0.0, max=1.0, help="With --simulate: relative std of v_star and kappa_v over the drivers."),
    ] = None
    seed: Annotated[int | None, typer.Option(min=0, help="With --simulate: seed of the random numbers.")] = None
    parameter: SetParameter = None
    effect: AddEffect = None
    ring: Ring = None
    model: ModelFile = None
    law: Law = PAPERS
    critic: Annotated[
        bool, typer.Option("--critic", help="Start the critic, which publishes on /verdict what the model lacks.")
    ] = False
    save_state: Annotated[
        Path | None, typer.Option("--save-state", help="Directory to save what the estimators learn of each driver.")
    ] = None
    resume: Annotated[
        Path | None,
        typer.Option("--resume", help="Directory of an earlier --save-state; the estimators continue from it."),
    ] = None
    array: Annotated[
        bool,
        typer.Option("--array", help="Publish all drivers in one message on /drivers, not on topics of each driver."),
    ] = False
    engine: Annotated[
        str,
        typer.Option(help="Code of the filters: compiled, or filterpy (slower and easy to read, the same numbers)."),
    ] = "compiled"
    as_json: Json = False


@takes(RunOptions)
def run(options: RunOptions) -> None:
    """Replay or simulate drivers as ROS topics, and estimate them.

    Each driver has a filter of their own. All topics are recorded.
    """
    try:
        result = replay(options)
    except KeyboardInterrupt:
        print_note("interrupted before the first sample; nothing was recorded")
        raise
    _print_run(result, options)


def replay(options: RunOptions) -> "RunResult":
    """Replay and record, with a progress bar."""
    rate = rate_of(options.rate)
    gc.disable()  # no module is garbage, and to look for garbage among them takes a tenth of a second
    try:
        with ros_needed():
            from sugiyama_ros.nodes.base import environment
            from sugiyama_ros.nodes.run import run as run_nodes
    finally:
        gc.freeze()
        gc.enable()
    source = _source(options)
    print_cautions(options.model)
    domain = environment.isolate()
    doing = "simulating" if options.simulate else "replaying"
    with stage(f"{doing} in ROS domain {domain}") as advance:
        return run_nodes(
            source,
            options.output,
            rate=rate,
            ring_m=options.ring,
            model=options.model,
            law=options.law,
            critic=options.critic,
            save_state=options.save_state,
            resume=options.resume,
            array=options.array,
            engine=options.engine,
            overwrite=options.overwrite,
            on_progress=advance,
        )


def _source(options: RunOptions) -> "Path | FromSimulator":
    """The file to replay, or the drivers to simulate. Raises InputError where the options do not say which."""
    from sugiyama_ros.driver.parameters import read_parameters
    from sugiyama_ros.nodes.plan import FromSimulator
    from sugiyama_ros.simulation.experiment import Experiment

    asked = {
        "--vehicles": options.vehicles,
        "--duration": options.duration,
        "--spread": options.spread,
        "--seed": options.seed,
        "--set": options.parameter,
        "--effect": options.effect,
    }
    if not options.simulate:
        if options.source is None:
            raise InputError("run: no file given; give trajectories, or --simulate")
        for name, value in asked.items():
            if value is not None:
                raise InputError(
                    f"{name}: is for simulated drivers; give --simulate in place of a file, or leave it out"
                )
        return options.source
    if options.source is not None:
        raise InputError(f"{options.source}: simulated drivers need no file; leave it out, or leave out --simulate")
    given = {"ring_m": options.ring, "duration_s": options.duration, "spread": options.spread, "seed": options.seed}
    experiment = Experiment(**{name: value for name, value in given.items() if value is not None})  # type: ignore[arg-type]
    vehicles = options.vehicles if options.vehicles is not None else 22
    experiment.check(vehicles)
    changes = read_parameters(options.parameter or (), "--set")
    return FromSimulator(vehicles, experiment, changes=changes, effects=tuple(options.effect or ()))


def _print_run(result: "RunResult", options: RunOptions) -> None:
    """Print what the estimators know at the end of a run."""
    from sugiyama_ros.effects.registry import ROW
    from sugiyama_ros.page.truth import against_truth
    from sugiyama_ros.page.words import start_of_drivers

    try:
        against = against_truth(result.output)
    except InputError as error:  # another program has sent junk, which is in the recording too
        against = None
        print_note(f"no comparison with the truth: {error}")
    if options.as_json:
        truth = {} if against is None else {"truth": dataclasses.asdict(against)}
        print_json({**dataclasses.asdict(result), **truth})
        _end(result)
        return
    names = sorted({name for d in result.drivers for name in d.law}, key=ROW.entries.index) or ["v_star", "kappa_v"]
    known = [{"v_star": d.v_star, "kappa_v": d.kappa_v, **d.law} for d in result.drivers]
    rows = tuple(
        (
            str(d.vehicle) if d.name == str(d.vehicle) else f"{d.vehicle} ({d.name})",
            *(f"{values[name]:.3g}" if name in values and name in d.identified else _VAGUE for name in names),
            f"{d.one_step_rmse_m:.3f}",
            f"{d.nis_mean:.2f}",
        )
        for d, values in zip(result.drivers, known, strict=True)
    )
    headings = ("vehicle", *map(ROW.heading, names), "one-step RMSE [m]", "mean NIS")
    print_table(TextTable("What the estimators know at the end", headings, (*rows, *_mean(result, len(names)))))
    if against is not None:
        print_against(against)
    if (use := result.use_of_model) is not None:
        print_line(start_of_drivers(str(options.model), use.is_own, use.left_out))
    print_line(
        f"{result.steps} steps of {result.vehicles} vehicles at {result.real_time_factor:.0f} times real time;"
        f" {result.messages_recorded} messages recorded, {result.messages_lost} lost."
    )
    print_line(f"All topics are in {result.output} (sugiyama info {result.output}).")
    anew = {"overwrite": True} if result.output.with_suffix(".html").exists() else {}
    page = command_line("report", report, source=result.output, show=True, **anew)
    print_line(f"look at it: {page}; with --diagnosis FILE, the page shows what diagnose --save FILE has found")
    if result.interrupted:
        print_note("The run was interrupted: the recording ends early, but it can be read.")
    _end(result)


def _mean(result: "RunResult", parameters: int) -> list[tuple[str, ...]]:
    """The last row: the mean over the drivers who follow somebody; none for a single one."""
    known = [d for d in result.drivers if math.isfinite(d.one_step_rmse_m)]
    drivers = [d for d in known if d.follows] or known
    if len(drivers) < 2:
        return []
    error, nis = (sum(getattr(d, name) for d in drivers) / len(drivers) for name in ("one_step_rmse_m", "nis_mean"))
    return [(f"mean of {len(drivers)}", *[""] * parameters, f"{error:.3f}", f"{nis:.2f}")]


def _end(result: "RunResult") -> None:
    """End the program with the exit code of Ctrl-C if the run was interrupted."""
    if result.interrupted:
        raise typer.Exit(INTERRUPTED)


@dataclass(frozen=True)
class _LiveOptions:
    """Arguments and options of ``sugiyama live``."""

    source: Annotated[
        Path | None,
        typer.Argument(help="Trajectories to replay. Without them, the page shows the nodes that are running."),
    ] = None
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help=f"MCAP file to write. By default {_LIVE}, which each replay replaces."),
    ] = None
    overwrite: Overwrite = False
    rate: Rate = "1"
    ring: Ring = None
    model: ModelFile = None
    law: Law = PAPERS
    host: Annotated[
        str,
        typer.Option("--host", help="Address to listen on. If other machines can reach it, the page asks for a token."),
    ] = "127.0.0.1"
    port: Annotated[int, typer.Option("--port", min=1024, max=65535, help="Port to listen on.")] = 5006
    show: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False


@takes(_LiveOptions)
def live(options: _LiveOptions) -> None:
    """Serve a web page that shows the topics as they arrive.

    Ctrl-C ends it.
    """
    with ros_needed():
        from sugiyama_ros.nodes.base import environment
        from sugiyama_ros.nodes.live import serve
        from sugiyama_ros.nodes.plan import RunSettings
    from sugiyama_ros.laws.registry import law
    from sugiyama_ros.page.words import start_of_drivers

    def ready(url: str, use: "UseOfModel | None") -> None:
        if use is not None:
            print_note(start_of_drivers(str(options.model), use.is_own, use.left_out))
        print_note(f"live page: {url} (Ctrl-C ends it)")
        if options.show:
            show_page(url)

    if not options.host.strip():
        raise InputError("--host: is empty; leave it out for this machine alone, or give an address such as 0.0.0.0")
    law(options.law)
    print_cautions(options.model)
    output = own_output(options.output, _LIVE, options.overwrite)
    settings = RunSettings(
        rate_of(options.rate), options.ring, options.model, options.law, critic=True, overwrite=output.overwrite
    )
    domain = environment.isolate() if options.source is not None else environment.domain()
    print_note(f"{'starting the nodes' if options.source is not None else 'listening'} in ROS domain {domain}")
    before = _time_of(output.path)
    serve(options.source, output.path, settings, host=options.host, port=options.port, on_ready=ready)
    if options.source is None:
        return
    if _time_of(output.path) == before:
        print_note("nothing was recorded: the page ended before the first sample")
    else:
        print_note(f"all topics are in {output.path}; look at it: sugiyama report {output.path} --open")


def _time_of(path: Path) -> int | None:
    """When a file was written [ns]; None if it is not there."""
    return path.stat().st_mtime_ns if path.exists() else None
