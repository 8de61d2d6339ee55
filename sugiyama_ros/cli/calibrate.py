"""``sugiyama calibrate``."""

import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sugiyama_ros.cli.options import (
    PAPERS,
    Json,
    Law,
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
from sugiyama_ros.cli.output import print_json, print_line, print_note, print_table, print_warnings, progress
from sugiyama_ros.errors import InputError

if TYPE_CHECKING:
    from sugiyama_ros.calibration.result import Calibration
    from sugiyama_ros.trajectories.trajectories import Trajectories


@dataclass(frozen=True)
class CalibrateOptions:
    """Arguments and options of the command."""

    sources: Sources
    formulation: Annotated[
        str,
        typer.Option("--formulation", help="paper: perceived states are smoothed. causal: they are filtered."),
    ] = "causal"
    parameters: Annotated[
        str,
        typer.Option(
            "--parameters",
            help="Parameters to estimate, separated by commas. Default: sigma_nu,sigma_a,v_star,kappa_v, and"
            " sigma_x,sigma_v where the positions are smooth.",
        ),
    ] = ""
    effects: Annotated[
        str,
        typer.Option(
            "--effects", help="Effects to fit with the parameters, separated by commas. Causal formulation only."
        ),
    ] = ""
    regularise: Annotated[
        bool,
        typer.Option(
            "--regularise", help="causal: the drivers are draws from one population. paper: add the paper's penalty."
        ),
    ] = False
    profile: Annotated[
        bool,
        typer.Option(
            "--profile", help="Compute intervals from the profile likelihood, which takes longer. Not with --effects."
        ),
    ] = False
    law: Law = PAPERS
    classes: Annotated[
        int,
        typer.Option(
            "--classes", min=0, help="Number of classes of drivers who share all parameters, for short recordings."
        ),
    ] = 0
    seed: Seed = 0
    scheduler: Scheduler = None
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Model file (YAML) to write.")] = None
    overwrite: Overwrite = False
    ring: Ring = None
    wide: Wide = False
    as_json: Json = False

    @property
    def is_pooled(self) -> bool:
        """Whether all drivers are calibrated together, as one population."""
        return bool(names(self.effects)) or self.law != PAPERS or (self.regularise and self.formulation == "causal")

    @property
    def needs_one_lane(self) -> bool:
        """Whether an option works on a single lane only, on which everybody is present."""
        alone = self.formulation == "paper" or self.is_pooled or self.regularise
        return alone or bool(self.classes) or self.output is not None

    def check(self) -> None:
        """Raise InputError for options that contradict each other."""
        if self.formulation not in ("paper", "causal"):
            raise InputError(f"--formulation {self.formulation}: give paper or causal")
        for name, given in (("--effects", bool(names(self.effects))), ("--law", self.law != PAPERS)):
            if given and self.formulation == "paper":
                raise InputError(f"{name}: the paper's formulation is the paper's driver; use --formulation causal")
        if self.law != PAPERS and names(self.parameters):
            raise InputError("--parameters: with --law, all parameters of the law are estimated; leave it out")
        if self.is_pooled and self.profile:
            raise InputError(
                "--profile: is for drivers calibrated one by one; leave out --effects, --law and --regularise"
            )
        if self.classes and (self.is_pooled or self.profile or self.regularise):
            raise InputError(
                "--classes: the drivers of a class share all parameters; leave out --effects, --law, --regularise"
                " and --profile"
            )


@takes(CalibrateOptions)
def calibrate(options: CalibrateOptions) -> None:
    """Estimate the parameters of each driver.

    The estimates are maximum-likelihood estimates, with their uncertainty.
    """
    options.check()
    output = model_output(options.output, options.overwrite, options.sources)
    from sugiyama_ros.formats.registry import format_of, read_trajectories
    from sugiyama_ros.laws.registry import law
    from sugiyama_ros.workers import workers

    law(options.law)
    source, *others = options.sources
    if others and options.needs_one_lane:
        raise InputError(
            f"{others[0]}: -o, --effects, --law and other options need one lane that all drivers share; give one file"
        )
    if others or (not options.needs_one_lane and format_of(source).is_of_tracks):
        _calibrate_tracks(options)
        return
    trajectories = read_trajectories(source, options.ring)
    print_warnings(trajectories)
    began = time.monotonic()
    with progress("calibrating") as advance, workers(len(trajectories.vehicle), options.scheduler) as work:
        found = _calibrated(options, trajectories, work, advance)
    wall_s = time.monotonic() - began
    if output is not None:
        found.write(output)
    doubts = _cautions(found)
    if options.as_json:
        print_json(found.document(wall_s))
    else:
        _print(found, options.output, options.wide)
    for line in doubts:
        print_note(f"caution: {line}")


def _calibrate_tracks(options: CalibrateOptions) -> None:
    """Estimate the parameters of drivers on tracks."""
    from sugiyama_ros.calibration.on_tracks import calibrate_tracks
    from sugiyama_ros.formats.choices import Choices
    from sugiyama_ros.formats.folder import read_files
    from sugiyama_ros.formats.registry import read_tracks
    from sugiyama_ros.workers import workers

    choices, sources = Choices(ring_m=options.ring), options.sources
    tracks = read_tracks(sources[0], choices) if len(sources) == 1 else read_files(sources, choices)
    print_warnings(tracks)
    began = time.monotonic()
    with progress("calibrating") as advance, workers(tracks.runs, options.scheduler) as work:
        found = calibrate_tracks(
            tracks, names(options.parameters), profiled=options.profile, work=work, on_progress=advance
        )
    if options.as_json:
        print_json(found.document(time.monotonic() - began))
        return
    print_table(found.table(), wide=options.wide)
    print_line(found.headline())


def _calibrated(
    options: CalibrateOptions,
    trajectories: "Trajectories",
    work: Executor,
    advance: Callable[[int, int], None],
) -> "Calibration":
    """Drivers calibrated together, in classes, or one by one."""
    from sugiyama_ros.calibration.calibrate import each_driver, in_classes, pooled
    from sugiyama_ros.calibration.result import Settings
    from sugiyama_ros.fit.smooth_positions import evenness

    settings = Settings(
        formulation="paper" if options.formulation == "paper" else "causal",
        estimated=names(options.parameters) or evenness(trajectories).estimated(options.formulation),
        is_regularised=options.regularise,
        profiled=options.profile,
        seed=options.seed,
        law=options.law,
    )
    if options.is_pooled:
        return pooled(trajectories, settings, names(options.effects), work)
    if options.classes:
        return in_classes(trajectories, settings, options.classes, work)
    return each_driver(trajectories, settings, work=work, on_progress=advance)


def _cautions(found: "Calibration") -> list[str]:
    """What makes the figures doubtful. The paper's formulation needs no causal filter, which takes long to load."""
    if found.settings.formulation == "paper":
        return []
    from sugiyama_ros.calibration.soundness import cautions

    return cautions(found)


def _print(found: "Calibration", output: Path | None, wide: bool) -> None:
    for line in found.class_sentences():
        print_line(line)
    print_table(found.table(), wide=wide)
    for line in found.shared_sentences():
        print_line(line)
    if output is not None:
        print_line(f"model file: {output}")
