"""What the commands print: text, tables and JSON on stdout; notes and progress on stderr."""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.box import HEAVY_HEAD
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from sugiyama_ros.results import plain
from sugiyama_ros.tables import TextTable

if TYPE_CHECKING:
    from sugiyama_ros.page.truth import AgainstTruth

# Columns of a table that is printed to a pipe, or on a narrower terminal: other programs want unbroken lines.
_WIDTH = 200
_out, _err = Console(), Console(stderr=True)


def print_line(text: str) -> None:
    """Print a line of text, unbroken."""
    _out.print(escape(text), soft_wrap=True, highlight=False)


def print_note(text: str) -> None:
    """Print a line of text to stderr, unbroken."""
    _err.print(escape(text), soft_wrap=True, highlight=False)


def print_table(table: TextTable, boxed: bool = True) -> None:
    """Print a table, with unbroken lines."""
    box = HEAVY_HEAD if boxed else None
    shown = Table(title=escape(table.title) or None, title_justify="left", box=box)
    for number, heading in enumerate(table.headings):
        shown.add_column(escape(heading), justify="left" if number < table.left else "right")
    for row in table.rows:
        shown.add_row(*map(escape, row))
    Console(width=max(_out.width, _WIDTH)).print(shown, highlight=False)


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


def to_json(document: Any, indent: int | None = None) -> str:
    """A document as JSON; NaN and infinite numbers become null."""
    return json.dumps(plain(document), indent=indent, allow_nan=False)


@contextmanager
def progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """Show a bar on a terminal; show nothing in a pipe."""
    if not _err.is_terminal:
        yield lambda done, total: None
        return
    columns = (TextColumn(what), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=_err, transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
