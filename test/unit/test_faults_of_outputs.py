"""Fault injection: every call to the operating system fails once, on every way to a file.

After any failure, a name has the old file or the new file, whole, and nothing else is left behind.
"""

import ast
import errno
import hashlib
import io
import os
import shutil
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sugiyama_ros.errors import OutputError
from sugiyama_ros.files import Output, Target, output_of, writing
from sugiyama_ros.filters.online import Learnt
from sugiyama_ros.formats.convert import write_bag
from sugiyama_ros.formats.fetch import CATALOGUE, fetch
from sugiyama_ros.formats.mcap_reader import METADATA, Bag, bag_files
from sugiyama_ros.formats.mcap_writer import FolderWriter, Qos
from sugiyama_ros.formats.measured import MEASURED_TYPE, messages
from sugiyama_ros.formats.recover import recover
from sugiyama_ros.formats.tracks_parquet import write_tracks
from sugiyama_ros.nodes.keeper import Kept, write_learnt
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.dense import DenseTracks, tracks_of

OLD = b"old, and whole"
PACKAGE = Path(__file__).parents[2] / "sugiyama_ros"
#: Files that may open others for writing: the one place, closed standard streams, and logs and pages of the
#: developers in folders of their own.
OTHERS = {
    "files.py",
    "cli/__init__.py",
    "formats/mcap_records.py",
}


def ring(steps: int = 200) -> DenseTracks:
    position = np.arange(steps)[:, None] * 0.5 + np.array([0.0, 30.0, 60.0])
    return DenseTracks(position % 100.0, np.full(3, 4.5), np.arange(3), Road(100.0), 0.5, 0.0, "model", "ab")


KEPT = Kept(Learnt(("v_star",), np.array([2.0]), np.array([[0.1]])), 5)


class Disk:
    """Counts the calls that may fail, and lets call number ``failing`` fail."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, failing: int) -> None:
        self.calls: list[str] = []
        self._failing = failing
        for name in ("fsync", "link", "open", "fdopen", "mkdir"):
            monkeypatch.setattr(os, name, self._fails(name, getattr(os, name)))
        monkeypatch.setattr(Path, "replace", self._fails("replace", Path.replace))

    def _call(self, name: str) -> None:
        self.calls.append(name)
        if len(self.calls) - 1 == self._failing:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def _fails(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            self._call(name)
            made = function(*arguments, **options)
            return Stream(made, self._call) if name == "fdopen" else made

        return call


class Stream:
    """A file whose writes may fail: half of the data is written then, as on a disk that is full."""

    def __init__(self, stream: Any, call: Callable[[str], None]) -> None:
        self._stream, self._call = stream, call

    def write(self, data: bytes) -> int:
        try:
            self._call("write")
        except OSError:
            self._stream.write(memoryview(data)[: len(data) // 2])
            self._stream.flush()
            raise
        return int(self._stream.write(data))

    def flush(self) -> None:
        self._call("flush")
        self._stream.flush()

    def truncate(self) -> int:
        self._call("truncate")
        return int(self._stream.truncate())

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def failures(write: Callable[[], object], before: Callable[[], None]) -> Iterator[tuple[str, bool]]:
    """Write again and again, each time with another call that fails; yields the call, and whether an error came."""
    failing = 0
    while True:
        before()
        with pytest.MonkeyPatch.context() as monkeypatch:
            disk = Disk(monkeypatch, failing)
            try:
                write()
                error = False
            except OutputError:
                error = True
        if len(disk.calls) <= failing:
            return
        yield disk.calls[failing], error
        failing += 1


def recovered(target: Target) -> None:
    """Recover a bag, which is beside the target."""
    source = output_of(target).path.with_name("source.mcap")
    if not source.exists():
        write_bag(ring(30), source)
    recover(source, target)


def plain(target: Target) -> None:
    with writing(target) as stream:
        stream.write(b"new" * 1000)


#: The kinds of files: all others are written as the plain one is.
WRITERS: dict[str, Callable[[Target], object]] = {
    "plain": plain,
    "bag": lambda target: write_bag(ring(), target),
    "parquet": lambda target: write_tracks(tracks_of(ring(20)), target),
    "state": lambda target: write_learnt(output_of(target).path, KEPT),
    "recover": recovered,
}


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("writer", WRITERS)
def test_every_failure_leaves_the_old_or_the_new_file_whole(tmp_path: Path, writer: str, overwrite: bool) -> None:
    path = tmp_path / f"out{Path(writer).suffix}"
    write = WRITERS[writer]
    write(Output(path))
    new, beside = path.read_bytes(), sorted(one.name for one in tmp_path.iterdir() if one != path)
    replaces = overwrite or writer == "state"  # a file of its own

    def before() -> None:
        path.unlink(missing_ok=True)
        if overwrite:
            path.write_bytes(OLD)

    seen = set()
    for call, error in failures(lambda: write(Output(path, overwrite)), before):
        seen.add(call)
        there = path.read_bytes() if path.exists() else None
        assert there in ((OLD, new) if overwrite else (None, new)), call
        assert (there == new) == (not error), call
        assert sorted(one.name for one in tmp_path.iterdir() if one != path) == beside, call
    assert path.read_bytes() == new
    assert seen >= {"open", "fdopen", "write", "flush", "fsync", "replace" if replaces else "link"}


@pytest.mark.parametrize("overwrite", [False, True])
def test_every_failure_of_a_fetch_leaves_whole_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, overwrite: bool
) -> None:
    """Both files are old or new, the bag is new only beside new data, and the user's archive of the name stays."""
    data = b"# circuit length is 100m.\n1.0 0.0\n2.0 0.5\n3.0 1.0\n\n50.0 0.0\n51.0 0.5\n52.0 1.0\n"
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as packed:
        packed.writestr("case1.data", data)
    content = archive.getvalue()
    entry = replace(
        CATALOGUE["sugiyama2008"], size_bytes=len(content), sha256=hashlib.sha256(content).hexdigest()
    )  # fmt: skip
    monkeypatch.setitem(CATALOGUE, "sugiyama2008", entry)
    monkeypatch.setattr("urllib.request.urlopen", lambda *_, **__: io.BytesIO(content))
    folder = tmp_path / "data"

    def before() -> None:
        if not overwrite:
            shutil.rmtree(folder, ignore_errors=True)
            return
        folder.mkdir(exist_ok=True)
        for name in ("case1.data", "case1.mcap", "sugiyama2008.zip"):
            (folder / name).write_bytes(OLD)

    def there() -> dict[str, bytes]:
        return {one.name: one.read_bytes() for one in folder.iterdir()} if folder.exists() else {}

    before()
    old = there()
    fetch("sugiyama2008", folder, overwrite=True)
    new, seen = there(), set()
    for call, error in failures(lambda: fetch("sugiyama2008", folder, overwrite=overwrite), before):
        seen.add(call)
        found = there()
        assert found in (old, old | {"case1.data": data}, new), call
        assert (found == new) == (not error), call
    assert there() == new
    assert seen >= {"open", "write", "flush", "fsync", "replace" if overwrite else "link", "mkdir"}


