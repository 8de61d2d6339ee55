"""``sugiyama demo``."""

import math
import os
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sugiyama_ros.cli.options import Json, Overwrite, Ring, Seed, own_output, takes, to_write
from sugiyama_ros.cli.output import print_json, print_line, print_note, print_table, show_page
from sugiyama_ros.cli.run import INTERRUPTED, RunOptions, replay
from sugiyama_ros.errors import InputError
from sugiyama_ros.files import Output
from sugiyama_ros.progress import stages
from sugiyama_ros.results import TextTable, plain

if TYPE_CHECKING:
    from sugiyama_ros.diagnosis.rounds import Diagnosis
    from sugiyama_ros.nodes.run import RunResult
    from sugiyama_ros.page.above import Above
    from sugiyama_ros.simulation.junction import JunctionRun
    from sugiyama_ros.trajectories.tracks import Tracks

_OWN = "sugiyama-demo.mcap"


@dataclass(frozen=True)
class _DemoOptions:
    """Options of the command."""

    data: Annotated[
        Path | None, typer.Option(help="Measured trajectories in any known format, instead of simulated ones.")
    ] = None
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help=f"MCAP file to write; the report is beside it. By default {_OWN}, which each demo replaces.",
        ),
    ] = None
    overwrite: Overwrite = False
    ring: Ring = None
    scene: Annotated[
        str | None, typer.Option(help="Where simulated drivers meet, instead of the ring: roundabout or signals.")
    ] = None
    hidden: Annotated[
        str | None,
        typer.Option(help="Effect that the simulated drivers have and the model lacks; `sugiyama effects` lists them."),
    ] = None
    seed: Seed = 1
    show: Annotated[bool, typer.Option("--open", help="Open the report in the browser.")] = False
    as_json: Json = False


@takes(_DemoOptions)
def demo(options: _DemoOptions) -> None:
    """Find out what the model lacks, add it, and show it on a page.

    Simulated drivers have an effect that the model lacks. The program replays the simulated experiment, finds what the
    model lacks, adds it to the model, and replays the experiment again. With --data, it does the same with a measured
    experiment.
    """
    recording = own_output(options.output, _OWN, options.overwrite)
    page = to_write(recording.path.with_suffix(".html"), recording.overwrite)
    from sugiyama_ros.api import FEW_STEPS
    from sugiyama_ros.formats.choices import Choices
    from sugiyama_ros.formats.registry import read_tracks
    from sugiyama_ros.page.recording import read_recording
    from sugiyama_ros.page.report import write_report

    for name, given in (("scene", options.scene), ("hidden", options.hidden)):
        if options.data is not None and given is not None:
            raise InputError(f"--{name}: is for simulated drivers; leave out --{name} or --data")
    if options.data is None and options.ring is not None:
        raise InputError("--ring: is for measured drivers; leave out --ring, or add --data")
    truth: dict[str, Any] = {}
    above = None
    if options.data is not None:
        most, tracks = FEW_STEPS, read_tracks(options.data, Choices(ring_m=options.ring))
    elif options.scene is not None:
        most, (tracks, truth, above) = 1, _at_scene(options.scene, options.hidden, options.seed)
    else:
        most, (tracks, truth) = 1, _simulated(options.hidden, options.seed)
    before, found, after = _before_and_after(tracks, recording, options.seed, most)
    told = _document(found, truth)
    write_report(replace(read_recording(recording.path), above=above), told, page)
    if options.show:
        show_page(str(page.path))
    rmse = [math.sqrt(sum(d.one_step_rmse_m**2 for d in r.drivers) / len(r.drivers)) for r in (before, after)]
    if not options.as_json:
        _print(told, rmse, recording, page)
        return
    print_json(
        {
            **told,
            "published_one_step_rmse_m": {"before": rmse[0], "after": rmse[1]},
            "messages_lost": before.messages_lost + after.messages_lost,
            "output": str(recording.path),
            "report": str(page.path),
        }
    )


def _document(found: "Diagnosis", truth: dict[str, Any]) -> dict[str, Any]:
    """The document of a diagnosis, with its sentences and the truth."""
    from sugiyama_ros.page.document import document
    from sugiyama_ros.page.words import sentences

    told = {**truth, **plain(document(found))}
    told["verdict"]["told"] = sentences(told)
    return told


