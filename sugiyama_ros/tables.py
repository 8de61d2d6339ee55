"""Tables of text: results say what stands in a table, and the command line prints it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TextTable:
    """A table of text.

    Parameters
    ----------
    title
        Title above the table; empty for none.
    headings
        Heading of each column.
    rows
        Cells of each row, one for each heading.
    left
        Number of columns, from the left, that are aligned to the left; the others are aligned to the right.
    """

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: int = 0
