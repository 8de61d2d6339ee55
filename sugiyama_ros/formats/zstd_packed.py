"""Bags that rosbag2 has compressed by zstd as a whole (compression mode FILE), or message by message (mode MESSAGE)."""

import shutil
import tempfile
from pathlib import Path
from typing import IO, BinaryIO, cast

import zstandard

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.mcap_records import MAX_RECORD
from sugiyama_ros.formats.reading import open_input

#: First bytes of what zstd has compressed.
ZSTD = b"\x28\xb5\x2f\xfd"
# Bytes that are unpacked at once, and that stay free on the disk.
_BLOCK, _STAY_FREE = 1 << 20, 1 << 30


def open_packed(path: Path) -> BinaryIO:
    """Open a file for reading; one that zstd has compressed is unpacked into a file without a name first.

    Raises InputError.
    """
    stream = open_input(path)
    if stream.read(len(ZSTD)) != ZSTD:
        return stream
    stream.seek(0)
    opened: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - the caller closes it
    try:
        with stream:
            _unpack(path, stream, opened)
    except BaseException:
        opened.close()
        raise
    return cast("BinaryIO", opened)


def _unpack(path: Path, packed: BinaryIO, out: IO[bytes]) -> None:
    by_hand = f"`zstd -d {path} -o {path.with_suffix('')}`"
    try:
        for block in zstandard.ZstdDecompressor().read_to_iter(packed, write_size=_BLOCK):
            if shutil.disk_usage(tempfile.gettempdir()).free < _STAY_FREE:
                raise InputError(f"{path}: too large to be unpacked into {tempfile.gettempdir()}; run {by_hand}")
            out.write(block)
    except (zstandard.ZstdError, OSError, MemoryError) as error:
        raise InputError(f"{path}: cannot be unpacked ({error}); try {by_hand}") from None


def unpacked(data: bytes, where: str) -> bytes:
    """Unpack a message. Raises InputError where it is damaged, or larger than any record."""
    try:
        if zstandard.frame_content_size(data) <= MAX_RECORD:
            return zstandard.ZstdDecompressor().decompress(data, max_output_size=MAX_RECORD)
    except (zstandard.ZstdError, MemoryError) as error:
        raise InputError(f"{where}: cannot be unpacked ({error}); the file is damaged") from None
    raise InputError(f"{where}: claims more than {MAX_RECORD} bytes; not read")