def test_a_directory_of_rosbag2_holds_whole_files_alone(tmp_path: Path) -> None:
    """After any failure, each file with a name can be read, and metadata.yaml is there only beside all files."""
    given = [(stamp, data) for kind, stamp, data in messages(ring(60)) if kind == MEASURED_TYPE]
    at = iter(range(1000))
    folder = tmp_path / "0"

    def before() -> None:
        nonlocal folder
        folder = tmp_path / str(next(at))

    def write() -> None:
        with FolderWriter(folder, split_bytes=2000) as bag:
            topic = bag.topic("/measured", MEASURED_TYPE, Qos())
            for number, (stamp, data) in enumerate(given):
                bag.write(topic, data, stamp, stamp)
                if number % 20 == 19:
                    bag.flush()

    written = 0
    for call, error in failures(write, before):
        whole = sorted(folder.glob("*.mcap")) if folder.exists() else []
        found = 0
        for path in whole:
            with Bag(path) as one:
                found += sum(1 for _ in one.messages())
        if (folder / METADATA).exists():
            assert (bag_files(folder), found) == (whole, len(given)), call
        assert error == (found < len(given) or not (folder / METADATA).exists()), call
        for part in folder.glob("*.part") if folder.exists() else ():  # what was flushed before the failure
            saved = recover(part, folder / "saved.mcap")
            found += saved.messages
        written = max(written, found)
    assert written == len(given)
    assert len(bag_files(folder)) > 1


def writes(call: ast.Call) -> bool:
    """Whether a call opens a file for writing, or gives a file a name."""
    called = call.func
    name = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")
    is_os = isinstance(called, ast.Attribute) and getattr(called.value, "id", "") == "os"
    values = [getattr(one, "value", None) for one in (*call.args, *(keyword.value for keyword in call.keywords))]
    mode = any(isinstance(v, str) and set(v) <= set("rwaxbt+") and set(v) & set("wax+") for v in values)
    to_stream = any(getattr(one, "id", "") in ("stream", "file") for one in call.args)
    return (
        (name == "open" and (mode or is_os))
        or name in ("write_text", "write_bytes", "mkstemp", "copyfile", "touch", "TemporaryFile", "NamedTemporaryFile")
        or (name in ("savefig", "imsave", "write_table", "to_csv", "to_parquet") and call.args and not to_stream)
        or (is_os and name in ("rename", "replace", "link", "truncate", "fdopen"))
    )


def calls(tree: ast.AST) -> Iterator[ast.Call]:
    return (node for node in ast.walk(tree) if isinstance(node, ast.Call))


TREES = {str(path.relative_to(PACKAGE)): ast.parse(path.read_text()) for path in PACKAGE.rglob("*.py")}


def test_only_one_place_opens_files_for_writing() -> None:
    assert {name for name, tree in TREES.items() if any(map(writes, calls(tree)))} == OTHERS


def test_writing_is_always_the_head_of_a_with_statement() -> None:
    """So a failure of any kind removes what was begun."""
    for name, tree in TREES.items():
        heads = [item.context_expr for node in ast.walk(tree) if isinstance(node, ast.With) for item in node.items]
        for call in calls(tree):
            assert getattr(call.func, "id", "") != "writing" or call in heads, name
