"""``sugiyama diagnose`` and ``sugiyama compare``."""

import itertools
import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sugiyama_ros.cli.options import (
    Json,
    Law,
    ModelFile,
    Overwrite,
    Ring,
    Scheduler,
    Seed,
    Sources,
    command_line,
    model_to_write,
    names,
    takes,
    to_write,
)
from sugiyama_ros.cli.output import print_json, print_line, print_note, print_table, print_warnings
from sugiyama_ros.errors import InputError
from sugiyama_ros.laws import PAPERS
from sugiyama_ros.progress import OnStage, stages
from sugiyama_ros.results import plain, to_json

if TYPE_CHECKING:
    from sugiyama_ros.diagnosis.rounds import Diagnosis
    from sugiyama_ros.fit import model_file
    from sugiyama_ros.trajectories.tracks import Tracks


@dataclass(frozen=True)
class _DiagnoseOptions:
    """Arguments and options of ``sugiyama diagnose``."""

    sources: Sources
    add: Annotated[
        str | None,
        typer.Option(
            help="auto: add effects for as long as the data ask for more; without --add, in three steps at most. Or"
            " names, separated by commas: add these, whatever the data say. `sugiyama effects` lists them; groups of"
            " constants such as response_constants, and discovered_force:COVARIATE, have names, too.",
        ),
    ] = None
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Model file (YAML) to write, with the effects that were added."),
    ] = None
    save: Annotated[
        Path | None,
        typer.Option(help="Document (JSON) to write with all that was found, for `sugiyama report --diagnosis`."),
    ] = None
    simulations: Annotated[
        int, typer.Option(min=1, max=1000, help="Number of recordings that each model simulates, for the checks.")
    ] = 2
    overwrite: Overwrite = False
    ring: Ring = None
    law: Law = PAPERS
    seed: Seed = 0
    scheduler: Scheduler = None
    as_json: Json = False


@takes(_DiagnoseOptions)
def diagnose(options: _DiagnoseOptions) -> None:
    """Find out what the model lacks.

    The diagnosis says where the model fails, which effect explains the failure, and how certain that is.
    """
    add = _names(options.add, options.law)
    model = model_to_write(options.output, options.overwrite)
    saved = None if options.save is None else to_write(options.save, options.overwrite, ".json")
    from sugiyama_ros.api import FEW_STEPS
    from sugiyama_ros.files import writing
    from sugiyama_ros.fit.model_file import write_model
    from sugiyama_ros.formats.choices import Choices
    from sugiyama_ros.formats.registry import read_tracks
    from sugiyama_ros.laws.registry import law
    from sugiyama_ros.page.document import document
    from sugiyama_ros.page.words import cautions, sentences
    from sugiyama_ros.workers import helpers

    law(options.law)
    recording = read_tracks(options.sources, Choices(ring_m=options.ring))
    print_warnings(recording)
    most = None if options.add else FEW_STEPS
    settings = {"add": add, "most": most, "law": options.law, "seed": options.seed, "simulations": options.simulations}
    with stages() as shown, helpers(options.scheduler) as workers:
        advance = _saying(f"diagnosing {recording.headline()}", shown)
        if isinstance(workers, int):
            found = _found(recording, workers=workers, on_progress=advance, **settings)
        else:
            advance("diagnosing on the cluster", 0, 1)
            found = workers.submit(_found, recording, **settings).result()
    # what a page needs to say how to run the same data
    given = {"sources": [str(source) for source in options.sources], "ring_m": options.ring}
    written = {"model_file": options.output, "file": options.save}
    everything = plain({**document(found), "command": _command(options), **written, **given})
    everything["verdict"]["told"] = sentences(everything)
    if model is not None:
        write_model(model, found.data, found.final.fit, cautions(everything))
    if saved is not None:
        with writing(saved) as stream:
            stream.write(to_json(everything).encode())
    if options.as_json:
        print_json(everything)
        return
    _print_found(everything)
    _print_next(everything, options)
    print_note(f"simulated recordings of each model: {found.simulations}; {found.wall_s:.0f} s")


def _found(recording: "Tracks", **settings: Any) -> "Diagnosis":
    """The diagnosis, on all processors: of this machine, or of a worker of a cluster."""
    from sugiyama_ros.diagnosis.diagnose import diagnose as find

    return find(recording, **{"workers": os.cpu_count() or 1, **settings})


def _names(add: str | None, law: str) -> tuple[str, ...]:
    """The names to add; none for a search. Raises InputError for an empty list or an unknown name."""
    if add is None or add == "auto":
        return ()
    if not names(add):
        raise InputError("--add: has no name; give auto, or names of effects (sugiyama effects lists them)")
    if "auto" in names(add):
        raise InputError(f"--add {add}: give auto alone, or names without it")
    from sugiyama_ros.diagnosis.candidates import check_names

    check_names(names(add), law)
    return names(add)


def _print_found(found: Mapping[str, Any]) -> None:
    """Print the verdict, and the tables that it rests on."""
    from sugiyama_ros.page import tables

    for line in found["verdict"]["told"]:
        print_line(line)
    print_table(tables.steps(found))
    if found["verdict"]["effects"]:
        print_table(tables.by_driver(found))


def _command(options: _DiagnoseOptions, **changed: object) -> str:
    """The command with these options, of which some are changed."""
    return command_line("diagnose", _DiagnoseOptions, **{**vars(options), **changed})


