"""``sugiyama calibrate``."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sugiyama_ros.cli.options import (
    Json,
    Law,
    Overwrite,
    Ring,
    Scheduler,
    Sources,
    model_to_write,
    names,
    takes,
)
from sugiyama_ros.cli.output import print_json, print_line, print_note, print_table, print_warnings
from sugiyama_ros.laws import PAPERS
from sugiyama_ros.progress import stage

if TYPE_CHECKING:
    from sugiyama_ros.calibration.result import Calibration, Settings


@dataclass(frozen=True)
class _CalibrateOptions:
    """Arguments and options of the command."""

    sources: Sources
    formulation: Annotated[
        str, typer.Option(help="causal: states are filtered, without a look ahead. paper: they are smoothed.")
    ] = "causal"
    parameters: Annotated[
        str,
        typer.Option(
            help="Parameters to estimate, separated by commas. Default: sigma_nu,sigma_a,v_star,kappa_v, and"
            " sigma_x,sigma_v where the positions are smooth.",
        ),
    ] = ""
    effects: Annotated[
        str,
        typer.Option(
            help="Effects to fit with the parameters, separated by commas; `sugiyama effects` lists them. Causal"
            " formulation only."
        ),
    ] = ""
    regularise: Annotated[
        bool | None,
        typer.Option(
            help="Let the drivers resemble each other: as draws from one population, or by the paper's penalty. By"
            " default on tracks, where drivers come and go.",
        ),
    ] = None
    profile: Annotated[
        bool,
        typer.Option(
            "--profile", help="Compute intervals from the profile likelihood, which takes longer. Not with --effects."
        ),
    ] = False
    law: Law = PAPERS
    classes: Annotated[
        str,
        typer.Option(
            help="Classes of drivers who share all parameters: their number; auto for the number that predicts held-out"
            " drivers best; vehicle for the classes of the vehicles; 0 for none."
        ),
    ] = "0"
    goal: Annotated[
        list[str] | None,
        typer.Option(
            help="NAME:place=PLACE[,speed=SPEED][,deceleration=B][,lane=LANE]: what some drivers may intend, such as an"
            " exit, or with speed 0 the end of the lane; SI units. May be repeated."
        ),
    ] = None
    seed: Annotated[int, typer.Option(min=0, help="With --classes or --goal: seed of the random numbers.")] = 0
    scheduler: Scheduler = None
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Model file (YAML) to write.")] = None
    overwrite: Overwrite = False
    ring: Ring = None
    as_json: Json = False

    @property
    def settings(self) -> "Settings":
        """What the library is asked for. Raises InputError for options that contradict each other."""
        from sugiyama_ros.calibration.result import Settings, number_of_classes
        from sugiyama_ros.fit.goals import read_goal

        settings = Settings(
            formulation=self.formulation,  # type: ignore[arg-type]
            estimated=names(self.parameters),
            is_regularised=self.regularise,
            profiled=self.profile,
            seed=self.seed,
            law=self.law,
            effects=names(self.effects),
            classes=number_of_classes(self.classes, "--{}".format),
            goals=tuple(read_goal(text, "--goal") for text in self.goal or ()),
        )
        settings.check("--{}".format)
        return settings


@takes(_CalibrateOptions)
def calibrate(options: _CalibrateOptions) -> None:
    """Estimate the parameters of each driver.

    The estimates are maximum-likelihood estimates, with their uncertainty.
    """
    output = model_to_write(options.output, options.overwrite)
    from sugiyama_ros.calibration.calibrate import calibrate_drivers
    from sugiyama_ros.formats.choices import Choices
    from sugiyama_ros.formats.registry import read_tracks

    settings = options.settings
    tracks = read_tracks(options.sources, Choices(ring_m=options.ring))
    print_warnings(tracks)
    began = time.monotonic()
    with stage("calibrating") as advance:
        found = calibrate_drivers(tracks, settings, options.scheduler, advance, str(options.sources[0]))
    wall_s = time.monotonic() - began
    if output is not None:
        found.write(output)
    doubts = _cautions(found)
    if options.as_json:
        print_json(found.document(wall_s))
    else:
        _print(found, options.output)
    for line in doubts:
        print_note(f"caution: {line}")


def _cautions(found: "Calibration") -> list[str]:
    """What makes the figures doubtful. The paper's formulation needs no causal filter, which takes long to load."""
    if found.settings.formulation == "paper":
        return []
    from sugiyama_ros.calibration.soundness import cautions

    return cautions(found)


def _print(found: "Calibration", output: Path | None) -> None:
    for line in found.class_sentences():
        print_line(line)
    print_table(found.table())
    for line in found.shared_sentences():
        print_line(line)
    if found.road is None:
        print_line(found.headline())
    if output is not None:
        print_line(f"model file: {output}")
