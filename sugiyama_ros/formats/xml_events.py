"""Elements of XML files, one after the other, in bounded memory."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import BinaryIO, TypeAlias
from xml.etree import ElementTree

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.reading import open_input

_BLOCK = 1 << 16
Parser: TypeAlias = "ElementTree.XMLPullParser[ElementTree.Element]"


def elements(path: Path, *tags: str) -> Iterator[ElementTree.Element]:
    """Whole elements of some tags, outermost first seen; each is forgotten when the next is asked for.

    Parameters
    ----------
    path : Path
        The file.
    *tags : str
        Tags of the elements, which do not lie inside one another.

    Yields
    ------
    Element
        The element with everything in it.

    Raises
    ------
    InputError
        With the line, for a file that is not XML, declares entities, or has an encoding that Python's parser lacks.
    """
    parser: Parser = ElementTree.XMLPullParser(events=("start", "end"))
    with open_input(path) as stream:
        depth: list[ElementTree.Element] = []
        try:
            for event, element in _events(path, stream, parser):
                if event == "start":
                    depth.append(element)
                    continue
                depth.pop()
                if element.tag in tags:
                    yield element
                if not any(one.tag in tags for one in depth):
                    element.clear()
                    if depth:
                        depth[-1].remove(element)
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


def attribute(attributes: Mapping[str, str], name: str, where: str) -> float:
    """A number among the attributes of an element. Raises InputError."""
    if name not in attributes:
        raise InputError(f"{where}: no attribute {name}; write the file with it")
    try:
        return float(attributes[name])
    except ValueError:
        raise InputError(f"{where}: {name} {attributes[name][:40]!r} is not a number; correct the file") from None
