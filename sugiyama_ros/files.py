"""The one place that reads documents and opens files for writing.

A file is written under a random name beside its own name, such as ``out.csv.3f9a1c07.part``. It is flushed to the disk
and renamed at the end. After an error, the file under the name is the old one, whole, or none.

A command never writes to a file that it was given or has read, such as metadata beside it or a file of a folder. Only
the command line remembers which files these are; in a notebook, a file that was read may be written.
"""

import json
import math
import os
import re
import secrets
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from sugiyama_ros.errors import InputError, OutputError, cure_of_place

# Largest document [bytes], and how deep lists and mappings may lie in one another.
_LARGEST_BYTES, _DEEPEST = 50_000_000, 32
# Longest part [bytes] of a name that is kept in the name of the unfinished file; file systems allow 255 in all.
_MOST_OF_A_NAME = 235
_PART = re.compile(r"(?P<name>.+?)(?:\.[0-9a-f]{8})?\.part", re.DOTALL)
_KINDS = {
    stat.S_IFDIR: "a directory",
    stat.S_IFLNK: "a link",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}

# A file is its device and its number there, whatever its names.
_Key = tuple[int, int]
_read: set[_Key] = set()
_own: set[_Key] = set()
_remembers = False


@contextmanager
def remembered() -> Iterator[None]:
    """Remember which files are read in the block, and forget them at its end; a command runs in such a block."""
    global _remembers
    _remembers = True
    try:
        yield
    finally:
        _remembers = False
        _read.clear()
        _own.clear()


def note(number: int) -> None:
    """Note that the program reads the file with a descriptor. A file that it has written itself does not count."""
    if _remembers and (key := _key(os.fstat(number))) not in _own:
        _read.add(key)


def note_given(path: Path) -> None:
    """Note that somebody has given a file as an input, whether the program reads it or not."""
    if _remembers:
        with suppress(OSError, ValueError):
            about = path.stat()
            if stat.S_ISREG(about.st_mode):
                _read.add(_key(about))


def _key(about: os.stat_result) -> _Key:
    return about.st_dev, about.st_ino


def read_json(path: Path) -> Any:
    """Read a JSON document. Raises InputError, also for a name that comes twice in an object."""

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name, value in pairs:
            if name in found:
                raise InputError(f"{path}: {name[:40]!r} is given twice; give it once")
            found[name] = value
        return found

    def parse(text: str) -> Any:
        try:
            return json.loads(text, object_pairs_hook=once)
        except json.JSONDecodeError as error:
            raise _not(path, "JSON", error.lineno, error.msg) from None

    return _parsed(path, parse, "JSON")


def read_yaml(path: Path) -> Any:
    """Read a YAML document without aliases. Raises InputError, also for a key that comes twice in a mapping."""
    # Imported here: a document in JSON needs no YAML.
    import yaml

    # libyaml, if it is installed, is ten times faster
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

    def check(text: str) -> None:
        # Of each open collection: the keys so far, none of a list, and whether a key comes next.
        keys: list[set[str] | None] = []
        is_key: list[bool] = []
        # The events come one by one. Only the loader below goes into lists within lists, by recursion.
        for event in yaml.parse(text, Loader=loader):
            if isinstance(event, yaml.AliasEvent):
                raise InputError(f"{path}: has aliases (*name), which are not read; write out what they stand for")
            if isinstance(event, yaml.CollectionEndEvent):
                keys.pop(), is_key.pop()
            if not isinstance(event, yaml.NodeEvent):
                continue
            if keys and (seen := keys[-1]) is not None:
                if is_key[-1] and isinstance(event, yaml.ScalarEvent):
                    if event.value in seen:
                        line = event.start_mark.line + 1 if event.start_mark else 0
                        raise InputError(f"{path}:{line}: {event.value[:40]!r} is given twice; give it once")
                    seen.add(event.value)
                is_key[-1] = not is_key[-1]
            if isinstance(event, yaml.CollectionStartEvent):
                keys.append(set() if isinstance(event, yaml.MappingStartEvent) else None)
                is_key.append(True)
            if len(keys) > _DEEPEST:
                raise InputError(f"{path}: lists and mappings lie more than {_DEEPEST} deep; not read")

    def parse(text: str) -> Any:
        try:
            check(text)
            return yaml.load(text, Loader=loader)
        except yaml.MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            raise _not(path, "YAML", mark.line + 1 if mark else 0, error.problem or error.context or "") from None
        except yaml.YAMLError as error:
            raise _not(path, "YAML", 0, getattr(error, "reason", "")) from None
        except (ValueError, LookupError, TypeError, AttributeError):  # of "2001-99-99", "!!int ''"
            raise _not(path, "YAML", 0, "a date, or a value with a tag (!!), is none") from None

    return _parsed(path, parse, "YAML")