def _bag_for(source: Path) -> Path:
    """A name for the run of a file, here: that of the data, unless there is such a bag or its page already."""
    ends = itertools.chain(("", "_run"), (f"_run_{k}" for k in itertools.count(2)))
    bags = (Path(f"{source.stem or 'run'}{end}.mcap") for end in ends)
    return next(bag for bag in bags if not bag.exists() and not bag.with_suffix(".html").exists())


def _saying(line: str, advance: OnStage) -> OnStage:
    """Progress that says first what is worked on, once a recording is accepted: a refusal is one line."""
    left = [line]

    def said(what: str, done: int, total: int) -> None:
        while left:
            print_note(left.pop())
        advance(what, done, total)

    return said


def _print_next(found: Mapping[str, Any], options: _DiagnoseOptions) -> None:
    """Say what to do next, as commands that can be pasted."""
    from sugiyama_ros.api import FEW_STEPS
    from sugiyama_ros.cli.run import RunOptions

    sources, ring, model = options.sources, options.ring, options.output

    def run() -> str:
        return command_line("run", RunOptions, source=sources[0], ring=ring, model=model, output=bag)

    bag, effects = _bag_for(sources[0]), found["verdict"]["effects"]
    if model is not None:
        other = command_line("compare", _CompareOptions, sources=["OTHER"], model=model, ring=ring, seed=options.seed)
        print_line(f"model file: {model}; whether it holds for another recording: {other}")
        if options.save is None and len(sources) == 1:
            print_line(f"use it: {run()}")
    if options.add is None and len({one["step"] for one in effects}) == FEW_STEPS:
        anew = {"output": model and model.with_stem(f"{model.stem}_all"), "save": None}
        print_line(f"to add more than {FEW_STEPS} steps: {_command(options, add='auto', **anew)}")
    if options.save is not None and len(sources) == 1:
        page = shlex.join(["sugiyama", "report", str(bag), "--diagnosis", str(options.save), "--open"])
        print_line(f"look at it: {run()} && {page}")
    elif options.save is None:
        wanted = model or ("model.yaml" if effects else None)
        kept = "the model and the diagnosis" if wanted and model is None else "the diagnosis"
        again = _command(options, output=wanted, save="diagnosis.json", overwrite=model is not None)
        print_line(f"to keep {kept}: {again}")


@dataclass(frozen=True)
class _CompareOptions:
    """Arguments and options of ``sugiyama compare``."""

    sources: Sources
    effects: Annotated[
        str, typer.Option(help="Effects to add to the model, separated by commas; `sugiyama effects` lists them.")
    ] = ""
    model: ModelFile = None
    show_all: Annotated[bool, typer.Option("--all", help="Print all models, and what the whole road does.")] = False
    ring: Ring = None
    seed: Seed = 0
    scheduler: Scheduler = None
    as_json: Json = False


@takes(_CompareOptions)
def compare(options: _CompareOptions) -> None:
    """Compare the model with measurements and with other models.

    The comparison uses samples that no fit has seen. It says which model forecasts best, and by how much.
    """
    from sugiyama_ros.fit.model_file import read_model
    from sugiyama_ros.formats.choices import Choices
    from sugiyama_ros.formats.registry import read_tracks
    from sugiyama_ros.page.document import comparison_document
    from sugiyama_ros.verdict.compare import compare as compare_models
    from sugiyama_ros.workers import helpers

    given = read_model(options.model) if options.model is not None else None
    recording = read_tracks(options.sources, Choices(ring_m=options.ring))
    print_warnings(recording)
    with stages() as shown, helpers(options.scheduler) as workers:
        advance = _saying(f"comparing models on {recording.headline()}", shown)
        compared = compare_models(
            recording, names(options.effects), given, seed=options.seed, workers=workers, on_progress=advance
        )
    document = plain(comparison_document(compared))
    if options.as_json:
        print_json({"headline": compared.headline(), **document})
        return
    _print_compared(document, options, given)


def _print_compared(found: Mapping[str, Any], options: _CompareOptions, given: "model_file.ModelFile | None") -> None:
    """Print which model forecasts best, and the table; ``given``: what the model file holds."""
    from sugiyama_ros.page import tables
    from sugiyama_ros.page.words import best_model, left_out, use_of_file

    def again(**changed: object) -> str:
        return command_line("compare", _CompareOptions, **{**vars(options), **changed})

    models = found["models"]
    print_line(best_model(found))
    if found["drivers_left_out"]:
        print_line(left_out(found["drivers_left_out"], len(models[0]["drivers"])))
    if any(one["kind"] == "in_sample" for one in models):
        anew = given.effects_to_fit() if given is not None else ()
        fit = f"; fitted anew without what is predicted: {again(effects=','.join(anew), model=None)}" if anew else ""
        print_line(f"{options.model} was fitted to this recording, so its errors are in sample{fit}")
    elif (used := use_of_file(found, str(options.model))) is not None:
        print_line(used)
    print_table(tables.compared(found, show_all=options.show_all))
    if not options.show_all:
        print_line(f"all {len(models)} models, and what the whole road does: {again(show_all=True)}")
        return
    if (road := tables.collective(found)) is not None:
        print_table(road)
        print_line(
            "±: measured, the standard error over blocks of time; simulated, the standard deviation over simulations"
        )
    print_line(
        f"{models[-1]['name']}: the base model on a recording that it simulates itself, with other samples than yours;"
        " it shows the errors that the model's own noise makes"
    )