def _simulated(hidden: str | None, seed: int) -> tuple["Tracks", dict[str, Any]]:
    """A simulated experiment with a hidden effect, and the truth for the document."""
    from sugiyama_ros.studies.effects import DEMONSTRATED, STRENGTHS, hide

    hidden = hidden or "slow_patch"
    if hidden not in STRENGTHS:
        raise InputError(f"--hidden {hidden}: is not known; give one of {', '.join(STRENGTHS)}")
    simulated, values = hide(hidden, DEMONSTRATED.get(hidden, STRENGTHS[hidden][0]), seed)
    print_note("22 simulated drivers on a ring of 230 m, for 250 s. They have an effect that the model lacks.")
    return simulated.measured, {"hidden": {"name": hidden, "parameters": dict(values)}}


def _at_scene(scene: str, hidden: str | None, seed: int) -> tuple["Tracks", dict[str, Any], "Above"]:
    """Drivers with a hidden effect who meet, the truth for the document, and the scene from above."""
    from sugiyama_ros.studies.scenes import HIDDEN, hide_at_scene

    if scene not in HIDDEN:
        raise InputError(f"--scene {scene}: is not known; give {' or '.join(HIDDEN)}")
    run, name, values = hide_at_scene(scene, hidden, seed)
    print_note(
        f"{len(run.travellers)} simulated drivers, scene {scene}. They have an effect that the model lacks. To find it"
        " takes some minutes."
    )
    return run.measured, {"hidden": {"name": name, "parameters": dict(values)}}, _above(run)


def _above(run: "JunctionRun") -> "Above":
    """The network of a run from above, with the ways of its drivers."""
    import numpy as np

    from sugiyama_ros.page.above import Above

    ways = []
    for path in run.paths:
        place = np.linspace(0.0, path.length_m, math.ceil(path.length_m) + 1, dtype=np.float64)
        ways.append(np.array([place, *path.at(place)[:2]]))
    lanes = tuple(np.array([lane.x_m, lane.y_m]) for lane in run.network.lanes)
    return Above(lanes, {i: ways[one.route] for i, one in enumerate(run.travellers)})


def _print(told: dict[str, Any], rmse: list[float], recording: Output, page: Output) -> None:
    from sugiyama_ros.page.names import addition
    from sugiyama_ros.page.words import size_of

    for line in told["verdict"]["told"]:
        print_line(line)
    errors = told["errors"]
    # as in the report: on unseen data; the estimators learn as they go, and begin with the paper's parameters
    rows: list[tuple[str, ...]] = [
        ("one step ahead [m]", *(f"{errors[when]['one_step_rmse_m']:.3f}" for when in ("before", "after"))),
        ("one step ahead, by the live estimators [m]", f"{rmse[0]:.3f}", f"{rmse[1]:.3f}"),
    ]
    of_runs = {"free run of all cars, 10 s [m]": "free_run_10s_m", "one car, 10 s [m]": "single_car_10s_m"}
    for title, name in of_runs.items():
        ends = [errors[when][name] for when in ("before", "after")]
        if None not in ends and all(map(math.isfinite, ends)):  # tracks have no runs of all cars
            rows.append((title, *(f"{end:.2f}" for end in ends)))
    print_table(TextTable("", ("error", "before", "after"), tuple(rows), left=1))
    if truth := told.get("hidden"):
        print_line(f"The hidden effect: {addition(told, truth)}: {size_of(told, truth)}")
    print_line(f"all topics: {recording.path} (look at them: sugiyama info {recording.path})")
    print_line(f"report: {page.path} (open it in a browser)")


def _before_and_after(
    tracks: "Tracks", output: Output, seed: int, most: int
) -> tuple["RunResult", "Diagnosis", "RunResult"]:
    """Replay with the base model, find what is missing, and replay with it."""
    from sugiyama_ros.diagnosis.diagnose import diagnose as find
    from sugiyama_ros.fit.model_file import write_model
    from sugiyama_ros.formats.convert import write_bag

    with tempfile.TemporaryDirectory() as directory:
        model, source = Path(directory) / "model.yaml", Path(directory) / "measured.mcap"
        if tracks.line_m is None:
            write_bag(tracks.dense(), source)
        else:
            source = source.with_suffix(".parquet")
            tracks.save(source)
        before = _to_the_end(RunOptions(Path(directory) / "before.mcap", source))
        with stages() as advance:
            found = find(tracks, most=most, seed=seed, workers=os.cpu_count() or 1, on_progress=advance)
        write_model(model, found.data, found.final.fit)
        return before, found, _to_the_end(RunOptions(output.path, source, output.overwrite, model=model))


def _to_the_end(options: RunOptions) -> "RunResult":
    """Replay all samples. A run that Ctrl-C has interrupted ends the demo."""
    result = replay(options)
    if result.interrupted:
        raise typer.Exit(INTERRUPTED)
    return result
