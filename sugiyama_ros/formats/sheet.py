"""Tables: text (CSV with any separator, or aligned by spaces), Parquet and data frames; chosen columns as arrays."""

import csv
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.format import HEAD_BYTES
from sugiyama_ros.formats.reading import DAY_S, FORMS, lines, open_input, seconds_of, times_of, unix_lines
from sugiyama_ros.trajectories.labels import Labels, labels, plain_text, without_point_zero

#: Most rows of a table: 40 million take about 4 GB as tracks.
MAX_ROWS = 40_000_000
# Texts that say that a value is missing; an infinite number is missing too, unless it is asked for.
_MISSING = ("", "nan", "NaN", "NAN", "NA", "N/A", "null", "NULL", "None")
_NO_VALUE = (*_MISSING, "inf", "-inf")
_BLOCK = 1 << 21
_PARQUET = b"PAR1"
_SPACES = " "
# A column of times keeps its unit: seconds of one of its parts.
_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@dataclass(frozen=True)
class Sheet:
    """A table in a file: where its columns are.

    path: the file; names: names of all columns, in the order of the file; separator: what stands between two fields; a
    space for any number of blanks; empty for Parquet and data frames; header: number of the line with the names, from
    1; 0 where there is none; frame: the table itself, if it is a data frame and no file.
    """

    path: Path
    names: tuple[str, ...]
    separator: str = ","
    header: int = 1
    frame: Any = None

    @property
    def is_parquet(self) -> bool:
        """Whether the table is one of Parquet, or a data frame: its columns have types."""
        return not self.separator

    def find(self, *alternatives: str) -> str | None:
        """The first of some names that the table has, in any case, and with any of ``_ -`` in between; None if none."""
        known = {_plain(name): name for name in reversed(self.names)}
        return next((known[_plain(name)] for name in alternatives if _plain(name) in known), None)

    def has(self, *names: str) -> bool:
        """Whether the table has all of these columns, as `find` finds them."""
        return all(self.find(name) is not None for name in names)


def sheet_of(path: Path, head: bytes, header: int = 1, names: tuple[str, ...] = ()) -> Sheet | None:
    """Find the columns of a table; None for a file that is no table."""
    if head.startswith(_PARQUET):
        return _parquet_sheet(path)
    text = head.decode("utf-8-sig", errors="replace")
    rows = text.splitlines()
    if header == 1 and not names and rows and rows[0].lower().startswith("sep="):
        header = 2  # spreadsheets say the separator in the first line
    if b"\0" in head or len(rows) < header or "\ufffd" in text[:-4] or not rows[header - 1].strip():
        return None
    first = rows[header - 1]
    separator = next((s for s in (";", "\t", ",") if s in first), _SPACES)
    if names:
        return Sheet(path, names, separator, header=0)
    fields = first.split() if separator == _SPACES else next(csv.reader([first], delimiter=separator), [])
    return Sheet(path, tuple(_unique([one.strip() for one in fields])), separator, header)


def text_sheet(path: Path, head: bytes, header: int = 1) -> Sheet | None:
    """Find the columns of a table of text; None for a file that is none, as one of Parquet."""
    return None if head.startswith(_PARQUET) else sheet_of(path, head, header)


def head_of(path: Path) -> bytes:
    """The first bytes of a file, by which it is recognised; nothing of a folder."""
    # a name that no file can have is refused when it is opened
    with suppress(OSError, ValueError):
        if path.is_dir():
            return b""
    with open_input(path) as stream:
        return stream.read(HEAD_BYTES)


def read_sheet(
    sheet: Sheet,
    numbers: set[str],
    texts: set[str],
    times: Mapping[str, float] | None = None,
    infinite: Collection[str] = (),
) -> dict[str, Array | Labels]:
    """Read some columns.

    times: names of the columns to read as times [s], and what their numbers count [s]; dates, clocks and columns with a
    type of times are seconds in any case; infinite: names of the columns whose numbers may be infinite; elsewhere, such
    a number is missing. Raises InputError.
    """
    import pyarrow

    times = dict(times or {})
    wanted = _Wanted(numbers - set(times), texts - set(times), times, infinite)
    # One row does not tell how numbers are written: all rows must fit one way.
    ways = [(".", False), (",", False)] + [(".", True), (",", True)] * bool(times)
    reason = ""
    for decimal, as_text in ways[:1] if sheet.is_parquet else ways:
        try:
            return _gathered(sheet, replace(wanted, decimal=decimal, as_text=as_text))
        except (pyarrow.ArrowException, OSError, ValueError, UnicodeDecodeError) as error:
            if isinstance(error, _NotSuchError) and sheet.is_parquet:
                raise InputError(f"{sheet.path}: {error}") from None
            reason = " ".join(str(error).split())[:200]
            if reason.startswith("Empty CSV"):
                raise InputError(f"{sheet.path}: no samples; give a table of positions") from None
    raise _first_bad(sheet, wanted) or InputError(f"{sheet.path}: not a table: {reason}; correct the file") from None


