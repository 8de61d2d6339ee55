"""Tables of text (CSV with any separator, or aligned by spaces) and Parquet tables: chosen columns, as arrays."""

import csv
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import RawIOBase
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.format import HEAD_BYTES
from sugiyama_ros.formats.reading import lines, open_input, sha256
from sugiyama_ros.trajectories.labels import Labels, labels, plain_text

#: Most rows of a table: 40 million take about 4 GB as tracks.
MAX_ROWS = 40_000_000
#: Texts that say that a value is missing.
MISSING = ("", "nan", "NaN", "NAN", "NA", "N/A", "null", "NULL", "None", "inf", "-inf")
_BLOCK = 1 << 21
_PARQUET = b"PAR1"
_SPACES = " "


@dataclass(frozen=True)
class Sheet:
    """A table in a file: where its columns are.

    Parameters
    ----------
    path : Path
        The file.
    names : tuple of str
        Names of all columns, in the order of the file.
    separator : str
        What stands between two fields; a space for any number of blanks; empty for Parquet.
    header : int
        Number of the line with the names, from 1; 0 where there is none.
    decimal : str
        The decimal point.
    """

    path: Path
    names: tuple[str, ...]
    separator: str = ","
    header: int = 1
    decimal: str = "."

    @property
    def is_parquet(self) -> bool:
        """Whether the file is a Parquet table."""
        return not self.separator

    def find(self, *alternatives: str) -> str | None:
        """The first of some names that the table has, in any case, and with any of ``_ -`` in between; None if none."""
        known = {_plain(name): name for name in reversed(self.names)}
        return next((known[_plain(name)] for name in alternatives if _plain(name) in known), None)

    def has(self, *names: str) -> bool:
        """Whether the table has all of these columns, as `find` finds them."""
        return all(self.find(name) is not None for name in names)


def sheet_of(path: Path, head: bytes, header: int = 1, names: tuple[str, ...] = ()) -> Sheet | None:
    """Find the columns of a table; None for a file that is no table.

    Parameters
    ----------
    path : Path
        The file.
    head : bytes
        Its first bytes.
    header : int
        Number of the line with the names.
    names : tuple of str
        Names of the columns of a table without a line of names.

    Returns
    -------
    Sheet or None
        The table.
    """
    if head.startswith(_PARQUET):
        return _parquet_sheet(path)
    text = head.decode("utf-8-sig", errors="replace")
    rows = text.splitlines()
    if b"\0" in head or len(rows) < header or "\ufffd" in text[:-4] or not rows[header - 1].strip():
        return None
    first = rows[header - 1]
    separator = next((s for s in (";", "\t", ",") if s in first), _SPACES)
    data = [row for row in rows[header:-1] if row.strip()]
    if names:
        return Sheet(path, names, separator, header=0)
    fields = first.split() if separator == _SPACES else next(csv.reader([first], delimiter=separator), [])
    decimal = "," if separator != "," and data and re.search(r"\d,\d", data[0]) and "." not in data[0] else "."
    return Sheet(path, tuple(_unique([one.strip() for one in fields])), separator, header, decimal)


def head_of(path: Path) -> bytes:
    """The first bytes of a file, by which it is recognised; nothing of a folder."""
    if path.is_dir():
        return b""
    with open_input(path) as stream:
        return stream.read(HEAD_BYTES)


def checksum_of(path: Path) -> str:
    """Checksum (SHA-256) of a file."""
    with open_input(path) as stream:
        return sha256(stream)


