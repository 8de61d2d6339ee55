"""``sugiyama diagnose`` and ``sugiyama compare``."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from sugiyama_ros.cli.options import Json, ModelFile, Overwrite, Ring, Seed, Source, model_output, names, takes
from sugiyama_ros.cli.output import print_json, print_line, print_note, print_table
from sugiyama_ros.errors import InputError
from sugiyama_ros.progress import stages


@dataclass(frozen=True)
class DiagnoseOptions:
    """Arguments and options of the command."""

    source: Source
    add: Annotated[
        str | None, typer.Option("--add", help="auto: add effects until the data support no further one.")
    ] = None
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Model file (YAML) to write, with the effects that were added."),
    ] = None
    quick: Annotated[
        bool, typer.Option("--quick", help="Simulate fewer recordings: faster, with rougher p-values.")
    ] = False
    purpose: Annotated[
        str, typer.Option("--for", help="prediction, simulation or online: what an addition must not make worse.")
    ] = "prediction"
    overwrite: Overwrite = False
    ring: Ring = None
    seed: Seed = 0
    as_json: Json = False


@takes(DiagnoseOptions)
def diagnose(given: DiagnoseOptions) -> None:
    """Find out what the model lacks.

    The diagnosis says where the model fails, which effect explains the failure, and how certain that is.
    """
    if given.add not in (None, "auto"):
        raise InputError(f"--add {given.add}: is not known; give auto")
    to_write = model_output(given.output, given.overwrite, given.source)
    from sugiyama_ros.diagnosis import tables
    from sugiyama_ros.diagnosis.diagnosis import diagnose as find
    from sugiyama_ros.diagnosis.use import purpose_of
    from sugiyama_ros.diagnosis.verdict import document, sentences
    from sugiyama_ros.fit.model_file import write_model
    from sugiyama_ros.formats.registry import read_trajectories

    purpose = purpose_of(given.purpose)
    trajectories = read_trajectories(given.source, given.ring)
    with stages() as advance:
        found = find(
            trajectories,
            seed=given.seed,
            quick=given.quick,
            most=8 if given.add else 3,
            workers=os.cpu_count() or 1,
            purpose=purpose,
            on_progress=advance,
        )
    if to_write is not None:
        write_model(to_write, found.data, found.final)
    if given.as_json:
        print_json(document(found))
        return
    for line in sentences(found):
        print_line(line)
    print_table(tables.steps(found))
    print_table(tables.by_driver(document(found)["drivers"]))
    runs = f"{found.bootstrap_runs} simulated recordings" + (" (quick)" if given.quick else "")
    print_note(f"p-values from {runs}; {found.wall_s:.0f} s")


def compare(
    source: Source,
    effects: Annotated[str, typer.Option("--effects", help="Effects to add to the model, separated by commas.")] = "",
    model: ModelFile = None,
    ring: Ring = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Compare the model with measurements and with other models.

    The comparison uses samples that no fit has seen.
    """
    from sugiyama_ros.diagnosis import tables
    from sugiyama_ros.diagnosis.compare import compare as compare_models
    from sugiyama_ros.diagnosis.comparison_document import document
    from sugiyama_ros.fit.model_file import read_model
    from sugiyama_ros.formats.registry import read_trajectories

    given = read_model(model) if model is not None else None
    trajectories = read_trajectories(source, ring)
    with stages() as advance:
        compared = compare_models(
            trajectories, names(effects), given, seed=seed, workers=os.cpu_count() or 1, on_progress=advance
        )
    if as_json:
        print_json(document(compared))
        return
    print_table(tables.held_out_errors(compared.models))
    print_table(tables.details(compared.models))
    print_table(tables.collective(compared.measured, compared.models))
    print_line(f"white innovations have an autocorrelation within ± {compared.models[0].band:.3f}")