@dataclass(frozen=True)
class _Wanted:
    """Columns to read, and how numbers are written: the decimal point, and whether times are read as text."""

    numbers: set[str]
    texts: set[str]
    times: Mapping[str, float]
    infinite: Collection[str]
    decimal: str = "."
    as_text: bool = False

    @property
    def names(self) -> list[str]:
        return sorted(self.numbers | self.texts | set(self.times))


def _gathered(sheet: Sheet, wanted: _Wanted) -> dict[str, Array | Labels]:
    """The columns, if all rows fit."""
    if sheet.frame is not None:
        batches = iter(sheet.frame.select(wanted.names).to_batches())
    else:
        batches = _parquet_batches(sheet, wanted.names) if sheet.is_parquet else _text_batches(sheet, wanted)
    columns: dict[str, _Numbers | _Times | _Texts] = {
        **{name: _Numbers(name, name in wanted.infinite) for name in wanted.numbers},
        **{name: _Times(name, factor) for name, factor in wanted.times.items()},
        **{name: _Texts() for name in wanted.texts},
    }
    rows = 0
    for batch in batches:
        rows += batch.num_rows
        if rows > MAX_ROWS:
            raise InputError(f"{sheet.path}: more than {MAX_ROWS} rows; split the file")
        for name, column in columns.items():
            column.add(batch[name])
    if rows == 0:
        raise InputError(f"{sheet.path}: no samples; give a table of positions")
    return {name: columns.pop(name).whole() for name in wanted.names}


class _NotSuchError(ValueError):
    """A value that does not belong into a column."""


class _Numbers:
    """A column of numbers, gathered from batches of Arrow, which are let go."""

    def __init__(self, name: str, may_be_infinite: bool = False) -> None:
        self._name, self._may_be_infinite = name, may_be_infinite
        self._parts: list[Array] = []

    def add(self, column: Any) -> None:
        """Add the column of a batch."""
        import pyarrow

        kind = pyarrow.types
        if kind.is_dictionary(column.type):
            column = column.cast(column.type.value_type)
        if kind.is_string(column.type) or kind.is_large_string(column.type):
            self._parts.append(self._of_text(column))
            return
        if kind.is_nested(column.type) or kind.is_temporal(column.type) or kind.is_binary(column.type):
            raise _NotSuchError(f"column {self._name}: {column.type} is no type of numbers; give numbers")
        if kind.is_boolean(column.type):
            column = column.cast(pyarrow.int8())
        self._parts.append(_values(column.cast(pyarrow.float64(), safe=False), np.dtype(np.float64), np.nan))

    def _of_text(self, column: Any) -> Array:
        coded = column.dictionary_encode()
        texts = [one.strip() for one in coded.dictionary.to_pylist()]
        decimal = "," if any("," in one for one in texts) else "."
        bad = next((one for one in texts if not _is_number(one, decimal)), None)
        if bad is not None:
            raise _NotSuchError(f"column {self._name}: {bad[:40]!r} is not a number; correct the row")
        value = np.array([_float(one, decimal) for one in texts] + [np.nan])
        return np.asarray(value[_codes(coded)])

    def whole(self) -> Array:
        """The column, (R,), NaN where missing."""
        column = np.concatenate(self._parts)
        if not self._may_be_infinite:
            column[np.isinf(column)] = np.nan
        return column