def _not(path: Path, kind: str, line: int, why: str) -> InputError:
    """The error to raise for a document that is not of a kind, in a line if that is known."""
    return InputError(f"{path}{f':{line}' if line else ''}: is no {kind}: {why or 'damaged'}; correct it")


def _parsed(path: Path, parse: Callable[[str], Any], kind: str) -> Any:
    """Read a file, check its size and depth, and parse it. Raises InputError."""
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: not a regular file; give a file")
        with path.open("rb") as stream:
            note(stream.fileno())
            content = stream.read(_LARGEST_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}; check the name and the permissions") from None
    if len(content) > _LARGEST_BYTES:
        raise InputError(f"{path}: larger than {_LARGEST_BYTES // 1_000_000} MB; is it the right file?")
    try:
        return parse(content.decode())
    except (ValueError, OverflowError, RecursionError):
        raise InputError(f"{path}: is no {kind} in UTF-8; give a file that sugiyama has written") from None


def number(value: Any, where: str) -> float:
    """Return a finite number of a document. Raises InputError."""
    if isinstance(value, int | float | str) and not isinstance(value, bool):
        with suppress(OverflowError, ValueError):
            found = float(value)
            if math.isfinite(found):
                return found
    raise InputError(f"{where}: {str(value)[:40]!r} is no finite number; correct it")


@dataclass(frozen=True)
class Output:
    """A file to write.

    path: the file; overwrite: whether a regular file of this name is replaced; may_be_read: whether that may be a file
    which this command has read.
    """

    path: Path
    overwrite: bool = False
    may_be_read: bool = False

    def check(self) -> None:
        """Check that the file may be written. A command that takes long calls this first. Raises OutputError."""
        if not _is_there(self.path):
            if not os.access(self.path.parent, os.W_OK | os.X_OK):
                reason = "Permission denied" if self.path.parent.is_dir() else "No such directory"
                raise OutputError(f"{self.path}: cannot be written: {reason}; choose another place")
            return
        if not self.may_be_read and _read and _key(self.path.stat()) in _read:
            raise OutputError(f"{self.path}: is also read by this command; give another name for the output")
        if not self.overwrite:
            raise _exists(self.path)


#: What the functions that write accept. A plain path stands for an output that may be replaced.
Target = Path | Output


def output_of(target: Target) -> Output:
    """Return the output for a target; a regular file under a plain path is replaced."""
    return target if isinstance(target, Output) else Output(Path(target), overwrite=True, may_be_read=True)


