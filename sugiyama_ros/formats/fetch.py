"""Download a public data set, verify, unpack and convert it."""

import http.client
import io
import time
import urllib.error
import urllib.request
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from sugiyama_ros.errors import InputError
from sugiyama_ros.files import Output, make_directory, writing
from sugiyama_ros.formats.convert import convert
from sugiyama_ros.formats.reading import sha256
from sugiyama_ros.progress import OnProgress


@dataclass(frozen=True)
class _DataSet:
    """A public archive: a zip file, of which one ``.data`` file is used."""

    url: str
    size_bytes: int
    sha256: str
    member: str
    licence: str


CATALOGUE = {
    "sugiyama2008": _DataSet(
        url="https://mathematical-society-of-traffic-flow.github.io/assets/data/data.zip",
        size_bytes=275_807,
        sha256="751ec706d55b911e775deeb9436f2c340245883a4b7a567206411a1dcdba6fe4",
        member="case1.data",
        licence=(
            "The Mathematical Society of Traffic Flow allows the use of this data for academic research and for"
            " non-commercial purposes. Users cite New J. Phys. 10 (2008) 033001 and New J. Phys. 11 (2009)"
            " 083025. The data may not be passed on to others: give them the address instead."
        ),
    ),
}


_TIMEOUT_S = 20.0
_LONGEST_S = 600.0
_BLOCK = 1 << 16
# Largest file that is unpacked [bytes].
_MAX_UNPACKED = 16 << 20


@dataclass(frozen=True)
class Fetched:
    """Files of a data set: as published, and as a bag."""

    data: Path
    bag: Path


def fetch(
    name: str,
    directory: Path,
    url: str | None = None,
    on_progress: OnProgress | None = None,
    overwrite: bool = False,
) -> Fetched:
    """Download a data set of the catalogue into a directory, verify and unpack it, and convert it to a bag.

    The caller asks the user to accept the licence. A file that is incomplete or wrong is never left under its name.

    Raises InputError, OutputError.
    """
    if name not in CATALOGUE:
        raise InputError(f"{name}: not in the catalogue; it has {', '.join(CATALOGUE)}")
    data_set = CATALOGUE[name]
    directory = Path(directory)
    make_directory(directory)
    data = Output(directory / data_set.member, overwrite)
    bag = Output(data.path.with_suffix(".mcap"), overwrite)
    data.check()
    bag.check()
    archive = io.BytesIO()  # the catalogue says how large it is
    for block in _downloaded(url or data_set.url, data_set, on_progress):
        archive.write(block)
    content = _unpacked(archive, f"{name}.zip", data_set)
    with writing(data) as stream:
        stream.write(content)
    convert(data.path, bag)
    return Fetched(data.path, bag.path)


def _downloaded(url: str, data_set: _DataSet, on_progress: OnProgress | None) -> Iterator[bytes]:
    """Blocks of the file at an address, at most as many bytes as the catalogue states."""
    if not url.startswith(("http://", "https://")):
        raise InputError(f"{url}: not a web address; it must start with https:// or http://")
    received, until = 0, time.monotonic() + _LONGEST_S
    try:
        with urllib.request.urlopen(url, timeout=_TIMEOUT_S) as response:
            while block := response.read1(_BLOCK):
                received += len(block)
                if received > data_set.size_bytes:
                    raise InputError(f"{url}: larger than the {data_set.size_bytes} bytes expected; check the address")
                if time.monotonic() > until:
                    raise InputError(f"{url}: not complete after {_LONGEST_S:g} s; try again with a better connection")
                yield block
                if on_progress:
                    on_progress(received, data_set.size_bytes)
    except urllib.error.HTTPError as error:
        error.close()
        raise InputError(f"{url}: the server answers {error.code} {error.reason}; check the address") from None
    except (OSError, ValueError, http.client.HTTPException) as error:
        reason = getattr(error, "reason", None) or error
        raise InputError(f"{url}: cannot be reached ({reason}); check the network and the address") from None


def _unpacked(archive: BinaryIO, name: str, data_set: _DataSet) -> bytes:
    """Content of the wanted file in a verified archive. Only its content is used, never its path."""
    size, found = archive.seek(0, 2), sha256(archive)
    if (size, found) != (data_set.size_bytes, data_set.sha256):
        raise InputError(
            f"{name}: not the expected file: {size} bytes, SHA-256 {found}; expected {data_set.size_bytes},"
            f" {data_set.sha256}; the download broke off or the file has changed: try again, or report it"
        )
    try:
        with zipfile.ZipFile(archive) as unzipped:
            members = [one for one in unzipped.namelist() if one.endswith(".data")]
            wanted = [one for one in members if one.endswith(data_set.member)]
            if len(wanted) != 1:
                have = ", ".join(members[:20]) or "no .data file"
                raise InputError(f"{name}: has not one {data_set.member} but {have}; report it")
            with unzipped.open(wanted[0]) as member:
                content = member.read(_MAX_UNPACKED + 1)
    except (zipfile.BadZipFile, zlib.error, RuntimeError, NotImplementedError, EOFError) as error:
        raise InputError(f"{name}: cannot be unpacked: {error}; report it") from None
    if len(content) > _MAX_UNPACKED:
        raise InputError(f"{name}: {wanted[0]} has more than {_MAX_UNPACKED} bytes unpacked; not used")
    return content