class _Times:
    """A column of times, gathered from batches of Arrow, which are let go."""

    def __init__(self, name: str, factor: float) -> None:
        self._name, self._factor = name, factor
        self._numbers = _Numbers(name)
        self._texts: _Texts | None = None

    def add(self, column: Any) -> None:
        """Add the column of a batch."""
        import pyarrow

        kind = pyarrow.types
        if kind.is_dictionary(column.type) and kind.is_temporal(column.type.value_type):
            column = column.cast(column.type.value_type)
        if kind.is_dictionary(column.type) or kind.is_string(column.type) or kind.is_large_string(column.type):
            self._texts = self._texts or _Texts()
            self._texts.add(column)
            return
        if kind.is_date(column.type):
            column, self._factor = column.cast(pyarrow.date32()).cast(pyarrow.int32()), DAY_S
        elif kind.is_temporal(column.type):
            width = pyarrow.int32() if kind.is_time32(column.type) else pyarrow.int64()
            column, self._factor = column.cast(width), _UNITS[column.type.unit]
        self._numbers.add(column)

    def whole(self) -> Array:
        """The times [s], (R,), NaN where missing."""
        if self._texts is None:
            # what becomes too large is left out later on, as no time
            with np.errstate(over="ignore"):
                return self._numbers.whole() * self._factor
        column = self._texts.coded()
        texts = [one if one not in _NO_VALUE else "nan" for one in column.text]
        time, bad = times_of(texts)
        if bad:
            raise _NotSuchError(f"column {self._name}: {bad[:40]!r} is not a time; give {FORMS}")
        plain = np.array([is_number(one, ".,") for one in texts] + [True])
        return np.asarray((np.append(time, np.nan) * np.where(plain, self._factor, 1.0))[column.code])


class _Texts:
    """A column of text, gathered from batches of Arrow, which are let go."""

    def __init__(self) -> None:
        self._parts: list[NDArray[np.int32]] = []
        self._place: dict[str, int] = {}

    def add(self, column: Any) -> None:
        """Add the column of a batch."""
        import pyarrow

        kind = pyarrow.types
        if not kind.is_dictionary(column.type):
            is_number = kind.is_floating(column.type) or kind.is_integer(column.type)
            column = (column if is_number else column.cast(pyarrow.string())).dictionary_encode()
        texts = column.dictionary
        if not (kind.is_floating(texts.type) or kind.is_integer(texts.type)):
            texts = texts.cast(pyarrow.string())
        names = ["" if one is None or one != one else plain_text(one) for one in texts.to_pylist()]
        place = [-1 if one in _NO_VALUE else self._place.setdefault(one, len(self._place)) for one in names]
        self._parts.append(np.array([*place, -1], dtype=np.int32)[_codes(column)])

    def coded(self) -> Labels:
        """The column, (R,), as it is written."""
        return labels(np.concatenate(self._parts), self._place)

    def whole(self) -> Labels:
        """The column, (R,); whole numbers that are all written as 12.0 lose their point."""
        return without_point_zero(self.coded())


def _codes(column: Any) -> NDArray[np.int32]:
    """Place of each value of a column of categories in its dictionary, (R,); -1 where missing."""
    import pyarrow

    return _values(column.indices.cast(pyarrow.int32()), np.dtype(np.int32), -1)


def _values(column: Any, kind: np.dtype[Any], missing: float) -> NDArray[Any]:
    """A copy of the values of a column of numbers of this kind, (R,).

    ``to_numpy`` of pyarrow would load pandas, which takes longer than most files.
    """
    known, data = column.buffers()
    start, stop = column.offset, column.offset + len(column)
    values = np.frombuffer(data, kind)[start:stop].copy() if len(column) else np.empty(0, kind)
    if column.null_count:
        bits = np.unpackbits(np.frombuffer(known, np.uint8), bitorder="little")[start:stop]
        values[bits == 0] = missing
    return values


