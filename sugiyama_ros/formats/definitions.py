"""Texts of ROS message definitions, from the message packages that are installed."""

import json
import os
import re
import sys
from functools import cache
from pathlib import Path

from sugiyama_ros.errors import InputError

_SEPARATOR = "=" * 80
_TYPE = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*")
_FIELD = re.compile(r"\s*([A-Za-z][A-Za-z0-9_/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]")
_PRIMITIVE = {"bool", "byte", "char", "float32", "float64", "string", "wstring"} | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}


@cache
def full_text(type_name: str) -> str:
    """Definition of a message and of all types in it, in MCAP's schema encoding ``ros2msg``.

    type_name: name of the type, such as ``std_msgs/msg/Header``. Raises InputError.
    """
    texts: dict[str, str] = {}
    _collect(type_name, texts)
    first, *others = texts.items()
    return "\n".join([first[1], *(f"{_SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n{text}" for name, text in others)])


@cache
def type_hash(type_name: str) -> str:
    """Hash (RIHS01) of a message type, as its package states it; empty if it states none."""
    path = _file(type_name).with_suffix(".json")
    if not path.is_file():
        return ""
    for entry in json.loads(path.read_text())["type_hashes"]:
        if entry["type_name"] == type_name:
            return str(entry["hash_string"])
    return ""


def _collect(type_name: str, texts: dict[str, str]) -> None:
    """Add the definition of ``type_name`` and of all types in it to ``texts``, depth first."""
    texts[type_name] = _file(type_name).read_text()
    package = type_name.partition("/")[0]
    for line in texts[type_name].splitlines():
        field = _FIELD.match(line)
        if field is None or field[1] in _PRIMITIVE:
            continue
        used_package, _, name = field[1].rpartition("/")
        used = f"{used_package.removesuffix('/msg') or package}/msg/{name}"
        if used not in texts:
            _collect(used, texts)


def _file(type_name: str) -> Path:
    """File with the definition of a message type."""
    if not _TYPE.fullmatch(type_name):
        raise InputError(f"{type_name}: not the name of a message type; write package/msg/Name")
    package, _, name = type_name.split("/")
    # An installed ROS 2 names its prefixes in the environment. The wheels install below the interpreter's prefix.
    prefixes = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    for prefix in [*prefixes, sys.prefix]:
        path = Path(prefix, "share", package, "msg", f"{name}.msg")
        if path.is_file():
            return path
    ours = package == "sugiyama_msgs"
    cure = "run `pip install ./msg_defs`, or build and source the workspace" if ours else "install it"
    raise InputError(f"{type_name}: message package {package} is not installed; {cure}")
