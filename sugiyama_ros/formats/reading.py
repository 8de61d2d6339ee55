"""Reading of text files and XML, with every line, number and time checked."""

import gzip
import hashlib
import math
import os
import re
import shlex
import zlib
from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime, timezone
from io import BufferedReader, RawIOBase
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias
from xml.etree import ElementTree

import numpy as np

from sugiyama_ros import files
from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError

_MAX_LINE = 10_000
#: First bytes of a file that is packed by gzip.
GZIP = b"\x1f\x8b"
# Files that hold another file, or text in another encoding: their first bytes, and the cure.
_PACKED = (
    (GZIP, "compressed by gzip", "unpack it with gunzip"),
    (b"PK\x03\x04", "a zip archive or a spreadsheet", "unpack it with unzip, or save it as CSV"),
    (b"BZh", "compressed by bzip2", "unpack it with bunzip2"),
    (b"\xfd7zXZ", "compressed by xz", "unpack it with unxz"),
    (b"\x28\xb5\x2f\xfd", "compressed by zstd", "unpack it with unzstd"),
    (b"\xff\xfe", "text in UTF-16", "save it as UTF-8"),
    (b"\xfe\xff", "text in UTF-16", "save it as UTF-8"),
)


def open_input(path: Path) -> BinaryIO:
    """Open a regular file for reading. Raises InputError if it is missing or cannot be read."""
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: not a regular file; give a file")
        stream = path.open("rb")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}; check the name and the permissions") from None
    files.note(stream.fileno())
    return stream


def why_no_text(head: bytes) -> str:
    """Say why the first bytes of a file are no UTF-8 text, and what to do; empty if they are text, or nothing known."""
    for magic, what, cure in _PACKED:
        if head.startswith(magic):
            return f"{what}; {cure}"
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as error:
        # the last letter may be cut off
        if error.end < len(head) - 4 and b"\0" not in head:
            return "not UTF-8 text; save it as UTF-8, as by iconv -f LATIN1 -t UTF-8"
    return ""


def shown_name(path: Path) -> str:
    """Name of a file as text; bytes that are not UTF-8 are written as in \\xe9."""
    return os.fsencode(path.name).decode(errors="backslashreplace")


def command_for(path: Path) -> str:
    """The command, without options, that converts a file to tracks."""
    return f"sugiyama convert {shlex.quote(str(path))} tracks.parquet"


def shown_stem(path: Path) -> str:
    """Name of a file without its suffix, as `shown_name` writes it."""
    return shown_name(path.with_suffix(""))


class _UnixLines(RawIOBase):
    """A file in which lines that end in CR, or in CR and LF, end in LF."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream, self._after_cr = stream, False

    def readable(self) -> bool:
        """Always."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Put the next bytes into a buffer."""
        while block := self._stream.read(len(buffer)):
            # a pair may be cut in two
            begin = int(self._after_cr and block.startswith(b"\n"))
            self._after_cr = block.endswith(b"\r")
            block = block[begin:].replace(b"\r\n", b"\n").replace(b"\r", b"\n")
            if block:
                buffer[: len(block)] = block
                return len(block)
        return 0


def unix_lines(stream: BinaryIO) -> BufferedReader:
    """A file, read from where it is, in which all lines end in LF."""
    return BufferedReader(_UnixLines(stream), 1 << 16)


def lines(path: Path, stream: BinaryIO) -> Iterator[str]:
    """Lines of a text file without their ends. Raises InputError for a line that is too long or not UTF-8."""
    number = 0
    stream = unix_lines(stream)
    while line := stream.readline(_MAX_LINE + 1):
        number += 1
        if len(line) > _MAX_LINE:
            raise InputError(f"{path}:{number}: a line of more than {_MAX_LINE} bytes; not a table of positions")
        try:
            text = line.decode("utf-8-sig" if number == 1 else "utf-8")
        except UnicodeDecodeError:
            raise InputError(f"{path}:{number}: not UTF-8 text; this is not a table of positions") from None
        yield text.rstrip("\n")


