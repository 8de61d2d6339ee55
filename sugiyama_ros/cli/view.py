"""``sugiyama view``."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from sugiyama_ros.cli.options import Overwrite
from sugiyama_ros.cli.output import print_line
from sugiyama_ros.cli.report import showing
from sugiyama_ros.errors import InputError
from sugiyama_ros.outputs import Output, writing

_SUFFIX = ".rrd"


def view(
    source: Annotated[Path, typer.Argument(help="MCAP file that `sugiyama run` recorded.")],
    diagnosis: Annotated[
        Path | None,
        typer.Option("--diagnosis", help="Document that `sugiyama diagnose --json` printed for the same data."),
    ] = None,
    save: Annotated[
        Path | None, typer.Option("--save", help=f"Recording of Rerun ({_SUFFIX}) to write, instead of the viewer.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Show a recorded run in the Rerun viewer.

    The viewer shows the road from above, positions, speeds, what was learnt of each driver, and the verdict. It needs
    rerun-sdk, which is not installed by default.
    """
    if find_spec("rerun") is None:
        raise InputError("view: rerun-sdk is not installed; pip install 'sugiyama_ros[view]'")
    output = _output(save, overwrite, source) if save is not None else None
    import rerun

    from sugiyama_ros.page.diagnosis import read_diagnosis
    from sugiyama_ros.page.recording import read_recording
    from sugiyama_ros.page.rerun_view import log

    found = read_diagnosis(diagnosis) if diagnosis is not None else None
    recording = read_recording(source)
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


def _output(path: Path, overwrite: bool, source: Path) -> Output:
    """The file to write. Raises InputError for another suffix, or OutputError."""
    if path.suffix != _SUFFIX:
        raise InputError(f"{path}: is not the name of a recording of Rerun; give a name that ends in {_SUFFIX}")
    output = Output(path, overwrite, (source,))
    output.check()
    return output
