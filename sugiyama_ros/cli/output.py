"""What the commands print: text, tables and JSON on stdout; notes and progress on stderr."""

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from shutil import which
from typing import TYPE_CHECKING, Any

from rich.box import HEAVY_HEAD
from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from sugiyama_ros.errors import harmless
from sugiyama_ros.results import TextTable, to_json

if TYPE_CHECKING:
    from sugiyama_ros.page.truth import AgainstTruth
    from sugiyama_ros.trajectories.tracks import Tracks

# Columns of a terminal, at least, and columns of a line that is not broken.
_NARROW, _WIDE = 80, 1000
# Whoever finds no browser says so within this time [s].
_OPENS_S = 2.0
_out, _err = Console(), Console(stderr=True)


def _shown(text: str) -> str:
    """A text as rich prints it: whatever it holds are characters, and neither markup nor commands to the terminal."""
    return escape(harmless(text))


def print_line(text: str) -> None:
    """Print a line of text, unbroken."""
    _out.print(_shown(text), soft_wrap=True, highlight=False)


def print_note(text: str) -> None:
    """Print a line of text to stderr, unbroken."""
    _err.print(_shown(text), soft_wrap=True, highlight=False)


def print_warnings(tracks: "Tracks") -> None:
    """Print to stderr what a recording needs attention for, and who is no driver."""
    for note in tracks.about.notes:
        if note.startswith("warning"):
            print_note(note)
    if controlled := tracks.controlled_names:
        print_note(f"a controller drives {', '.join(controlled)}: counted as no driver, but as the leader of others")


def print_cautions(model: Path | None) -> None:
    """Print to stderr what a user of a model must know, if the model file says anything."""
    if model is None:
        return
    from sugiyama_ros.fit.model_file import read_model

    for line in read_model(model).cautions:
        print_note(f"caution: {model}: {' '.join(line.split())}")


def print_table(table: TextTable, boxed: bool = True) -> None:
    """Print a table. Columns that do not fit stand below, with the first column again.

    What is not known, NaN, is shown as "-".
    """
    for number, part in enumerate(_parts(table, max(_out.width, _NARROW))):
        _print_part(part if number == 0 else replace(part, title=""), boxed)


def _parts(table: TextTable, room: int) -> Iterator[TextTable]:
    """Parts of a table that fit into ``room`` columns, each with the columns that are aligned to the left."""
    columns = [(heading, *(row[k] for row in table.rows)) for k, heading in enumerate(table.headings)]
    width = [max(map(cell_len, column)) + 3 for column in columns]
    kept = list(range(max(table.left, 1)))
    own = 1 + sum(width[k] for k in kept)
    part: list[int] = []
    for k in range(len(kept), len(columns)):
        if part and own + sum(width[j] for j in part) + width[k] > room:
            yield _only(table, kept + part)
            part = []
        part.append(k)
    yield _only(table, kept + part)


def _only(table: TextTable, columns: list[int]) -> TextTable:
    rows = tuple(tuple(row[k] for k in columns) for row in table.rows)
    return replace(table, headings=tuple(table.headings[k] for k in columns), rows=rows)


def _print_part(table: TextTable, boxed: bool) -> None:
    box = HEAVY_HEAD if boxed else None
    shown = Table(title=_shown(table.title) or None, title_justify="left", box=box)
    for number, heading in enumerate(table.headings):
        shown.add_column(_shown(heading), justify="left" if number < table.left else "right")
    for row in table.rows:
        shown.add_row(*("-" if cell == "nan" else _shown(cell) for cell in row))
    Console(width=_WIDE).print(shown, highlight=False)


def print_json(document: Any) -> None:
    """Print one JSON document."""
    sys.stdout.write(to_json(document, indent=2) + "\n")


def print_against(found: "AgainstTruth") -> None:
    """Print estimates and the truth."""
    print_table(found.table())
    for line in found.lines():
        print_line(line)


def tell(document: Any, text: str, as_json: bool) -> None:
    """Print the document if JSON is wanted, else the text."""
    if as_json:
        print_json(document)
    else:
        print_line(text)


def show_page(place: str) -> None:
    """Open a page, given as a file or an address, in the browser; say how to look at it where there is no browser."""
    opener = which("open" if sys.platform == "darwin" else "xdg-open")
    has_opened = False
    if opener is not None:
        quiet = subprocess.DEVNULL
        asked = subprocess.Popen([opener, place], stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True)
        try:
            has_opened = asked.wait(_OPENS_S) == 0
        except subprocess.TimeoutExpired:  # a browser that stays
            has_opened = True
    if not has_opened:
        print_note(f"no browser was found here; open {place} in one")
