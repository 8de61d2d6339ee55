"""Tables of text. A result fills a table, and the command line prints the table."""

from dataclasses import dataclass


def figure(value: float, digits: int = 3) -> str:
    """Write a number for people: with so many digits, and never as 1.63e+03.

    Examples
    --------
    >>> figure(1634.2), figure(0.01234), figure(999.7)
    ('1634', '0.0123', '1000')
    """
    text = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e+" in text else text


@dataclass(frozen=True)
class TextTable:
    """A table of text.

    title: title above the table; empty for no title; headings: heading of each column; rows: cells of each row, one
    cell for each heading; left: number of columns that are aligned to the left, counted from the left; the other
    columns are aligned to the right.
    """

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: int = 0
