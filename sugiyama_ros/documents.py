"""The one place that reads documents: JSON and YAML of a bounded size and depth, from regular files."""

import json
import math
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from sugiyama_ros import inputs
from sugiyama_ros.errors import InputError

#: Largest document [bytes], and how deep lists and mappings may lie in one another.
LARGEST_BYTES, DEEPEST = 50_000_000, 32


def read_json(path: Path) -> Any:
    """Read a JSON document. Raises InputError."""
    return parsed(path, json.loads, "JSON")


def read_yaml(path: Path) -> Any:
    """Read a YAML document without aliases. Raises InputError."""
    # Imported here: a document in JSON needs no YAML.
    import yaml

    # libyaml, if it is installed, is ten times faster
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

    def parse(text: str) -> Any:
        try:
            depth = 0
            # The events come one by one. Only the loader below goes into lists within lists, by recursion.
            for event in yaml.parse(text, Loader=loader):
                if isinstance(event, yaml.AliasEvent):
                    raise InputError(f"{path}: has aliases (*name), which are not read; write out what they stand for")
                depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
                if depth > DEEPEST:
                    raise InputError(f"{path}: lists and mappings lie more than {DEEPEST} deep; not read")
            return yaml.load(text, Loader=loader)
        except (yaml.YAMLError, LookupError, TypeError, AttributeError) as error:  # of "!!int ''", LookupError
            raise ValueError("is no YAML") from error

    return parsed(path, parse, "YAML")


def parsed(path: Path, parse: Callable[[str], Any], kind: str) -> Any:
    """Read a file, check its size and depth, and parse it. Raises InputError."""
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: not a regular file; give a file")
        with path.open("rb") as stream:
            inputs.note(stream.fileno())
            content = stream.read(LARGEST_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}; check the name and the permissions") from None
    if len(content) > LARGEST_BYTES:
        raise InputError(f"{path}: larger than {LARGEST_BYTES // 1_000_000} MB; is it the right file?")
    try:
        return parse(content.decode())
    except (ValueError, OverflowError, RecursionError):
        raise InputError(f"{path}: is no {kind}; give a file that sugiyama has written") from None


def number(value: Any, where: str) -> float:
    """Return a finite number of a document. Raises InputError."""
    if isinstance(value, int | float | str) and not isinstance(value, bool):
        with suppress(OverflowError, ValueError):
            found = float(value)
            if math.isfinite(found):
                return found
    raise InputError(f"{where}: {str(value)[:40]!r} is no finite number; correct it")
