"""``sugiyama diagnose`` and ``sugiyama compare``."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sugiyama_ros.cli.options import (
    Json,
    ModelFile,
    Overwrite,
    Ring,
    Scheduler,
    Seed,
    Sources,
    Wide,
    model_output,
    names,
    takes,
)
from sugiyama_ros.cli.output import print_json, print_line, print_note, print_table, print_warnings
from sugiyama_ros.errors import InputError
from sugiyama_ros.progress import stages

if TYPE_CHECKING:
    from sugiyama_ros.diagnosis.diagnosis import Diagnosis


@dataclass(frozen=True)
class DiagnoseOptions:
    """Arguments and options of ``sugiyama diagnose``."""

    sources: Sources
    add: Annotated[
        str | None,
        typer.Option(
            "--add",
            help="auto: add effects until the data support no further one. Or names, separated by commas: add these, if"
            " the data support them.",
        ),
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
    refit: Annotated[
        int | None,
        typer.Option(
            "--refit",
            min=0,
            help="Fit the final model to this many recordings that it simulates, for standard errors that hold; by"
            " default 6, 2 with --quick, and none unless names explain the data.",
        ),
    ] = None
    overwrite: Overwrite = False
    ring: Ring = None
    seed: Seed = 0
    scheduler: Scheduler = None
    wide: Wide = False
    as_json: Json = False


@takes(DiagnoseOptions)
def diagnose(options: DiagnoseOptions) -> None:
    """Find out what the model lacks.

    The diagnosis says where the model fails, which effect explains the failure, and how certain that is.
    """
    chosen = _chosen(options.add)
    to_write = model_output(options.output, options.overwrite, options.sources)
    from sugiyama_ros.diagnosis import tables
    from sugiyama_ros.diagnosis.diagnosis import diagnose as find
    from sugiyama_ros.diagnosis.use import FEW_ADDITIONS, MANY_ADDITIONS, Goal, purpose_of
    from sugiyama_ros.diagnosis.verdict import document, sentences
    from sugiyama_ros.fit.model_file import write_model
    from sugiyama_ros.formats.registry import read_recordings
    from sugiyama_ros.workers import helpers

    most = MANY_ADDITIONS if options.add else FEW_ADDITIONS
    goal = Goal(only=chosen or (), forces=chosen == (), purpose=purpose_of(options.purpose), most=most)
    recording = read_recordings(options.sources, options.ring)
    print_warnings(recording)
    with stages() as advance, helpers(options.scheduler) as workers:
        found = find(
            recording,
            seed=options.seed,
            quick=options.quick,
            goal=goal,
            refit=options.refit,
            workers=workers,
            on_progress=advance,
        )
    if to_write is not None:
        write_model(to_write, found.data, found.final)
    if options.as_json:
        print_json(document(found))
        return
    for line in sentences(found):
        print_line(line)
    print_table(tables.steps(found), wide=options.wide)
    print_table(tables.by_driver(document(found)["drivers"]), wide=options.wide)
    _print_next(found, options.sources, options.output, options.add)
    runs = f"from up to {found.bootstrap_runs} simulated recordings" if found.bootstrap_runs else "without simulations"
    print_note(f"p-values {runs}{' (quick)' if found.quick else ''}; {found.wall_s:.0f} s")


def _chosen(add: str | None) -> tuple[str, ...] | None:
    """The names to add, none of them for auto, or None. Raises InputError for an empty list."""
    if add is None or add == "auto":
        return None if add is None else ()
    if not names(add):
        raise InputError("--add: has no name; give auto, or names of effects (sugiyama effects lists them)")
    return names(add)


def _print_next(found: "Diagnosis", sources: Sequence[Path], output: Path | None, add: str | None) -> None:
    """Say which additions the data do not support, and what to do next."""
    for name in sorted(set(names(add or "")) - {"auto", *(one.name for one in found.named)}):
        print_line(f"{name}: was not added; the data do not support it")
    source = " ".join(map(str, sources))
    if output is not None:
        print_line(f"model file: {output} (compare it: sugiyama compare {source} --model {output})")
    elif found.named and add is None:
        print_line(f"add it: sugiyama diagnose {source} --add auto -o model.yaml")
    if len(sources) == 1:
        print_line(
            f"look at it: sugiyama diagnose {source} --json > diagnosis.json; sugiyama run {source} -o run.mcap;"
            " sugiyama report run.mcap --diagnosis diagnosis.json --open"
        )


def compare(
    sources: Sources,
    effects: Annotated[str, typer.Option("--effects", help="Effects to add to the model, separated by commas.")] = "",
    model: ModelFile = None,
    ring: Ring = None,
    seed: Seed = 0,
    scheduler: Scheduler = None,
    wide: Wide = False,
    as_json: Json = False,
) -> None:
    """Compare the model with measurements and with other models.

    The comparison uses samples that no fit has seen.
    """
    from sugiyama_ros.diagnosis import tables
    from sugiyama_ros.diagnosis.compare import compare as compare_models
    from sugiyama_ros.diagnosis.comparison_document import document
    from sugiyama_ros.fit.model_file import read_model
    from sugiyama_ros.fit.recording import told_of
    from sugiyama_ros.formats.registry import read_recordings
    from sugiyama_ros.workers import helpers

    given = read_model(model) if model is not None else None
    recording = read_recordings(sources, ring)
    print_warnings(recording)
    with stages() as advance, helpers(scheduler) as workers:
        compared = compare_models(recording, names(effects), given, seed=seed, workers=workers, on_progress=advance)
    if as_json:
        print_json(document(compared))
        return
    if compared.left_out:
        print_line(told_of(compared.left_out, compared.vicinity.drivers))
    print_table(tables.held_out_errors(compared.models), wide=wide)
    print_table(tables.details(compared.models), wide=wide)
    if compared.measured is not None:
        print_table(tables.collective(compared.measured, compared.wave_speed_se, compared.models), wide=wide)
        print_line(
            "±: measured, the standard error over blocks of time; simulated, the standard deviation over simulations"
        )
    print_line(
        "floor: the base model on a recording that it simulates itself; where that recording is harder than yours, a"
        " model may lie below"
    )
    print_line(f"white innovations have an autocorrelation within ± {compared.models[0].band:.3f}")
