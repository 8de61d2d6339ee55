"""Mutations that know the grammar of a file: fields and lines of a text, nodes of a document, records of a bag."""

import copy
import re
import struct
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import zstandard
from hypothesis import strategies as st

from sugiyama_ros.formats.mcap_records import HEAD, MAGIC

#: What a field may become.
_FIELDS = (
    *("", "0", "-0.0", "-1", "1e308", "-1e308", "1e-308", "1e400", "nan", "inf", "-inf", "NaN", "null", "true"),
    *("9" * 19, "9" * 400, "18446744073709551616", "-9223372036854775809", "1_000", "0x10", "1,5", "1.5.5", "٣", "½"),
    *('"', "'", "\x00", "\ufeff", "\r", "\t", " ", ";", ",", "#", "&", "<", ">", "[", "{", "}", "*a", "&a", "-", ":"),
    *("a" * 5000, "../../etc/passwd", "/dev/zero", "%s", "\ud7ff", "veh_1", "12.0", "2024-01-01T00:00:00Z"),
)
#: What a node of a document may become.
_NODES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2**31, 2**63, -(2**63) - 1, 10**400, 0.0, -0.0, 1e308, -1e308, 1e-320, 0.5),
    *(float("nan"), float("inf"), "", "x", "nan", "1e999", "\x00", "a" * 5000, [], {}, [[]], [None], {"": None}),
    *({"x": {"x": {"x": []}}}, [1e308] * 50, ["x"] * 50),
)
_NUMBERS = tuple(
    pattern
    for value in (0, 1, 2, 255, 2**15, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1)
    for pattern in (struct.pack("<Q", value), struct.pack("<I", value & 0xFFFFFFFF), bytes([value & 255]))
) + tuple(struct.pack("<d", value) for value in (float("nan"), float("inf"), -1.0, 1e308, 0.0, 5e-324))
_TOKEN = re.compile(r"[^\s,;<>=\"'\[\]{}:]+")
_Place = st.floats(0.0, 1.0, exclude_max=True)


class Edit(NamedTuple):
    """One change: what is done, where (as a part of the whole), and what comes there."""

    act: str
    place: float
    what: Any


def _edits(acts: tuple[str, ...], what: Any) -> st.SearchStrategy[list[Edit]]:
    return st.lists(st.builds(Edit, st.sampled_from(acts), _Place, st.sampled_from(what)), min_size=1, max_size=4)


def _token(text: str, edit: Edit) -> str:
    tokens = list(_TOKEN.finditer(text))
    if not tokens:
        return text + str(edit.what)
    one = tokens[int(edit.place * len(tokens))]
    more = one.group() + " " + edit.what if edit.act == "token twice" else edit.what
    return text[: one.start()] + more + text[one.end() :]


def _lines(text: str, edit: Edit) -> str:
    lines = text.split("\n")
    k = int(edit.place * len(lines))
    match edit.act:
        case "line away":
            del lines[k]
        case "line twice":
            lines.insert(k, lines[k])
        case "lines swapped":
            lines[k - 1 : k + 1] = lines[k - 1 : k + 1][::-1]
        case "line":
            lines[k] = edit.what
    return "\n".join(lines)


def _bytes(data: bytes, edit: Edit) -> bytes:
    k = int(edit.place * (len(data) + 1))
    match edit.act:
        case "cut":
            return data[:k]
        case "bytes":
            return data[:k] + edit.what + data[k + len(edit.what) :]
        case "more bytes":
            return data[:k] + edit.what + data[k:]
    return data


_BYTES = ("cut", "bytes", "more bytes")


def binaries(data: bytes) -> st.SearchStrategy[bytes]:
    """Bytes that are cut, replaced or inserted."""

    def change(edits: list[Edit]) -> bytes:
        changed = data
        for edit in edits:
            changed = _bytes(changed, edit)
        return changed

    return _edits(_BYTES, _NUMBERS).map(change)


