"""``sugiyama simulate``."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sugiyama_ros.cli.options import (
    AddEffect,
    Json,
    Law,
    ModelFile,
    Overwrite,
    Seed,
    SetParameter,
    command_line,
    takes,
    to_write,
)
from sugiyama_ros.cli.output import print_cautions, print_json, print_line, print_note
from sugiyama_ros.errors import InputError
from sugiyama_ros.files import Output
from sugiyama_ros.laws import PAPERS
from sugiyama_ros.progress import stage

if TYPE_CHECKING:
    from sugiyama_ros.arrays import Array
    from sugiyama_ros.controllers.controller import Controlled
    from sugiyama_ros.fit import model_file
    from sugiyama_ros.simulation.experiment import Experiment
    from sugiyama_ros.simulation.idle import Moving


# Number of vehicles, unless a model file or somebody says otherwise.
_VEHICLES = 22


@dataclass(frozen=True)
class _SimulateOptions:
    """Options of the command."""

    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="File to write: .mcap or .csv; for tracks, .parquet or .csv."),
    ]
    vehicles: Annotated[
        int | None,
        typer.Option(min=1, help="Number of vehicles, on each lane. By default those of the model file, or 22."),
    ] = None
    ring: Annotated[
        float | None,
        typer.Option(
            min=0.0, help="Circumference of the ring [m]; 0 for an open road. By default the model file's, or 230."
        ),
    ] = None
    lanes: Annotated[
        int | None, typer.Option(min=1, max=100, help="Simulate an open road with so many lanes, and write tracks.")
    ] = None
    scene: Annotated[
        str | None,
        typer.Option(help="Simulate drivers who meet: roundabout, crossing, signals or merge; writes tracks."),
    ] = None
    view: Annotated[
        str | None,
        typer.Option(help="With --lanes: FROM,TO: part of the road [m] on which vehicles are seen. By default all."),
    ] = None
    duration: Annotated[float, typer.Option(min=1.0, help="Duration of the simulation [s].")] = 250.0
    period: Annotated[
        float | None,
        typer.Option(min=0.05, max=2.0, help="Time between two samples [s]. By default the model file's, or 1/3."),
    ] = None
    spread: Annotated[
        float,
        typer.Option(min=0.0, max=1.0, help="Relative standard deviation of v_star and kappa_v over the drivers."),
    ] = 0.0
    start: Annotated[str, typer.Option(help="Start in a jam, or on a ring with equal gaps: jam or equal.")] = "jam"
    controlled: Annotated[
        str | None, typer.Option(help="Numbers of vehicles that a controller drives, such as 0,7; needs --controller.")
    ] = None
    controller: Annotated[
        str | None,
        typer.Option(help="NAME[:KEY=VALUE[,...]]: what drives the controlled vehicles; see `sugiyama controllers`."),
    ] = None
    law: Law = PAPERS
    parameter: SetParameter = None
    effect: AddEffect = None
    model: ModelFile = None
    overwrite: Overwrite = False
    seed: Seed = 0
    as_json: Json = False


@takes(_SimulateOptions)
def simulate(options: _SimulateOptions) -> None:
    """Simulate drivers on a ring, an open road or a junction.

    The file has the positions that a camera would measure. An MCAP file also has the truth about each vehicle. Vehicle
    0 starts at 0 m, behind all others. The drivers of a model file are the vehicles 0, 1 and so on in the order of the
    file, whoever drove ahead of whom in its recording.
    """
    print_cautions(options.model)
    from sugiyama_ros.controllers.registry import controlled_by
    from sugiyama_ros.fit.model_file import drivers_of
    from sugiyama_ros.simulation.experiment import Experiment

    if options.lanes is None and options.view is not None:
        cure = "add --lanes" if options.scene is None else "give --lanes in place of --scene"
        raise InputError(f"--view: is for lanes; {cure}, or leave it out")
    if options.lanes is not None and options.ring:
        raise InputError("--ring: a ring has one lane; leave out --ring or --lanes")
    if options.lanes is not None and (options.controlled, options.controller) != (None, None):
        raise InputError("--controlled: is for one lane; leave out --controlled and --controller, or --lanes")
    if options.scene is not None:
        _check_scene(options)
    is_tracks = options.lanes is not None or options.scene is not None
    output = to_write(options.output, options.overwrite, ".parquet" if is_tracks else ".mcap", ".csv")
    file = None if options.model is None else drivers_of(options.model, options.law, "--{}".format)
    usual = _VEHICLES if file is None or is_tracks else len(file.vehicle)
    vehicles = (options.vehicles or usual) * (options.lanes or 1)
    of_file = {} if file is None else file.conditions.of_experiment(vehicles)
    given = {"ring_m": 0.0 if is_tracks and not options.ring else options.ring, "period_s": options.period}
    fields: dict[str, Any] = {**of_file, **{name: value for name, value in given.items() if value is not None}}
    experiment = Experiment(
        **fields, duration_s=options.duration, spread=options.spread, seed=options.seed, start=options.start
    )
    experiment.check(vehicles)
    drive = _at_scene if options.scene is not None else _on_one_lane if options.lanes is None else _on_lanes
    controlled = controlled_by(options.controlled, options.controller, "--{}".format)
    rows = _rows(options, file, vehicles, experiment, controlled)
    with stage("simulating"):
        document, lines = drive(options, experiment, rows, controlled, output)
    if options.as_json:
        print_json({"output": str(options.output), "vehicles": vehicles, **document, "seed": options.seed})
        return
    for line in lines:
        print_line(line)
    for c in document.get("collisions", ()):
        ends = "they are taken off the road" if options.scene else "the run ends there"
        print_note(f"collision: vehicle {c['vehicle']} into {c['leader']} at {c['time_s']:.1f} s; {ends}")
    if options.scene and document["collisions"] and document["duration_s"] < options.duration - experiment.period_s:
        print_note(
            f"the run ends at {document['duration_s']:.1f} s, when nobody is left: {document['came_through']} of"
            f" {vehicles} came through; take another --seed, or other drivers"
        )


def _on_one_lane(
    options: _SimulateOptions,
    experiment: "Experiment",
    rows: "Array",
    controlled: "Controlled | None",
    output: Output,
) -> tuple[dict[str, Any], list[str]]:
    """Write a ring or a lane with the truth; returns the document, and what is said."""
    from sugiyama_ros.formats.table import write_csv
    from sugiyama_ros.formats.truth import write_simulated
    from sugiyama_ros.simulation.experiment import carry_out

    simulated = carry_out(experiment, rows, controlled)
    measured, speed = simulated.dense, simulated.speed[len(simulated.speed) // 2 :]
    if output.path.suffix == ".mcap":
        write_simulated(measured, simulated.truth, output)
    else:
        write_csv(measured, output)
    second_half = {"v_avg": speed.mean(), "v_min": speed.min(axis=1).mean(), "v_max": speed.max(axis=1).mean()}
    document = {
        "steps": len(simulated.speed),
        "duration_s": measured.duration_s,
        "second_half": second_half,
        "collisions": [dataclasses.asdict(c) for c in simulated.collisions],
    }
    shown = ", ".join(f"{name} {value:.2f}" for name, value in second_half.items())
    lines = [f"{len(rows)} vehicles, {measured.duration_s:.1f} s, in {options.output}", f"second half: {shown} m/s"]
    if output.path.suffix == ".csv" and measured.road.is_ring:
        # a table says nothing of the road
        from sugiyama_ros.cli.data import info

        lines.append(f"look at it: {command_line('info', info, files=[options.output], ring=experiment.ring_m)}")
    return document, lines


def _on_lanes(
    options: _SimulateOptions, experiment: "Experiment", rows: "Array", _: "Controlled | None", output: Output
) -> tuple[dict[str, Any], list[str]]:
    """Write the tracks of who is in view on an open road with lanes; results as of ``_on_one_lane``."""
    from sugiyama_ros.formats.tracks_parquet import write_tracks
    from sugiyama_ros.simulation.lanes import alike_lanes

    lanes = options.lanes or 1
    tracks = alike_lanes(experiment, rows, lanes, _view(options.view))
    write_tracks(tracks, output)
    seen = f"{len(rows)} vehicles on {lanes} lanes, {tracks.runs} of them seen, {len(tracks)} rows"
    document = {"lanes": lanes, "seen": tracks.runs, "rows": len(tracks)}
    return document, [seen, f"in {options.output} (sugiyama info {options.output})"]


def _check_scene(options: _SimulateOptions) -> None:
    """Refuse options that a scene does not have."""
    for name in ("ring", "lanes"):
        if getattr(options, name):
            raise InputError(f"--{name}: is not for a scene; leave out --{name} or --scene")
    if (options.controlled, options.controller) != (None, None):
        raise InputError("--controlled: is not for a scene; leave out --controlled and --controller, or --scene")
    if options.start != "jam":
        raise InputError("--start: is not for a scene, where drivers come one after the other; leave it out")


def _at_scene(
    options: _SimulateOptions, experiment: "Experiment", rows: "Array", _: "Controlled | None", output: Output
) -> tuple[dict[str, Any], list[str]]:
    """Write the tracks of drivers who meet at a scene; results as of ``_on_one_lane``."""
    from sugiyama_ros.formats.tracks_parquet import write_tracks
    from sugiyama_ros.simulation.scenes import simulate_scene

    run = simulate_scene(
        options.scene or "",
        rows,
        options.seed,
        duration_s=options.duration,
        spread=options.spread,
        period_s=experiment.period_s,
    )
    write_tracks(run.measured, output)
    document = {
        "scene": options.scene,
        "duration_s": float(run.rows.time_s.max()),
        "came_through": int(run.arrived.sum()),
        "longest_stop_s": run.longest_stop_s,
        "rows": len(run.measured),
        "collisions": [dataclasses.asdict(c) for c in run.collisions],
    }
    return document, [run.headline(), f"in {options.output} (sugiyama info {options.output})"]


def _view(text: str | None) -> tuple[float, float]:
    """Part of the road [m] that is seen. Raises InputError."""
    if text is None:
        return -math.inf, math.inf
    try:
        first, last = (float(part) for part in text.split(","))
    except ValueError:
        first, last = math.nan, math.nan
    if not first < last:
        raise InputError(f"--view {text}: is no part of a road; give two positions in metres, such as 100,500")
    return first, last


def _begin(
    options: _SimulateOptions, experiment: "Experiment", controlled: "Controlled | None", rows: "Array"
) -> "Sequence[Moving]":
    """Put drivers with these rows at the start of what the options ask for."""
    from sugiyama_ros.simulation.experiment import set_up
    from sugiyama_ros.simulation.lanes import set_up_lanes
    from sugiyama_ros.simulation.scenes import scene_simulator

    if options.scene is not None:
        return [scene_simulator(options.scene, rows, options.seed, options.spread, experiment.period_s)]
    return set_up_lanes(experiment, rows, options.lanes) if options.lanes else [set_up(experiment, rows, controlled)]


def _rows(
    options: _SimulateOptions,
    file: "model_file.ModelFile | None",
    vehicles: int,
    experiment: "Experiment",
    controlled: "Controlled | None",
) -> "Array":
    """Parameters (N, WIDTH) of N drivers: the paper's or a model file's, changed by --set and --effect."""
    import numpy as np

    from sugiyama_ros.driver.parameters import defaults, read_parameters
    from sugiyama_ros.effects.needs import check_parameter
    from sugiyama_ros.effects.registry import ROW, read_effects
    from sugiyama_ros.fit.model_file import drive_by
    from sugiyama_ros.simulation.experiment import changed
    from sugiyama_ros.simulation.idle import check_acts, check_somebody_drives
    from sugiyama_ros.simulation.scenes import road_of

    road = experiment.road if options.scene is None else road_of(options.scene)
    rows = ROW.with_effects(defaults(vehicles)) if file is None else file.simulated(vehicles)
    if options.law != PAPERS:
        rows = np.array([drive_by(row, options.law) for row in rows])
    if options.spread:
        check_parameter("v_star", rows, "--spread")
    values = read_parameters(options.parameter or (), "--set")
    for name in values:
        check_parameter(name, rows, f"--set {name}")
    effects = read_effects(options.effect or (), "--effect")
    check_somebody_drives(vehicles, () if controlled is None else controlled.vehicles, options.law, options.spread)
    asked = rows, values, effects, road
    check_acts(partial(_begin, options, experiment, controlled), experiment.samples - 1, asked)
    return changed(*asked)
