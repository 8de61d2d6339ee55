"""Columns of text, kept as categories: a small number for each row, and each text once."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Ints, Mask

_DIGITS = re.compile(r"(\d+)")
_WHOLE, _POINT_ZERO = re.compile(r"-?\d+"), re.compile(r"-?\d+(\.0+|,0)")


@dataclass(frozen=True, eq=False)
class Labels:
    """A column of text.

    code: (R,), place of each row's text in ``text``; -1 where the text is missing; text: the texts, each once, in their
    _natural order (2 before 10).
    """

    code: NDArray[np.int32]
    text: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.code)

    def __getitem__(self, rows: Ints | Mask | slice) -> "Labels":
        """The same column for some of the rows."""
        return Labels(self.code[rows], self.text)

    def values(self) -> NDArray[np.object_]:
        """The text of each row, shape (R,); None where it is missing."""
        return np.array((*self.text, None), dtype=object)[self.code]

    def at(self, row: int) -> str:
        """The text of one row; empty where it is missing."""
        return self.text[self.code[row]] if self.code[row] >= 0 else ""

    def used(self) -> tuple[str, ...]:
        """The texts that occur in at least one row."""
        return tuple(self.text[code] for code in np.unique(self.code).tolist() if code >= 0)

    def place(self, text: str) -> int:
        """Place of a text; -1 for a text that is not there."""
        return self.text.index(text) if text in self.text else -1


def _natural(text: str) -> tuple[tuple[int, int, str], ...]:
    """A key that sorts texts with numbers in them by these numbers."""
    return tuple((0, int(part), "") if part.isdecimal() else (1, 0, part) for part in _DIGITS.split(text) if part)


def labels(code: NDArray[np.integer], text: Iterable[str]) -> Labels:
    """Make a column of categories whose texts may occur twice and stand in any order.

    code: (R,), place of each row's text; -1 where it is missing.
    """
    texts = list(text)
    ordered = sorted(set(texts), key=lambda one: (_natural(one), one))
    place = {one: number for number, one in enumerate(ordered)}
    move = np.array([place[one] for one in texts] + [-1], dtype=np.int32)
    return Labels(move[code], tuple(ordered))


def labels_of(values: Iterable[object]) -> Labels:
    """Make a column of categories of one value for each row; None is missing, the number 12.0 becomes 12."""
    found: dict[object, int] = {}
    code = np.array([-1 if v is None else found.setdefault(v, len(found)) for v in values], dtype=np.int32)
    return labels(code, [plain_text(value) for value in found])


def numbered(values: NDArray[np.generic]) -> Labels:
    """Make a column of categories of an array of numbers, shape (R,); NaN is missing."""
    unique, code = np.unique(values, return_inverse=True)
    code = code.astype(np.int32)
    if unique.dtype.kind == "f":
        code[np.isnan(values)] = -1
        unique = unique[~np.isnan(unique)]
    return labels(code, [plain_text(value) for value in unique.tolist()])


def same_label(rows: int, text: str) -> Labels:
    """Make a column that has one text in all rows."""
    return Labels(np.zeros(rows, dtype=np.int32), (text,))


def joined(first: Labels, second: Labels, link: str) -> Labels:
    """Make a column of the texts of two columns with a link between them; missing where either is missing."""
    width = len(second.text) + 1
    both = first.code.astype(np.int64) * width + second.code
    both[(first.code < 0) | (second.code < 0)] = -1
    unique, code = np.unique(both, return_inverse=True)
    code = code.astype(np.int32)
    if len(unique) and unique[0] == -1:
        unique, code = unique[1:], code - 1
    return labels(code, [f"{first.text[one // width]}{link}{second.text[one % width]}" for one in unique.tolist()])


def plain_text(value: object) -> str:
    """The text of a value; a whole number that is kept as 12.0 becomes 12."""
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value).strip()


def without_point_zero(column: Labels) -> Labels:
    """The column, whose whole numbers lose their ``.0`` where all texts are whole numbers and stay different.

    Tables write whole numbers as 12.0, or 12,0, where some are missing. Names such as 3.0 and 3.1 stay as they are.
    """
    short = [re.split("[.,]", text)[0] if _POINT_ZERO.fullmatch(text) else text for text in column.text]
    if short == list(column.text) or len(set(short)) < len(short):
        return column
    if not all(_WHOLE.fullmatch(text) for text in short):
        return column
    return labels(column.code, short)


def matched(column: Labels, names: Labels) -> Labels:
    """A column of names that stand in another column; 12.0 may be called 12 there, and 12 be called 12.0."""
    known = set(names.text)
    found = [
        next((one for one in (text, text.removesuffix(".0"), f"{text}.0") if one in known), text)
        for text in column.text
    ]
    return column if found == list(column.text) else labels(column.code, found)
