"""The document of a diagnosis, as the report needs it: read and checked field by field."""

import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sugiyama_ros.documents import number, read_json
from sugiyama_ros.errors import InputError
from sugiyama_ros.trajectories.trajectories import Trajectories

_NUMBER, _NUMBER_OR_NULL, _TEXT = "a number", "a number or null", "a text"
#: Fields that the report shows. A list with one entry stands for any number of them, a mapping with the key "" for
#: any names.
_FIELDS: dict[str, Any] = {
    "verdict": {
        "effects": [
            {
                "name": _TEXT,
                "heldout_gain_nats": _NUMBER,
                "heldout_gain_se": _NUMBER,
                "indistinguishable": [_TEXT],
            }
        ]
    },
    "candidates": [{"name": _TEXT, "heldout_gain_nats": _NUMBER_OR_NULL, "heldout_gain_se": _NUMBER_OR_NULL}],
    "smallest_detectable": [{"name": _TEXT, "parameter": _TEXT, "value": _NUMBER}],
    "errors": {"": {}},
    "drivers": [
        {
            "vehicle": _NUMBER,
            "single_car_10s_before_m": _NUMBER_OR_NULL,
            "single_car_10s_after_m": _NUMBER_OR_NULL,
        }
    ],
}
_ERROR = re.compile(r"one_step_rmse_m|loglik_per_sample|(free_run|single_car)_\d+(\.\d+)?s_m")


def read_diagnosis(path: Path) -> dict[str, Any]:
    """Read a document that ``sugiyama diagnose --save`` wrote.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    dict
        The document; all fields that the report shows are there, and of the right type.

    Raises
    ------
    InputError
        If the file cannot be read, or a field is missing or wrong. The message names the field.
    """
    document: dict[str, Any] = read_json(path)
    try:
        _check(document, _FIELDS, "document")
        for model, errors in document["errors"].items():
            for name in filter(_ERROR.fullmatch, errors):
                _check(errors[name], _NUMBER_OR_NULL, f"errors.{model}.{name}")
        for group, name in (("candidates", "name"), ("drivers", "vehicle")):
            if len({one[name] for one in document[group]}) != len(document[group]):
                raise InputError(f"{group}: a {name} occurs twice")
    except InputError as error:
        raise InputError(f"{path}: is no diagnosis: {error}; give what `sugiyama diagnose --save` wrote") from None
    return document


def check_same(document: Mapping[str, Any], name: Path | str, trajectories: Trajectories, bag: Path) -> str:
    """Check that a diagnosis is of the recording in a bag.

    Parameters
    ----------
    document : mapping
        The diagnosis.
    name : Path or str
        What to call the diagnosis in the message.
    trajectories : Trajectories
        What was measured, as the bag has it.
    bag : Path
        The bag.

    Returns
    -------
    str
        A warning if the diagnosis does not say which recording it is of, else nothing.

    Raises
    ------
    InputError
        If the diagnosis is of another recording.
    """
    about = document.get("data")
    data: Mapping[str, Any] = about if isinstance(about, dict) else {}
    checksum, source = data.get("sha256"), file_of(document, str(data.get("source") or "another recording")[:200])
    if not checksum or not trajectories.sha256:
        return f"warning: {name}: does not say which recording it is of; a page needs that of {bag}"
    if checksum == trajectories.sha256:
        return ""
    anew = run_command(document, source, None, bag.with_name(f"{Path(source).stem}_run.mcap"))
    raise InputError(
        f"{name}: is a diagnosis of {source}, but {bag} is a run of {trajectories.source or 'another file'}; give a run"
        f" of the same file: {anew}"
    )


def file_of(document: Mapping[str, Any], source: str) -> str:
    """The file that was diagnosed, as it was given; ``source`` if the document does not say, or there were several."""
    known = document.get("sources")
    return str(known[0]) if isinstance(known, list) and len(known) == 1 else source


def run_command(document: Mapping[str, Any] | None, source: str, ring_m: float | None, output: Path) -> str:
    """Return the command that runs a recording, as it can be pasted.

    Parameters
    ----------
    document : mapping or None
        Diagnosis of the recording, which may know where its file is.
    source : str
        Name of the file, if the diagnosis does not know.
    ring_m : float or None
        Circumference [m] to give, if the diagnosis does not know.
    output : Path
        Bag to write.
    """
    if document is not None and file_of(document, ""):
        source, ring_m = file_of(document, source), document.get("ring_m")
    ring = ["--ring", f"{ring_m:.10g}"] if isinstance(ring_m, int | float) and ring_m else []
    return shlex.join(["sugiyama", "run", source, *ring, "-o", str(output)])


def _check(value: Any, wanted: Any, where: str) -> None:
    """Check a value of the document. Raises InputError, with the place, for another type."""
    if isinstance(wanted, dict):
        if not isinstance(value, dict):
            raise InputError(f"{where[:80]}: is not a mapping")
        for name, inner in wanted.items():
            if name and name not in value:
                raise InputError(f"{where[:80]}: has no {name}")
            for key in [name] if name else value:
                _check(value[key], inner, f"{where}.{key}")
    elif isinstance(wanted, list):
        if not isinstance(value, list):
            raise InputError(f"{where[:80]}: is not a list")
        for k, one in enumerate(value):
            _check(one, wanted[0], f"{where}[{k}]")
    elif wanted == _TEXT:
        if not isinstance(value, str):
            raise InputError(f"{where[:80]}: is not a text")
    elif isinstance(value, str) or (value is None and wanted == _NUMBER):
        raise InputError(f"{where[:80]}: is not {wanted}")
    elif value is not None:
        number(value, where[:80])
