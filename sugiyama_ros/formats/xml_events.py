"""Elements of XML files, one after the other, in bounded memory."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import BinaryIO, TypeAlias
from xml.etree import ElementTree

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.reading import open_input
from sugiyama_ros.formats.times import seconds_of

_BLOCK = 1 << 16
_MARK = b"\xef\xbb\xbf"
Parser: TypeAlias = "ElementTree.XMLPullParser[ElementTree.Element]"


def root_of(path: Path) -> ElementTree.Element:
    """The first element of an XML file, without what is in it. Raises InputError."""
    parser: Parser = ElementTree.XMLPullParser(events=("start",))
    with open_input(path) as stream:
        try:
            # a comment with all options of a program may come first
            for _, element in _events(path, stream, parser):
                element.tag = _plain(element.tag)
                return element
        except ElementTree.ParseError as error:
            raise InputError(f"{path}:{error.position[0]}: not XML: {error}; correct the file") from None
    raise InputError(f"{path}: not XML: no element; correct the file")


def has_root(head: bytes, path: Path, tag: str) -> bool:
    """Whether a file, of which ``head`` are the first bytes, is XML whose first element has a tag.

    A damaged file counts as one, if the tag is in its first bytes.
    """
    if not head.removeprefix(_MARK).lstrip().startswith(b"<"):
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
                    element.tag = _plain(element.tag)
                    depth.append(element)
                    continue
                depth.pop()
                if len(depth) == 1:
                    if element.tag in tags:
                        yield element
                    element.clear()
                    depth[0].remove(element)
        except ElementTree.ParseError as error:
            raise InputError(f"{path}:{error.position[0]}: not XML: {error}; correct the file") from None


def _events(path: Path, stream: BinaryIO, parser: "Parser") -> Iterator[tuple[str, ElementTree.Element]]:
    while block := stream.read(_BLOCK):
        if b"<!ENTITY" in block or b"<!DOCTYPE" in block:
            raise InputError(f"{path}: declares a document type; remove it")
        try:
            parser.feed(block)
        except (LookupError, ValueError) as error:
            raise InputError(f"{path}: its encoding cannot be read: {error}; save it as UTF-8") from None
        yield from parser.read_events()  # type: ignore[misc]
    parser.close()
    yield from parser.read_events()  # type: ignore[misc]


def _plain(tag: str) -> str:
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
