"""``sugiyama demo``."""

import math
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sugiyama_ros.cli.options import Json, Overwrite, Ring, Seed, own_output
from sugiyama_ros.cli.output import print_json, print_line, print_note
from sugiyama_ros.cli.run import INTERRUPTED, RunOptions, print_run, replay
from sugiyama_ros.errors import InputError
from sugiyama_ros.outputs import Output
from sugiyama_ros.progress import stages

if TYPE_CHECKING:
    from sugiyama_ros.diagnosis.diagnosis import Diagnosis
    from sugiyama_ros.nodes.run import RunResult
    from sugiyama_ros.trajectories.trajectories import Trajectories

_OWN = "sugiyama-demo.mcap"


def demo(
    data: Annotated[
        Path | None, typer.Option("--data", help="Measured trajectories to replay, instead of simulated ones.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help=f"MCAP file to write; the report is beside it. By default {_OWN}, which each demo replaces.",
        ),
    ] = None,
    overwrite: Overwrite = False,
    ring: Ring = None,
    hidden: Annotated[
        str, typer.Option("--hidden", help="Effect that the simulated drivers have and the model lacks, or random.")
    ] = "slow_patch",
    seed: Seed = 1,
    show: Annotated[bool, typer.Option("--open", help="Open the report in the browser.")] = False,
    as_json: Json = False,
) -> None:
    """Find an effect that is hidden in simulated drivers.

    The program replays the simulated experiment, finds what the model lacks, adds it to the model, and replays the
    experiment again. With --data, it replays a measured experiment and estimates its drivers instead.
    """
    recording = own_output(output, _OWN, overwrite, data)
    if data is not None:
        print_run(replay(RunOptions(recording.path, data, recording.overwrite, ring=ring)), as_json)
        return
    from sugiyama_ros.diagnosis.verdict import document
    from sugiyama_ros.page.recording import read_recording
    from sugiyama_ros.page.report import write_report
    from sugiyama_ros.studies.hiding import STRENGTHS, hide

    hidden = _chosen(hidden, tuple(STRENGTHS), seed)
    page = _page_beside(recording)
    simulated, values = hide(hidden, STRENGTHS[hidden][0], seed)
    print_note("22 simulated drivers on a ring of 230 m, for 250 s. They have an effect that the model lacks.")
    before, found, after = _before_and_after(simulated.measured, recording, seed)
    write_report(read_recording(recording.path), document(found), page)
    if show:
        typer.launch(str(page.path))
    rmse = [math.sqrt(sum(d.one_step_rmse_m**2 for d in r.drivers) / len(r.drivers)) for r in (before, after)]
    if not as_json:
        _print(found, rmse, f"{hidden} ({', '.join(f'{k} {v:.3g}' for k, v in values.items())})", recording, page)
        return
    print_json(
        {
            "hidden": {"name": hidden, "parameters": values},
            **document(found),
            "published_one_step_rmse_m": {"before": rmse[0], "after": rmse[1]},
            "messages_lost": before.messages_lost + after.messages_lost,
            "output": str(recording.path),
            "report": str(page.path),
        }
    )


def _print(found: "Diagnosis", rmse: list[float], hidden: str, recording: Output, page: Output) -> None:
    from sugiyama_ros.diagnosis.verdict import sentences

    print_line(f"before: the one-step error of the estimators is {rmse[0]:.4f} m")
    for line in sentences(found):
        print_line(line)
    print_line(f"after: with what was found, the error is {rmse[1]:.4f} m; all topics are in {recording.path}")
    print_line(f"the hidden effect: {hidden}")
    print_line(f"report: {page.path}")


def _page_beside(recording: Output) -> Output:
    """The report, whose name is the recording's with another suffix. Raises InputError or OutputError."""
    page = Output(recording.path.with_suffix(".html"), recording.overwrite)
    if page.path == recording.path:
        raise InputError(f"{recording.path}: is the name of a page; give a name that ends in .mcap")
    page.check()
    return page


def _chosen(hidden: str, effects: tuple[str, ...], seed: int) -> str:
    """The effect to hide. Raises InputError for an unknown name."""
    if hidden == "random":
        import numpy as np

        return effects[int(np.random.default_rng(seed).integers(len(effects)))]
    if hidden not in effects:
        raise InputError(f"--hidden {hidden}: is not known; give one of {', '.join(effects)}, random")
    return hidden


def _before_and_after(
    trajectories: "Trajectories", output: Output, seed: int
) -> tuple["RunResult", "Diagnosis", "RunResult"]:
    """Replay with the base model, find what is missing, and replay with it."""
    from sugiyama_ros.diagnosis.diagnosis import diagnose as find
    from sugiyama_ros.fit.model_file import write_model
    from sugiyama_ros.formats.convert import write_trajectories

    with tempfile.TemporaryDirectory() as directory:
        source, model = Path(directory) / "simulated.mcap", Path(directory) / "model.yaml"
        write_trajectories(trajectories, source)
        before = _to_the_end(RunOptions(Path(directory) / "before.mcap", source))
        with stages() as advance:
            found = find(
                trajectories,
                seed=seed,
                quick=True,
                most=1,
                verdict_only=True,
                workers=os.cpu_count() or 1,
                on_progress=advance,
            )
        write_model(model, found.data, found.final)
        return before, found, _to_the_end(RunOptions(output.path, source, output.overwrite, model=model))


def _to_the_end(options: RunOptions) -> "RunResult":
    """Replay all samples. A run that Ctrl-C has interrupted ends the demo."""
    result = replay(options)
    if result.interrupted:
        raise typer.Exit(INTERRUPTED)
    return result