def read_sheet(sheet: Sheet, numbers: set[str], texts: set[str]) -> Mapping[str, Array | Labels]:
    """Read some columns.

    Parameters
    ----------
    sheet : Sheet
        The table.
    numbers, texts : set of str
        Names of the columns to read as numbers (NaN where missing) and as text.

    Returns
    -------
    mapping
        Arrays (R,) and `Labels` by name.

    Raises
    ------
    InputError
        With line and column, for a line that does not fit; or if there are more than ``MAX_ROWS`` rows.
    """
    import pyarrow

    try:
        batches = _parquet_batches(sheet, numbers | texts) if sheet.is_parquet else _text_batches(sheet, numbers, texts)
        gathered = {name: _Texts() if name in texts else _Numbers() for name in sorted(numbers | texts)}
        rows = 0
        for batch in batches:
            rows += batch.num_rows
            if rows > MAX_ROWS:
                raise InputError(f"{sheet.path}: more than {MAX_ROWS} rows; split the file")
            for name, column in gathered.items():
                column.add(batch[name])
        if rows == 0:
            raise InputError(f"{sheet.path}: no samples; give a table of positions")
        return {name: gathered.pop(name).whole() for name in sorted(numbers | texts)}
    except (pyarrow.ArrowException, OSError, ValueError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())[:200]
        if reason.startswith("Empty CSV"):
            raise InputError(f"{sheet.path}: no samples; give a table of positions") from None
        raise _first_bad(sheet, numbers) or InputError(
            f"{sheet.path}: not a table: {reason}; correct the file"
        ) from None


class _Numbers:
    """A column of numbers, gathered from batches of Arrow, which are let go."""

    def __init__(self) -> None:
        self._parts: list[Array] = []

    def add(self, column: Any) -> None:
        """Add the column of a batch."""
        import pyarrow
        from pyarrow import compute

        if pyarrow.types.is_dictionary(column.type):
            column = column.cast(column.type.value_type)
        if pyarrow.types.is_timestamp(column.type):
            microseconds = column.cast(pyarrow.timestamp("us")).cast(pyarrow.int64())
            column = compute.divide(microseconds.cast(pyarrow.float64()), 1e6)
        self._parts.append(np.array(column.cast(pyarrow.float64()).to_numpy(zero_copy_only=False)))

    def whole(self) -> Array:
        """The column, (R,), NaN where missing."""
        return np.concatenate(self._parts)


class _Texts:
    """A column of text, gathered from batches of Arrow, which are let go."""

    def __init__(self) -> None:
        self._parts: list[NDArray[np.int32]] = []
        self._place: dict[str, int] = {}

    def add(self, column: Any) -> None:
        """Add the column of a batch."""
        import pyarrow

        if not pyarrow.types.is_dictionary(column.type):
            column = column.cast(pyarrow.string()).dictionary_encode()
        code = column.indices.cast(pyarrow.int32()).fill_null(-1).to_numpy(zero_copy_only=False)
        texts = column.dictionary.cast(pyarrow.string()).to_pylist()
        place = [self._place.setdefault(plain_text(one or ""), len(self._place)) for one in texts]
        self._parts.append(np.array([*place, -1], dtype=np.int32)[code])

    def whole(self) -> Labels:
        """The column, (R,)."""
        return labels(np.concatenate(self._parts), self._place)


def _text_batches(sheet: Sheet, numbers: set[str], texts: set[str]) -> Iterator[Any]:
    import pyarrow
    from pyarrow import csv as arrow_csv

    text = pyarrow.dictionary(pyarrow.int32(), pyarrow.string())
    convert = arrow_csv.ConvertOptions(
        include_columns=sorted(numbers) + sorted(texts),
        column_types={**dict.fromkeys(numbers, pyarrow.float64()), **dict.fromkeys(texts, text)},
        null_values=list(MISSING),
        strings_can_be_null=True,
        decimal_point=sheet.decimal,
    )
    read = arrow_csv.ReadOptions(column_names=list(sheet.names), block_size=_BLOCK, use_threads=False)
    parse = arrow_csv.ParseOptions(delimiter="," if sheet.separator == _SPACES else sheet.separator)
    with (
        _body(sheet) as stream,
        arrow_csv.open_csv(stream, read, parse, convert, pyarrow.system_memory_pool()) as reader,
    ):
        yield from reader


