"""``sugiyama view``."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from sugiyama_ros.cli.options import Overwrite
from sugiyama_ros.cli.output import print_line
from sugiyama_ros.cli.report import check_data, showing
from sugiyama_ros.errors import InputError
from sugiyama_ros.outputs import Output, writing

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
            " vehicles, for Lichtblick and Foxglove (.json) or PlotJuggler (.xml).",
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Show a recorded run in the Rerun viewer.

    The viewer shows the road from above, positions, speeds, what was learnt of each driver, and the verdict. It needs
    rerun-sdk, which is not installed by default.
    """
    if save is not None and save.suffix in (".json", ".xml"):
        _save_layout(source, _output(save, overwrite, source))
        return
    if find_spec("rerun") is None:
        raise InputError("view: rerun-sdk is not installed; pip install rerun-sdk")
    output = _output(save, overwrite, source) if save is not None else None
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
    from sugiyama_ros.page.layouts import lichtblick, plotjuggler

    vehicles = read_trajectories(source, None).vehicle.tolist()
    is_json = output.path.suffix == ".json"
    with writing(output) as file:
        file.write((lichtblick if is_json else plotjuggler)(vehicles).encode())
    program = "Lichtblick or Foxglove" if is_json else "PlotJuggler"
    print_line(f"layout of {len(vehicles)} vehicles: {output.path} (import it in {program}, and open {source})")


def _output(path: Path, overwrite: bool, source: Path) -> Output:
    """The file to write. Raises InputError for another suffix, or OutputError."""
    if path.suffix not in (_RERUN, ".json", ".xml"):
        raise InputError(f"{path}: has no known ending; give a name that ends in {_RERUN}, .json or .xml")
    output = Output(path, overwrite, (source,))
    output.check()
    return output
