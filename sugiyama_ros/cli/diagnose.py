"""``sugiyama diagnose`` and ``sugiyama compare``."""

import shlex
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
    bag_for,
    command_line,
    model_output,
    names,
    takes,
)
from sugiyama_ros.cli.output import print_json, print_line, print_note, print_table, print_warnings, to_json
from sugiyama_ros.errors import InputError
from sugiyama_ros.outputs import Output
from sugiyama_ros.progress import stages

if TYPE_CHECKING:
    from sugiyama_ros.diagnosis.compare import Comparison
    from sugiyama_ros.diagnosis.diagnosis import Diagnosis
    from sugiyama_ros.fit import model_file


@dataclass(frozen=True)
class DiagnoseOptions:
    """Arguments and options of ``sugiyama diagnose``."""

    sources: Sources
    add: Annotated[
        str | None,
        typer.Option(
            "--add",
            help="By default, up to three effects that the data support are added. auto: as many as the data support,"
            " up to eight, and a force without a name. Or names, separated by commas: these are added whatever the data"
            " say of them. They are effects, their forms, response_constants and other groups of constants, or"
            " discovered_force:COVARIATE.",
        ),
    ] = None
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Model file (YAML) to write, with the effects that were added."),
    ] = None
    save: Annotated[
        Path | None,
        typer.Option("--save", help="Document (JSON) to write, for `sugiyama report --diagnosis`: all that was found."),
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
    to_save = _document_output(options)
    from sugiyama_ros.diagnosis.diagnosis import diagnose as find
    from sugiyama_ros.diagnosis.use import FEW_ADDITIONS, MANY_ADDITIONS, Goal, purpose_of
    from sugiyama_ros.diagnosis.verdict import document
    from sugiyama_ros.fit.model_file import write_model
    from sugiyama_ros.formats.registry import read_recordings
    from sugiyama_ros.outputs import writing
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
        write_model(to_write, found.data, found.final, found.cautions())
    everything = {
        **document(found),
        "command": _command(options),
        "model_file": options.output,
        "file": options.save,
        **_given(options),
    }
    if to_save is not None:
        with writing(to_save) as stream:
            stream.write(to_json(everything).encode())
    if options.as_json:
        print_json(everything)
        return
    _print_found(found, options)
    _print_next(found, options)
    runs = f"from up to {found.bootstrap_runs} simulated recordings" if found.bootstrap_runs else "without simulations"
    print_note(f"p-values {runs}{' (quick)' if found.quick else ''}; {found.wall_s:.0f} s")


def _document_output(options: DiagnoseOptions) -> Output | None:
    """The document to write, if one is wanted. Raises InputError for a name that is not JSON, or OutputError."""
    if options.save is None:
        return None
    if options.save.suffix != ".json":
        raise InputError(f"{options.save}: is not the name of a document; give a name that ends in .json")
    output = Output(options.save, options.overwrite, tuple(options.sources))
    output.check()
    return output


def _chosen(add: str | None) -> tuple[str, ...] | None:
    """The names to add, none of them for auto, or None. Raises InputError for an empty list or an unknown name."""
    if add is None or add == "auto":
        return None if add is None else ()
    if not names(add):
        raise InputError("--add: has no name; give auto, or names of effects (sugiyama effects lists them)")
    if "auto" in names(add):
        raise InputError(f"--add {add}: give auto alone, or names without it")
    from sugiyama_ros.diagnosis.asked import check_names

    check_names(names(add))
    return names(add)


def _print_found(found: "Diagnosis", options: DiagnoseOptions) -> None:
    """Print the verdict, and the tables that it rests on."""
    from sugiyama_ros.diagnosis import tables
    from sugiyama_ros.diagnosis.verdict import document, sentences

    for line in sentences(found):
        print_line(line)
    if found.named and options.add is None:
        print_line("Without --add, up to three effects are added; --add auto goes on as long as the data support more.")
    print_table(tables.steps(found), wide=options.wide)
    if found.named:
        print_table(tables.by_driver(document(found)["drivers"]), wide=options.wide)


def _command(options: DiagnoseOptions, **changed: object) -> str:
    """The command with these options, of which some are changed."""
    return command_line("diagnose", DiagnoseOptions, **{**vars(options), **changed})


def _given(options: DiagnoseOptions) -> dict[str, object]:
    """What a page needs to say how to run the same data."""
    return {"sources": [str(one) for one in options.sources], "ring_m": options.ring}


def _print_next(found: "Diagnosis", options: DiagnoseOptions) -> None:
    """Say what to do next, as commands that can be pasted."""
    from sugiyama_ros.cli.run import RunOptions

    sources, ring, model = options.sources, options.ring, options.output

    def run() -> str:
        return command_line("run", RunOptions, source=sources[0], ring=ring, model=model, output=bag)

    bag = bag_for(sources[0])
    if model is not None:
        compared = command_line("compare", CompareOptions, sources=sources, model=model, ring=ring, seed=options.seed)
        print_line(f"model file: {model} (compare it: {compared})")
        if options.save is None and len(sources) == 1:
            print_line(f"use it: {run()}")
    forces = [force.can_be_added for force in found.discovered if force.can_be_added]
    if forces and not any(one.name == "discovered_force" for one in found.named):
        asked = ",".join((*(one.form for one in found.named), forces[0]))
        anew = {"output": model and model.with_stem(f"{model.stem}_force"), "save": None}
        print_line(f"to add a force that is left: {_command(options, add=asked, **anew)}")
    if options.save is not None and len(sources) == 1:
        page = shlex.join(["sugiyama", "report", str(bag), "--diagnosis", str(options.save), "--open"])
        print_line(f"look at it: {run()} && {page}")
    elif options.save is None:
        wanted = model or ("model.yaml" if found.named else None)
        kept = "the model and the page" if wanted and model is None else "the page"
        again = _command(options, output=wanted, save="diagnosis.json", overwrite=model is not None)
        print_line(f"to keep what {kept} need: {again}")


@dataclass(frozen=True)
class CompareOptions:
    """Arguments and options of ``sugiyama compare``."""

    sources: Sources
    effects: Annotated[str, typer.Option("--effects", help="Effects to add to the model, separated by commas.")] = ""
    model: ModelFile = None
    show_all: Annotated[
        bool, typer.Option("--all", help="Print all models and all errors, and what the whole road does.")
    ] = False
    ring: Ring = None
    seed: Seed = 0
    scheduler: Scheduler = None
    wide: Wide = False
    as_json: Json = False


@takes(CompareOptions)
def compare(options: CompareOptions) -> None:
    """Compare the model with measurements and with other models.

    The comparison uses samples that no fit has seen. It says which model predicts best, and by how much.
    """
    from sugiyama_ros.diagnosis.compare import compare as compare_models
    from sugiyama_ros.diagnosis.comparison_document import document
    from sugiyama_ros.fit.model_file import read_model
    from sugiyama_ros.formats.registry import read_recordings
    from sugiyama_ros.workers import helpers

    given = read_model(options.model) if options.model is not None else None
    recording = read_recordings(options.sources, options.ring)
    print_warnings(recording)
    with stages() as advance, helpers(options.scheduler) as workers:
        compared = compare_models(
            recording, names(options.effects), given, seed=options.seed, workers=workers, on_progress=advance
        )
    if options.as_json:
        print_json(document(compared))
        return
    _print_compared(compared, options, given)


def _print_compared(compared: "Comparison", options: CompareOptions, given: "model_file.ModelFile | None") -> None:
    """Print which model predicts best, and the errors; ``given``: what the model file holds."""
    from sugiyama_ros.diagnosis import tables
    from sugiyama_ros.fit.recording import told_of

    def again(**changed: object) -> str:
        return command_line("compare", CompareOptions, **{**vars(options), **changed})

    print_line(compared.headline())
    if compared.left_out:
        print_line(told_of(compared.left_out, compared.vicinity.drivers))
    if any(one.kind == "in_sample" for one in compared.models):
        anew = given.effects_to_fit() if given is not None else ()
        fit = f"; fitted anew without what is predicted: {again(effects=','.join(anew), model=None)}" if anew else ""
        print_line(f"{options.model} was fitted to this recording, so its errors are in sample{fit}")
    elif given is not None:
        drivers = compared.vicinity.numbers
        same = sum(number in given.vehicle for number in drivers)
        median = "" if same == len(drivers) else " and the others those of its median driver"
        print_line(
            f"{options.model} is taken as it is, while all other models are fitted to this recording: {same} of"
            f" {len(drivers)} drivers have the parameters of the vehicle with their number{median}"
        )
    if not options.show_all:
        print_table(tables.main_errors(compared), wide=options.wide)
        print_line(f"all {len(compared.models)} models, and further errors: {again(show_all=True)}")
        return
    print_table(tables.held_out_errors(compared.models), wide=options.wide)
    print_table(tables.details(compared.models), wide=options.wide)
    if compared.measured is not None:
        print_table(tables.collective(compared.measured, compared.wave_speed_se, compared.models), wide=options.wide)
        print_line(
            "±: measured, the standard error over blocks of time; simulated, the standard deviation over simulations"
        )
    print_line(
        f"{compared.models[-1].name}: the base model on a recording that it simulates itself, with other samples than"
        " yours; it shows the errors that the model's own noise makes"
    )
    print_line(f"white innovations have an autocorrelation within ± {compared.models[0].band:.3f}")
