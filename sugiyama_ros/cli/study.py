"""``sugiyama study``."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import Annotated, Any

import typer

from sugiyama_ros.cli.options import Json, Overwrite, Ring, Seed, takes, to_write
from sugiyama_ros.cli.output import print_json, print_line, print_table
from sugiyama_ros.errors import InputError
from sugiyama_ros.files import Output, writing
from sugiyama_ros.progress import stage
from sugiyama_ros.results import TextTable, needs

# Characters of a line of a caption.
_CAPTION = 150


@dataclass(frozen=True)
class _StudyOptions:
    """Options of ``sugiyama study``."""

    name: Annotated[str, typer.Argument(help="Name of the study. Without a name, all studies are listed.")] = ""
    source: Annotated[Path | None, typer.Argument(help="Trajectories of measured drivers: .data, .csv or .mcap.")] = (
        None
    )
    runs: Annotated[int, typer.Option("--runs", min=1, help="Number of simulated runs of each case.")] = 8
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Picture to write: .png or .pdf.")] = None
    overwrite: Overwrite = False
    ring: Ring = None
    seed: Seed = 0
    as_json: Json = False


@takes(_StudyOptions)
def study(options: _StudyOptions) -> None:
    """Answer a question of the paper again.

    Some studies simulate drivers, others use measured drivers.
    """
    from sugiyama_ros.formats.choices import Choices
    from sugiyama_ros.formats.registry import read_tracks
    from sugiyama_ros.studies.registry import STUDIES
    from sugiyama_ros.studies.registry import study as study_of
    from sugiyama_ros.studies.study import Asked
    from sugiyama_ros.trajectories.dense import one_road
    from sugiyama_ros.workers import workers

    given = [name for name in ("source", "runs", "seed", "ring", "output") if _is_given(options, name)]
    if not options.name and given:
        what = ", ".join(f"--{name}" for name in given)
        raise InputError(f"study: {what}, and no name of a study; give a name (sugiyama study lists them)")
    if "ring" in given and "source" not in given:
        raise InputError("--ring: is for measured drivers; leave it out, or give a FILE")
    if not options.name and options.as_json:
        print_json([{"study": one.name, "question": one.question, "paper": one.paper} for one in STUDIES.values()])
        return
    if not options.name:
        for one in STUDIES.values():
            print_line(f"{one.name:12} {one.question}")
        return
    picture = None if options.output is None else to_write(options.output, options.overwrite, ".png", ".pdf")
    asked = study_of(options.name)
    asked.check(given)
    if picture is not None:
        needs("matplotlib", "--output")
    trajectories = None
    if options.source is not None:
        tracks = read_tracks(options.source, Choices(ring_m=options.ring))
        trajectories = one_road(tracks, str(options.source))
    with stage(f"study {options.name}"), workers(options.runs) as work:
        answer = asked.answer(Asked(trajectories, options.runs, options.seed, work))
        if picture is not None:
            _draw(answer.draw, picture, f"{asked.question} The paper: {asked.paper} (seed {options.seed})")
    if options.as_json:
        print_json({"study": options.name, "paper": asked.paper, "rows": answer.rows, "seed": options.seed})
        return
    print_table(_table(asked.question, answer.rows))
    print_line(f"The paper: {asked.paper}")


def _is_given(options: _StudyOptions, name: str) -> bool:
    """Whether an option has another value than by default."""
    return bool(getattr(options, name) != getattr(_StudyOptions, name))


def _table(title: str, answers: Sequence[Mapping[str, Any]]) -> TextTable:
    headings = tuple(dict.fromkeys(heading for row in answers for heading in row))
    cells = ((row.get(heading, "") for heading in headings) for row in answers)
    rows = tuple(tuple(f"{c:.4g}" if isinstance(c, float) else str(c) for c in row) for row in cells)
    return TextTable(title, headings, rows)


def _draw(draw: Callable[[Any], None], output: Output, caption: str) -> None:
    """Draw a picture with a caption below it."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 7), layout="constrained")
    draw(figure)
    figure.supxlabel(fill(caption, _CAPTION), x=0.01, ha="left", fontsize=9)
    with writing(output) as stream:
        figure.savefig(stream, dpi=120, format=output.path.suffix[1:])
