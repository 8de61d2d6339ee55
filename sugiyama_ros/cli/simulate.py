"""``sugiyama simulate``."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sugiyama_ros.cli.options import Json, ModelFile, Overwrite, Seed, takes
from sugiyama_ros.cli.output import print_json, print_line, print_note
from sugiyama_ros.errors import InputError
from sugiyama_ros.outputs import Output

if TYPE_CHECKING:
    from sugiyama_ros.arrays import Array
    from sugiyama_ros.simulation.simulator import Simulation


@dataclass(frozen=True)
class SimulateOptions:
    """Options of the command."""

    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .mcap or .csv.")]
    vehicles: Annotated[int, typer.Option(min=1, help="Number of vehicles.")] = 22
    ring: Annotated[float, typer.Option(min=0.0, help="Circumference of the ring [m]; 0 for an open road.")] = 230.0
    duration: Annotated[float, typer.Option(min=1.0, help="Duration of the simulation [s].")] = 250.0
    gap: Annotated[
        float, typer.Option(help="Gap between the vehicles at the start [m]. All vehicles start from rest.")
    ] = 2.0
    period: Annotated[float, typer.Option(min=0.01, max=2.0, help="Time between two samples [s].")] = 1.0 / 3.0
    horizon: Annotated[
        int | None,
        typer.Option(min=1, max=100, help="Number of periods that a driver looks ahead. By default as in the paper."),
    ] = None
    spread: Annotated[
        float,
        typer.Option(min=0.0, max=1.0, help="Relative standard deviation of v_star and kappa_v over the drivers."),
    ] = 0.0
    parameter: Annotated[
        list[str] | None, typer.Option("--set", help="NAME=VALUE: parameter of all drivers. May be repeated.")
    ] = None
    effect: Annotated[
        list[str] | None,
        typer.Option("--effect", help="NAME:PARAMETER=VALUE[,...]: effect on all drivers. May be repeated."),
    ] = None
    model: ModelFile = None
    overwrite: Overwrite = False
    seed: Seed = 0
    as_json: Json = False


@takes(SimulateOptions)
def simulate(options: SimulateOptions) -> None:
    """Simulate drivers on a ring or an open road.

    The file has the positions that a camera would measure.
    """
    from sugiyama_ros.formats.convert import write_trajectories
    from sugiyama_ros.formats.plain_csv import write_csv

    output = options.output
    writers: dict[str, Callable[[Any, Output], object]] = {".mcap": write_trajectories, ".csv": write_csv}
    if output.suffix not in writers:
        raise InputError(f"{output}: cannot be written as {output.suffix or 'nothing'}; give a .mcap or .csv name")
    to_write = Output(output, options.overwrite, (options.model,) if options.model is not None else ())
    to_write.check()
    simulated = _simulated(options)
    writers[output.suffix](simulated.measured, to_write)
    speed = simulated.speed[len(simulated.speed) // 2 :]
    second_half = {"v_avg": speed.mean(), "v_min": speed.min(axis=1).mean(), "v_max": speed.max(axis=1).mean()}
    document = {
        "output": str(output),
        "vehicles": options.vehicles,
        "steps": len(simulated.speed),
        "duration_s": simulated.measured.duration_s,
        "second_half": second_half,
        "collisions": [dataclasses.asdict(c) for c in simulated.collisions],
        "seed": options.seed,
    }
    if options.as_json:
        print_json(document)
        return
    print_line(f"{options.vehicles} vehicles, {simulated.measured.duration_s:.1f} s, in {output}")
    shown = ", ".join(f"{name} {value:.2f}" for name, value in second_half.items())
    print_line(f"second half: {shown} m/s")
    for c in simulated.collisions:
        print_note(f"collision: vehicle {c.vehicle} into {c.leader} at {c.time_s:.1f} s; the run ends there")


def _simulated(options: SimulateOptions) -> "Simulation":
    """Simulate from rest."""
    from sugiyama_ros.simulation.experiment import Experiment, carry_out

    experiment = Experiment(
        ring_m=options.ring,
        duration_s=options.duration,
        gap_m=options.gap,
        period_s=options.period,
        horizon=options.horizon,
        spread=options.spread,
        seed=options.seed,
    )
    experiment.check(options.vehicles)
    return carry_out(experiment, _rows(options))


def _rows(options: SimulateOptions) -> "Array":
    """Parameters (N, WIDTH) of the drivers: the paper's or a model file's, changed by --set and --effect."""
    import numpy as np

    from sugiyama_ros.driver.parameters import defaults, index
    from sugiyama_ros.effects.registry import ROW, switch_on
    from sugiyama_ros.fit.model_file import read_model

    rows = ROW.with_effects(defaults(options.vehicles))
    if options.model is not None:
        rows = read_model(options.model).rows_of(np.arange(options.vehicles))
    for text in options.parameter or ():
        name, _, value = text.partition("=")
        try:
            rows[:, index(name)] = float(value)
        except ValueError:
            raise InputError(f"--set {text}: is not NAME=VALUE with a number as value") from None
    for text in options.effect or ():
        name, _, pairs = text.partition(":")
        try:
            values = {k: float(v) for k, _, v in (pair.partition("=") for pair in pairs.split(","))}
        except ValueError:
            raise InputError(f"--effect {text}: is not NAME:PARAMETER=VALUE[,PARAMETER=VALUE]") from None
        rows = switch_on(rows, name, values)
    return rows
