"""``sugiyama report``."""

import dataclasses
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sugiyama_ros.cli.options import Json, Overwrite, to_write
from sugiyama_ros.cli.output import print_against, print_note, show_page, tell
from sugiyama_ros.errors import InputError

if TYPE_CHECKING:
    from sugiyama_ros.page.recording import Recording


def report(
    source: Annotated[Path, typer.Argument(help="MCAP file that `sugiyama run` recorded.")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="HTML file to write.")] = None,
    diagnosis: Annotated[
        Path | None,
        typer.Option("--diagnosis", help="Document that `sugiyama diagnose --save` wrote for the same data."),
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
    from sugiyama_ros.page.recording import read_recording
    from sugiyama_ros.page.report import write_report
    from sugiyama_ros.page.truth import against_truth

    if not source.name:
        raise InputError(f"{source}: not a file; give a file that `sugiyama run` recorded")
    page = to_write(output or source.with_suffix(".html"), overwrite, ".html")
    found, recording = read_diagnosis(diagnosis) if diagnosis is not None else None, read_recording(source)
    _check_data(found, diagnosis, recording, source)
    against = against_truth(source, recording)
    with _showing(diagnosis):
        write_report(recording, found, page, against)
    document: dict[str, Any] = {"output": str(page.path), "size_bytes": page.path.stat().st_size}
    if against is not None:
        document["truth"] = dataclasses.asdict(against)
        if not as_json:
            print_against(against)
    tell(document, f"page: {page.path}", as_json)
    if show:
        show_page(str(page.path))


def _check_data(found: Mapping[str, Any] | None, diagnosis: Path | None, recording: "Recording", source: Path) -> None:
    """Check that a diagnosis is of the recording; print a note where it does not say. Raises InputError."""
    from sugiyama_ros.page.diagnosis import check_same

    if found is not None and diagnosis is not None:
        doubt = check_same(found, diagnosis, recording.trajectories, source)
        if doubt:
            print_note(doubt)


@contextmanager
def _showing(diagnosis: Path | None) -> Iterator[None]:
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
