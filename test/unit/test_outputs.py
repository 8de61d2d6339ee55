"""Files are written in one place: what it refuses, and that every failure leaves the old or the new file whole."""

import os
import socket
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from sugiyama_ros import files
from sugiyama_ros.errors import OutputError
from sugiyama_ros.files import Output, name_of_part, read_yaml, writing
from sugiyama_ros.formats.reading import open_input

OLD = b"old, and whole"


def write(output: Output, content: bytes = b"new") -> None:
    with writing(output) as stream:
        stream.write(content)


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def make_fifo(path: Path) -> None:
    os.mkfifo(path)


def make_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        here = Path.cwd()
        os.chdir(path.parent)  # the name of a socket may not be long
        try:
            made.bind(path.name)
        finally:
            os.chdir(here)


def make_link(path: Path) -> None:
    (path.parent / "elsewhere").write_bytes(OLD)
    path.symlink_to("elsewhere")


def make_dangling_link(path: Path) -> None:
    path.symlink_to("nowhere")


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (make_fifo, "a pipe"),
        (make_socket, "a socket"),
        (make_link, "a link"),
        (make_dangling_link, "a link"),
        (Path.mkdir, "a directory"),
    ],
)
def test_what_is_no_regular_file_is_refused_and_stays(tmp_path: Path, make: Callable[[Path], Any], what: str) -> None:
    path = tmp_path / "out.csv"
    make(path)
    before, kind = names(tmp_path), path.lstat().st_mode
    with pytest.raises(OutputError, match=f"is {what}; give the name of a file"):
        write(Output(path, overwrite=True))
    assert (names(tmp_path), path.lstat().st_mode) == (before, kind)


def test_devices_are_refused() -> None:
    with pytest.raises(OutputError, match="is a device"):
        write(Output(Path("/dev/full"), overwrite=True))
    assert stat.S_ISCHR(Path("/dev/full").stat().st_mode)


def test_a_file_that_was_read_on_the_way_is_never_written(tmp_path: Path) -> None:
    """Metadata beside the tracks, a map of columns, a file of a folder; but what the command wrote itself may go."""
    with files.remembered():
        for name, read in (("a.yaml", read_yaml), ("b.csv", lambda path: open_input(path).close())):
            (tmp_path / name).write_bytes(OLD)
            read(tmp_path / name)
            (tmp_path / f"link.{name}").hardlink_to(tmp_path / name)
            for known in (name, f"link.{name}"):
                with pytest.raises(OutputError, match="is also read by this command"):
                    write(Output(tmp_path / known, overwrite=True))
                assert (tmp_path / known).read_bytes() == OLD
        own = Output(tmp_path / "own.csv", overwrite=True)
        for content in (b"first", b"second"):
            write(own, content)
            open_input(own.path).close()
        assert own.path.read_bytes() == b"second"
    write(Output(tmp_path / "b.csv", overwrite=True))  # nothing is remembered after the command


def test_a_file_that_appears_in_the_meantime_stays_and_nothing_is_lost(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"

    def write_while_it_appears() -> None:
        with writing(Output(path)) as stream:
            stream.write(b"new")
            path.write_bytes(OLD)

    with pytest.raises(OutputError, match="what was written is in") as caught:
        write_while_it_appears()
    assert path.read_bytes() == OLD
    (part,) = tmp_path.glob("*.part")
    assert part.read_bytes() == b"new"
    assert str(part) in str(caught.value)


def test_the_file_has_the_usual_permissions(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write(Output(tmp_path / "out.csv"))
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "out.csv").stat().st_mode) == 0o640


@pytest.mark.parametrize(
    ("part", "name"),
    [("a.mcap.3f9a1c07.part", "a.mcap"), ("a.mcap.part", "a.mcap"), ("a.mcap", None), (".part", None)],
)
def test_the_name_of_an_unfinished_file(part: str, name: str | None) -> None:
    assert name_of_part(Path("folder") / part) == (Path("folder") / name if name else None)
