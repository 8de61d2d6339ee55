"""``sugiyama report`` and ``sugiyama view``."""

import dataclasses
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sugiyama_ros.cli.options import Json, Overwrite, need_matplotlib
from sugiyama_ros.cli.output import print_against, print_line, print_note, show_page, tell
from sugiyama_ros.errors import InputError
from sugiyama_ros.outputs import Output, make_directory, writing

if TYPE_CHECKING:
    from sugiyama_ros.page.recording import Recording


def report(
    source: Annotated[Path, typer.Argument(help="MCAP file that `sugiyama run` recorded.")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="HTML file to write.")] = None,
    diagnosis: Annotated[
        Path | None,
        typer.Option("--diagnosis", help="Document that `sugiyama diagnose --save` wrote for the same data."),
    ] = None,
    figures: Annotated[
        Path | None, typer.Option("--figures", help="Directory to write figures to, for a paper: PDF and PNG.")
    ] = None,
    overwrite: Overwrite = False,
    show: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    as_json: Json = False,
) -> None:
    """Write an HTML page about a recorded run.

    The page shows what was measured, what the model says, where it fails, and what is missing. If the drivers were
    simulated, estimates are compared with the truth.
    """
    from sugiyama_ros.page.diagnosis import read_diagnosis
    from sugiyama_ros.page.recording import against_truth, read_recording
    from sugiyama_ros.page.report import write_report

    if not source.name:
        raise InputError(f"{source}: not a file; give a file that `sugiyama run` recorded")
    page = output or source.with_suffix(".html")
    if page.suffix != ".html":
        raise InputError(f"{page}: is not the name of a page; give a name that ends in .html")
    to_write = Output(page, overwrite, (source, *([diagnosis] if diagnosis is not None else ())))
    to_write.check()
    if figures is not None:
        need_matplotlib("--figures")
        make_directory(figures)
    found, recording = read_diagnosis(diagnosis) if diagnosis is not None else None, read_recording(source)
    check_data(found, diagnosis, recording, source)
    against = against_truth(source, recording)
    written: list[Path] = []
    with showing(diagnosis):
        if figures is not None:
            # the figures first: what refuses them leaves no page behind
            from sugiyama_ros.page.figures import write_figures

            written = write_figures(recording, found, figures, overwrite)
        write_report(recording, found, to_write, against)
    text = f"page: {page}" + (f"; {len(written)} figures in {figures}" if written else "")
    document = {"output": str(page), "size_bytes": page.stat().st_size, "figures": written}
    if against is not None:
        document["truth"] = dataclasses.asdict(against)
        if not as_json:
            print_against(against)
    tell(document, text, as_json)
    if show:
        show_page(str(page))


def check_data(found: Mapping[str, Any] | None, diagnosis: Path | None, recording: "Recording", source: Path) -> None:
    """Check that a diagnosis is of the recording; print a note where it does not say. Raises InputError."""
    from sugiyama_ros.page.diagnosis import check_same

    if found is not None and diagnosis is not None:
        doubt = check_same(found, diagnosis, recording.trajectories, source)
        if doubt:
            print_note(doubt)


@contextmanager
def showing(diagnosis: Path | None) -> Iterator[None]:
    """Name the diagnosis where what it says cannot be drawn: its checked fields are not all that the page shows."""
    import numpy as np

    try:
        with np.errstate(all="ignore" if diagnosis is not None else "warn"):
            yield
    except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError) as error:
        if diagnosis is None:
            raise
        raise InputError(
            f"{diagnosis}: cannot be shown: {error!r}; give what `sugiyama diagnose --save` wrote for the same data"
        ) from error


_RERUN = ".rrd"


def view(
    source: Annotated[Path, typer.Argument(help="MCAP file that `sugiyama run` recorded.")],
    diagnosis: Annotated[
        Path | None,
        typer.Option("--diagnosis", help="Document that `sugiyama diagnose --save` wrote for the same data."),
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option(
            "--save",
            help=f"File to write instead of opening the viewer: a recording of Rerun ({_RERUN}), or a layout with all"
            " vehicles for Lichtblick and Foxglove (.json).",
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Show a recorded run in the Rerun viewer.

    The viewer shows the road from above, positions, speeds, what was learnt of each driver, and the verdict. It needs
    rerun-sdk, which is not installed by default.
    """
    if save is not None and save.suffix == ".json":
        _save_layout(source, _to_save(save, overwrite, source))
        return
    if find_spec("rerun") is None:
        raise InputError("view: rerun-sdk is not installed; pip install rerun-sdk")
    output = _to_save(save, overwrite, source) if save is not None else None
    import rerun

    from sugiyama_ros.page.diagnosis import read_diagnosis
    from sugiyama_ros.page.recording import read_recording
    from sugiyama_ros.page.rerun_view import log

    found = read_diagnosis(diagnosis) if diagnosis is not None else None
    recording = read_recording(source)
    check_data(found, diagnosis, recording, source)
    stream = rerun.RecordingStream("sugiyama")
    if output is None:
        stream.spawn()
        with showing(diagnosis):
            log(stream, recording, found)
        stream.disconnect()
        return
    content = stream.binary_stream()
    with showing(diagnosis):
        log(stream, recording, found)
    with writing(output) as file:
        file.write(content.read(flush=True))
    print_line(f"recording of Rerun: {output.path} (look at it: rerun {output.path})")


def _save_layout(source: Path, output: Output) -> None:
    """Write a layout of panels with all vehicles of a recording, for another program."""
    from sugiyama_ros.formats.registry import read_trajectories
    from sugiyama_ros.page.layouts import lichtblick

    vehicles = read_trajectories(source, None).vehicle.tolist()
    with writing(output) as file:
        file.write(lichtblick(vehicles).encode())
    print_line(
        f"layout of {len(vehicles)} vehicles: {output.path} (import it in Lichtblick or Foxglove, and open {source})"
    )


def _to_save(path: Path, overwrite: bool, source: Path) -> Output:
    """The file to write. Raises InputError for another suffix, or OutputError."""
    if path.suffix not in (_RERUN, ".json"):
        raise InputError(f"{path}: has no known ending; give a name that ends in {_RERUN} or .json")
    output = Output(path, overwrite, (source,))
    output.check()
    return output
