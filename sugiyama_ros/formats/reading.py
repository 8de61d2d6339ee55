"""Reading of text files, with every line and number checked."""

import hashlib
import math
import os
from collections.abc import Iterator
from io import BufferedReader, RawIOBase
from pathlib import Path
from typing import Any, BinaryIO

from sugiyama_ros import inputs
from sugiyama_ros.errors import InputError

_MAX_LINE = 10_000
# Files that hold another file, or text in another encoding: their first bytes, and the cure.
_PACKED = (
    (b"\x1f\x8b", "compressed by gzip", "unpack it with gunzip"),
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
    inputs.note(stream.fileno())
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