def _text_batches(sheet: Sheet, wanted: _Wanted) -> Iterator[Any]:
    import pyarrow
    from pyarrow import csv as arrow_csv

    text = pyarrow.dictionary(pyarrow.int32(), pyarrow.string())
    types = {**dict.fromkeys(wanted.numbers, pyarrow.float64()), **dict.fromkeys(wanted.texts, text)}
    types |= dict.fromkeys(wanted.times, text if wanted.as_text else pyarrow.float64())
    convert = arrow_csv.ConvertOptions(
        include_columns=wanted.names,
        column_types=types,
        null_values=list(_MISSING),
        strings_can_be_null=True,
        decimal_point=wanted.decimal,
    )
    read = arrow_csv.ReadOptions(column_names=list(sheet.names), block_size=2 * _BLOCK, use_threads=False)
    parse = arrow_csv.ParseOptions(delimiter="\t" if sheet.separator == _SPACES else sheet.separator)
    with _body(sheet) as stream:
        for block in _blocks(stream):
            if sheet.separator == _SPACES:
                block = b"\n".join(b"\t".join(line.split()) for line in block.split(b"\n"))
            # A thread of Arrow that still read from Python when Python ends would abort the program.
            source = pyarrow.BufferReader(block)
            yield from arrow_csv.read_csv(source, read, parse, convert, pyarrow.system_memory_pool()).to_batches()


def _blocks(stream: Any) -> Iterator[bytes]:
    """Whole lines, about `_BLOCK` bytes at a time; at least one block. Raises ValueError for a longer line."""
    rest, is_first = b"", True
    while more := stream.read(_BLOCK):
        whole, end, after = (rest + more).rpartition(b"\n")
        rest = after
        if len(rest) > _BLOCK:
            raise ValueError(f"a line is longer than {_BLOCK} bytes")
        if whole.strip():
            yield whole + end
            is_first = False
    if is_first or rest.strip():
        yield rest


@contextmanager
def _body(sheet: Sheet) -> Iterator[Any]:
    """The lines below the names."""
    with open_input(sheet.path) as file:
        if sheet.header == 0 and file.read(3) != b"\xef\xbb\xbf":
            file.seek(0)
        stream = unix_lines(file)
        for _ in range(sheet.header):
            stream.readline(1 << 20)
        yield stream


@contextmanager
def parquet_file(path: Path) -> Iterator[Any]:
    """An open file of Parquet, whose pages are compared with their checksums. Raises InputError if it is damaged."""
    from pyarrow import ArrowException, parquet

    try:
        with parquet.ParquetFile(path, page_checksum_verification=True) as file:
            yield file
    except (ArrowException, OSError, ValueError) as error:
        reason = " ".join(str(error).split())[:100]
        raise InputError(f"{path}: cut or damaged: {reason}; get the file again, or convert its source again") from None


def _parquet_sheet(path: Path) -> Sheet:
    with parquet_file(path) as file:
        names = tuple(file.schema_arrow.names)
    if double := [name for name in names if names.count(name) > 1]:
        raise InputError(f"{path}: has {names.count(double[0])} columns {double[0]}; rename all but one")
    return Sheet(path, names, separator="")


def _parquet_batches(sheet: Sheet, names: list[str]) -> Iterator[Any]:
    with parquet_file(sheet.path) as file:
        if file.metadata.num_rows > MAX_ROWS:
            raise InputError(f"{sheet.path}: more than {MAX_ROWS} rows; split the file")
        yield from file.iter_batches(batch_size=1 << 18, columns=names)


def _first_bad(sheet: Sheet, wanted: _Wanted) -> InputError | None:
    """The first line that does not fit; None if every line does."""
    if sheet.is_parquet:
        return None
    decimals = [".", ","]  # what the lines so far allow
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
            for name, text in zip(sheet.names, (one.strip() for one in fields), strict=True):
                if name in wanted.times and text not in _NO_VALUE and seconds_of(text) is None:
                    return InputError(f"{where}: column {name}: {text[:40]!r} is not a time; give {FORMS}")
                if name not in wanted.numbers:
                    continue
                decimals = [decimal for decimal in decimals if _is_number(text, decimal)]
                if not decimals:
                    mixed = "" if not is_number(text, ".,") else ", or has another decimal point"
                    return InputError(f"{where}: column {name}: {text[:40]!r} is not a number{mixed}; correct the line")
    return None


def is_number(text: str, decimals: str = ".") -> bool:
    """Whether a text is a number, written with one of some decimal points, or says that a value is missing."""
    return any(_is_number(text, decimal) for decimal in decimals)


def _is_number(text: str, decimal: str) -> bool:
    if text in _MISSING:
        return True
    if "_" in text or (decimal == "," and "." in text):
        return False
    try:
        float(text.replace(decimal, "."))
    except ValueError:
        return False
    return True


def _float(text: str, decimal: str) -> float:
    return np.nan if text in _MISSING else float(text.replace(decimal, "."))


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