def texts(text: str) -> st.SearchStrategy[bytes]:
    """A text with fields and lines that are replaced, repeated, swapped or missing; or with damaged bytes."""
    acts = ("token", "token", "token", "token twice", "line", "line away", "line twice", "lines swapped")

    def change(edits: list[Edit]) -> bytes:
        changed = text
        for edit in edits:
            changed = _token(changed, edit) if edit.act.startswith("token") else _lines(changed, edit)
        return changed.encode("utf-8", errors="surrogatepass")

    return _edits(acts, _FIELDS).map(change) | binaries(text.encode())


def _paths(node: Any, here: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if here:
        yield here
    for key, below in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        yield from _paths(below, (*here, key))


def documents(document: Any, dump: Callable[[Any], str]) -> st.SearchStrategy[bytes]:
    """A document with nodes that are replaced, repeated or missing; or with damaged text."""

    def change(edits: list[Edit]) -> bytes:
        changed = copy.deepcopy(document)
        for edit in edits:
            paths = list(_paths(changed))
            if not paths:
                break
            *above, key = paths[int(edit.place * len(paths))]
            node = changed
            for step in above:
                node = node[step]
            if edit.act == "node":
                node[key] = copy.deepcopy(edit.what)
            elif edit.act == "node away":
                del node[key]
            elif isinstance(node, list):
                node.append(copy.deepcopy(node[key]))
            else:
                node[str(edit.what)[:20]] = copy.deepcopy(node[key])
        return dump(changed).encode()

    return _edits(("node", "node", "node away", "node twice"), _NODES).map(change) | texts(dump(document))


def _records(data: bytes) -> list[tuple[int, bytes]]:
    found, at = [], 0
    while at + HEAD.size <= len(data):
        kind, length = HEAD.unpack_from(data, at)
        found.append((kind, data[at + HEAD.size : at + HEAD.size + length]))
        at += HEAD.size + length
    return found


def _joined(records: list[tuple[int, bytes]]) -> bytes:
    return b"".join(HEAD.pack(kind, len(body)) + body for kind, body in records)


def _record(records: list[tuple[int, bytes]], edit: Edit) -> None:
    if not records:
        return
    k = int(edit.place * len(records))
    kind, body = records[k]
    match edit.act:
        case "record away":
            del records[k]
        case "record twice":
            records.insert(k, records[k])
        case "kind":
            records[k] = (edit.what[0] % 17, body)
        case "records swapped":
            records[k - 1 : k + 1] = records[k - 1 : k + 1][::-1]
        case "body":
            within = edit.place * len(records) - k
            records[k] = (kind, _bytes(body, Edit("bytes", within, edit.what)))


def bags(data: bytes) -> st.SearchStrategy[bytes]:
    """A bag whose records are changed, at the top level and within its chunks; or with damaged bytes."""
    acts = ("record away", "record twice", "kind", "records swapped", "body", "body", "body")

    def change(inside: list[Edit], edits: list[Edit]) -> bytes:
        records = _records(data[len(MAGIC) : -len(MAGIC)])
        for k, (kind, body) in enumerate(records):
            if kind == 6:
                records[k] = (kind, _chunk(body, inside))
        for edit in edits:
            _record(records, edit)
        return MAGIC + _joined(records) + MAGIC

    edits = _edits(acts, _NUMBERS)
    return st.builds(change, edits, st.just([]) | edits) | binaries(data)


def _chunk(body: bytes, edits: list[Edit]) -> bytes:
    """A chunk with changed records, compressed anew, without a checksum."""
    name = struct.unpack_from("<I", body, 28)[0]
    content = body[32 + name + 8 :]
    if body[32 : 32 + name] == b"zstd":
        content = zstandard.ZstdDecompressor().decompress(content, max_output_size=1 << 26)
    records = _records(content)
    for edit in edits:
        _record(records, edit)
    content = _joined(records)
    packed = zstandard.compress(content)
    times = body[:16]
    return times + struct.pack("<QI", len(content), 0) + struct.pack("<I4sQ", 4, b"zstd", len(packed)) + packed
