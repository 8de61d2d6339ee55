"""``sugiyama simulate``."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sugiyama_ros.cli.options import AddEffect, Json, ModelFile, Overwrite, Seed, SetParameter, Start, takes
from sugiyama_ros.cli.output import print_json, print_line, print_note
from sugiyama_ros.errors import InputError
from sugiyama_ros.outputs import Output

if TYPE_CHECKING:
    from sugiyama_ros.arrays import Array
    from sugiyama_ros.simulation.result import Simulation


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
    start: Start = "jam"
    parameter: SetParameter = None
    effect: AddEffect = None
    model: ModelFile = None
    overwrite: Overwrite = False
    seed: Seed = 0
    as_json: Json = False


@takes(SimulateOptions)
def simulate(options: SimulateOptions) -> None:
    """Simulate drivers on a ring or an open road.

    The file has the positions that a camera would measure. An MCAP file also has the truth about each vehicle.
    """
    from sugiyama_ros.formats.plain_csv import write_csv
    from sugiyama_ros.formats.truth import write_simulated

    output = options.output
    if output.suffix not in (".mcap", ".csv"):
        raise InputError(f"{output}: cannot be written as {output.suffix or 'nothing'}; give a .mcap or .csv name")
    to_write = Output(output, options.overwrite, (options.model,) if options.model is not None else ())
    to_write.check()
    simulated = _simulated(options)
    if output.suffix == ".mcap":
        write_simulated(simulated.measured, simulated.truth, to_write)
    else:
        write_csv(simulated.measured, to_write)
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
        start=options.start,
    )
    experiment.check(options.vehicles)
    return carry_out(experiment, _rows(options))


def _rows(options: SimulateOptions) -> "Array":
    """Parameters (N, WIDTH) of the drivers: the paper's or a model file's, changed by --set and --effect."""
    import numpy as np

    from sugiyama_ros.driver.parameters import defaults
    from sugiyama_ros.effects.registry import ROW
    from sugiyama_ros.effects.texts import read_effect, read_parameter
    from sugiyama_ros.fit.model_file import read_model
    from sugiyama_ros.simulation.experiment import changed

    rows = ROW.with_effects(defaults(options.vehicles))
    if options.model is not None:
        rows = read_model(options.model).rows_of(np.arange(options.vehicles))
    for text in options.parameter or ():
        rows = changed(rows, dict([read_parameter(text, "--set")]), {})
    for text in options.effect or ():
        rows = changed(rows, {}, dict([read_effect(text, "--effect")]))
    return rows