def number(text: str, field: str, where: str) -> float:
    """A finite number. Raises InputError, with line and field, for anything else."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {field} {text[:40]!r} is not a finite number; correct or remove the line")
    return value


def sha256(stream: BinaryIO) -> str:
    """Checksum of a file; the stream is rewound before and after."""
    digest = hashlib.sha256()
    stream.seek(0)
    while block := stream.read(1 << 20):
        digest.update(block)
    stream.seek(0)
    return digest.hexdigest()


def checksum_of(path: Path) -> str:
    """Checksum (SHA-256) of a file."""
    with open_input(path) as stream:
        return sha256(stream)


#: A day [s].
DAY_S = 86_400.0
#: What a text should look like that is not a time, for messages.
FORMS = "seconds, or a time such as 0:01:02.5 or 2024-05-31 10:00:00"
# Perhaps days, as 2:00:00:01 or 2 days 00:00:01; hours, minutes and seconds. Without hours, there is a fraction: nobody
# knows whether 10:30 means minutes or hours.
_CLOCK = re.compile(r"(?:(\d{1,6})(?::| days? ,?))?(\d{1,4}):(\d{1,2}):(\d{1,2}(?:[.,]\d*)?)")
_MINUTES = re.compile(r"(\d{1,6}):(\d{1,2}[.,]\d*)")
_DATE = re.compile(
    r"(\d{4})[-/](\d{2})[-/](\d{2})[T ](\d{2}):(\d{2})(?::(\d{2}(?:[.,]\d*)?))?\s?(Z|UTC|[+-]\d{2}:?\d{2})?"
)


def seconds_of(text: str) -> float | None:
    """The time [s] that a text says; None for a text that is no time."""
    text = text.strip()
    try:
        return float(text if "." in text else text.replace(",", "."))
    except ValueError:
        pass
    if found := _CLOCK.fullmatch(text):
        days, hours, minutes, rest = found[1] or 0, found[2], found[3], found[4]
        return DAY_S * int(days) + 3600.0 * int(hours) + 60.0 * int(minutes) + _with_comma(rest)
    if found := _MINUTES.fullmatch(text):
        return 60.0 * int(found[1]) + _with_comma(found[2])
    return _since_1970(text)


def times_of(texts: Iterable[str]) -> tuple[Array, str]:
    """Times [s] of texts, (N,), and the first text that is no time, or nothing.

    A clock that passes midnight goes on counting.
    """
    texts = list(texts)
    found = [seconds_of(text) for text in texts]
    bad = next((text for text, time in zip(texts, found, strict=True) if time is None), "")
    time = np.array([np.nan if one is None else one for one in found], dtype=np.float64)
    clock = np.array([_CLOCK.fullmatch(text.strip()) is not None for text in texts], dtype=bool)
    if clock.any() and clock.all() and np.nanmax(time) < DAY_S:
        time = _past_midnight(time)
    return time, bad


def _past_midnight(time: Array) -> Array:
    """Times of the day [s], (R,), that go on counting at midnight."""
    ordered = np.unique(time[np.isfinite(time)])
    hole = np.diff(ordered)
    # nobody records for half a day; what comes after such a hole was before midnight
    if len(hole) and hole.max() > 0.5 * DAY_S:
        return np.where(time <= ordered[np.argmax(hole)], time + DAY_S, time)
    return time


def clock_of_digits(time: Array) -> Array | None:
    """Times of the day [s], (R,), of numbers such as 65959.9 or 65959900 for 06:59:59.9; None for other numbers.

    Such numbers have no minute and no second above 59, and jump by 40 more where a minute ends.
    """
    if np.nanmax(np.abs(time), initial=0.0) >= 240_000_000.0:
        return None
    for part in (1.0, 1e-3):
        digits = np.round(time * part, 6)
        beyond = (digits < 0.0) | (digits >= 240_000.0) | (digits % 100.0 >= 60.0) | (digits // 100.0 % 100.0 >= 60.0)
        if beyond.any():
            continue
        known = np.unique(digits[np.isfinite(digits)])
        clock = _past_midnight(_of_digits(known))
        order = np.argsort(clock)
        real = np.diff(clock[order])
        ends = np.abs(np.diff(known[order]) - real) > 1.0
        # a hole in seconds that are counted seldom ends just where a minute does
        if ends.any() and np.median(real[ends]) <= 2.0 * np.median(real):
            return _past_midnight(_of_digits(digits))
    return None


def _of_digits(digits: Array) -> Array:
    return 3600.0 * (digits // 10_000.0) + 60.0 * (digits // 100.0 % 100.0) + digits % 100.0


def _since_1970(text: str) -> float | None:
    if not (found := _DATE.fullmatch(text)):
        return None
    year, month, day, hour, minute = (int(found[k]) for k in range(1, 6))
    try:
        start = datetime(year, month, day, hour, minute, tzinfo=timezone.utc).timestamp()
    except ValueError:
        return None
    zone = found[7] or "Z"
    ahead = 0.0
    if zone[0] in "+-":
        ahead = (3600.0 * int(zone[1:3]) + 60.0 * int(zone[-2:])) * (-1.0 if zone[0] == "-" else 1.0)
    return start + _with_comma(found[6] or "0") - ahead


def _with_comma(text: str) -> float:
    return float(text.replace(",", "."))


_BLOCK = 1 << 16
# Bytes of one element below the first one, at most: what is read is bounded, however much is packed into a file.
_LARGEST_ELEMENT = 50_000_000
_MARK = b"\xef\xbb\xbf"
# What the parser calls a file that ends early: no element, a token that is not closed, half a letter.
_CUT_OFF = (3, 5, 6)
Parser: TypeAlias = "ElementTree.XMLPullParser[ElementTree.Element]"


def root_of(path: Path) -> ElementTree.Element:
    """The first element of an XML file, without what is in it. Raises InputError."""
    parser: Parser = ElementTree.XMLPullParser(events=("start",))
    with open_input(path) as stream:
        try:
            # a comment with all options of a program may come first
            for _, element in _events(path, stream, parser):
                element.tag = _local(element.tag)
                return element
        except ElementTree.ParseError as error:
            raise InputError(f"{path}:{error.position[0]}: not XML: {error}; correct the file") from None
    raise InputError(f"{path}: not XML: no element; correct the file")


def has_root(head: bytes, path: Path, tag: str) -> bool:
    """Whether a file, of which ``head`` are the first bytes, is XML whose first element has a tag.

    It may be packed by gzip. A damaged file counts as one, if the tag is in its first bytes.
    """
    if not head.removeprefix(_MARK).lstrip().startswith((b"<", GZIP)):
        return False
    try:
        return root_of(path).tag == tag
    except InputError:
        return f"<{tag}".encode() in head


def elements(path: Path, *tags: str) -> Iterator[ElementTree.Element]:
    """Whole elements directly below the first one; each is forgotten when the next is asked for. Raises InputError."""
    parser: Parser = ElementTree.XMLPullParser(events=("start", "end"))
    with open_input(path) as stream:
        depth: list[ElementTree.Element] = []
        try:
            for event, element in _events(path, stream, parser):
                if event == "start":
                    element.tag = _local(element.tag)
                    depth.append(element)
                    continue
                depth.pop()
                if len(depth) == 1:
                    if element.tag in tags:
                        yield element
                    element.clear()
                    depth[0].remove(element)
        except ElementTree.ParseError as error:
            if error.code not in _CUT_OFF:
                raise InputError(f"{path}:{error.position[0]}: not XML: {error}; correct the file") from None
            cure = "get the file again, or let the program that writes it come to its end"
            if len(tags) == 1 and depth:
                # elements of one kind are a sequence, whose beginning is right without its end
                cure += f", or cut it behind its last </{tags[0]}> and add </{depth[0].tag}>"
            raise InputError(f"{path}:{error.position[0]}: ends early; {cure}") from None


def _events(path: Path, stream: BinaryIO, parser: "Parser") -> Iterator[tuple[str, ElementTree.Element]]:
    depth, size = 0, 0
    for block in _blocks(path, stream):
        size += len(block)
        if size > _LARGEST_ELEMENT:
            raise InputError(f"{path}: an element of more than {_LARGEST_ELEMENT // 1_000_000} MB; split the file")
        if b"<!ENTITY" in block or b"<!DOCTYPE" in block:
            raise InputError(f"{path}: declares a document type; remove it")
        try:
            parser.feed(block)
        except (LookupError, ValueError) as error:
            raise InputError(f"{path}: its encoding cannot be read: {error}; save it as UTF-8") from None
        for event in parser.read_events():
            depth += 1 if event[0] == "start" else -1
            size = 0 if depth == 1 else size
            yield event  # type: ignore[misc]
    parser.close()
    yield from parser.read_events()  # type: ignore[misc]


def _blocks(path: Path, stream: BinaryIO) -> Iterator[bytes]:
    """The content of a file, unpacked if it is packed by gzip. Raises InputError."""
    packed = stream.read(len(GZIP)) == GZIP
    stream.seek(0)
    source = gzip.GzipFile(fileobj=stream) if packed else stream
    try:
        while block := source.read(_BLOCK):
            yield block
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise InputError(f"{path}: damaged: {error}; get the file again") from None


def _local(tag: str) -> str:
    """A tag without its namespace."""
    return tag.rpartition("}")[2]


def attribute(attributes: Mapping[str, str], name: str, where: str) -> float:
    """A number among the attributes of an element. Raises InputError."""
    if name not in attributes:
        raise InputError(f"{where}: no attribute {name}; write the file with it")
    # a clock is a number of seconds
    value = seconds_of(attributes[name])
    if value is None:
        raise InputError(f"{where}: {name} {attributes[name][:40]!r} is not a number; correct the file")
    return value