class Draft:
    """A file that is being written, under a random name beside its own.

    target: the file; path, part: the file, and the unfinished file; stream: where to write. Raises OutputError.
    """

    def __init__(self, target: Target) -> None:
        self._output = output_of(target)
        self.path = self._output.path
        self._output.check()
        try:
            self.part, self.stream = _begun(self.path)
        except (OSError, ValueError) as error:
            raise not_written(self.path, error) from None

    def sync(self) -> None:
        """Bring everything to the disk."""
        self.stream.flush()
        os.fsync(self.stream.fileno())

    def finish(self) -> None:
        """Bring everything to the disk, and give the file its name. Raises OutputError."""
        self.sync()
        if _remembers:
            _own.add(_key(os.fstat(self.stream.fileno())))
        self.stream.close()
        try:
            self._output.check()
            if self._output.overwrite:
                self.part.replace(self.path)
            else:
                _name_new(self.part, self.path)
        except OutputError as error:
            raise OutputError(f"{error}; what was written is in {self.part}") from None
        _sync_folder(self.path.parent)

    def discard(self) -> None:
        """Remove what was written."""
        self.close()
        with suppress(OSError):
            self.part.unlink(missing_ok=True)

    def close(self) -> None:
        """Close the unfinished file, and leave it where it is."""
        # A full disk refuses the rest of the buffer, but the file is closed.
        with suppress(OSError):
            self.stream.close()


@contextmanager
def writing(target: Target) -> Iterator[BinaryIO]:
    """Write a file that gets its name when the block ends, and is removed if the block fails. Raises OutputError.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> path = Path(mkdtemp()) / "a.txt"
    >>> with writing(path) as stream:
    ...     _ = stream.write(b"whole")
    >>> path.read_text()
    'whole'
    """
    draft = Draft(target)
    try:
        yield draft.stream
        draft.finish()
    except OutputError:
        if not draft.stream.closed:
            draft.discard()
        raise
    except OSError as error:
        draft.discard()
        raise not_written(draft.path, error) from None
    except BaseException:
        draft.discard()
        raise


def not_written(path: Path, error: OSError | ValueError) -> OutputError:
    """Return the error to raise for a place that cannot be written."""
    reason = getattr(error, "strerror", None) or error
    return OutputError(f"{path}: cannot be written: {reason}; {cure_of_place(error)}")


def make_directory(path: Path) -> None:
    """Make a directory if it does not exist. Raises OutputError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise not_written(path, error) from None


def name_of_part(part: Path) -> Path | None:
    """Return the name that an unfinished file would have got; None if it is no unfinished file.

    part: such as ``out.mcap.3f9a1c07.part``.
    """
    found = _PART.fullmatch(part.name)
    return part.with_name(found["name"]) if found else None


def _is_there(path: Path) -> bool:
    """Whether a regular file of the name exists. Raises OutputError for anything else of the name."""
    try:
        kind = stat.S_IFMT(path.lstat().st_mode)
    except FileNotFoundError:
        return False
    except (OSError, ValueError) as error:
        raise not_written(path, error) from None
    if kind != stat.S_IFREG:
        raise OutputError(f"{path}: is {_KINDS.get(kind, 'no regular file')}; give the name of a file")
    return True


def _exists(path: Path) -> OutputError:
    return OutputError(f"{path}: exists already; choose another name, or replace it with --overwrite")


def _begun(path: Path) -> tuple[Path, BinaryIO]:
    """A new file beside ``path``, which nobody else has."""
    name = os.fsdecode(os.fsencode(path.name)[:_MOST_OF_A_NAME])
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    while True:
        part = path.with_name(f"{name}.{secrets.token_hex(4)}.part")
        with suppress(FileExistsError):
            number = os.open(part, flags, 0o666)
            break
    try:
        return part, os.fdopen(number, "w+b")
    except OSError:
        os.close(number)
        part.unlink()
        raise


def _name_new(part: Path, path: Path) -> None:
    """Rename ``part``; raises OutputError instead of replacing a file."""
    try:
        os.link(part, path, follow_symlinks=False)
    except FileExistsError:
        raise _exists(path) from None
    except OSError:  # a file system without hard links; whether the name is free was checked a moment ago
        part.replace(path)
    else:
        with suppress(OSError):
            part.unlink()


def _sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk, on file systems that can."""
    with suppress(OSError):
        number = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(number)
        finally:
            os.close(number)
