"""What a diagnosis hands on for pages and pictures: names for people, and the recording driven by the model."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidates import CONSTANTS
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.laws.registry import LAWS

if TYPE_CHECKING:
    from sugiyama_ros.diagnosis.diagnosis import Diagnosis

# Time between two samples of a picture [s], and largest number of points of one run in the document.
_EVERY_S, _MOST = 0.6, 20_000


def drives(d: "Diagnosis") -> dict[str, Any]:
    """Return free runs through all blocks of time with the model before and after the additions, thinned out.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.

    Returns
    -------
    dict
        ``time_s`` (T,), ``block`` (T,), and the positions [m] ``before`` and ``after`` (T, N), wrapped on a ring; None
        where a vehicle is not there. In each block the model starts anew from the measured state. On tracks there is
        no road to show, and the lists are empty.
    """
    around = d.data.vicinity
    if not around.is_whole_road:
        return {"time_s": [], "block": [], "before": [], "after": []}
    every = max(1, round(_EVERY_S / around.period_s), math.ceil(around.position_m.size / _MOST))
    return {
        "time_s": np.round(around.time_s[::every, 0], 3).tolist(),
        "block": d.data.block[0, ::every].tolist(),
        "before": _rows(d.before.block_position_m[::every]),
        "after": _rows(d.after.block_position_m[::every]),
    }


def about() -> dict[str, Any]:
    """Explain every name that the document mentions: effects, constants and laws.

    Returns
    -------
    dict
        For each name: ``kind`` (effect, constants or law), ``title``, ``summary``, and for each of the ``parameters``
        its unit, its meaning, and whether it is a ``place`` or a ``time``. An effect also has ``is_limit``: a smaller
        value of its first parameter is a stronger effect.
    """
    declared: dict[str, Any] = {p.name: p for p in ROW.declared}
    found = {
        c.name: _explained(c.title, c.summary, [declared[name] for name in c.parameters], "constants")
        for c in CONSTANTS
    }
    effects = {
        name: {**_explained(e.title, e.summary, e.parameters, "effect"), "is_limit": e.is_limit}
        for name, e in EFFECTS.items()
    }
    laws = {name: _explained(law.title, law.summary, law.parameters, "law") for name, law in LAWS.items()}
    return {**found, **effects, **laws}


def _explained(title: str, summary: str, parameters: Sequence[Parameter], kind: str) -> dict[str, Any]:
    return {
        "title": title,
        "summary": summary,
        "kind": kind,
        "parameters": {
            p.name: {"unit": "" if p.unit == "1" else p.unit, "meaning": p.description, "axis": p.axis}
            for p in parameters
        },
    }


def _rows(position_m: Array) -> list[list[float | None]]:
    return [[round(x, 1) if np.isfinite(x) else None for x in row] for row in position_m.tolist()]
