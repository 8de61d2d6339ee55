"""The document of a diagnosis, as the report needs it: read and checked field by field."""

import re
from pathlib import Path
from typing import Any

from sugiyama_ros.documents import number, read_json
from sugiyama_ros.errors import InputError

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