@contextmanager
def _body(sheet: Sheet) -> Iterator[Any]:
    """The lines below the names; blanks between fields are made commas."""
    import pyarrow

    with open_input(sheet.path) as stream:
        if sheet.header == 0 and stream.read(3) != b"\xef\xbb\xbf":
            stream.seek(0)
        for _ in range(sheet.header):
            stream.readline(1 << 20)
        yield pyarrow.PythonFile(_Collapsed(stream) if sheet.separator == _SPACES else stream, mode="r")


class _Collapsed(RawIOBase):
    """A file in which any number of blanks between two fields is read as one comma."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream, self._before, self._held = stream, np.uint8(10), b""

    def readable(self) -> bool:
        """Always."""
        return True

    def read(self, size: int = -1) -> bytes:
        """The next bytes."""
        while block := self._stream.read(size):
            data = np.frombuffer(block, dtype=np.uint8)
            data = data[data != 13]
            blank = (data == 32) | (data == 9)
            before = np.concatenate(([self._before], data[:-1])) if len(data) else data
            # Of blanks in a row one stays; none stays at the start of a line.
            keep = ~blank | ~((before == 32) | (before == 9) | (before == 10))
            self._before = data[-1] if len(data) else self._before
            kept = self._held + bytes(np.where(blank, np.uint8(44), data)[keep])
            # A comma at the end waits: at the end of a line it is left out.
            self._held = b"," if kept.endswith(b",") else b""
            kept = kept.removesuffix(b",").replace(b",\n", b"\n")
            if kept:
                return kept
        return b""


def _parquet_sheet(path: Path) -> Sheet | None:
    import pyarrow
    from pyarrow import parquet

    try:
        with parquet.ParquetFile(path) as file:
            names = tuple(file.schema_arrow.names)
    except (pyarrow.ArrowException, OSError, ValueError):
        return None
    if double := [name for name in names if names.count(name) > 1]:
        raise InputError(f"{path}: has {names.count(double[0])} columns {double[0]}; rename all but one")
    return Sheet(path, names, separator="")


def _parquet_batches(sheet: Sheet, names: set[str]) -> Iterator[Any]:
    from pyarrow import parquet

    with parquet.ParquetFile(sheet.path) as file:
        if file.metadata.num_rows > MAX_ROWS:
            raise InputError(f"{sheet.path}: more than {MAX_ROWS} rows; split the file")
        yield from file.iter_batches(batch_size=1 << 18, columns=sorted(names))


def _first_bad(sheet: Sheet, numbers: set[str]) -> InputError | None:
    """The first line that does not fit; None if every line does."""
    if sheet.is_parquet:
        return None
    with open_input(sheet.path) as stream:
        for count, line in enumerate(lines(sheet.path, stream), start=1):
            if count <= sheet.header or not line.strip():
                continue
            where = f"{sheet.path}:{count}"
            try:
                fields = (
                    line.split() if sheet.separator == _SPACES else next(csv.reader([line], delimiter=sheet.separator))
                )
            except csv.Error as error:
                return InputError(f"{where}: not CSV: {error}; correct the line")
            if len(fields) != len(sheet.names):
                return InputError(f"{where}: {len(fields)} fields, but {len(sheet.names)} columns; correct the line")
            for name, text in zip(sheet.names, fields, strict=True):
                if name in numbers and not _is_number(text.strip(), sheet.decimal):
                    return InputError(f"{where}: column {name}: {text[:40]!r} is not a number; correct the line")
    return None


def _is_number(text: str, decimal: str) -> bool:
    try:
        float(text.replace(decimal, ".") if text not in MISSING else "0")
    except ValueError:
        return False
    return True


def _plain(name: str) -> str:
    return name.lower().replace("-", "_").replace(" ", "_")


def _unique(names: list[str]) -> list[str]:
    """The names, with a number behind those that are empty or occur twice."""
    seen: dict[str, int] = {}
    found = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        found.append(name if name and seen[name] == 1 else f"{name}~{seen[name]}")
    return found
