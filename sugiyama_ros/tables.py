"""Tables of text. A result fills a table, and the command line prints the table."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TextTable:
    """A table of text.

    Parameters
    ----------
    title : str
        Title above the table; empty for no title.
    headings : tuple of str
        Heading of each column.
    rows : tuple of tuple of str
        Cells of each row, one cell for each heading.
    left : int
        Number of columns that are aligned to the left, counted from the left. The other columns are aligned to the
        right.
    """

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: int = 0
