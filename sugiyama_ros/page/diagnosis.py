"""The document of a diagnosis, as the report needs it: read and checked field by field."""

import re
import shlex
from collections.abc import Mapping
from dataclasses import is_dataclass
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

from sugiyama_ros.errors import InputError
from sugiyama_ros.files import number, read_json
from sugiyama_ros.trajectories.about import file_in
from sugiyama_ros.trajectories.dense import DenseTracks

_KINDS = {str: "a text", bool: "true or false", dict: "a mapping", list: "a list"}
_ERROR = re.compile(r"one_step_rmse_m|loglik_per_sample|(free_run|single_car)_\d+(\.\d+)?s(_crps)?_m")


def _fields() -> dict[str, Any]:
    """Types of the fields that the report shows. A mapping has these names, at least."""
    from sugiyama_ros.diagnosis.check import Check
    from sugiyama_ros.page.document import Addition, Dropped, Tried

    return {
        "verdict": {"outcome": str, "effects": list[Addition], "dropped": list[Dropped]},
        "candidates": list[Tried],
        "checks": list[Check],
        "smallest_detectable": list[dict[str, Any]],
        "errors": {"before": dict[str, Any], "after": dict[str, Any]},
        "drivers": list[dict[str, Any]],
    }


def read_diagnosis(path: Path) -> dict[str, Any]:
    """Read a document that ``sugiyama diagnose --save`` wrote. Raises InputError."""
    document: dict[str, Any] = read_json(path)
    try:
        _check(document, _fields(), "document")
        for model, errors in document["errors"].items():
            _check(errors, dict[str, Any], f"errors.{model}")
            for name in filter(_ERROR.fullmatch, errors):
                _check(errors[name], float | None, f"errors.{model}.{name}")
        for k, one in enumerate(document["drivers"]):
            ends = dict.fromkeys((f"single_car_10s_{when}_m" for when in ("before", "after")), float | None)
            _check(one, {"vehicle": float, **ends}, f"drivers[{k}]")
        for k, one in enumerate(document["smallest_detectable"]):
            _check(one, {"name": str, "parameter": str, "value": float}, f"smallest_detectable[{k}]")
        for group, name in (("candidates", "name"), ("drivers", "vehicle")):
            if len({one[name] for one in document[group]}) != len(document[group]):
                raise InputError(f"{group}: a {name} occurs twice")
    except InputError as error:
        raise InputError(f"{path}: is no diagnosis: {error}; give what `sugiyama diagnose --save` wrote") from None
    return document


def check_same(document: Mapping[str, Any], name: Path | str, trajectories: DenseTracks, bag: Path) -> str:
    """Check that a diagnosis is of the recording in a bag. Raises InputError."""
    about = document.get("data")
    data: Mapping[str, Any] = about if isinstance(about, dict) else {}
    checksum, source = data.get("sha256"), file_of(document, str(data.get("source") or "another recording")[:200])
    if not checksum or not trajectories.sha256:
        return f"warning: {name}: does not say which recording it is of; a page needs that of {bag}"
    if checksum == trajectories.sha256:
        return ""
    output = bag.with_name(f"{Path(source).stem}_run.mcap")
    anew = run_command(document, source, None, output, str(document.get("model_file") or ""))
    raise InputError(
        f"{name}: is a diagnosis of {source}, but {bag} is a run of {trajectories.source or 'another file'}; give a run"
        f" of the same file: {anew}"
    )


def file_of(document: Mapping[str, Any], source: str) -> str:
    """The file that was diagnosed, as it was given; ``source`` if the document does not say, or there were several."""
    known = document.get("sources")
    return str(known[0]) if isinstance(known, list) and len(known) == 1 else file_in(source)


def run_command(document: Mapping[str, Any] | None, source: str, ring_m: float | None, output: Path, model: str) -> str:
    """Return the command that runs a recording, as it can be pasted.

    ring_m: circumference [m] to give, if the diagnosis does not know; model: file of the model; empty for none.
    """
    if document is not None and file_of(document, ""):
        source, ring_m = file_of(document, source), document.get("ring_m")
    ring = ["--ring", f"{ring_m:.10g}"] if isinstance(ring_m, int | float) and ring_m else []
    return shlex.join(["sugiyama", "run", source, *ring, "-o", str(output), *(["--model", model] if model else [])])


def _check(value: Any, wanted: Any, where: str) -> None:
    """Check a value against a type, or a mapping of names to types. Raises InputError, with the place."""
    if is_dataclass(wanted):
        wanted = get_type_hints(wanted)
    if isinstance(wanted, dict):
        _check(value, dict, where)
        for name, inner in wanted.items():
            if name not in value:
                raise InputError(f"{where[:80]}: has no {name}")
            _check(value[name], inner, f"{where}.{name}")
    elif isinstance(wanted, UnionType):
        if value is not None:
            _check(value, get_args(wanted)[0], where)
    elif get_origin(wanted) is list:
        _check(value, list, where)
        for k, one in enumerate(value):
            _check(one, get_args(wanted)[0], f"{where}[{k}]")
    elif get_origin(wanted) is dict:
        _check(value, dict, where)
        for name, one in value.items():
            inner = get_args(wanted)[1]
            if one is not None or inner is not float:  # a number may be unknown
                _check(one, inner, f"{where}.{name}")
    elif wanted in (float, int):
        if isinstance(value, str) or value is None:
            raise InputError(f"{where[:80]}: is not a number")
        number(value, where[:80])
    elif wanted is not Any and not isinstance(value, wanted):
        raise InputError(f"{where[:80]}: is not {_KINDS[wanted]}")
